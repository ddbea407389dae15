//! A small glTF 2.0 writer: just what the project's own scenes need.
//!
//! Every length goes through one [`Scale`], a power of two, so that a scene and its scaled twin differ in exponents only.

use super::shapes::Shape;
use base64::Engine;
use serde_json::{Map, Value, json};
use std::collections::BTreeSet;

/// Times `2^k`: exact for any length that stays a normal float.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Scale(pub i32);

impl Scale {
    /// The scaled length, in metres.
    pub fn length(self, metres: f32) -> f32 {
        // Exact: powi of 2 is, and so is a product with a power of two.
        metres * 2.0f32.powi(self.0)
    }

    /// A scaled point or vector.
    pub fn vector(self, metres: [f32; 3]) -> [f32; 3] {
        metres.map(|value| self.length(value))
    }
}

/// Index of a material.
#[derive(Clone, Copy, Debug)]
pub struct Material(usize);

/// Accessors of one shape; meshes may share them.
#[derive(Clone, Copy, Debug)]
pub struct Geometry {
    positions: usize,
    normals: usize,
    indices: usize,
}

/// Index of a mesh.
#[derive(Clone, Copy, Debug)]
pub struct Mesh(usize);

/// Index of a node.
#[derive(Clone, Copy, Debug)]
pub struct Node(usize);

/// Where a node is. Lengths are scaled by the writer.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    /// Metres.
    pub at: [f32; 3],
    /// Unit quaternion x, y, z, w.
    pub rotation: [f32; 4],
    /// Metres per unit of the mesh; 1 for meshes whose vertices are metres.
    pub size: f32,
}

impl Placement {
    /// At the origin, vertices in metres.
    pub const ORIGIN: Self = Self { at: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0], size: 1.0 };

    /// A mesh of unit size made `size` metres large.
    pub fn sized(at: [f32; 3], size: f32) -> Self {
        Self { at, size, ..Self::ORIGIN }
    }

    /// Turned about the vertical axis.
    pub fn turned(at: [f32; 3], degrees: f64) -> Self {
        let half = degrees.to_radians() / 2.0;
        Self { at, rotation: [0.0, half.sin() as f32, 0.0, half.cos() as f32], size: 1.0 }
    }
}

/// How a picture is taken. Lengths are scaled by the writer.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Metres.
    pub eye: [f32; 3],
    /// Looked at, metres.
    pub target: [f32; 3],
    /// Full vertical angle, degrees.
    pub yfov_degrees: f32,
    /// Aperture radius and focus distance, metres.
    pub lens: Option<(f32, f32)>,
    /// Opens and closes, seconds after the frame's time.
    pub shutter: Option<(f32, f32)>,
}

/// A glTF document under construction.
pub struct Gltf {
    scale: Scale,
    bin: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    meshes: Vec<Value>,
    materials: Vec<Value>,
    nodes: Vec<Value>,
    cameras: Vec<Value>,
    animations: Vec<Value>,
    extensions: BTreeSet<&'static str>,
    scene_extras: Map<String, Value>,
}

/// A number as people would write it: the shortest that reads back as the same f32.
fn number(value: f32) -> Value {
    json!(value.to_string().parse::<f64>().expect("a float prints as a float"))
}

fn numbers(values: &[f32]) -> Value {
    values.iter().copied().map(number).collect()
}

impl Gltf {
    /// An empty document whose lengths will be multiplied by `scale`.
    pub fn new(scale: Scale) -> Self {
        Self {
            scale,
            bin: Vec::new(),
            views: Vec::new(),
            accessors: Vec::new(),
            meshes: Vec::new(),
            materials: Vec::new(),
            nodes: Vec::new(),
            cameras: Vec::new(),
            animations: Vec::new(),
            extensions: BTreeSet::new(),
            scene_extras: Map::new(),
        }
    }

    /// Pure Lambert of this reflectance.
    pub fn diffuse(&mut self, name: &str, reflectance: [f32; 3]) -> Material {
        let extensions = self.no_specular();
        self.material(json!({
            "name": name,
            "doubleSided": true,
            "pbrMetallicRoughness": pbr(reflectance, 0.0, 1.0),
            "extensions": extensions,
        }))
    }

