//! Where a ray met a surface: the point, both normals, and the attributes that materials look up.

use crate::PreparedScene;
use crate::accel::{Hit, Ray};
use crate::math::Frame;
use farm_scene::{Material, Mesh};
use glam::{Vec2, Vec3, Vec4};

/// Corners of a triangle and the weights of a point in it.
#[derive(Clone, Copy)]
pub(crate) struct Corners {
    vertices: [u32; 3],
    weights: [f32; 3],
}

impl Corners {
    pub fn new(mesh: &Mesh, hit: &Hit) -> Self {
        Self::at(mesh, hit.primitive, hit.u, hit.v)
    }

    /// The point of a triangle whose second and third corner have the weights `u` and `v`.
    pub fn at(mesh: &Mesh, triangle: u32, u: f32, v: f32) -> Self {
        Self { vertices: mesh.triangles[triangle as usize], weights: [1.0 - u - v, u, v] }
    }

    /// Interpolates an attribute.
    pub fn blend<T: Copy + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>>(
        &self,
        values: &[T],
    ) -> T {
        let [a, b, c] = self.vertices.map(|vertex| values[vertex as usize]);
        a * self.weights[0] + b * self.weights[1] + c * self.weights[2]
    }

    /// Texture coordinates; (0, 0) in a mesh that does not have the set.
    pub fn uv(&self, mesh: &Mesh, set: u32) -> Vec2 {
        mesh.uvs.get(set as usize).map_or(Vec2::ZERO, |uvs| self.blend(uvs))
    }

    /// Factor of the base colour.
    pub fn color(&self, mesh: &Mesh) -> Vec4 {
        mesh.colors.as_ref().map_or(Vec4::ONE, |colors| self.blend(colors))
    }
}

/// Where a ray met a triangle of a mesh.
pub(crate) struct Interaction<'a> {
    /// World space.
    pub point: Vec3,
    /// Bound of the point's rounding error per axis.
    pub error: Vec3,
    /// Unit geometric normal on the side that the ray came from.
    pub normal_geometric: Vec3,
    /// Around the shading normal, on the side that the ray came from.
    pub frame: Frame,
    /// Unit direction back along the ray.
    pub wo: Vec3,
    /// Whether the front was met.
    pub front: bool,
    pub mesh: &'a Mesh,
    pub material: &'a Material,
    /// Index of `material` in the scene.
    pub material_index: u32,
    pub corners: Corners,
}

impl<'a> Interaction<'a> {
    /// The surface that `ray` met at `hit`, a hit of an instance that is a mesh.
    pub fn new(scene: &'a PreparedScene, ray: &Ray, hit: &Hit) -> Self {
        let drawn = scene.drawn(hit.instance);
        let (mesh, material) = scene.mesh_and_material(drawn);
        let corners = Corners::new(mesh, hit);
        let surface = scene.world.accel.surface(hit, ray.time);
        let wo = -ray.direction;
        let front = surface.normal_geometric.dot(wo) >= 0.0;
        let normal_geometric = if front { surface.normal_geometric } else { -surface.normal_geometric };
        let normal = scene.shading_normal(drawn, &surface, &corners, ray.time).unwrap_or(normal_geometric);
        // Whatever the file's normals say, the shading normal is on the side that is looked at.
        let normal = if normal.dot(normal_geometric) < 0.0 { -normal } else { normal };
        let normal = facing(normal, wo, normal_geometric);
        let frame = Frame::from_z(normal);
        Self {
            point: surface.point,
            error: surface.error,
            normal_geometric,
            frame,
            wo,
            front,
            mesh,
            material,
            material_index: drawn.material(),
            corners,
        }
    }

    /// A ray to a light `distance` metres away. It ends before the light by what rounding may have moved its ends, so that a
    /// surface in which the light lies does not hide it; but not by more, so that a wall just before the light does.
    pub fn spawn_towards(&self, direction: Vec3, time: f32, distance: f32) -> Ray {
        /// Relative error of the distance along a ray that meets the light's plane under a degree: 2^-24 / sin(1 degree), doubled
        /// to a power of two.
        const REACH: f32 = 1.0 - 1.0 / (1 << 17) as f32;
        let error = 2.0 * (self.error.x + self.error.y + self.error.z);
        self.spawn(direction, time, (distance * REACH - error).max(0.0))
    }

    /// A ray that leaves the surface into `direction` (unit, world).
    pub fn spawn(&self, direction: Vec3, time: f32, t_max: f32) -> Ray {
        let origin = crate::accel::offset_origin(self.point, self.error, self.normal_geometric, direction);
        #[cfg(feature = "mutations")]
        let (origin, time) =
            (crate::mutations::start(origin, direction), crate::mutations::time_of_bounce(time));
        Ray { origin, direction, time, t_max }
    }
}

/// `normal`, or, where an interpolated or mapped normal turns away from the viewer and would make an opaque surface black,
/// the normal bent just so far that `wo` is at a grazing angle.
fn facing(normal: Vec3, wo: Vec3, normal_geometric: Vec3) -> Vec3 {
    /// Cosine of the grazing angle to which a shading normal is bent.
    const GRAZING: f32 = 1e-3;
    let cosine = normal.dot(wo);
    if cosine >= GRAZING || normal == normal_geometric {
        return normal;
    }
    (normal + wo * (GRAZING - cosine)).try_normalize().unwrap_or(normal_geometric)
}
