//! Scenes: as glTF, and as the snapshots that travel.

use crate::scenes::{Named, Scale};
use farm_import::{ImportOptions, import};
use farm_scene::{Scene, decode, encode};
use std::path::Path;

const NAMES: [&str; 3] = ["cornell-diffuse", "slit", "lens-motion"];

/// A scene that has little of everything: skin, morph targets, animation, sparse accessors, copies, a lens, lights.
const RICH: &str = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
"nodes": [{"children": [1, 2, 3], "mesh": 0, "skin": 0, "weights": [0.5]}, {"camera": 0, "translation": [0, 1, 2]},
{"mesh": 1, "rotation": [0, 0, 0, 1], "extensions": {"KHR_lights_punctual": {"light": 0}}},
{"mesh": 1, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}}}],
"meshes": [{"primitives": [{"attributes": {"POSITION": 0, "JOINTS_0": 3, "WEIGHTS_0": 4}, "indices": 1,
"targets": [{"POSITION": 6}]}]}, {"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 2}, "indices": 1}]}],
"skins": [{"joints": [1, 2]}], "cameras": [{"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1},
"extras": {"fStop": 2, "apertureBlades": 5}}],
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
"bufferViews": [{"buffer": 0, "byteLength": 188}],
"buffers": [{"byteLength": 188, "uri": "data:application/octet-stream;base64,DATA"}]}"#;

fn rich() -> Vec<u8> {
    let mut bytes: Vec<u8> = vec![];
    let floats = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    bytes.extend(floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0]));
    bytes.extend([0_u16, 1, 2, 0, 2, 3].iter().flat_map(|index| index.to_le_bytes()));
    bytes.extend(floats(&[0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]));
    bytes.extend([1, 0, 0, 0].repeat(4));
    bytes.extend(floats(&[0.5, 0.5, 0.0, 0.0].repeat(4)));
    bytes.extend(floats(&[0.25, 1.0]));
    bytes.extend([0, 0, 0, 0, 1, 0, 3, 0]);
    let data = base64::Engine::encode(&base64::engine::general_purpose::STANDARD, &bytes);
    RICH.replace("DATA", &data).into_bytes()
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
    named().map(|scene| scene.glb(Scale(0))).collect()
}

pub(super) fn decode_document(bytes: &[u8], file: &Path) -> bool {
    std::fs::write(file, bytes).expect("a temporary file");
    import(file, &ImportOptions::default()).is_ok()
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
