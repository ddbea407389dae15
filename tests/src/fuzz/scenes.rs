//! Scenes: as glTF, and as the snapshots that travel.

use crate::scenes::{Named, Scale};
use farm_import::{ImportOptions, import};
use farm_scene::{Scene, decode, encode};
use std::path::Path;

const NAMES: [&str; 3] = ["cornell-diffuse", "slit", "lens-motion"];

/// A document that has little of everything: skin, morph targets, animation, sparse accessors, copies, a picture, a lens, lights.
/// BUFFER, ALL and PICTURE stand for where its bytes are and how many there are.
const RICH: &str = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
"nodes": [{"children": [1, 2, 3], "mesh": 0, "skin": 0, "weights": [0.5]}, {"camera": 0, "translation": [0, 1, 2]},
{"mesh": 1, "rotation": [0, 0, 0, 1], "extensions": {"KHR_lights_punctual": {"light": 0}}},
{"mesh": 1, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}}}],
"meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 2, "JOINTS_0": 3, "WEIGHTS_0": 4}, "indices": 1,
"material": 0, "mode": 4, "targets": [{"POSITION": 6}]}]},
{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 2}, "indices": 1}]}],
"materials": [{"normalTexture": {"index": 0, "texCoord": 0}, "alphaMode": "MASK", "alphaCutoff": 0.25,
"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0.5},
"extensions": {"KHR_materials_ior": {"ior": 1.4}, "KHR_materials_transmission": {"transmissionFactor": 1}}}],
"textures": [{"source": 0, "sampler": 0}], "samplers": [{"wrapS": 10497, "magFilter": 9729}],
"images": [{"bufferView": 1}], "skins": [{"joints": [1, 2]}],
"cameras": [{"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1}, "extras": {"fStop": 2, "apertureBlades": 5}}],
"extensions": {"KHR_lights_punctual": {"lights": [{"type": "spot", "intensity": 5, "spot": {"outerConeAngle": 0.5}}]}},
"animations": [{"samplers": [{"input": 5, "output": 5}, {"input": 5, "output": 0, "interpolation": "STEP"}],
"channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}]}],
"accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 4},
{"bufferView": 0, "byteOffset": 48, "componentType": 5123, "type": "SCALAR", "count": 6},
{"bufferView": 0, "byteOffset": 60, "componentType": 5126, "type": "VEC2", "count": 4},
{"bufferView": 0, "byteOffset": 92, "componentType": 5121, "type": "VEC4", "count": 4},
{"bufferView": 0, "byteOffset": 108, "componentType": 5126, "type": "VEC4", "count": 4},
{"bufferView": 0, "byteOffset": 172, "componentType": 5126, "type": "SCALAR", "count": 2},
{"componentType": 5126, "type": "VEC3", "count": 4, "sparse": {"count": 2,
"indices": {"bufferView": 0, "byteOffset": 184, "componentType": 5123}, "values": {"bufferView": 0, "byteOffset": 0}}}],
"bufferViews": [{"buffer": 0, "byteLength": 188}, {"buffer": 0, "byteOffset": 188, "byteLength": PICTURE}],
"buffers": [{"byteLength": ALL BUFFER}]}"#;

/// Bytes before the picture.
const NUMBERS: usize = 188;

/// The bytes of the rich document.
fn rich_bytes() -> Vec<u8> {
    let mut bytes: Vec<u8> = vec![];
    let floats = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    bytes.extend(floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0]));
    bytes.extend([0_u16, 1, 2, 0, 2, 3].iter().flat_map(|index| index.to_le_bytes()));
    bytes.extend(floats(&[0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]));
    bytes.extend([1, 0, 0, 0].repeat(4));
    bytes.extend(floats(&[0.5, 0.5, 0.0, 0.0].repeat(4)));
    bytes.extend(floats(&[0.25, 1.0]));
    bytes.extend([0, 0, 0, 0, 1, 0, 3, 0]);
    assert_eq!(bytes.len(), NUMBERS, "as the accessors say");
    bytes.extend(&super::images::textures()[0]);
    bytes
}

