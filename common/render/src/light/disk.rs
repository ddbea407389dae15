//! Sampling a disk by, very nearly, the solid angle it subtends.

use super::{
    geometry::{Placement, Toward},
    triangle::EDGE_ON,
};
use crate::math::sin_cos_turns;
use glam::DVec3;

/// Axes whose lengths and right angle differ by no more than this are those of a circle that was rotated with rounding.
const ROUND: f64 = 1e-5;

/// A disk in world space.
#[derive(Clone, Copy, Debug)]
pub(super) struct Disk {
    pub centre: DVec3,
    /// Conjugate half axes.
    pub x: DVec3,
    pub y: DVec3,
    /// `x` cross `y` towards the side that is lit; as long as area / pi.
    pub normal: DVec3,
}

/// A disk of which a point sees the front.
#[derive(Clone, Copy, Debug)]
pub(super) enum DiskView {
    /// A circle: sampled within its cone.
    Cone(Cone),
    /// An ellipse: sampled by area.
    Ellipse { disk: Disk, centre: DVec3, volume: f64 },
}

impl Disk {
    /// The disk of this radius in the node's XY plane.
    pub fn new(placement: &Placement, radius: f32) -> Self {
        let radius = f64::from(radius);
        Self {
            centre: placement.origin.as_dvec3(),
            x: placement.x.as_dvec3() * radius,
            y: placement.y.as_dvec3() * radius,
            normal: placement.facing() * (radius * radius),
        }
    }

    fn is_round(&self) -> bool {
        let (x, y) = (self.x.length_squared(), self.y.length_squared());
        (x - y).abs() <= ROUND * x && self.x.dot(self.y).abs() <= ROUND * x
    }
}

impl DiskView {
    /// None where the disk has no area, is seen edge-on or from behind.
    pub fn new(point: DVec3, disk: Disk) -> Option<Self> {
        let centre = disk.centre - point;
        let volume = -centre.dot(disk.normal);
        let lit = volume > EDGE_ON * (centre.length_squared() * disk.normal.length_squared()).sqrt();
        if !lit || !volume.is_finite() {
            return None;
        }
        Some(if disk.is_round() {
            Self::Cone(Cone::new(centre, disk.normal))
        } else {
            Self::Ellipse { disk, centre, volume }
        })
    }

    /// Density of a unit direction that hits the disk, 1/sr.
    pub fn pdf(&self, direction: DVec3) -> f64 {
        match self {
            Self::Cone(cone) => cone.pdf(direction),
            Self::Ellipse { disk, volume, .. } => {
                ellipse_pdf(volume / direction.dot(disk.normal).abs(), *volume)
            }
        }
    }

    /// A direction for two uniform numbers.
    pub fn sample(&self, [u0, u1]: [f64; 2]) -> Toward {
        match self {
            Self::Cone(cone) => cone.sample([u0, u1]),
            Self::Ellipse { disk, centre, volume } => {
                let (sin, cos) = turns(u0);
                let radius = u1.sqrt();
                let point = *centre + disk.x * (radius * cos) + disk.y * (radius * sin);
                let distance = point.length();
                Toward { direction: point / distance, distance, pdf: ellipse_pdf(distance, *volume) }
            }
        }
    }
}

/// `d^2 / (cos A)` with A = pi |normal| and cos = volume / (|normal| d).
fn ellipse_pdf(distance: f64, volume: f64) -> f64 {
    distance * distance * distance / (core::f64::consts::PI * volume)
}

/// Sine and cosine of `u` full turns.
pub(super) fn turns(u: f64) -> (f64, f64) {
    let (sin, cos) = sin_cos_turns(u as f32);
    (f64::from(sin), f64::from(cos))
}

/// The elliptic cone of directions from a point to a circle.
///
/// In the plane at distance 1 across the cone's axis the circle is an ellipse with half axes a and b. By the bisector theorem and
/// the law of cosines, with s the sum of the distances to the nearest and the farthest point of the circle:
/// `b^2 = 4 R^2 / (s^2 - 4 R^2)`, `a^2 = b^2 (1 - 4 t^2 / s^2)`, t the centre's distance from the foot of the perpendicular.
///
/// Within an azimuth the cosine to the axis is uniform over the cone. The azimuth has the density of an ellipse whose half axes
/// squared are `1 - cos` of the cone's half angles: exact on both axes and, in between, so close to the share of solid angle
/// there that the density is nearly constant. For a circle around the axis it is the uniform cone.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cone {
    axis: DVec3,
    /// Unit directions across, of the half axes a and b.
    across: [DVec3; 2],
    /// 1/a^2, 1/b^2.
    inverse_squares: [f64; 2],
    /// `sqrt(1 - cos)` of the half angles towards a and b.
    spreads: [f64; 2],
    /// Towards the disk's plane; unit length.
    down: DVec3,
    /// Distance to the disk's plane.
    height: f64,
}

