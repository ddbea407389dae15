//! The interface to the inside of a solid transparent body.

use super::fresnel::interface;
use super::ggx::{Ggx, reflect};
use super::{BsdfSample, NOTHING};
use glam::Vec3;

/// Smallest spread in radians that refraction by microfacets can have and single precision can still resolve.
const RESOLVED: f32 = 1e-6;

/// Microfacets that reflect and refract by Fresnel's equations (Walter et al. 2007, "Microfacet Models for Refraction through Rough
/// Surfaces"). +z is outside. What is refracted is tinted by the base colour, as glTF says of transmission.
///
/// Radiance is scaled by 1/eta^2 on its way through, eta the index where light comes from over that where it goes; in and out again
/// it cancels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dielectric {
    tint: Vec3,
    ggx: Ggx,
    /// Index inside over index outside.
    ior: f32,
}

impl Dielectric {
    /// Perceptual roughness in [0, 1]; `ior` is that of the inside relative to the outside, > 0.
    pub fn new(tint: Vec3, roughness: f32, ior: f32) -> Self {
        Self { tint, ggx: Ggx::from_roughness(roughness), ior }
    }

    /// Whether microfacets cannot be told from a smooth surface. An index of 1 bends nothing, however rough.
    pub fn is_delta(&self) -> bool {
        self.ggx.is_delta() || self.ggx.alpha() * (self.ior - 1.0).abs() < RESOLVED
    }

    /// Index on the other side of `wo` over that on its own.
    fn eta(&self, wo: Vec3) -> f32 {
        if wo.z > 0.0 { self.ior } else { 1.0 / self.ior }
    }

    /// See [`super::Bsdf`].
    pub fn eval_pdf(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        let (wo, wi, eta) = (upright(wo, wo), upright(wi, wo), self.eta(wo));
        if self.is_delta() || wo.z == 0.0 || wi.z == 0.0 {
            return NOTHING;
        }
        let reflected = wi.z > 0.0;
        let Some(h) = half_vector(wo, wi, if reflected { 1.0 } else { eta }) else { return NOTHING };
        let cos_o = wo.dot(h);
        let met = interface(cos_o, eta);
        let facets = self.ggx.reflection(wo, wi, h);
        if reflected {
            (Vec3::splat(met.reflectance * facets.scattering), met.reflectance * facets.pdf)
        } else {
            let share = (1.0 - met.reflectance) * 4.0 * spread(cos_o, met.eta_cos_t, eta);
            (self.tint * (share * facets.scattering / (eta * eta)), share * facets.pdf)
        }
    }

    /// See [`super::Bsdf`].
    pub fn sample(&self, wo: Vec3, u: [f32; 3]) -> Option<BsdfSample> {
        let (side, eta) = (wo, self.eta(wo));
        let wo = upright(wo, side);
        if wo.z == 0.0 {
            return None;
        }
        let delta = self.is_delta();
        let h = if delta { Vec3::Z } else { self.ggx.sample(wo, [u[0], u[1]]) };
        let cos_o = wo.dot(h);
        let met = interface(cos_o, eta);
        let transmission = u[2] >= met.reflectance;
        let (wi, probability) = if transmission {
            // The part along the facet shrinks by eta; the part across it follows from Snell's law.
            ((h * (cos_o - met.eta_cos_t) - wo) / eta, 1.0 - met.reflectance)
        } else {
            (reflect(wo, h), met.reflectance)
        };
        if (wi.z < 0.0) != transmission || wi.z == 0.0 {
            return None;
        }
        let masking = if delta { 1.0 } else { self.ggx.masking(wo, wi) };
        let weight = if transmission { self.tint * (masking / (eta * eta)) } else { Vec3::splat(masking) };
        let mut pdf = probability;
        if !delta {
            pdf *= self.ggx.reflection_pdf(wo, h);
            if transmission {
                pdf *= 4.0 * spread(cos_o, met.eta_cos_t, eta);
            }
        }
        let eta = if transmission { eta } else { 1.0 };
        Some(BsdfSample { wi: upright(wi, side), weight, pdf, delta, transmission, eta })
    }
}

