//! Triangles and what is stored at their corners.

use glam::{Vec2, Vec3, Vec4};
use serde::{Deserialize, Serialize};

/// Indexed triangles. Optional attributes are absent, not empty, when the scene does not need them; each has one entry per
/// position.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Mesh {
    /// For messages.
    pub name: String,
    /// Metres, mesh space, at rest.
    pub positions: Vec<Vec3>,
    /// Three positions per triangle; counter-clockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
    /// Unit shading normals; absent means flat.
    pub normals: Option<Vec<Vec3>>,
    /// Unit tangent and handedness (+1 or -1); present only where a normal map needs it.
    pub tangents: Option<Vec<Vec4>>,
    /// Texture coordinate sets.
    pub uvs: Vec<Vec<Vec2>>,
    /// Linear RGBA that multiplies the base colour.
    pub colors: Option<Vec<Vec4>>,
    /// Joint influences.
    pub skinning: Option<Skinning>,
    /// Displacements that a node's weights add up.
    pub morph_targets: Vec<MorphTarget>,
}

/// Joint influences per vertex, `influences` of them in a row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Skinning {
    /// Influences per vertex: a multiple of 4.
    pub influences: u32,
    /// Index into the skin's joints.
    pub joints: Vec<u16>,
    /// Weights; each vertex' sum to one.
    pub weights: Vec<f32>,
}

/// Displacements at weight one. Each list is absent or has one entry per position.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MorphTarget {
    /// Metres.
    pub positions: Option<Vec<Vec3>>,
    /// Added to the normals before normalisation.
    pub normals: Option<Vec<Vec3>>,
    /// Added to the tangents' direction.
    pub tangents: Option<Vec<Vec3>>,
}
