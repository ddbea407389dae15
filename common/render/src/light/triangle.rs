//! Sampling a triangle by the solid angle it subtends.

use super::geometry::{EmitterTriangle, Toward};
use crate::math::{atan2_f64, cos_f64, sin_f64};
use glam::{DVec3, Vec3};

/// A triangle whose longest edge is at most this share of the distance to its nearest corner is sampled by area: over so small
/// an angle the two densities differ by a few per cent, and area needs no transcendentals.
const SMALL: f64 = 1.0 / 32.0;

/// Cosine between a plane and the direction to a point in it, as rounding may leave it: a few units of the last place.
pub(super) const EDGE_ON: f64 = 16.0 * f64::EPSILON;

/// A triangle seen from a point that it lights.
///
/// Solid angles follow Van Oosterom and Strackee 1983; the mapping cuts off a sub-triangle of a given solid angle by reflecting
/// one corner, which needs one sine and cosine and stays accurate for small and for hemispherical triangles (the idea of
/// Peters 2021, "BRDF Importance Sampling for Polygonal Lights", section 3), then goes uniformly along the remaining arc
/// (Arvo 1995, "Stratified Sampling of Spherical Triangles").
#[derive(Clone, Copy, Debug)]
pub(super) struct TriangleView {
    /// Corners relative to the point.
    corners: [DVec3; 3],
    /// Geometric normal, as long as twice the area.
    normal: DVec3,
    /// Six times the volume of the tetrahedron of point and triangle; positive.
    volume: f64,
    method: Method,
}

#[derive(Clone, Copy, Debug)]
enum Method {
    Area,
    SolidAngle {
        /// Unit directions of the corners, in cyclic order; the first and the last are the farthest apart.
        units: [DVec3; 3],
        /// Their triple product.
        triple: f64,
        /// Half the solid angle.
        half: f64,
    },
}

impl TriangleView {
    /// None where the triangle has no area, is seen edge-on or, if one-sided, from behind.
    pub fn new(point: DVec3, triangle: &EmitterTriangle, two_sided: bool) -> Option<Self> {
        let front = if triangle.mirrored { -1.0 } else { 1.0 };
        Self::between(point, triangle.corners.map(Vec3::as_dvec3), (!two_sided).then_some(front))
    }

    /// As [`TriangleView::new`], with corners in double precision. One-sided emission is from the side where they run
    /// counter-clockwise for `front` = 1 and clockwise for -1.
    pub fn between(point: DVec3, corners: [DVec3; 3], front: Option<f64>) -> Option<Self> {
        let [a, b, c] = corners;
        let (ab, ac) = (b - a, c - a);
        let normal = ab.cross(ac);
        let relative = [a - point, b - point, c - point];
        let height = -relative[0].dot(normal);
        let squares = relative.map(DVec3::length_squared);
        let edge_on = EDGE_ON * (squares[0] * normal.length_squared()).sqrt();
        let lit = front.map_or(height.abs(), |front| front * height) > edge_on;
        if !lit || !height.is_finite() {
            return None;
        }
        let volume = height.abs();
        let nearest = squares[0].min(squares[1]).min(squares[2]);
        let longest = ab.length_squared().max(ac.length_squared()).max((c - b).length_squared());
        let view = Self { corners: relative, normal, volume, method: Method::Area };
        Some(if longest <= SMALL * SMALL * nearest { view } else { view.by_solid_angle() })
    }

    /// The same triangle, sampled by solid angle however small it looks.
    pub fn by_solid_angle(self) -> Self {
        let [a, b, c] = self.corners;
        let lengths = [a.length(), b.length(), c.length()];
        let units = [a / lengths[0], b / lengths[1], c / lengths[2]];
        // From the exact edges, so that slivers keep their relative precision.
        let triple = self.volume / (lengths[0] * lengths[1] * lengths[2]);
        let cosines = [units[0].dot(units[1]), units[1].dot(units[2]), units[2].dot(units[0])];
        let half = atan2_f64(triple, 1.0 + (cosines[0] + cosines[1] + cosines[2]));
        let method = Method::SolidAngle { units: longest_last(units, cosines), triple, half };
        Self { method, ..self }
    }