/// Normal of the microfacets that send light between two directions of relative index `eta`, or none: such a facet would be seen
/// from behind, or light would have to pass on the same side.
fn half_vector(wo: Vec3, wi: Vec3, eta: f32) -> Option<Vec3> {
    let h = (wo + wi * eta).try_normalize()?;
    let h = if h.z < 0.0 { -h } else { h };
    let possible = wo.dot(h) > 0.0 && (wi.dot(h) > 0.0) == (wi.z > 0.0);
    possible.then_some(h)
}

/// Solid angle of facet normals over that of refracted directions, times cos(wo, h):
/// |cos(wi, h)| cos(wo, h) / (cos(wi, h) + cos(wo, h) / eta)^2, with g = eta |cos(wi, h)| and without the cancellation.
fn spread(cos_o: f32, g: f32, eta: f32) -> f32 {
    let ratio = (cos_o + g) / ((eta - 1.0) * (eta + 1.0));
    cos_o * g * eta * ratio * ratio
}

/// Turns the side that `side` is on upwards, and back again.
fn upright(w: Vec3, side: Vec3) -> Vec3 {
    if side.z < 0.0 { Vec3::new(w.x, w.y, -w.z) } else { w }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn degrees(angle: f32) -> Vec3 {
        let (sin, cos) = angle.to_radians().sin_cos();
        Vec3::new(sin, 0.0, cos)
    }

    #[test]
    fn smooth_glass_obeys_snell_and_fresnel() {
        let glass = Dielectric::new(Vec3::new(1.0, 0.5, 0.25), 0.0, 1.5);
        let wo = degrees(60.0);
        let through = glass.sample(wo, [0.0, 0.0, 0.5]).unwrap();
        assert!(through.delta && through.transmission);
        assert!((through.wi.x + wo.x / 1.5).abs() < 1e-6 && through.wi.z < 0.0);
        assert!((through.pdf - (1.0 - 0.089_186_7)).abs() < 1e-6, "{}", through.pdf);
        assert!(
            (through.weight * 2.25 - Vec3::new(1.0, 0.5, 0.25)).length() < 1e-6,
            "radiance shrinks by eta^2"
        );
        assert_eq!(through.eta, 1.5);
        let back = glass.sample(through.wi, [0.0, 0.0, 0.5]).unwrap();
        assert!((back.wi - wo).length() < 1e-6, "the way back");
        assert!((back.weight.x * through.weight.x - 1.0).abs() < 1e-6, "in and out cancels");
        let mirrored = glass.sample(wo, [0.0, 0.0, 0.01]).unwrap();
        assert_eq!((mirrored.wi, mirrored.eta), (Vec3::new(-wo.x, 0.0, wo.z), 1.0));
    }

    #[test]
    fn beyond_the_critical_angle_nothing_leaves() {
        let glass = Dielectric::new(Vec3::ONE, 0.0, 1.5);
        let inside = degrees(42.0) * Vec3::new(1.0, 1.0, -1.0);
        let sample = glass.sample(inside, [0.3, 0.3, 0.999]).unwrap();
        assert!(!sample.transmission && sample.weight == Vec3::ONE && sample.pdf == 1.0);
    }

    #[test]
    fn an_index_of_one_is_not_there() {
        for roughness in [0.0, 0.5, 1.0] {
            let nothing = Dielectric::new(Vec3::ONE, roughness, 1.0);
            for wo in [degrees(0.0), degrees(59.0), degrees(89.99), -degrees(33.0)] {
                for u in [0.0, 0.5, 0.999] {
                    let sample = nothing.sample(wo, [u, u, u]).unwrap();
                    assert_eq!((sample.wi, sample.weight, sample.pdf), (-wo, Vec3::ONE, 1.0));
                }
            }
        }
    }

    #[test]
    fn refraction_is_reciprocal_up_to_the_scale_of_radiance() {
        let glass = Dielectric::new(Vec3::ONE, 0.6, 1.5);
        for (wo, wi) in [
            (degrees(20.0), -degrees(-10.0)),
            (degrees(50.0), -degrees(25.0)),
            (degrees(5.0), -degrees(40.0)),
        ] {
            let (there, back) = (glass.eval_pdf(wo, wi).0.x, glass.eval_pdf(wi, wo).0.x);
            assert!(there > 0.0, "{wo} {wi}");
            assert!((there * 2.25 - back).abs() <= 2e-5 * back, "{there} x 2.25 against {back}");
        }
    }
}