    /// GGX metal of this reflectance at normal incidence; `alpha = roughness^2`.
    pub fn metal(&mut self, name: &str, reflectance: [f32; 3], roughness: f32) -> Material {
        self.material(json!({
            "name": name,
            "doubleSided": true,
            "pbrMetallicRoughness": pbr(reflectance, 1.0, roughness),
        }))
    }

    /// Lambert under a dielectric coat of index 1.5.
    pub fn plastic(&mut self, name: &str, reflectance: [f32; 3], roughness: f32) -> Material {
        self.material(json!({
            "name": name,
            "doubleSided": true,
            "pbrMetallicRoughness": pbr(reflectance, 0.0, roughness),
        }))
    }

    /// Clear, smooth, solid glass of this index of refraction.
    pub fn glass(&mut self, name: &str, ior: f32) -> Material {
        let thickness = number(self.scale.length(1.0));
        self.extensions.extend(["KHR_materials_transmission", "KHR_materials_volume", "KHR_materials_ior"]);
        self.material(json!({
            "name": name,
            "pbrMetallicRoughness": pbr([1.0; 3], 0.0, 0.0),
            "extensions": {
                "KHR_materials_transmission": { "transmissionFactor": 1.0 },
                "KHR_materials_volume": { "thicknessFactor": thickness },
                "KHR_materials_ior": { "ior": number(ior) },
            },
        }))
    }

    /// Emits `color * strength` W/sr/m^2 from its front side and reflects nothing.
    pub fn emitter(&mut self, name: &str, color: [f32; 3], strength: f32) -> Material {
        self.extensions.insert("KHR_materials_emissive_strength");
        let mut extensions = self.no_specular();
        extensions["KHR_materials_emissive_strength"] = json!({ "emissiveStrength": number(strength) });
        self.material(json!({
            "name": name,
            "pbrMetallicRoughness": pbr([0.0; 3], 0.0, 1.0),
            "emissiveFactor": numbers(&color),
            "extensions": extensions,
        }))
    }

    fn no_specular(&mut self) -> Value {
        self.extensions.insert("KHR_materials_specular");
        json!({ "KHR_materials_specular": { "specularFactor": 0.0 } })
    }

    fn material(&mut self, material: Value) -> Material {
        self.materials.push(material);
        Material(self.materials.len() - 1)
    }

    /// Stores a shape whose vertices are metres.
    pub fn geometry(&mut self, shape: &Shape) -> Geometry {
        let positions: Vec<_> = shape.positions.iter().map(|&position| self.scale.vector(position)).collect();
        let positions = self.vectors(&positions, true);
        Geometry {
            positions,
            normals: self.vectors(&shape.normals, false),
            indices: self.indices(&shape.triangles),
        }
    }

    /// Stores a unit sphere about the origin once: its positions are its normals. Nodes give it its radius.
    pub fn unit_sphere(&mut self, shape: &Shape) -> Geometry {
        assert_eq!(shape.positions, shape.normals, "a unit sphere about the origin");
        let positions = self.vectors(&shape.positions, true);
        Geometry { positions, normals: positions, indices: self.indices(&shape.triangles) }
    }

    /// A mesh of several shapes, each with its material.
    pub fn mesh(&mut self, name: &str, parts: &[(Geometry, Material)]) -> Mesh {
        let primitives: Vec<_> = parts
            .iter()
            .map(|(geometry, material)| {
                json!({
                    "attributes": { "POSITION": geometry.positions, "NORMAL": geometry.normals },
                    "indices": geometry.indices,
                    "material": material.0,
                })
            })
            .collect();
        self.meshes.push(json!({ "name": name, "primitives": primitives }));
        Mesh(self.meshes.len() - 1)
    }

    /// Puts a mesh into the scene.
    pub fn node(&mut self, name: &str, mesh: Mesh, placement: Placement) -> Node {
        let mut node = json!({ "name": name, "mesh": mesh.0 });
        if placement.at != [0.0; 3] {
            node["translation"] = numbers(&self.scale.vector(placement.at));
        }
        if placement.rotation != Placement::ORIGIN.rotation {
            node["rotation"] = numbers(&placement.rotation);
        }
        // Vertices in metres carry the scale themselves; unit meshes take it from their node.
        if placement.size != 1.0 {
            node["scale"] = numbers(&[self.scale.length(placement.size); 3]);
        }
        self.nodes.push(node);
        Node(self.nodes.len() - 1)
    }

