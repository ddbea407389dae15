//! What can be hit, and where it stands: the input of the build.

use std::sync::Arc;

use glam::Vec3;

use crate::transform::{Jumps, MotionTransform};

/// Triangles over shared vertices, still or deforming.
#[derive(Clone, Debug, Default)]
pub struct TriangleMesh {
    /// Vertex positions, object space, at times `0, 1/(K-1), .. 1` of each piece of the shutter; a single key stands still. Between keys
    /// each vertex moves on a straight line.
    pub keys: Vec<Vec<Vec3>>,
    /// What cuts the shutter into pieces.
    pub jumps: Jumps,
    /// Three vertices per triangle, counter-clockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// A mesh that does not deform.
    pub fn fixed(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Self {
        Self { keys: vec![positions], jumps: Jumps::default(), triangles }
    }

    /// Whether vertices move relative to each other while the shutter is open.
    pub fn deforms(&self) -> bool {
        self.keys.len() > 1
    }

    /// Object-space corners of a triangle at time `u` of the shutter.
    #[inline]
    pub fn corners(&self, primitive: u32, u: f32) -> [Vec3; 3] {
        self.triangles[primitive as usize].map(|vertex| self.vertex(vertex, u))
    }

    /// Object-space position of a vertex at time `u` of the shutter.
    #[inline]
    pub fn vertex(&self, vertex: u32, u: f32) -> Vec3 {
        if self.keys.len() == 1 {
            return self.keys[0][vertex as usize];
        }
        let (segment, f) = self.jumps.segment_at(u, self.keys.len());
        self.keys[segment][vertex as usize] * (1.0 - f) + self.keys[segment + 1][vertex as usize] * f
    }

    /// # Panics
    /// When there is no key, keys differ in length, or a triangle names a vertex that is not there.
    pub(super) fn check(&self) {
        let vertices = self.keys.first().expect("a mesh has at least one key").len();
        assert!(self.keys.iter().all(|key| key.len() == vertices), "all keys have the same vertices");
        assert!(
            !self.deforms() || self.keys.len().is_multiple_of(self.jumps.pieces()),
            "every piece of the shutter has as many keys"
        );
        let in_range = |triangle: &[u32; 3]| triangle.iter().all(|&i| (i as usize) < vertices);
        assert!(self.triangles.iter().all(in_range), "triangles name vertices of their mesh");
    }
}

/// A shape in its own space.
#[derive(Clone, Debug)]
pub enum Geometry {
    /// Triangles.
    Triangles(Arc<TriangleMesh>),
    /// The disk of radius 1 in the XY plane; its front is +Z.
    Disk,
    /// The square [-1, 1] x [-1, 1] in the XY plane; its front is +Z.
    Rectangle,
    /// The sphere of radius 1; its front is outside.
    Sphere,
}

impl Geometry {
    /// Number of primitives.
    pub fn primitives(&self) -> usize {
        match self {
            Self::Triangles(mesh) => mesh.triangles.len(),
            Self::Disk | Self::Rectangle | Self::Sphere => 1,
        }
    }
}

/// One appearance of a geometry in the world.
#[derive(Clone, Debug)]
pub struct InstanceDesc {
    /// Index into the list of geometries.
    pub geometry: u32,
    /// Object space to world space.
    pub transform: MotionTransform,
}
