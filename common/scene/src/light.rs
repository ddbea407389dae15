//! Lights that are not meshes.

use crate::Image;
use glam::{Quat, Vec3};
use serde::{Deserialize, Serialize};

/// A light at a node. Points along the node's -Z where it has a direction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Light {
    /// For messages.
    pub name: String,
    /// Where it is: index into `Scene::nodes`.
    pub node: u32,
    /// What it is.
    pub kind: LightKind,
}

/// Kinds of light. Sizes are in the node's space and scale with it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum LightKind {
    /// Radiant intensity (candela), the same in all directions.
    Point {
        /// W/sr.
        intensity: Vec3,
    },
    /// A point light within a cone.
    Spot {
        /// W/sr along the axis.
        intensity: Vec3,
        /// Radians from the axis up to which intensity is full.
        inner_cone: f32,
        /// Radians from the axis beyond which there is none.
        outer_cone: f32,
    },
    /// Parallel light from infinitely far (lux on a plane that faces it).
    Directional {
        /// W/m^2.
        irradiance: Vec3,
    },
    /// A sphere that emits outwards.
    Sphere {
        /// W/sr/m^2.
        radiance: Vec3,
        /// Metres.
        radius: f32,
    },
    /// A rectangle around the node's origin that emits along -Z; black from behind.
    Rectangle {
        /// W/sr/m^2.
        radiance: Vec3,
        /// Along X, metres.
        width: f32,
        /// Along Y, metres.
        height: f32,
    },
    /// A disk around the node's origin that emits along -Z; black from behind.
    Disk {
        /// W/sr/m^2.
        radiance: Vec3,
        /// Metres.
        radius: f32,
    },
}

/// Light from infinitely far in all directions: a latitude-longitude image whose top row is +Y and whose centre is +X, with
/// `u = 0.5 + atan2(z, x) / 2 pi`, `v = 0.5 - asin(y) / pi`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Environment {
    /// Radiance; `Pixels::Float`. A single pixel is a constant environment.
    pub image: Image,
    /// Multiplies the image.
    pub intensity: f32,
    /// Environment space to world space.
    pub rotation: Quat,
    /// Whether camera rays see it or black.
    pub visible_to_camera: bool,
}