    /// Moves a node by `metres` while the shutter is open.
    pub fn move_while_open(&mut self, node: Node, metres: [f32; 3]) {
        let vector = numbers(&self.scale.vector(metres));
        self.nodes[node.0]["extras"] = json!({ "motionVector": vector });
    }

    /// Moves a node along a line: translations in metres at times in seconds.
    pub fn animate_translation(&mut self, node: Node, times: &[f32], metres: &[[f32; 3]]) {
        let metres: Vec<_> = metres.iter().map(|&value| self.scale.vector(value)).collect();
        let output = self.vectors(&metres, false);
        self.animate(node, "translation", times, output);
    }

    /// Turns a node: unit quaternions at times in seconds.
    pub fn animate_rotation(&mut self, node: Node, times: &[f32], rotations: &[[f32; 4]]) {
        let view = self.view(rotations.as_flattened().iter().flat_map(|value| value.to_le_bytes()), None);
        let output = self.accessor(view, 5126, "VEC4", rotations.len());
        self.animate(node, "rotation", times, output);
    }

    fn animate(&mut self, node: Node, path: &str, times: &[f32], output: usize) {
        let view = self.view(times.iter().flat_map(|value| value.to_le_bytes()), None);
        let input = self.accessor(view, 5126, "SCALAR", times.len());
        let (first, last) = (times[0], times[times.len() - 1]);
        self.accessors[input]["min"] = numbers(&[first]);
        self.accessors[input]["max"] = numbers(&[last]);
        self.animations.push(json!({
            "samplers": [{ "input": input, "output": output, "interpolation": "LINEAR" }],
            "channels": [{ "sampler": 0, "target": { "node": node.0, "path": path } }],
        }));
    }

    /// Adds the camera.
    pub fn camera(&mut self, view: View) {
        let [eye, target] = [view.eye, view.target].map(|point| glam::Vec3::from(point).as_dvec3());
        let back = (eye - target).normalize();
        let right = glam::DVec3::Y.cross(back).normalize();
        let turn = glam::DQuat::from_mat3(&glam::DMat3::from_cols(right, back.cross(right), back));
        let mut camera = json!({
            "name": "camera",
            "type": "perspective",
            "perspective": {
                "yfov": number(view.yfov_degrees.to_radians()),
                "aspectRatio": number(16.0 / 9.0),
                "znear": number(self.scale.length(0.125)),
            },
        });
        let mut extras = Map::new();
        if let Some((radius, focus)) = view.lens {
            extras.insert("apertureRadius".to_owned(), number(self.scale.length(radius)));
            extras.insert("focusDistance".to_owned(), number(self.scale.length(focus)));
        }
        if let Some((open, close)) = view.shutter {
            extras.insert("shutterOpen".to_owned(), number(open));
            extras.insert("shutterClose".to_owned(), number(close));
        }
        if !extras.is_empty() {
            camera["extras"] = extras.into();
        }
        self.cameras.push(camera);
        self.nodes.push(json!({
            "name": "camera",
            "camera": self.cameras.len() - 1,
            "translation": numbers(&self.scale.vector(view.eye)),
            "rotation": numbers(&turn.as_quat().to_array()),
        }));
    }

    /// Lights the scene by a lat-long image beside the document.
    pub fn environment(&mut self, uri: &str) {
        self.scene_extras.insert("environment".to_owned(), json!({ "uri": uri, "intensity": 1.0 }));
    }

    fn vectors(&mut self, vectors: &[[f32; 3]], bounds: bool) -> usize {
        let view = self.view(vectors.as_flattened().iter().flat_map(|value| value.to_le_bytes()), None);
        let accessor = self.accessor(view, 5126, "VEC3", vectors.len());
        if bounds {
            let fold = |choose: fn(f32, f32) -> f32, start: f32| {
                vectors.iter().fold([start; 3], |a, b| [0, 1, 2].map(|axis| choose(a[axis], b[axis])))
            };
            self.accessors[accessor]["min"] = numbers(&fold(f32::min, f32::INFINITY));
            self.accessors[accessor]["max"] = numbers(&fold(f32::max, f32::NEG_INFINITY));
        }
        accessor
    }

