//! The hierarchy that places things in the world.

use glam::{DMat4, DQuat, DVec3, Mat4, Vec3};
use serde::{Deserialize, Serialize};

/// A node's place relative to its parent. f64, so that a scene far from its origin keeps its detail.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Transform {
    /// Translation x rotation x scale; the only form that animations act upon.
    Trs {
        /// Metres.
        translation: DVec3,
        /// Unit quaternion.
        rotation: DQuat,
        /// Factor per axis; may be negative or zero.
        scale: DVec3,
    },
    /// Any affine matrix, column vectors; the bottom row is (0, 0, 0, 1).
    Matrix(DMat4),
}

impl Transform {
    /// No change of place.
    pub const IDENTITY: Self =
        Self::Trs { translation: DVec3::ZERO, rotation: DQuat::IDENTITY, scale: DVec3::ONE };
}

/// A mesh drawn with a material.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Instance {
    /// Index into `Scene::meshes`. Instances that draw one mesh share its memory.
    pub mesh: u32,
    /// Index into `Scene::materials`.
    pub material: u32,
}

/// A node of the hierarchy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Node {
    /// For messages; need not be unique.
    pub name: String,
    /// Index of the parent, always smaller than the node's own.
    pub parent: Option<u32>,
    /// Place relative to the parent, at rest.
    pub transform: Transform,
    /// Translation over the whole shutter, world space, metres; moves the node's own instances, not its children.
    pub motion_vector: Option<Vec3>,
    /// What is drawn here.
    pub instances: Vec<Instance>,
    /// Index into `Scene::skins`: the skin deforms this node's instances, and the node's own place is ignored.
    pub skin: Option<u32>,
    /// Morph target weights at rest; as many as the instances' meshes have targets, or none.
    pub morph_weights: Vec<f32>,
}

/// Joints that deform a mesh.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Skin {
    /// Node index of each joint.
    pub joints: Vec<u32>,
    /// Mesh space to joint space, one per joint.
    pub inverse_bind: Vec<Mat4>,
}
