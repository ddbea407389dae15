//! A small glTF 2.0 writer: just what the project's own scenes need.
//!
//! Every length goes through one [`Scale`], a power of two, so that a scene and its scaled twin differ in exponents only.

mod document;
mod material;

use super::shapes::Shape;
pub use material::Material;
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

    /// The scaled length as the document says it. Documents hold more digits than an f32, and readers use them: so it is the
    /// decimal that is scaled, not its nearest f32.
    fn said(self, metres: f32) -> Value {
        json!(decimal(metres) * 2.0f64.powi(self.0))
    }

    fn all_said(self, metres: &[f32]) -> Value {
        metres.iter().map(|value| self.said(*value)).collect()
    }
}

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
fn decimal(value: f32) -> f64 {
    value.to_string().parse().expect("a float prints as a float")
}

fn number(value: f32) -> Value {
    json!(decimal(value))
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
            node["translation"] = self.scale.all_said(&placement.at);
        }
        if placement.rotation != Placement::ORIGIN.rotation {
            node["rotation"] = numbers(&placement.rotation);
        }
        // Vertices in metres carry the scale themselves; unit meshes take it from their node.
        if placement.size != 1.0 {
            node["scale"] = self.scale.all_said(&[placement.size; 3]);
        }
        self.nodes.push(node);
        Node(self.nodes.len() - 1)
    }

    /// Moves a node by `metres` while the shutter is open.
    pub fn move_while_open(&mut self, node: Node, metres: [f32; 3]) {
        let vector = self.scale.all_said(&metres);
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
                "znear": self.scale.said(0.125),
            },
        });
        let mut extras = Map::new();
        if let Some((radius, focus)) = view.lens {
            extras.insert("apertureRadius".to_owned(), self.scale.said(radius));
            extras.insert("focusDistance".to_owned(), self.scale.said(focus));
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
            "translation": self.scale.all_said(&view.eye),
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
}