    /// Solid angle where the triangle is sampled by it; none where it is sampled by area.
    pub fn solid_angle(&self) -> Option<f64> {
        match self.method {
            Method::Area => None,
            Method::SolidAngle { half, .. } => Some(2.0 * half),
        }
    }

    /// Density of a unit direction that hits the triangle, 1/sr.
    pub fn pdf(&self, direction: DVec3) -> f64 {
        match self.method {
            Method::Area => self.area_pdf(self.distance(direction)),
            Method::SolidAngle { half, .. } => 0.5 / half,
        }
    }

    /// A direction for two uniform numbers, and the barycentric weights of the second and third corner where it hits.
    pub fn sample(&self, u: [f64; 2]) -> (Toward, [f64; 2]) {
        match self.method {
            Method::Area => self.sample_area(u),
            Method::SolidAngle { units, triple, half } => {
                let direction = sample_solid_angle(units, triple, half, u);
                let toward = Toward { direction, distance: self.distance(direction), pdf: 0.5 / half };
                (toward, self.barycentric(direction))
            }
        }
    }

    fn sample_area(&self, [u0, u1]: [f64; 2]) -> (Toward, [f64; 2]) {
        let root = u0.sqrt();
        let (second, third) = (root * (1.0 - u1), root * u1);
        let [a, b, c] = self.corners;
        let point = a * (1.0 - root) + b * second + c * third;
        let distance = point.length();
        (Toward { direction: point / distance, distance, pdf: self.area_pdf(distance) }, [second, third])
    }

    /// `d^2 / (cos A)`; with cos = height / d, height = volume / 2 A.
    fn area_pdf(&self, distance: f64) -> f64 {
        2.0 * distance * distance * distance / self.volume
    }

    /// Metres to the triangle's plane.
    fn distance(&self, direction: DVec3) -> f64 {
        self.volume / direction.dot(self.normal).abs()
    }

    fn barycentric(&self, direction: DVec3) -> [f64; 2] {
        let [a, b, c] = self.corners;
        let sum = direction.dot(self.normal);
        let second = (direction.dot(c.cross(a)) / sum).clamp(0.0, 1.0);
        let third = (direction.dot(a.cross(b)) / sum).clamp(0.0, 1.0 - second);
        [second, third]
    }
}

/// Corners turned so that the widest of the arcs, whose cosines are given, joins the first and the last: the corner between them is
/// then opposite to neither, from where all directions would be the same.
fn longest_last([a, b, c]: [DVec3; 3], [ab, bc, ca]: [f64; 3]) -> [DVec3; 3] {
    if ca <= ab && ca <= bc {
        [a, b, c]
    } else if ab <= bc {
        [b, c, a]
    } else {
        [c, a, b]
    }
}

