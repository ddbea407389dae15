//! The JSON of a scene: looked over once as plain values, because the typed view would refuse valid files, cut indices to 32
//! bits and round places to f32; then typed.

use crate::error::{Fault, Place};
use crate::report::Warnings;
use farm_scene::Transform;
use glam::{DMat4, DQuat, DVec3};
use gltf::json::Root;
use serde_json::{Map, Value};

/// Extensions that are read.
const UNDERSTOOD: &[&str] = &[
    "EXT_camera_physical",
    "EXT_lights_area",
    "EXT_mesh_gpu_instancing",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// Extensions that change no picture: other choices of material, and notes about the file.
const HARMLESS: &[&str] = &["KHR_materials_variants", "KHR_xmp", "KHR_xmp_json_ld"];

/// Properties whose value is an index, or an array of indices.
const INDEX_KEYS: &[&str] = &[
    "buffer",
    "bufferView",
    "camera",
    "children",
    "index",
    "indices",
    "input",
    "inverseBindMatrices",
    "joints",
    "light",
    "material",
    "mesh",
    "node",
    "nodes",
    "output",
    "sampler",
    "scene",
    "skeleton",
    "skin",
    "source",
    "texCoord",
];

/// A scene's document.
pub(crate) struct Document {
    /// Everything, typed; indices are not checked yet.
    pub root: Root,
    /// Each node's place, in the precision that the text has.
    pub transforms: Vec<Transform>,
}

/// Reads a document.
pub(crate) fn parse(json: &[u8], warnings: &Warnings) -> Result<Document, Fault> {
    let mut value: Value =
        serde_json::from_slice(json).map_err(|err| Fault::whole(format!("is not valid JSON: {err}")))?;
    let object =
        value.as_object_mut().ok_or_else(|| Fault::whole("is no glTF: its JSON is not an object"))?;
    check_version(object)?;
    check_extensions(object, warnings)?;
    check_indices(object)?;
    let transforms = read_transforms(object)?;
    complete(object, warnings);
    let root = serde_path_to_error::deserialize(value).map_err(|err| {
        Fault::at(err.path().to_string(), format!("is not what glTF 2.0 has there: {}", err.inner()))
    })?;
    Ok(Document { root, transforms })
}

fn check_version(object: &Map<String, Value>) -> Result<(), Fault> {
    let place = Place::only("asset");
    let asset = object.get("asset").ok_or_else(|| place.fault("is missing; the file is no glTF 2.0"))?;
    let version = asset.get("version").and_then(Value::as_str).unwrap_or("none");
    place.ensure(version.starts_with("2."), || {
        format!("has version {version:?}; export the scene as glTF 2.0")
    })?;
    let least = asset.get("minVersion").and_then(Value::as_str).unwrap_or("2.0");
    place.ensure(least == "2.0", || format!("needs version {least:?} at least; glTF 2.0 is read"))
}

fn check_extensions(object: &Map<String, Value>, warnings: &Warnings) -> Result<(), Fault> {
    let names = |key: &str| {
        let list = object.get(key).and_then(Value::as_array).map(Vec::as_slice).unwrap_or_default();
        list.iter().filter_map(Value::as_str)
    };
    let known = |name: &str| UNDERSTOOD.contains(&name) || HARMLESS.contains(&name);
    let unknown: Vec<_> = names("extensionsRequired").filter(|name| !known(name)).collect();
    Place::only("extensionsRequired").ensure(unknown.is_empty(), || {
        format!("{} cannot be read; export the scene without it", unknown.join(", "))
    })?;
    for name in names("extensionsUsed").filter(|name| !known(name)) {
        warnings.add(&"extensionsUsed", format!("{name} is not understood and has no effect"));
    }
    Ok(())
}

/// The typed view takes an index modulo 2^32, so one that is larger would go unnoticed.
fn check_indices(object: &Map<String, Value>) -> Result<(), Fault> {
    let mut open: Vec<(&str, &Value, bool)> = vec![];
    open.extend(object.iter().map(|(key, value)| (key.as_str(), value, INDEX_KEYS.contains(&key.as_str()))));
    while let Some((key, value, is_index)) = open.pop() {
        match value {
            Value::Number(number) if is_index => {
                let fits = number.as_u64().is_some_and(|index| index < u64::from(u32::MAX));
                Place::only(key).ensure(fits, || format!("{number} is no index"))?;
            }
            Value::Array(values) => {
                let nested = key == "targets";
                open.extend(values.iter().map(|value| (key, value, is_index || nested)));
            }
            Value::Object(object) => {
                let all = matches!(key, "attributes" | "targets");
                let inner = object.iter().filter(|(key, _)| *key != "extras");
                open.extend(
                    inner
                        .map(|(key, value)| (key.as_str(), value, all || INDEX_KEYS.contains(&key.as_str()))),
                );
            }
            _ => {}
        }
    }
    Ok(())
}

/// Makes valid documents complete where the typed view wants more than the specification does.
fn complete(object: &mut Map<String, Value>, warnings: &Warnings) {
    for (list, key) in [("scenes", "nodes"), ("meshes", "primitives")] {
        for entry in object.get_mut(list).and_then(Value::as_array_mut).into_iter().flatten() {
            if let Some(entry) = entry.as_object_mut() {
                entry.entry(key).or_insert_with(|| Value::Array(Vec::new()));
            }
        }
    }
    let animations = object.get_mut("animations").and_then(Value::as_array_mut);
    for (index, animation) in animations.into_iter().flatten().enumerate() {
        let Some(channels) = animation.get_mut("channels").and_then(Value::as_array_mut) else { continue };
        let all = channels.len();
        channels
            .retain(|channel| channel.pointer("/target").is_none_or(|target| target.get("node").is_some()));
        if channels.len() < all {
            let place = Place::new("animation", index, None);
            warnings.add(&place, "moves something other than nodes, which stays still");
        }
    }
}

fn read_transforms(object: &Map<String, Value>) -> Result<Vec<Transform>, Fault> {
    let nodes = object.get("nodes").and_then(Value::as_array).map(Vec::as_slice).unwrap_or_default();
    let named = |node: &Value| node.get("name").and_then(Value::as_str).map(str::to_owned);
    nodes
        .iter()
        .enumerate()
        .map(|(index, node)| read_transform(node, &Place::new("node", index, named(node).as_deref())))
        .collect()
}

fn read_transform(node: &Value, place: &Place) -> Result<Transform, Fault> {
    let translation = numbers::<3>(node, "translation", place)?;
    let rotation = numbers::<4>(node, "rotation", place)?;
    let scale = numbers::<3>(node, "scale", place)?;
    if let Some(columns) = numbers::<16>(node, "matrix", place)? {
        let matrix = DMat4::from_cols_array(&columns);
        let affine = matrix.row(3).to_array() == [0.0, 0.0, 0.0, 1.0];
        place.field("matrix").ensure(affine, || "must have (0, 0, 0, 1) as its bottom row".to_owned())?;
        // A matrix beside other properties is invalid; those are then the identity in all files seen.
        return Ok(Transform::Matrix(matrix));
    }
    let rotation = DQuat::from_array(rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]));
    let length = rotation.length();
    place.field("rotation").ensure(length > 0.0 && length.is_finite(), || {
        "must be a quaternion of length 1; none is [0, 0, 0, 1]".to_owned()
    })?;
    Ok(Transform::Trs {
        translation: DVec3::from_array(translation.unwrap_or_default()),
        rotation: DQuat::from_array(rotation.to_array().map(|component| component / length)),
        scale: DVec3::from_array(scale.unwrap_or([1.0; 3])),
    })
}

