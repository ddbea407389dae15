//! Sampling a rectangle, or any parallelogram, by the solid angle it subtends.

use super::{
    geometry::{Placement, Toward},
    triangle::TriangleView,
};
use glam::DVec3;

/// A parallelogram of which a point sees the front: as two triangles where it looks large, by area where it looks small.
///
/// Two triangles give the very density that a spherical rectangle (Urena et al. 2013) gives, uniform in solid angle, and stay
/// accurate where the rectangle fills the hemisphere or has been sheared.
#[derive(Clone, Copy, Debug)]
pub(super) struct RectangleView {
    halves: [TriangleView; 2],
    /// Solid angles of the halves; none where they are sampled by area, as equals.
    angles: Option<[f64; 2]>,
}

/// Corners, counter-clockwise seen from the side that is lit.
pub(super) fn corners(placement: &Placement, width: f32, height: f32) -> [DVec3; 4] {
    let origin = placement.origin.as_dvec3();
    let x = placement.x.as_dvec3() * (0.5 * f64::from(width));
    let y = placement.y.as_dvec3() * (0.5 * f64::from(height));
    let y = if x.cross(y).dot(placement.facing()) < 0.0 { -y } else { y };
    [origin - x - y, origin + x - y, origin + x + y, origin - x + y]
}

impl RectangleView {
    /// None where it is seen edge-on or from behind.
    pub fn new(point: DVec3, [a, b, c, d]: [DVec3; 4]) -> Option<Self> {
        let halves = [
            TriangleView::between(point, [a, b, c], Some(1.0))?,
            TriangleView::between(point, [a, c, d], Some(1.0))?,
        ];
        // Where only one half is small both are taken by their angle, so that the two densities agree.
        let angles = match halves.map(|half| half.solid_angle()) {
            [Some(first), Some(second)] => Some([first, second]),
            [None, None] => None,
            _ => {
                let halves = halves.map(TriangleView::by_solid_angle);
                let angles = [halves[0].solid_angle()?, halves[1].solid_angle()?];
                return Some(Self { halves, angles: Some(angles) });
            }
        };
        Some(Self { halves, angles })
    }

    /// Density of a unit direction that hits the parallelogram, 1/sr.
    pub fn pdf(&self, direction: DVec3) -> f64 {
        match self.angles {
            Some([first, second]) => 1.0 / (first + second),
            // Both halves have the same area and lie in the same plane.
            None => 0.5 * self.halves[0].pdf(direction),
        }
    }

    /// A direction for two uniform numbers.
    pub fn sample(&self, [u0, u1]: [f64; 2]) -> Toward {
        let first = self.angles.map_or(0.5, |[first, second]| first / (first + second));
        let (half, share, u0) = if u0 < first {
            (&self.halves[0], first, u0 / first)
        } else {
            (&self.halves[1], 1.0 - first, (u0 - first) / (1.0 - first))
        };
        let (toward, _) = half.sample([u0.min(1.0), u1]);
        let pdf = match self.angles {
            Some([first, second]) => 1.0 / (first + second),
            None => toward.pdf * share,
        };
        Toward { pdf, ..toward }
    }
}

#[cfg(test)]
mod tests {
    use crate::light::{
        Placement,
        testing::{Stage, down, floor},
    };
    use glam::Vec3;

    #[test]
    fn parallel_rectangles_have_their_form_factors() {
        let unit = Stage::default().with_rectangle(1.0, 1.0, down(Vec3::Y));
        unit.expect_irradiance(&floor(Vec3::new(0.5, 0.0, 0.5)), 0.435_210, 1e-3);
        let wide = Stage::default().with_rectangle(2.0, 2.0, down(Vec3::Y));
        wide.expect_irradiance(&floor(Vec3::ZERO), 1.740_840, 1e-3);
    }

    #[test]
    fn a_standing_rectangle_has_its_form_factor() {
        let placement =
            Placement { origin: Vec3::new(0.5, 0.5, -1.0), x: Vec3::X, y: Vec3::Y, z: Vec3::NEG_Z };
        let stage = Stage::default().with_rectangle(1.0, 1.0, placement);
        stage.expect_irradiance(&floor(Vec3::ZERO), 0.175_094, 1e-3);
    }

    #[test]
    fn a_rectangle_as_wide_as_the_sky_gives_what_the_sky_gives() {
        let stage = Stage::default().with_rectangle(2e9, 2e9, down(Vec3::Y));
        stage.expect_irradiance(&floor(Vec3::ZERO), core::f64::consts::PI, 1e-3);
    }

    #[test]
    fn in_its_plane_and_behind_it_a_rectangle_is_dark() {
        let lights = Stage::default().with_rectangle(1.0, 1.0, down(Vec3::Y));
        for height in [1.0, 1.5] {
            assert_eq!(lights.irradiance(&floor(Vec3::new(3.0, height, 0.0)), 16), (0.0, 0.0));
        }
        let mirrored = Placement { x: Vec3::NEG_X, ..down(Vec3::Y) };
        let stage = Stage::default().with_rectangle(1.0, 1.0, mirrored);
        stage.expect_irradiance(&floor(Vec3::new(0.5, 0.0, 0.5)), 0.435_210, 1e-3);
    }
}