/// With corners A, B, C let P be A reflected in `o = x A + y C`, which lies on the arc A C. Then
/// `tan(solid angle of A B P / 2) = det(A, B, o) / ((A + B) o)`, which is solved for x and y.
fn sample_solid_angle([a, b, c]: [DVec3; 3], triple: f64, half: f64, [u0, u1]: [f64; 2]) -> DVec3 {
    let part = u0 * half;
    let (sin, cos) = (sin_f64(part), cos_f64(part));
    let x = triple * cos - (a.dot(c) + b.dot(c)) * sin;
    let y = (1.0 + a.dot(b)) * sin;
    let o = a * x + c * y;
    let square = o.length_squared();
    let p = if square > 0.0 { o * (2.0 * a.dot(o) / square) - a } else { a };
    // Uniform in height along the arc from B to P.
    let drop = 0.5 * u1 * (p - b).length_squared();
    let side = (p - b * p.dot(b)).normalize_or_zero();
    (b * (1.0 - drop) + side * (drop * (2.0 - drop)).max(0.0).sqrt()).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::testing::{Chance, Stage, floor};

    fn seen(point: DVec3, corners: [Vec3; 3], two_sided: bool) -> Option<TriangleView> {
        TriangleView::new(point, &EmitterTriangle { corners, mirrored: false }, two_sided)
    }

    const SHAPES: [[Vec3; 3]; 5] = [
        [Vec3::new(0.0, 1.0, 0.0), Vec3::new(1.0, 1.0, 0.0), Vec3::new(0.0, 1.0, 1.0)],
        [Vec3::new(-5.0, 0.5, -4.0), Vec3::new(7.0, 0.25, 0.0), Vec3::new(0.0, 1.0, 9.0)],
        [Vec3::new(20.0, 30.0, -4.0), Vec3::new(20.5, 30.0, -4.0), Vec3::new(20.0, 30.0, -3.0)],
        [Vec3::new(100.0, 0.01, 0.0), Vec3::new(101.0, 0.02, 0.0), Vec3::new(100.0, 0.01, 40.0)],
        [Vec3::new(0.0, 0.05, -1.0), Vec3::new(2.0, 0.05, 1.0), Vec3::new(-1.0, 0.05, 1.5)],
    ];

    /// Solid angle by brute force: the area's midpoints.
    fn solid_angle([a, b, c]: [Vec3; 3], steps: u32) -> f64 {
        let [a, b, c] = [a, b, c].map(Vec3::as_dvec3);
        let normal = (b - a).cross(c - a);
        let mut sum = 0.0;
        for i in 0..steps {
            for j in 0..steps - i {
                for (shift, inside) in [(1.0 / 3.0, true), (2.0 / 3.0, i + j + 1 < steps)] {
                    let (u, v) = (f64::from(i) + shift, f64::from(j) + shift);
                    let point = a + (b - a) * (u / f64::from(steps)) + (c - a) * (v / f64::from(steps));
                    let square = point.length_squared();
                    sum += if inside { point.dot(normal).abs() / (square * square.sqrt()) } else { 0.0 };
                }
            }
        }
        sum / (2.0 * f64::from(steps * steps))
    }

    #[test]
    fn the_mean_of_one_over_the_density_is_the_solid_angle() {
        for corners in SHAPES {
            let view = seen(DVec3::ZERO, corners, true).unwrap();
            let mut chance = Chance(3);
            let mut sum = 0.0;
            for _ in 0..20_000 {
                let u = [f64::from(chance.next()), f64::from(chance.next())];
                let (toward, [second, third]) = view.sample(u);
                assert!((toward.direction.length() - 1.0).abs() < 1e-9);
                let again = view.pdf(toward.direction.as_vec3().as_dvec3());
                assert!(
                    (again / toward.pdf - 1.0).abs() < 1e-4,
                    "{again} by chance, {} by choice",
                    toward.pdf
                );
                let [a, b, c] = corners.map(Vec3::as_dvec3);
                let point = a * (1.0 - second - third) + b * second + c * third;
                let error = (toward.direction * toward.distance - point).length();
                assert!(error < 1e-6 * point.length(), "{error} off at {point}");
                sum += 1.0 / toward.pdf;
            }
            let (mean, expected) = (sum / 20_000.0, solid_angle(corners, 1000));
            assert!((mean / expected - 1.0).abs() < 5e-3, "{mean}, expected {expected}");
        }
    }

    #[test]
    fn samples_are_uniform_in_solid_angle() {
        // Each quarter of the triangle receives samples by its own solid angle.
        for corners in SHAPES {
            let [a, b, c] = corners;
            let (ab, bc, ca) = (a.midpoint(b), b.midpoint(c), c.midpoint(a));
            let quarters = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]];
            let angles = quarters.map(|quarter| {
                seen(DVec3::ZERO, quarter, true).unwrap().by_solid_angle().solid_angle().unwrap()
            });
            let total: f64 = angles.iter().sum();
            let view = seen(DVec3::ZERO, corners, true).unwrap().by_solid_angle();
            assert!((view.solid_angle().unwrap() / total - 1.0).abs() < 1e-5);
            let mut counts = [0.0; 4];
            let mut chance = Chance(5);
            const COUNT: u32 = 40_000;
            for _ in 0..COUNT {
                let (_, [v, w]) = view.sample([f64::from(chance.next()), f64::from(chance.next())]);
                let quarter = if v + w < 0.5 {
                    0
                } else if v > 0.5 {
                    1
                } else if w > 0.5 {
                    2
                } else {
                    3
                };
                counts[quarter] += 1.0;
            }
            let chi: f64 = (0..4)
                .map(|i| {
                    let expected = f64::from(COUNT) * angles[i] / total;
                    (counts[i] - expected) * (counts[i] - expected) / expected.max(1e-3)
                })
                .sum();
            // 1e-5 of all seeds are beyond 26 for three degrees of freedom.
            assert!(chi < 26.0, "chi^2 {chi}, {counts:?} for {angles:?}");
        }
    }

    #[test]
    fn where_area_takes_over_both_methods_agree() {
        for reach in [31.9_f32, 32.1] {
            let corners =
                [Vec3::new(0.0, reach, 0.0), Vec3::new(0.5, reach, 0.5), Vec3::new(0.5, reach, -0.5)];
            let view = seen(DVec3::ZERO, corners, true).unwrap();
            let angle = view.by_solid_angle().solid_angle().unwrap();
            let (toward, _) = view.sample([0.4, 0.4]);
            assert!((toward.pdf * angle - 1.0).abs() < 1e-3, "{} sr", angle);
        }
    }

    #[test]
    fn edge_on_and_from_behind_there_is_nothing() {
        let corners = [Vec3::new(1.0, 0.0, 0.0), Vec3::new(2.0, 0.0, 0.0), Vec3::new(1.0, 0.0, 3.0)];
        assert!(seen(DVec3::ZERO, corners, true).is_none(), "in the plane");
        let above = DVec3::new(0.0, 1.0, 0.0);
        let (front, back) = (-above, above);
        assert!(seen(front, corners, false).is_some());
        assert!(seen(back, corners, false).is_none());
        assert!(seen(back, corners, true).is_some());
        let mirrored = EmitterTriangle { corners, mirrored: true };
        assert!(TriangleView::new(front, &mirrored, false).is_none());
        let (_, weights) = TriangleView::new(back, &mirrored, false).unwrap().sample([0.3, 0.6]);
        let (_, plain) = seen(back, corners, true).unwrap().sample([0.3, 0.6]);
        assert_eq!(weights, plain, "weights belong to the mesh's corners");
        let needle = [Vec3::ZERO, Vec3::X, Vec3::X * 3.0];
        assert!(seen(above, needle, true).is_none(), "without area");
    }

    #[test]
    fn a_triangle_gives_the_irradiance_that_lambert_found() {
        // E = 1/2 sum of edge angles times the edge planes' cosine to the normal (Lambert 1760).
        let [a, b, c] = [Vec3::new(-1.0, 1.0, -1.0), Vec3::new(2.0, 1.0, -0.5), Vec3::new(0.0, 3.0, 2.0)];
        let units = [a, c, b].map(|corner| corner.as_dvec3().normalize());
        let mut expected = 0.0;
        for i in 0..3 {
            let (from, to) = (units[i], units[(i + 1) % 3]);
            let cross = from.cross(to);
            expected += 0.5 * atan2_f64(cross.length(), from.dot(to)) * cross.normalize().y;
        }
        let mut stage = Stage::default().with_triangle([a, b, c], 1.0);
        stage.two_sided = true;
        stage.expect_irradiance(&floor(Vec3::ZERO), expected.abs(), 2e-3);
    }
}