/// 1 - cos of the angle whose squared tangent is 1 / x; accurate for small and large angles.
fn one_minus_cos(inverse_tan_square: f64) -> f64 {
    // cos^2 = x / (1 + x), sin^2 = 1 / (1 + x).
    let sum = 1.0 + inverse_tan_square;
    let cos = (inverse_tan_square / sum).sqrt();
    1.0 / (sum * (1.0 + cos))
}

impl Cone {
    fn new(centre: DVec3, normal: DVec3) -> Self {
        let length = normal.length();
        let down = normal / -length;
        let radius_square = length;
        let radius = radius_square.sqrt();
        let height = centre.dot(down);
        let side = centre - down * height;
        let offset = side.length();
        let sideways = if offset > 0.0 { side / offset } else { down.any_orthonormal_vector() };

        // Differences of lengths that may nearly cancel are taken as h^2 / (sum of the two).
        let square = height * height;
        let far = ((offset + radius) * (offset + radius) + square).sqrt();
        let near = ((offset - radius) * (offset - radius) + square).sqrt();
        let sum = far + near;
        let beyond_far = square / (far + offset + radius);
        let gap = (offset - radius).abs();
        let beyond_near = square / (near + gap);
        let (over_radius, over_offset) = if offset < radius {
            (beyond_far + beyond_near, beyond_far + (radius - offset) + near)
        } else {
            (beyond_far + (offset - radius) + near, beyond_far + beyond_near)
        };
        let inverse_b = over_radius * (sum + 2.0 * radius) / (4.0 * radius_square);
        let shrink = over_offset * (sum + 2.0 * offset) / (sum * sum);
        let inverse_a = inverse_b / shrink;

        // The axis meets the disk's plane where the bisector does.
        let foot = offset * (over_radius * (sum + 2.0 * radius) / (sum * sum));
        let slant = (foot * foot + square).sqrt();
        let axis = (sideways * foot + down * height) / slant;
        let a = (sideways * height - down * foot) / slant;
        Self {
            axis,
            across: [a, axis.cross(a)],
            inverse_squares: [inverse_a, inverse_b],
            spreads: [one_minus_cos(inverse_a).sqrt(), one_minus_cos(inverse_b).sqrt()],
            down,
            height,
        }
    }

    /// Density at an azimuth, and 1 - cos of the cone's half angle there.
    fn azimuth(&self, cos: f64, sin: f64) -> (f64, f64) {
        let edge = one_minus_cos(cos * cos * self.inverse_squares[0] + sin * sin * self.inverse_squares[1]);
        let [a, b] = self.spreads;
        let (x, y) = (cos / a, sin / b);
        (1.0 / (core::f64::consts::TAU * a * b * (x * x + y * y)), edge)
    }

    fn sample(&self, [u0, u1]: [f64; 2]) -> Toward {
        let (sin, cos) = turns(u0);
        let (x, y) = (self.spreads[0] * cos, self.spreads[1] * sin);
        let length = (x * x + y * y).sqrt();
        let (cos, sin) = (x / length, y / length);
        let (density, edge) = self.azimuth(cos, sin);
        let drop = u1 * edge;
        let radius = (drop * (2.0 - drop)).max(0.0).sqrt();
        let direction =
            self.axis * (1.0 - drop) + self.across[0] * (radius * cos) + self.across[1] * (radius * sin);
        Toward { direction, distance: self.height / direction.dot(self.down), pdf: density / edge }
    }