fn rich_text(buffer: &str) -> String {
    let all = rich_bytes().len();
    RICH.replace("PICTURE", &(all - NUMBERS).to_string())
        .replace("ALL", &all.to_string())
        .replace("BUFFER", buffer)
}

fn rich() -> Vec<u8> {
    let data = base64::Engine::encode(&base64::engine::general_purpose::STANDARD, rich_bytes());
    rich_text(&format!(r#", "uri": "data:application/octet-stream;base64,{data}""#)).into_bytes()
}

fn rich_container() -> Vec<u8> {
    let (json, bytes) = (rich_text("").into_bytes(), rich_bytes());
    let mut file = b"glTF\x02\0\0\0".to_vec();
    file.extend((12 + 8 + json.len() as u32 + 8 + bytes.len() as u32).to_le_bytes());
    for (kind, body) in [(b"JSON", json), (b"BIN\0", bytes)] {
        file.extend((body.len() as u32).to_le_bytes());
        file.extend_from_slice(kind);
        file.extend(body);
    }
    file
}

fn named() -> impl Iterator<Item = Named> {
    NAMES.into_iter().filter_map(Named::find)
}

pub(super) fn documents() -> Vec<Vec<u8>> {
    let texts = named().map(|scene| scene.text(Scale(0)).into_bytes());
    // The rich one is small: it is where most of the damage is interesting.
    texts.chain(std::iter::repeat_n(rich(), 6)).collect()
}

pub(super) fn containers() -> Vec<Vec<u8>> {
    named().map(|scene| scene.glb(Scale(0))).chain(std::iter::repeat_n(rich_container(), 3)).collect()
}

pub(super) fn decode_document(bytes: &[u8], file: &Path) -> bool {
    std::fs::write(file, bytes).expect("a temporary file");
    let outcome = import(file, &ImportOptions::default());
    if let Err(error) = &outcome {
        assert!(error.to_string().len() > 20, "a sentence: {error}");
    }
    outcome.is_ok()
}

/// As it is, and with a header that agrees with the length: a file that was cut is refused by its header alone.
pub(super) fn decode_container(bytes: &[u8], file: &Path) -> bool {
    let accepted = decode_document(bytes, file);
    let mut agreeing = bytes.to_vec();
    let length = (bytes.len() as u32).to_le_bytes();
    match agreeing.get_mut(8..12) {
        Some(place) if place != length => place.copy_from_slice(&length),
        _ => return accepted,
    }
    decode_document(&agreeing, file) || accepted
}

pub(super) fn snapshots() -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().expect("a folder for temporary files");
    let file = folder.path().join("scene");
    let scene = |bytes: Vec<u8>| -> Scene {
        std::fs::write(&file, bytes).expect("a temporary file");
        import(&file, &ImportOptions::default()).expect("our own scenes are scenes").scene
    };
    documents().into_iter().map(|bytes| encode(&scene(bytes))).collect()
}

pub(super) fn decode_snapshot(bytes: &[u8], _: &Path) -> bool {
    decode(bytes).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rich_document_is_a_scene_with_all_that_it_has() {
        let folder = tempfile::tempdir().expect("a folder");
        for (name, bytes) in [("rich.gltf", rich()), ("rich.glb", rich_container())] {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).expect("a file");
            let imported = import(&path, &ImportOptions::default()).unwrap_or_else(|err| panic!("{err}"));
            let scene = imported.scene;
            assert_eq!(imported.report.warnings, Vec::<String>::new());
            let counts = (scene.channels.len(), scene.skins.len(), scene.lights.len(), scene.images.len());
            assert_eq!(counts, (1, 1, 1, 1), "{name}");
            assert!(scene.meshes[0].tangents.is_some() && scene.meshes[0].morph_targets.len() == 1);
        }
    }
}
