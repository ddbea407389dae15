use super::*;
use farm_film::{FrameIndex, Resolution, SampleBlock};
use farm_image::{encode_partial, write_file};

/// Writes a partial of a made-up picture and gives its path.
fn part(folder: &Path, name: &str, tile: [u32; 4], samples: std::ops::Range<u64>, scene: u8) -> PathBuf {
    let tile = Tile::new(tile[0], tile[1], tile[2], tile[3]).unwrap();
    let block = SampleBlock::new(samples).unwrap();
    let sums = tile.pixels().map(|(x, y)| [x as f32, y as f32, block.samples() as f32]).collect();
    let header = PartialHeader {
        resolution: Resolution::new(8, 4).unwrap(),
        frame: FrameIndex(0),
        scene: [scene; 32],
        settings: [2; 32],
        seed: 3,
        renderer: "test".to_owned(),
        counters: Counters::default(),
    };
    let path = folder.join(name);
    write_file(&path, &encode_partial(&FilmTile::new(tile, block, sums), &header)).unwrap();
    path
}

fn merged(folder: &Path, parts: Vec<PathBuf>) -> Result<(), Fault> {
    run(&MergeArgs { parts, output: folder.join("out.exr"), preview: false, json: false })
}

const WHOLE: [u32; 4] = [0, 0, 8, 4];

#[test]
fn parts_in_any_order_make_a_picture() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let a = part(at, "a.exr", [0, 0, 8, 2], 0..64, 1);
    let b = part(at, "b.exr", [0, 2, 8, 4], 0..32, 1);
    let c = part(at, "c.exr", [0, 2, 8, 4], 32..64, 1);
    merged(at, vec![c, a, b]).unwrap();
    assert!(at.join("out.exr").exists());
}

#[test]
fn overlaps_gaps_and_strangers_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let refusal = |parts: Vec<PathBuf>| merged(at, parts).unwrap_err().to_string();
    let a = part(at, "a.exr", WHOLE, 0..32, 1);
    let again = part(at, "again.exr", WHOLE, 0..16, 1);
    let later = part(at, "later.exr", WHOLE, 64..128, 1);
    let half = part(at, "half.exr", [0, 0, 4, 4], 0..32, 1);
    let askew = part(at, "askew.exr", [2, 0, 8, 4], 0..32, 1);
    let other = part(at, "other.exr", WHOLE, 32..64, 7);

    let fault = refusal(vec![a.clone(), again]);
    assert!(fault.contains("a.exr") && fault.contains("again.exr") && fault.contains("overlap"), "{fault}");
    let fault = refusal(vec![a.clone(), later]);
    assert!(fault.contains("samples 32..64") && fault.contains("later.exr"), "{fault}");
    assert!(refusal(vec![half.clone()]).contains("16 of the 32 pixels"));
    let fault = refusal(vec![half, askew]);
    assert!(fault.contains("half.exr") && fault.contains("askew.exr"), "{fault}");
    let fault = refusal(vec![a, other]);
    assert!(fault.contains("other.exr") && fault.contains("another scene"), "{fault}");
    std::fs::write(at.join("text.exr"), "no picture").unwrap();
    assert!(refusal(vec![at.join("text.exr")]).contains("text.exr"));
    assert!(refusal(vec![at.join("none.exr")]).contains("none.exr"));
    assert!(!at.join("out.exr").exists());
}