    fn pdf(&self, direction: DVec3) -> f64 {
        let (x, y) = (direction.dot(self.across[0]), direction.dot(self.across[1]));
        let length = (x * x + y * y).sqrt();
        let (cos, sin) = if length > 0.0 { (x / length, y / length) } else { (1.0, 0.0) };
        let (density, edge) = self.azimuth(cos, sin);
        density / edge
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::testing::{Chance, Stage, down, floor};
    use glam::Vec3;

    fn stage() -> Stage {
        Stage::default().with_disk(1.0, 1.0, down(Vec3::Y))
    }

    #[test]
    fn a_parallel_disk_has_its_irradiance_on_and_off_its_axis() {
        for (offset, expected) in [(0.0, core::f64::consts::FRAC_PI_2), (1.0, 0.868_315), (3.0, 0.037_405)] {
            stage().expect_irradiance(&floor(Vec3::new(offset, 0.0, 0.0)), expected, 1e-3);
        }
    }

    #[test]
    fn a_tiny_bright_disk_and_a_huge_one_lose_nothing() {
        for (radius, radiance) in [(1e-4, 1e8), (1e-6, 1e12)] {
            let stage = Stage::default().with_disk(radius, radiance, down(Vec3::Y));
            let (mean, error) = stage.irradiance(&floor(Vec3::ZERO), 4);
            assert!((mean / core::f64::consts::PI - 1.0).abs() < 1e-4 && error < 1e-4, "{mean} +- {error}");
        }
        let huge = Stage::default().with_disk(1e9, 1.0, down(Vec3::Y));
        huge.expect_irradiance(&floor(Vec3::ZERO), core::f64::consts::PI, 1e-3);
        huge.expect_irradiance(&floor(Vec3::new(5e8, 0.0, 0.0)), core::f64::consts::PI, 1e-3);
    }

    #[test]
    fn every_sample_lies_on_the_disk_and_knows_its_density() {
        let mut chance = Chance(11);
        for _ in 0..2000 {
            let mut point = chance.point() * 3.0;
            point.y = point.y.min(0.999);
            let disk = Disk::new(&down(Vec3::Y), 1.0);
            let view = DiskView::new(point.as_dvec3(), disk).unwrap();
            for _ in 0..10 {
                let toward = view.sample([f64::from(chance.next()), f64::from(chance.next())]);
                let hit = point.as_dvec3() + toward.direction * toward.distance;
                assert!((hit.y - 1.0).abs() < 1e-9);
                let offset = hit - disk.centre;
                assert!(offset.length() < 1.0 + 1e-5, "{} off the axis from {point}", offset.length());
                let again = view.pdf(toward.direction);
                assert!((again / toward.pdf - 1.0).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn the_density_integrates_to_one_and_is_nearly_constant() {
        for point in
            [Vec3::ZERO, Vec3::new(1.0, 0.5, 0.0), Vec3::new(3.0, 0.0, 1.0), Vec3::new(0.5, 0.99, 0.5)]
        {
            let disk = Disk::new(&down(Vec3::Y), 1.0);
            let view = DiskView::new(point.as_dvec3(), disk).unwrap();
            // Over the disk by area: pdf cos / d^2.
            let (mut one, mut angle, mut most, mut least) = (0.0, 0.0, 0.0_f64, f64::INFINITY);
            const RINGS: u32 = 1000;
            for ring in 0..RINGS {
                for spoke in 0..RINGS {
                    let radius = ((f64::from(ring) + 0.5) / f64::from(RINGS)).sqrt();
                    let (sin, cos) = turns((f64::from(spoke) + 0.5) / f64::from(RINGS));
                    let on = disk.centre + DVec3::new(radius * cos, 0.0, radius * sin) - point.as_dvec3();
                    let square = on.length_squared();
                    let solid =
                        core::f64::consts::PI / f64::from(RINGS * RINGS) * on.y / (square * square.sqrt());
                    let pdf = view.pdf(on.normalize());
                    one += pdf * solid;
                    angle += solid;
                    most = most.max(pdf);
                    least = least.min(pdf);
                }
            }
            assert!((one - 1.0).abs() < 2e-3, "{one} from {point}");
            assert!(most * angle < 1.25 && least * angle > 0.8, "{least} to {most} around {}", 1.0 / angle);
        }
    }

    #[test]
    fn a_stretched_disk_is_an_ellipse() {
        let placement = Placement { x: Vec3::X * 2.0, ..down(Vec3::Y * 100.0) };
        let stage = Stage::default().with_disk(1.0, 1.0, placement);
        // Far away: radiance times area over squared distance.
        stage.expect_irradiance(&floor(Vec3::ZERO), 2.0 * core::f64::consts::PI / 1e4, 1e-3);
    }
}
