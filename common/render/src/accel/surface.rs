//! What shading needs to know about the place of a hit, with a bound of its rounding, and where to start the next ray.

use glam::{DVec3, Vec3};

use super::{Accel, Geometry, Hit, Place, shape::Shape, triangle::normal_f64};
use crate::transform::{Affine, unit};

/// A point of a surface in world space.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    /// Metres; computed in f64 and rounded once, so it is as near to the surface as f32 can be.
    pub point: Vec3,
    /// Bound per component of how far `point` may lie from the surface as rays from here will meet it. Never all zero.
    pub error: Vec3,
    /// Unit normal on the front side (corners counter-clockwise, +Z of disk and rectangle, outside of the sphere), also when
    /// the instance mirrors its geometry; zero where the instance flattens a shape away.
    pub normal_geometric: Vec3,
    /// Object to world space at the time of the hit.
    pub object_to_world: Affine,
    /// Whether `object_to_world` mirrors; [`Affine::normal`] already heeds it.
    pub mirrored: bool,
}

/// Rounding to nearest: half a unit in the last place, relative to the number.
const ROUND: f64 = 0.5 * f32::EPSILON as f64;

/// Share of a primitive's size by which a ray starts off its surface at least, where its coordinates are zero: rays meet
/// planes to f64, so any step off the plane is enough.
const STEP: f64 = 1.0 / (1u64 << 30) as f64;

impl Accel {
    /// The surface at a hit of a ray with this time within the shutter.
    pub fn surface(&self, hit: &Hit, time: f32) -> SurfacePoint {
        let map = self.transform(hit.instance).at(time);
        match self.geometry(hit.instance) {
            Geometry::Triangles(mesh) => match &self.instances[hit.instance as usize].place {
                Place::Baked | Place::World(_) => {
                    let corners = self.triangle_vertices(hit.instance, hit.primitive, time);
                    on_world_triangle(corners, hit, map)
                }
                Place::Object(_) => on_object_triangle(mesh.corners(hit.primitive, time), hit, map),
            },
            Geometry::Disk => on_shape(Shape::Disk, hit, map),
            Geometry::Rectangle => on_shape(Shape::Rectangle, hit, map),
            Geometry::Sphere => on_shape(Shape::Sphere, hit, map),
        }
    }

    /// World-space corners of a triangle at a time within the shutter; the same whether or not the instance was baked.
    ///
    /// # Panics
    /// When the instance has no triangles, or not this one.
    pub fn triangle_vertices(&self, instance: u32, primitive: u32, time: f32) -> [Vec3; 3] {
        let Geometry::Triangles(mesh) = self.geometry(instance) else {
            panic!("instance {instance} is a shape, and has no triangles");
        };
        if let Place::World(baked) = &self.instances[instance as usize].place {
            return baked.corners(primitive, time);
        }
        let map = self.transform(instance).at(time);
        mesh.corners(primitive, time).map(|p| map.point(p))
    }
}

/// Rays meet these very corners: only the point is rounded.
fn on_world_triangle(corners: [Vec3; 3], hit: &Hit, map: Affine) -> SurfacePoint {
    let corners = corners.map(|p| p.as_dvec3());
    let point = interpolated(corners, hit);
    let normal = area_normal(corners) * if map.mirrors() { -1.0 } else { 1.0 };
    let error = point.abs() * ROUND + DVec3::splat(size(corners) * STEP);
    surface_point(point, error, normal.as_vec3(), map)
}

/// Rays come to these corners, and are rounded there.
fn on_object_triangle(corners: [Vec3; 3], hit: &Hit, map: Affine) -> SurfacePoint {
    let corners = corners.map(|p| p.as_dvec3());
    let local = interpolated(corners, hit);
    let normal = map.normal_f64(area_normal(corners)).as_vec3();
    mapped(local, size(corners), normal, map)
}

fn on_shape(shape: Shape, hit: &Hit, map: Affine) -> SurfacePoint {
    let (local, normal) = shape.point(hit.u, hit.v);
    mapped(local, 2.0, map.normal(normal), map)
}

fn mapped(local: DVec3, size: f64, normal: Vec3, map: Affine) -> SurfacePoint {
    let point = map.point_f64(local);
    let rounded_there = local.abs() * ROUND;
    let m = &map.linear;
    let magnitude = [m.x_axis, m.y_axis, m.z_axis].map(|column| column.abs().as_dvec3());
    let reach = magnitude.iter().fold(0.0, |reach: f64, column| reach.max(column.max_element()));
    // The ray's start is rounded in world space, and once more in object space.
    let error = point.abs() * ROUND
        + magnitude[0] * rounded_there.x
        + magnitude[1] * rounded_there.y
        + magnitude[2] * rounded_there.z
        + DVec3::splat(size * reach * STEP);
    surface_point(point, error, normal, map)
}

fn surface_point(point: DVec3, error: DVec3, normal_geometric: Vec3, map: Affine) -> SurfacePoint {
    // A hair more covers the rounding of the bound itself.
    let error = (error * (1.0 + 4.0 * ROUND)).as_vec3();
    SurfacePoint {
        point: point.as_vec3(),
        error,
        normal_geometric,
        object_to_world: map,
        mirrored: map.mirrors(),
    }
}

fn interpolated([a, b, c]: [DVec3; 3], hit: &Hit) -> DVec3 {
    let (v, w) = (f64::from(hit.u), f64::from(hit.v));
    a + (b - a) * v + (c - a) * w
}

fn area_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    unit(normal_f64(a, b, c))
}

fn size([a, b, c]: [DVec3; 3]) -> f64 {
    (b - a).abs().max((c - a).abs()).max_element()
}

/// Where a ray from a surface point starts so that it does not meet the surface it leaves: off the box of the point's error along
/// the normal, to the side that `direction` points to, and rounded away (Pharr, Jakob, Humphreys 2023, section 6.8.6).
#[inline]
pub fn offset_origin(point: Vec3, error: Vec3, normal: Vec3, direction: Vec3) -> Vec3 {
    let distance = normal.x.abs() * error.x + normal.y.abs() * error.y + normal.z.abs() * error.z;
    let along = normal.x * direction.x + normal.y * direction.y + normal.z * direction.z;
    let offset = normal * if along < 0.0 { -distance } else { distance };
    let away = |p: f32, offset: f32| {
        if offset > 0.0 {
            (p + offset).next_up()
        } else if offset < 0.0 {
            (p + offset).next_down()
        } else {
            p
        }
    };
    Vec3::new(away(point.x, offset.x), away(point.y, offset.y), away(point.z, offset.z))
}