    fn indices(&mut self, triangles: &[[u32; 3]]) -> usize {
        let indices = triangles.as_flattened();
        let narrow: Option<Vec<u16>> = indices.iter().map(|&index| index.try_into().ok()).collect();
        let (view, kind) = match narrow {
            Some(narrow) => {
                (self.view(narrow.iter().flat_map(|index| index.to_le_bytes()), Some(34_963)), 5123)
            }
            None => (self.view(indices.iter().flat_map(|index| index.to_le_bytes()), Some(34_963)), 5125),
        };
        self.accessor(view, kind, "SCALAR", indices.len())
    }

    fn view(&mut self, bytes: impl Iterator<Item = u8>, target: Option<u32>) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let start = self.bin.len();
        self.bin.extend(bytes);
        let mut view = json!({ "buffer": 0, "byteOffset": start, "byteLength": self.bin.len() - start });
        if let Some(target) = target {
            view["target"] = target.into();
        }
        self.views.push(view);
        self.views.len() - 1
    }

    fn accessor(&mut self, view: usize, component: u32, kind: &str, count: usize) -> usize {
        let accessor =
            json!({ "bufferView": view, "componentType": component, "type": kind, "count": count });
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn document(&self, buffer: Value) -> Map<String, Value> {
        let mut scene = json!({ "nodes": (0..self.nodes.len()).collect::<Vec<_>>() });
        if !self.scene_extras.is_empty() {
            scene["extras"] = self.scene_extras.clone().into();
        }
        let lists = [
            ("nodes", &self.nodes),
            ("cameras", &self.cameras),
            ("meshes", &self.meshes),
            ("materials", &self.materials),
            ("animations", &self.animations),
            ("accessors", &self.accessors),
            ("bufferViews", &self.views),
        ];
        let mut document = Map::new();
        document.insert("asset".to_owned(), json!({ "version": "2.0", "generator": "farm-tests scenes" }));
        document.insert("extensionsUsed".to_owned(), json!(self.extensions));
        document.insert("scene".to_owned(), 0.into());
        document.insert("scenes".to_owned(), json!([scene]));
        for (name, list) in lists.into_iter().filter(|(_, list)| !list.is_empty()) {
            document.insert(name.to_owned(), list.clone().into());
        }
        document.insert("buffers".to_owned(), json!([buffer]));
        document
    }

    /// The document as a text with its buffer inside, one line per entry of its lists.
    pub fn into_text(self) -> String {
        let data = base64::engine::general_purpose::STANDARD.encode(&self.bin);
        let uri = format!("data:application/octet-stream;base64,{data}");
        let document = self.document(json!({ "byteLength": self.bin.len(), "uri": uri }));
        let entries = document.into_iter().map(|(name, value)| match value {
            Value::Array(list) if list.iter().all(Value::is_object) => {
                let lines: Vec<_> = list.iter().map(|entry| format!("    {entry}")).collect();
                format!("  \"{name}\": [\n{}\n  ]", lines.join(",\n"))
            }
            value => format!("  \"{name}\": {value}"),
        });
        format!("{{\n{}\n}}\n", entries.collect::<Vec<_>>().join(",\n"))
    }

    /// The document as a GLB.
    pub fn into_glb(mut self) -> Vec<u8> {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let mut json =
            Value::from(self.document(json!({ "byteLength": self.bin.len() }))).to_string().into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let mut glb = b"glTF".to_vec();
        let word = |value: usize, glb: &mut Vec<u8>| {
            glb.extend(u32::try_from(value).expect("a scene of less than 4 GB").to_le_bytes());
        };
        word(2, &mut glb);
        word(12 + 8 + json.len() + 8 + self.bin.len(), &mut glb);
        word(json.len(), &mut glb);
        glb.extend(b"JSON");
        glb.extend(json);
        word(self.bin.len(), &mut glb);
        glb.extend(b"BIN\0");
        glb.extend(self.bin);
        glb
    }
}

fn pbr(color: [f32; 3], metallic: f32, roughness: f32) -> Value {
    json!({
        "baseColorFactor": numbers(&[color[0], color[1], color[2], 1.0]),
        "metallicFactor": number(metallic),
        "roughnessFactor": number(roughness),
    })
}
