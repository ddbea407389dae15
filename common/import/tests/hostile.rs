//! Small files that ask for enormous scenes: the answer comes soon, and is a sentence or a scene of bearable size.

use farm_import::{ImportOptions, Imported, import};
use std::time::{Duration, Instant};

/// Far beyond what any of these takes, also on a busy machine.
const TIME_MAX: Duration = Duration::from_secs(20);

/// A triangle, and room for a few numbers behind it.
fn buffer() -> String {
    let positions = [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let bytes: Vec<u8> = positions.iter().flat_map(|value| value.to_le_bytes()).chain([0; 64]).collect();
    let data: String = bytes.iter().map(|byte| format!("%{byte:02x}")).collect();
    format!(
        r#""buffers": [{{"byteLength": 100, "uri": "data:application/octet-stream,{data}"}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 100}}]"#
    )
}

fn imported(rest: &str) -> Result<Imported, String> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("hostile.gltf");
    let text = format!(r#"{{"asset": {{"version": "2.0"}}, "scene": 0, {}, {rest}}}"#, buffer());
    std::fs::write(&path, text).expect("a file");
    let started = Instant::now();
    let outcome = import(&path, &ImportOptions::default());
    let elapsed = started.elapsed();
    assert!(elapsed < TIME_MAX, "took {elapsed:?}");
    outcome.map_err(|err| err.to_string())
}

fn refused(rest: &str, words: &str) {
    let said = imported(rest).expect_err("refused");
    assert!(said.contains(words), "{said}");
}

fn repeated(count: usize, part: impl Fn(usize) -> String) -> String {
    (0..count).map(part).collect::<Vec<_>>().join(", ")
}

const POSITIONS: &str = r#"{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3}"#;
const MESH: &str = r#""meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}]"#;

#[test]
fn copies_that_no_data_stands_for_are_refused() {
    for count in [1_000_000_u64, 2_000_000_000, u64::from(u32::MAX)] {
        let rest = format!(
            r#""scenes": [{{"nodes": [0]}}], {MESH},
            "nodes": [{{"mesh": 0, "extensions": {{"EXT_mesh_gpu_instancing": {{"attributes": {{"TRANSLATION": 1}}}}}}}}],
            "accessors": [{POSITIONS}, {{"componentType": 5126, "type": "VEC3", "count": {count}}}]"#
        );
        refused(&rest, "far more data than the file's buffers could hold");
    }
}

#[test]
fn many_nodes_that_share_many_copies_are_refused() {
    let node =
        r#"{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 1}}}}"#;
    let rest = format!(
        r#""scenes": [{{"nodes": [{}]}}], {MESH}, "nodes": [{}],
        "accessors": [{POSITIONS}, {{"componentType": 5126, "type": "VEC3", "count": 1000}}]"#,
        repeated(5000, |node| node.to_string()),
        repeated(5000, |_| node.to_owned())
    );
    refused(&rest, "far more data");
}

#[test]
fn many_nodes_that_share_a_mesh_of_many_parts_are_refused() {
    let rest = format!(
        r#""scenes": [{{"nodes": [{}]}}], "nodes": [{}], "meshes": [{{"primitives": [{}]}}], "accessors": [{POSITIONS}]"#,
        repeated(5000, |node| node.to_string()),
        repeated(5000, |_| r#"{"mesh": 0}"#.to_owned()),
        repeated(5000, |_| r#"{"attributes": {"POSITION": 0}}"#.to_owned())
    );
    refused(&rest, "far more data");
}

#[test]
fn many_roots_below_a_long_chain_are_read_at_once() {
    const LENGTH: usize = 40_000;
    let chain = repeated(LENGTH - 1, |node| format!(r#"{{"children": [{}]}}"#, node + 1));
    let leaves = repeated(LENGTH, |leaf| (LENGTH + leaf).to_string());
    let rest = format!(
        r#""scenes": [{{"nodes": [{leaves}]}}], "nodes": [{chain}, {{"children": [{leaves}]}}, {}]"#,
        repeated(LENGTH, |_| "{}".to_owned())
    );
    let scene = imported(&rest).expect("a scene").scene;
    assert!(scene.nodes.len() >= LENGTH);
}

#[test]
fn many_nodes_that_share_a_skin_of_many_joints_are_read_at_once() {
    const COUNT: usize = 20_000;
    let all = repeated(COUNT, |node| node.to_string());
    let rest = format!(
        r#""scenes": [{{"nodes": [{all}]}}], "nodes": [{}], {MESH}, "skins": [{{"joints": [{all}]}}], "accessors": [{POSITIONS}]"#,
        repeated(COUNT, |_| r#"{"mesh": 0, "skin": 0}"#.to_owned())
    );
    assert_eq!(imported(&rest).expect("a scene").report.triangles_drawn, COUNT as u64);
}

#[test]
fn pictures_that_unpack_to_far_more_than_they_hold_are_refused() {
    // 16384 x 16384 grey pixels of 16 bits in a file of some hundred bytes: the header alone counts.
    let header = |side: u32| {
        let mut ihdr = b"IHDR".to_vec();
        ihdr.extend(side.to_be_bytes());
        ihdr.extend(side.to_be_bytes());
        ihdr.extend([16, 0, 0, 0, 0]);
        let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\r".to_vec();
        png.extend(&ihdr);
        png.extend(crc32(&ihdr).to_be_bytes());
        let idat = b"IDAT";
        png.extend(0_u32.to_be_bytes());
        png.extend(idat);
        png.extend(crc32(idat).to_be_bytes());
        png
    };
    let uri = |side| {
        let data: String = header(side).iter().map(|byte| format!("%{byte:02x}")).collect();
        format!("data:image/png,{data}")
    };
    let scene = |side: u32, count: usize| {
        format!(
            r#""scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}], "accessors": [{POSITIONS}],
            "meshes": [{{"primitives": [{}]}}], "materials": [{}], "textures": [{}], "images": [{}]"#,
            repeated(count, |part| format!(r#"{{"attributes": {{"POSITION": 0}}, "material": {part}}}"#)),
            repeated(count, |part| format!(
                r#"{{"pbrMetallicRoughness": {{"baseColorTexture": {{"index": {part}}}}}}}"#
            )),
            repeated(count, |part| format!(r#"{{"source": {part}}}"#)),
            // Each a text of its own, so that none is taken for another.
            repeated(count, |part| format!(r#"{{"uri": "{}%{:02x}"}}"#, uri(side), part))
        )
    };
    refused(&scene(16384, 12), "make them smaller");
    refused(&scene(1 << 17, 1), "cannot be decoded");
}

/// ISO 3309, as PNG has it.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, byte: &u8| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg()))
    };
    !bytes.iter().fold(!0, step)
}
