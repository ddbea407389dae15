//! The analytic shapes of area lights, each in its own unit space, in f64.

use glam::{DVec3, Mat3, Vec3};

use super::{bounds::Box3, triangle::Meeting};
use crate::transform::{Affine, InverseAffine, unit};

/// A shape of unit size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shape {
    Disk,
    Rectangle,
    Sphere,
}

impl Shape {
    pub fn bounds(self) -> Box3 {
        let depth = if self == Self::Sphere { 1.0 } else { 0.0 };
        let high = Vec3::new(1.0, 1.0, depth);
        Box3 { low: -high, high }
    }

    /// The way back into the shape's space. Of a flat shape's map only the images of x and y matter, so the third column is replaced
    /// by one that makes it regular; `None` if the shape has no area.
    pub fn inverse(self, map: &Affine) -> Option<InverseAffine> {
        if self == Self::Sphere {
            return map.inverse();
        }
        let (x, y) = (map.linear.x_axis, map.linear.y_axis);
        let length = x.abs().max_element().max(y.abs().max_element());
        let z = unit(x.as_dvec3().cross(y.as_dvec3())) * f64::from(length);
        Affine::new(Mat3::from_cols(x, y, z.as_vec3()), map.translation).inverse()
    }

    /// Where a ray in the shape's space meets it, nearest first; both ends of the way through a sphere.
    #[inline]
    pub fn meet(self, origin: Vec3, direction: Vec3) -> [Option<Meeting>; 2] {
        let (o, d) = (origin.as_dvec3(), direction.as_dvec3());
        match self {
            Self::Sphere => meet_sphere(o, d),
            Self::Disk | Self::Rectangle => {
                let t = -o.z / d.z;
                let (x, y) = (o.x + t * d.x, o.y + t * d.y);
                let within = match self {
                    Self::Disk => x * x + y * y <= 1.0,
                    _ => x.abs() <= 1.0 && y.abs() <= 1.0,
                };
                let hit = within && t >= 0.0 && d.z != 0.0;
                [hit.then_some(Meeting { t: t as f32 + 0.0, u: x as f32, v: y as f32 }), None]
            }
        }
    }

    /// The point of the shape that a hit's coordinates name, and its normal; shape space.
    pub fn point(self, u: f32, v: f32) -> (DVec3, Vec3) {
        match self {
            Self::Sphere => {
                let p = from_octahedron(u, v);
                (p, p.as_vec3())
            }
            Self::Disk | Self::Rectangle => (DVec3::new(f64::from(u), f64::from(v), 0.0), Vec3::Z),
        }
    }
}

fn meet_sphere(o: DVec3, d: DVec3) -> [Option<Meeting>; 2] {
    let length2 = d.dot(d);
    // The point of the ray's line that is nearest to the centre; no cancellation however far away the ray starts.
    let middle = -o.dot(d) / length2;
    let nearest = o + d * middle;
    let height2 = 1.0 - nearest.dot(nearest);
    if height2.is_nan() || height2 < 0.0 {
        return [None, None];
    }
    let half = (height2 / length2).sqrt();
    [middle - half, middle + half].map(|t| {
        let (u, v) = to_octahedron(o + d * t);
        (t >= 0.0).then_some(Meeting { t: t as f32 + 0.0, u, v })
    })
}

/// Unit sphere to [-1, 1]^2 (Meyer et al. 2010, "On Floating-Point Normal Vectors").
fn to_octahedron(p: DVec3) -> (f32, f32) {
    let sum = p.x.abs() + p.y.abs() + p.z.abs();
    let (x, y) = (p.x / sum, p.y / sum);
    let (x, y) = if p.z >= 0.0 { (x, y) } else { fold(x, y) };
    (x as f32, y as f32)
}

fn from_octahedron(u: f32, v: f32) -> DVec3 {
    let (u, v) = (f64::from(u), f64::from(v));
    let z = 1.0 - u.abs() - v.abs();
    let (x, y) = if z >= 0.0 { (u, v) } else { fold(u, v) };
    unit(DVec3::new(x, y, z))
}

fn fold(x: f64, y: f64) -> (f64, f64) {
    ((1.0 - y.abs()).copysign(x), (1.0 - x.abs()).copysign(y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn disk_and_rectangle_end_where_they_should() {
        let down = |x: f32, y: f32, shape: Shape| shape.meet(Vec3::new(x, y, 2.0), -Vec3::Z)[0];
        assert_eq!(down(0.6, 0.79, Shape::Disk).map(|m| m.t), Some(2.0));
        assert!(down(0.8, 0.7, Shape::Disk).is_none());
        assert_eq!(down(1.0, -1.0, Shape::Rectangle), Some(Meeting { t: 2.0, u: 1.0, v: -1.0 }));
        assert!(down(1.001, 0.0, Shape::Rectangle).is_none());
        let in_plane = Shape::Disk.meet(Vec3::new(-2.0, 0.0, 0.0), Vec3::X);
        assert_eq!(in_plane, [None, None]);
    }

    #[test]
    fn sphere_is_met_on_its_surface_from_near_and_far() {
        for far in [0.0, 0.5, 3.0, 1e6] {
            let origin = Vec3::new(0.3, -0.2, -far);
            let direction = Vec3::new(0.0, 0.0, 2.0);
            let hits = Shape::Sphere.meet(origin, direction);
            let count = hits.iter().flatten().count();
            assert_eq!(count, if far < 1.0 { 1 } else { 2 });
            for hit in hits.into_iter().flatten() {
                let (p, normal) = Shape::Sphere.point(hit.u, hit.v);
                assert!((p.truncate() - glam::DVec2::new(0.3, -0.2)).length() < 1e-6);
                assert!((p.length() - 1.0).abs() < 1e-12 && (normal.as_dvec3() - p).length() < 1e-6);
            }
        }
        assert_eq!(Shape::Sphere.meet(Vec3::X * 1.01, Vec3::Y), [None, None]);
    }
}
