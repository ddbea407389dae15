//! Damaged files: whatever the bytes are, the answer comes soon, and is a scene or a sentence.

use farm_import::{ImportOptions, import};
use std::path::Path;
use std::time::{Duration, Instant};

/// Files per kind of damage.
const FILES: u64 = 2_000;

/// Far beyond what a small file takes, also on a busy machine.
const TIME_MAX: Duration = Duration::from_secs(5);

/// Numbers that are where bugs are.
const NASTY: [&str; 12] = [
    "-1",
    "0",
    "1",
    "3",
    "255",
    "65536",
    "4294967295",
    "4294967296",
    "18446744073709551615",
    "1e300",
    "-0.5",
    "null",
];

/// SplitMix64 (Steele, Lea, Flood 2014).
struct Dice(u64);

impl Dice {
    fn roll(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, end: usize) -> usize {
        (self.roll() % end as u64) as usize
    }
}

/// A document with something of everything: skin, morph targets, animation, sparse accessor, image, lens, light.
fn document() -> String {
    let accessor = |offset: usize, component: u32, kind: &str, count: usize| {
        format!(
            r#"{{"bufferView": 0, "byteOffset": {offset}, "componentType": {component}, "type": "{kind}", "count": {count}}}"#
        )
    };
    let accessors = [
        accessor(0, 5126, "VEC3", 4),
        accessor(48, 5123, "SCALAR", 6),
        accessor(60, 5126, "VEC2", 4),
        accessor(92, 5121, "VEC4", 4),
        accessor(108, 5126, "VEC4", 4),
        accessor(172, 5126, "SCALAR", 2),
        r#"{"componentType": 5126, "type": "VEC3", "count": 4, "sparse": {"count": 2,
        "indices": {"bufferView": 0, "byteOffset": 184, "componentType": 5123}, "values": {"bufferView": 0, "byteOffset": 0}}}"#
            .to_owned(),
    ];
    format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}],
        "nodes": [{{"children": [1, 2], "mesh": 0, "skin": 0, "weights": [0.5]}}, {{"camera": 0, "translation": [0, 1, 2]}},
        {{"mesh": 0, "rotation": [0, 0, 0, 1], "extensions": {{"KHR_lights_punctual": {{"light": 0}}}}}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0, "TEXCOORD_0": 2, "JOINTS_0": 3, "WEIGHTS_0": 4}},
        "indices": 1, "material": 0, "mode": 4, "targets": [{{"POSITION": 6}}]}}]}}],
        "materials": [{{"normalTexture": {{"index": 0, "texCoord": 0}}, "alphaMode": "MASK", "alphaCutoff": 0.25,
        "pbrMetallicRoughness": {{"baseColorTexture": {{"index": 0}}, "metallicFactor": 0.5}},
        "extensions": {{"KHR_materials_ior": {{"ior": 1.4}}, "KHR_materials_transmission": {{"transmissionFactor": 1}}}}}}],
        "textures": [{{"source": 0, "sampler": 0}}], "samplers": [{{"wrapS": 10497, "magFilter": 9729}}],
        "images": [{{"bufferView": 1}}], "skins": [{{"joints": [1, 2]}}],
        "cameras": [{{"type": "perspective", "perspective": {{"yfov": 0.8, "znear": 0.1}}, "extras": {{"fStop": 2, "apertureBlades": 5}}}}],
        "extensions": {{"KHR_lights_punctual": {{"lights": [{{"type": "spot", "intensity": 5, "spot": {{"outerConeAngle": 0.5}}}}]}}}},
        "animations": [{{"samplers": [{{"input": 5, "output": 5}}, {{"input": 5, "output": 0, "interpolation": "STEP"}}],
        "channels": [{{"sampler": 0, "target": {{"node": 0, "path": "weights"}}}}]}}],
        "accessors": [{}], "bufferViews": [{{"buffer": 0, "byteLength": 188}}, {{"buffer": 0, "byteOffset": 188, "byteLength": PNG}}],
        "buffers": [{{"byteLength": ALL}}]}}"#,
        accessors.join(", ")
    )
}

