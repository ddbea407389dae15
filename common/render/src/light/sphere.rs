//! Sampling a sphere by the solid angle it subtends.

use super::{disk::turns, geometry::Toward};
use glam::DVec3;

/// A sphere seen from outside; it emits outwards only.
#[derive(Clone, Copy, Debug)]
pub(super) struct SphereView {
    /// Unit direction to the centre.
    axis: DVec3,
    /// Distance of the centre.
    distance: f64,
    /// Square of the sine of the half angle.
    sin_square: f64,
    /// 1 - cosine of the half angle.
    edge: f64,
}

impl SphereView {
    /// None from inside, and where the sphere has no size.
    pub fn new(point: DVec3, centre: DVec3, radius: f64) -> Option<Self> {
        let to_centre = centre - point;
        let square = to_centre.length_squared();
        let sin_square = radius * radius / square;
        if !(sin_square > 0.0 && sin_square < 1.0) {
            return None;
        }
        let distance = square.sqrt();
        // Not 1 - cos, which is nothing for small angles.
        let edge = sin_square / (1.0 + (1.0 - sin_square).sqrt());
        Some(Self { axis: to_centre / distance, distance, sin_square, edge })
    }

    /// Density of a direction that hits the sphere, 1/sr.
    pub fn pdf(&self) -> f64 {
        1.0 / (core::f64::consts::TAU * self.edge)
    }

    /// A direction for two uniform numbers.
    pub fn sample(&self, [u0, u1]: [f64; 2]) -> Toward {
        let (sin, cos) = turns(u0);
        let drop = u1 * self.edge;
        let square = drop * (2.0 - drop);
        let radius = square.sqrt();
        let x = self.axis.any_orthonormal_vector();
        let y = self.axis.cross(x);
        let direction = self.axis * (1.0 - drop) + x * (radius * cos) + y * (radius * sin);
        let depth = (self.sin_square - square).max(0.0).sqrt();
        Toward { direction, distance: self.distance * (1.0 - drop - depth), pdf: self.pdf() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::{
        Placement,
        testing::{Stage, floor},
    };
    use farm_scene::LightKind;
    use glam::Vec3;

    fn sphere(radius: f32, radiance: f32, centre: Vec3) -> Stage {
        let kind = LightKind::Sphere { radiance: Vec3::splat(radiance), radius };
        Stage::default().with_light(kind, Placement::at(centre))
    }

    #[test]
    fn a_sphere_above_the_horizon_has_its_irradiance() {
        let pi = core::f64::consts::PI;
        sphere(1.0, 1.0, Vec3::new(0.0, 10.0, 0.0)).expect_irradiance(&floor(Vec3::ZERO), 0.01 * pi, 1e-4);
        let tilted = Vec3::new(75.0_f32.sqrt(), 5.0, 0.0);
        sphere(1.0, 1.0, tilted).expect_irradiance(&floor(Vec3::ZERO), 0.005 * pi, 1e-3);
        sphere(1e-6, 1e12, Vec3::Y).expect_irradiance(&floor(Vec3::ZERO), pi, 1e-4);
    }

    #[test]
    fn inside_a_sphere_it_is_dark() {
        assert_eq!(sphere(2.0, 1.0, Vec3::Y).irradiance(&floor(Vec3::ZERO), 8), (0.0, 0.0));
        assert_eq!(sphere(1.0, 1.0, Vec3::Y).irradiance(&floor(Vec3::ZERO), 8), (0.0, 0.0));
    }

    #[test]
    fn samples_lie_on_the_near_side() {
        let view = SphereView::new(DVec3::ZERO, DVec3::new(0.0, 3.0, 4.0), 2.0).unwrap();
        for i in 0..100 {
            let toward = view.sample([f64::from(i) / 100.0, f64::from(i * 37 % 100) / 100.0]);
            let hit = toward.direction * toward.distance;
            assert!(((hit - DVec3::new(0.0, 3.0, 4.0)).length() - 2.0).abs() < 1e-6);
            assert!(toward.distance < 21.0_f64.sqrt() + 1e-6, "beyond the limb");
        }
    }
}
