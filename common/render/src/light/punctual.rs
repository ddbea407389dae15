//! Lights without extent: point, spot and directional.

use super::geometry::Placement;
use crate::math::cos;
use glam::{DVec3, Vec3};

/// A spot's falloff, precomputed as KHR_lights_punctual's reference formula does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SpotCone {
    scale: f32,
    offset: f32,
    /// Cosine of the outer angle.
    pub cos_outer: f32,
}

impl SpotCone {
    /// Angles from the axis in radians.
    pub fn new(inner: f32, outer: f32) -> Self {
        let (cos_inner, cos_outer) = (cos(inner), cos(outer));
        let scale = 1.0 / (cos_inner - cos_outer).max(0.001);
        Self { scale, offset: -cos_outer * scale, cos_outer }
    }

    /// Share of the intensity in a direction whose cosine to the axis is given, in [0, 1].
    pub fn attenuation(&self, cosine: f32) -> f32 {
        let linear = (cosine * self.scale + self.offset).clamp(0.0, 1.0);
        linear * linear
    }
}

/// A point light, all around or within a cone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PointLight {
    /// W/sr.
    pub intensity: Vec3,
    /// Limits it to directions around the node's -Z.
    pub cone: Option<SpotCone>,
}

impl PointLight {
    /// Unit direction, distance and irradiance on a plane facing the light; none from its very position and outside its cone.
    pub fn arrive(&self, point: DVec3, placement: &Placement) -> Option<(DVec3, f64, Vec3)> {
        let toward = placement.origin.as_dvec3() - point;
        let square = toward.length_squared();
        if square == 0.0 || !square.is_finite() {
            return None;
        }
        let distance = square.sqrt();
        let direction = toward / distance;
        let share =
            self.cone.map_or(1.0, |cone| cone.attenuation(-direction.dot(placement.forward()) as f32));
        let irradiance = (self.intensity.as_dvec3() * (f64::from(share) / square)).as_vec3();
        (share > 0.0).then_some((direction, distance, irradiance))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spot_fades_smoothly_between_its_cones() {
        let cone = SpotCone::new(0.3, 0.6);
        assert_eq!(cone.attenuation(1.0), 1.0);
        assert_eq!(cone.attenuation(cos(0.29)), 1.0);
        assert_eq!(cone.attenuation(cos(0.61)), 0.0);
        let between = 0.5 * (cos(0.3) + cos(0.6));
        assert!((cone.attenuation(between) - 0.25).abs() < 1e-5);
        // A cone without a soft edge is still defined.
        assert_eq!(SpotCone::new(0.5, 0.5).attenuation(1.0), 1.0);
    }

    #[test]
    fn a_point_light_falls_off_with_the_square_of_the_distance() {
        let light = PointLight { intensity: Vec3::splat(100.0), cone: None };
        let place = Placement::at(Vec3::new(0.0, 2.0, 0.0));
        let (direction, distance, irradiance) = light.arrive(DVec3::ZERO, &place).unwrap();
        assert_eq!((direction, distance, irradiance), (DVec3::Y, 2.0, Vec3::splat(25.0)));
        assert!(
            light.arrive(DVec3::new(0.0, 2.0, 0.0), &place).is_none(),
            "on the surface it lights nothing"
        );
    }
}