fn buffer() -> Vec<u8> {
    let mut bytes = vec![];
    let positions = [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0];
    bytes.extend(positions.iter().flat_map(|value| value.to_le_bytes()));
    bytes.extend([0_u16, 1, 2, 0, 2, 3].iter().flat_map(|index| index.to_le_bytes()));
    bytes.extend([0.0_f32, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0].iter().flat_map(|value| value.to_le_bytes()));
    bytes.extend([1, 0, 0, 0].repeat(4));
    bytes.extend([0.5_f32, 0.5, 0.0, 0.0].repeat(4).iter().flat_map(|value| value.to_le_bytes()));
    bytes.extend([0.25_f32, 1.0].iter().flat_map(|value| value.to_le_bytes()));
    bytes.extend([0, 0, 0, 0, 1, 0, 3, 0]);
    let mut png = std::io::Cursor::new(vec![]);
    let image = image::RgbImage::from_fn(9, 7, |x, y| image::Rgb([x as u8 * 20, y as u8 * 30, 99]));
    image.write_to(&mut png, image::ImageFormat::Png).expect("a picture");
    bytes.extend(png.into_inner());
    bytes
}

fn glb(json: &str, bin: &[u8]) -> Vec<u8> {
    let json = json.replace("PNG", &(bin.len() - 188).to_string()).replace("ALL", &bin.len().to_string());
    let mut file = b"glTF\x02\0\0\0".to_vec();
    file.extend((12 + 8 + json.len() as u32 + 8 + bin.len() as u32).to_le_bytes());
    for (kind, body) in [(b"JSON", json.as_bytes()), (b"BIN\0", bin)] {
        file.extend((body.len() as u32).to_le_bytes());
        file.extend_from_slice(kind);
        file.extend_from_slice(body);
    }
    file
}

/// Imports the file; gives whether it became a scene.
fn survives(path: &Path, bytes: &[u8], seed: u64) -> bool {
    std::fs::write(path, bytes).expect("a file");
    let started = Instant::now();
    let outcome = import(path, &ImportOptions::default());
    let elapsed = started.elapsed();
    assert!(elapsed < TIME_MAX, "seed {seed} took {elapsed:?}");
    if let Err(error) = &outcome {
        assert!(error.to_string().len() > 20, "seed {seed}: {error}");
    }
    outcome.is_ok()
}

fn each_seed(damage: impl Fn(&mut Dice) -> Vec<u8>) -> u64 {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("damaged.glb");
    (0..FILES).filter(|&seed| survives(&path, &damage(&mut Dice(seed)), seed)).count() as u64
}

#[test]
fn the_undamaged_file_is_a_scene() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("whole.glb");
    std::fs::write(&path, glb(&document(), &buffer())).expect("a file");
    let imported = import(&path, &ImportOptions::default()).unwrap_or_else(|err| panic!("{err}"));
    let scene = imported.scene;
    assert_eq!(imported.report.warnings, Vec::<String>::new());
    assert_eq!(
        (scene.channels.len(), scene.skins.len(), scene.lights.len(), scene.images.len()),
        (1, 1, 1, 1)
    );
    assert!(scene.meshes[0].tangents.is_some() && scene.meshes[0].morph_targets.len() == 1);
}

#[test]
fn changed_bytes_do_no_harm() {
    let whole = glb(&document(), &buffer());
    let scenes = each_seed(|dice| {
        let mut file = whole.clone();
        for _ in 0..=dice.below(4) {
            let at = dice.below(file.len());
            file[at] = dice.roll() as u8;
        }
        file
    });
    assert!(scenes > 0 && scenes < FILES, "{scenes}");
}

#[test]
fn cut_files_do_no_harm() {
    let whole = glb(&document(), &buffer());
    let scenes = each_seed(|dice| {
        let mut file = whole[..dice.below(whole.len())].to_vec();
        // Every other time the header agrees.
        if file.len() >= 12 && dice.below(2) == 0 {
            let length = file.len() as u32;
            file[8..12].copy_from_slice(&length.to_le_bytes());
        }
        file
    });
    assert_eq!(scenes, 0);
}

#[test]
fn nasty_numbers_do_no_harm() {
    let (json, bin) = (document(), buffer());
    let numbers: Vec<usize> = json
        .match_indices(|c: char| c.is_ascii_digit())
        .map(|(at, _)| at)
        .filter(|&at| matches!(json.as_bytes()[at - 1], b' ' | b'['))
        .collect();
    let scenes = each_seed(|dice| {
        let mut json = json.clone();
        let at = numbers[dice.below(numbers.len())];
        let end = json[at..].find([',', '}', ']']).map_or(at + 1, |length| at + length);
        json.replace_range(at..end, NASTY[dice.below(NASTY.len())]);
        glb(&json, &bin)
    });
    assert!(scenes > 0 && scenes < FILES, "{scenes}");
}
