//! An infinitely thin transparent sheet.

use super::fresnel::interface;
use super::ggx::{Ggx, reflect};
use super::{BsdfSample, NOTHING};
use glam::Vec3;

/// glTF's transmission without volume: microfacets reflect by Fresnel's equations of a single interface, and what they do not reflect
/// goes on without being bent, tinted by the base colour and spread as much as the reflection. Both sides look the same.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thin {
    tint: Vec3,
    ggx: Ggx,
    ior: f32,
}

impl Thin {
    /// Perceptual roughness in [0, 1]; an index of exactly 1 is only a tint, however rough.
    pub fn new(tint: Vec3, roughness: f32, ior: f32) -> Self {
        Self { tint, ggx: Ggx::from_roughness(roughness), ior }
    }

    /// Whether light only goes straight on and into the mirror direction.
    pub fn is_delta(&self) -> bool {
        self.ggx.is_delta() || self.ior == 1.0
    }

    /// See [`super::Bsdf`].
    pub fn eval_pdf(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        if self.is_delta() || wo.z == 0.0 || wi.z == 0.0 {
            return NOTHING;
        }
        let transmission = wo.z * wi.z < 0.0;
        let (wo, wi) = (upper(wo), upper(wi));
        let sum = wo + wi;
        let length = sum.length();
        let facets = self.ggx.reflection(wo, wi, sum / length);
        let reflectance = interface(0.5 * length, self.ior).reflectance;
        let (share, colour) =
            if transmission { (1.0 - reflectance, self.tint) } else { (reflectance, Vec3::ONE) };
        (colour * (share * facets.scattering), share * facets.pdf)
    }

    /// See [`super::Bsdf`].
    pub fn sample(&self, wo: Vec3, u: [f32; 3]) -> Option<BsdfSample> {
        let wo_upper = upper(wo);
        if wo.z == 0.0 {
            return None;
        }
        let delta = self.is_delta();
        let h = if delta { Vec3::Z } else { self.ggx.sample(wo_upper, [u[0], u[1]]) };
        let cos = wo_upper.dot(h);
        let reflectance = interface(cos, self.ior).reflectance;
        let transmission = u[2] >= reflectance;
        let mirrored = reflect(wo_upper, h);
        if mirrored.z <= 0.0 {
            return None;
        }
        let same_side = Vec3::new(mirrored.x, mirrored.y, mirrored.z.copysign(wo.z));
        let wi = if !transmission {
            same_side
        } else if delta {
            -wo
        } else {
            same_side * Vec3::new(1.0, 1.0, -1.0)
        };
        let probability = if transmission { 1.0 - reflectance } else { reflectance };
        let (masking, density) = if delta {
            (1.0, 1.0)
        } else {
            (self.ggx.masking(wo_upper, mirrored), self.ggx.reflection_pdf(wo_upper, h))
        };
        let weight = if transmission { self.tint * masking } else { Vec3::splat(masking) };
        Some(BsdfSample { wi, weight, pdf: probability * density, delta, transmission, eta: 1.0 })
    }
}

fn upper(w: Vec3) -> Vec3 {
    Vec3::new(w.x, w.y, w.z.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_goes_straight_on_and_is_tinted_once() {
        let tint = Vec3::new(0.9, 0.4, 0.1);
        let sheet = Thin::new(tint, 0.0, 1.5);
        for wo in [Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.0, 0.6, -0.8)] {
            let through = sheet.sample(wo, [0.1, 0.2, 0.9]).unwrap();
            assert_eq!((through.wi, through.weight, through.eta), (-wo, tint, 1.0));
            let mirrored = sheet.sample(wo, [0.1, 0.2, 0.0]).unwrap();
            assert!(!mirrored.transmission && mirrored.wi.z == wo.z && mirrored.weight == Vec3::ONE);
            assert!((through.pdf + mirrored.pdf - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn a_rough_sheet_of_index_one_is_only_a_tint() {
        let sheet = Thin::new(Vec3::ONE, 0.7, 1.0);
        let wo = Vec3::new(0.6, 0.0, 0.8);
        let sample = sheet.sample(wo, [0.9, 0.9, 0.0]).unwrap();
        assert_eq!((sample.wi, sample.weight, sample.pdf), (-wo, Vec3::ONE, 1.0));
    }
}
