//! Where emitters are, asked of the scene at the moment a light is sampled.

use glam::{DVec3, Vec3};

/// Columns of a light's node-to-world transform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// World position of the node's origin, metres.
    pub origin: Vec3,
    /// The node's X axis in world space, with its scale.
    pub x: Vec3,
    /// The node's Y axis in world space, with its scale.
    pub y: Vec3,
    /// The node's Z axis in world space, with its scale; lights point along its opposite.
    pub z: Vec3,
}

impl Placement {
    /// Unrotated and unscaled at a position.
    pub const fn at(origin: Vec3) -> Self {
        Self { origin, x: Vec3::X, y: Vec3::Y, z: Vec3::Z }
    }

    /// Direction in which the light points, of unit length; zero where the transform is singular.
    pub(super) fn forward(&self) -> DVec3 {
        (-self.z.as_dvec3()).normalize_or_zero()
    }

    /// Mean scale of the three axes, for what has only one size.
    pub(super) fn scale(&self) -> f64 {
        let length = |axis: Vec3| axis.as_dvec3().length();
        (length(self.x) + length(self.y) + length(self.z)) / 3.0
    }

    /// Normal of the node's XY plane on the side towards which the light points, as long as the area of `x` times `y`.
    pub(super) fn facing(&self) -> DVec3 {
        let normal = self.x.as_dvec3().cross(self.y.as_dvec3());
        if normal.dot(self.z.as_dvec3()) < 0.0 { normal } else { -normal }
    }
}

/// An emissive triangle in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EmitterTriangle {
    /// In the mesh's order, which a sample's barycentric weights refer to.
    pub corners: [Vec3; 3],
    /// Whether they run clockwise seen from the front, as an instance that mirrors makes them.
    pub mirrored: bool,
}

/// Tells where emitters are at a time within the shutter. Must give the same answer each time it is asked.
pub trait EmitterGeometry {
    /// Where an emissive triangle is.
    fn triangle(&self, instance: u32, primitive: u32, time: f32) -> EmitterTriangle;

    /// Where the light with this index in `Scene::lights` is.
    fn placement(&self, light: u32, time: f32) -> Placement;
}

/// A point from which light is asked for, in double precision.
#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    /// World space, metres.
    pub point: DVec3,
    /// See `Receiver::normal`.
    pub normal: Option<DVec3>,
}

/// A direction towards an emitter, in double precision.
#[derive(Clone, Copy, Debug)]
pub(super) struct Toward {
    /// Unit length, world space, away from the receiver.
    pub direction: DVec3,
    /// Metres to the emitter's surface.
    pub distance: f64,
    /// Solid-angle density, 1/sr.
    pub pdf: f64,
}
