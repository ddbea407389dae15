//! The scene as a whole.

use crate::{Camera, Channel, Environment, Image, Light, Material, Mesh, Node, Skin, Texture};
use serde::{Deserialize, Serialize};

/// Everything there is to see, at all times. Lists refer to each other by index.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    /// Parents before children.
    pub nodes: Vec<Node>,
    /// Geometry; shared by the instances that draw it.
    pub meshes: Vec<Mesh>,
    /// Looks.
    pub materials: Vec<Material>,
    /// Lookups.
    pub textures: Vec<Texture>,
    /// Pixels.
    pub images: Vec<Image>,
    /// Points of view; never empty.
    pub cameras: Vec<Camera>,
    /// Lights that are not meshes.
    pub lights: Vec<Light>,
    /// Deformations.
    pub skins: Vec<Skin>,
    /// Motion.
    pub channels: Vec<Channel>,
    /// Light from infinitely far.
    pub environment: Option<Environment>,
}