fn numbers<const N: usize>(node: &Value, key: &str, place: &Place) -> Result<Option<[f64; N]>, Fault> {
    let Some(value) = node.get(key) else { return Ok(None) };
    let read: Option<Vec<f64>> =
        value.as_array().and_then(|values| values.iter().map(Value::as_f64).collect());
    let read = read.and_then(|numbers| <[f64; N]>::try_from(numbers).ok());
    read.map(Some).ok_or_else(|| place.field(key).fault(format!("must be an array of {N} numbers")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse_text(json: &str) -> Result<Document, String> {
        parse(json.as_bytes(), &Warnings::default())
            .map_err(|fault| format!("{}: {}", fault.place.unwrap_or_default(), fault.what))
    }

    fn with(rest: &str) -> String {
        format!(r#"{{"asset": {{"version": "2.0"}}, {rest}}}"#)
    }

    #[test]
    fn valid_files_that_the_typed_view_refuses_are_read() {
        let warnings = Warnings::default();
        let json = with(
            r#""scenes": [{}], "extensionsUsed": ["KHR_animation_pointer"], "animations": [{"samplers": [],
            "channels": [{"sampler": 0, "target": {"path": "pointer"}}]}]"#,
        );
        let document = parse(json.as_bytes(), &warnings).expect("valid");
        assert!(document.root.scenes[0].nodes.is_empty() && document.root.animations[0].channels.is_empty());
        let said = warnings.into_sentences().join("; ");
        assert!(
            said.contains("KHR_animation_pointer is not understood") && said.contains("animation 0"),
            "{said}"
        );
    }

    #[test]
    fn places_keep_the_precision_of_the_text() {
        let json = with(r#""nodes": [{"translation": [10000000.3, 0.1, -0.0]}]"#);
        let document = parse_text(&json).expect("valid");
        let Transform::Trs { translation, .. } = document.transforms[0] else { panic!("no matrix") };
        assert_eq!(translation.to_array().map(f64::to_bits), [10000000.3_f64, 0.1, -0.0].map(f64::to_bits));
    }

    #[test]
    fn what_is_no_gltf_is_refused_with_its_place() {
        let deep = "[".repeat(100_000);
        for (json, expected) in [
            ("", "not valid JSON"),
            ("[]", "not an object"),
            (deep.as_str(), "recursion limit"),
            (r#"{"asset": {"version": "2.0"}, "scene": NaN}"#, "not valid JSON"),
            ("{}", "asset: is missing"),
            (r#"{"asset": {"version": "1.0"}}"#, "version \"1.0\""),
            (r#"{"asset": {"version": "2.0", "minVersion": "2.1"}}"#, "\"2.1\""),
            (&with(r#""extensionsRequired": ["KHR_draco_mesh_compression"]"#), "KHR_draco_mesh_compression"),
            (&with(r#""meshes": [{"primitives": [{"attributes": {"POSITION": 4294967296}}]}]"#), "POSITION"),
            (&with(r#""scenes": [{"nodes": [-1]}]"#), "nodes"),
            (&with(r#""accessors": [{"count": 1e300}]"#), "accessors[0].count"),
            (&with(r#""accessors": [{"count": "3"}]"#), "accessors[0].count"),
            (&with(r#""nodes": [{"name": "a", "scale": [1, 1]}]"#), "node 0 \"a\" / scale"),
            (&with(r#""nodes": [{"rotation": [0, 0, 0, 0]}]"#), "node 0 / rotation"),
            (&with(r#""nodes": [{"matrix": [1,0,0,1, 0,1,0,0, 0,0,1,0, 0,0,0,1]}]"#), "bottom row"),
        ] {
            let what = parse_text(json).err().unwrap_or_default();
            assert!(what.contains(expected), "{:.80}: {what}", json);
        }
    }
}
