//! glTF's opaque material: a metal mixed with a diffuse base under a reflecting interface.

use super::fresnel::{SCHLICK_MEAN, Schlick, normal_reflectance, schlick_weight};
use super::ggx::reflect;
use super::{BsdfSample, Conductor, NOTHING};
use crate::math::{INV_PI, luminance};
use crate::sampling;
use glam::Vec3;

/// The numbers of a glTF material at a point, textures and factors multiplied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Colour of the metal, of the diffuse base and of what is transmitted, in [0, 1].
    pub base_color: Vec3,
    /// 0 dielectric .. 1 metal.
    pub metallic: f32,
    /// Perceptual roughness in [0, 1].
    pub roughness: f32,
    /// Index of refraction of the dielectric; 0 stands for an infinite one.
    pub ior: f32,
    /// Strength of the dielectric's reflection, in [0, 1].
    pub specular: f32,
    /// Tint of the dielectric's reflection head on, >= 0.
    pub specular_color: Vec3,
}

impl Default for Surface {
    /// White, rough, index 1.5.
    fn default() -> Self {
        let (base_color, specular_color) = (Vec3::ONE, Vec3::ONE);
        Self { base_color, metallic: 0.0, roughness: 1.0, ior: 1.5, specular: 1.0, specular_color }
    }
}

impl Surface {
    /// For a material that transmits the share `transmission` of what enters its dielectric part: the probability of meeting the
    /// transmissive member, and the opaque surface that is met otherwise. Their mixture is the material.
    pub fn split(&self, transmission: f32) -> (f32, Self) {
        let probability = (1.0 - self.metallic) * transmission;
        let metallic = if probability < 1.0 { self.metallic / (1.0 - probability) } else { 1.0 };
        (probability, Self { metallic: metallic.min(1.0), ..*self })
    }
}

/// The mixture of glTF 2.0, appendix B, with KHR_materials_specular and KHR_materials_ior:
///
/// metallic metal + (1 - metallic) (diffuse + specular), with one distribution of microfacets for both reflections, whose Schlick
/// reflectances add up: f0 = metallic base + (1 - metallic) s min(tint ((ior-1)/(ior+1))^2, 1), f90 = metallic + (1 - metallic) s.
///
/// Appendix B dims the diffuse base by 1 - F at the half vector, which at grazing angles gives back up to 1.9 of the light. Here
/// the interface dims light on its way in and on its way out,
/// base/pi (1 - F(cos_o)) (1 - F(cos_i)) / (1 - mean F), F the largest channel of the dielectric's Schlick reflectance
/// (the coupling of Kelemen and Szirmay-Kalos 2001): reciprocal, exactly 1 with a smooth white base, and within 1 % of appendix B
/// head on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MetallicRoughness {
    specular: Conductor,
    /// Base colour x share of dielectric / (1 - mean F).
    diffuse: Vec3,
    /// Reflectance of the interface over the base: head on, and what is added at grazing angles.
    coat: [f32; 2],
}

impl MetallicRoughness {
    /// From a material's numbers; `metallic` and `specular` are brought into [0, 1].
    pub fn new(surface: &Surface) -> Self {
        let (metallic, strength) = (surface.metallic.clamp(0.0, 1.0), surface.specular.clamp(0.0, 1.0));
        let dielectric = 1.0 - metallic;
        // An index of 1 is no interface: it has no grazing reflection either.
        let strength = if surface.ior == 1.0 { 0.0 } else { strength };
        let tint = (surface.specular_color * normal_reflectance(surface.ior)).min(Vec3::ONE);
        let fresnel = Schlick {
            f0: surface.base_color * metallic + tint * (strength * dielectric),
            f90: metallic + strength * dielectric,
        };
        let head_on = strength * tint.max_element();
        let coat = [head_on, strength - head_on];
        let entering = 1.0 - (coat[0] + coat[1] * SCHLICK_MEAN);
        let diffuse = if entering > 1e-6 { surface.base_color * (dielectric / entering) } else { Vec3::ZERO };
        Self { specular: Conductor::with_fresnel(fresnel, surface.roughness), diffuse, coat }
    }

    /// The reflecting part.
    pub fn specular(&self) -> &Conductor {
        &self.specular
    }

    /// Whether nothing is reflected by microfacets.
    pub fn is_diffuse(&self) -> bool {
        let fresnel = self.specular.fresnel();
        fresnel.f90 == 0.0 && fresnel.f0 == Vec3::ZERO
    }

    /// Whether everything is reflected in the mirror direction.
    pub fn is_delta(&self) -> bool {
        self.diffuse == Vec3::ZERO && self.specular.ggx().is_delta()
    }

    /// Share of light that passes the interface at a cosine.
    fn entering(&self, cos: f32) -> f32 {
        1.0 - (self.coat[0] + self.coat[1] * schlick_weight(cos))
    }

    fn diffuse_at(&self, wo: Vec3, wi: Vec3) -> Vec3 {
        self.diffuse * (self.entering(wo.z) * self.entering(wi.z))
    }

    /// Probability of sampling the reflection, by what both parts are expected to contribute.
    fn specular_probability(&self, wo: Vec3) -> f32 {
        let specular = luminance(self.specular.fresnel().at(wo.z));
        let diffuse = luminance(self.diffuse) * self.entering(wo.z);
        let sum = specular + diffuse;
        if sum > 0.0 { specular / sum } else { 1.0 }
    }

    /// See [`super::Bsdf`].
    pub fn eval_pdf(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return NOTHING;
        }
        self.eval_pdf_with(wo, wi, self.specular_probability(wo))
    }

    /// The same, with the probability of sampling the reflection known and both directions above the surface.
    fn eval_pdf_with(&self, wo: Vec3, wi: Vec3, p: f32) -> (Vec3, f32) {
        let (specular, specular_pdf) = self.specular.eval_pdf(wo, wi);
        let f = self.diffuse_at(wo, wi) * INV_PI + specular;
        (f, p * specular_pdf + (1.0 - p) * sampling::cosine_hemisphere_pdf(wi.z))
    }

    /// See [`super::Bsdf`].
    pub fn sample(&self, wo: Vec3, u: [f32; 3]) -> Option<BsdfSample> {
        if wo.z <= 0.0 {
            return None;
        }
        let p = self.specular_probability(wo);
        let wi = if u[2] < p {
            if self.specular.ggx().is_delta() {
                return Some(BsdfSample::mirror(wo, self.specular.fresnel().at(wo.z) / p, p));
            }
            reflect(wo, self.specular.ggx().sample(wo, [u[0], u[1]]))
        } else {
            sampling::cosine_hemisphere([u[0], u[1]])
        };
        if wi.z <= 0.0 {
            return None;
        }
        let (f, pdf) = self.eval_pdf_with(wo, wi, p);
        Some(BsdfSample::reflection(wi, f * (wi.z / pdf), pdf))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bsdf::Bsdf;

    #[test]
    fn without_reflection_it_is_lambert() {
        let albedo = Vec3::new(0.8, 0.5, 0.1);
        let surface = Surface { base_color: albedo, specular: 0.0, ..Surface::default() };
        let (wo, wi) = (Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.0, -0.8, 0.6));
        assert_eq!(MetallicRoughness::new(&surface).eval_pdf(wo, wi).0, albedo * INV_PI);
        assert!(matches!(Bsdf::metallic_roughness(&surface), Bsdf::Lambert(_)));
        let unity = Surface { ior: 1.0, specular: 1.0, ..surface };
        assert!(matches!(Bsdf::metallic_roughness(&unity), Bsdf::Lambert(_)), "index 1 is no interface");
    }

    #[test]
    fn a_metal_is_its_conductor() {
        let surface = Surface {
            base_color: Vec3::new(1.0, 0.7, 0.3),
            metallic: 1.0,
            roughness: 0.4,
            ..Surface::default()
        };
        let (wo, wi) = (Vec3::new(0.6, 0.0, 0.8), Vec3::new(-0.48, 0.36, 0.8));
        let mixed = MetallicRoughness::new(&surface);
        assert_eq!(mixed.eval_pdf(wo, wi).0, Conductor::new(surface.base_color, 0.4).eval_pdf(wo, wi).0);
        assert!(matches!(Bsdf::metallic_roughness(&surface), Bsdf::Conductor(_)));
    }

    #[test]
    fn a_smooth_white_base_under_glass_returns_everything() {
        let surface = Surface { roughness: 0.0, ..Surface::default() };
        let bsdf = MetallicRoughness::new(&surface);
        for cos in [1.0_f32, 0.7, 0.3, 0.05, 1e-3] {
            let wo = Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos);
            let n = 400;
            let diffuse: f64 = (0..n)
                .map(|i| ((i as f32 + 0.5) / n as f32).sqrt())
                .map(|z| f64::from(bsdf.diffuse_at(wo, Vec3::new(0.0, (1.0 - z * z).sqrt(), z)).x))
                .sum::<f64>()
                / f64::from(n);
            let specular = f64::from(bsdf.specular.fresnel().at(cos).x);
            assert!((diffuse + specular - 1.0).abs() < 1e-4, "cosine {cos}: {diffuse} + {specular}");
        }
    }

    #[test]
    fn the_transmitted_share_and_the_rest_are_the_material() {
        let surface = Surface { metallic: 0.25, ..Surface::default() };
        let (probability, rest) = surface.split(0.4);
        assert!((probability - 0.3).abs() < 1e-6);
        assert!(((1.0 - probability) * rest.metallic - 0.25).abs() < 1e-6, "as much metal as before");
        assert_eq!(Surface { metallic: 0.0, ..surface }.split(1.0).0, 1.0);
        assert_eq!(surface.split(0.0).1, surface);
    }
}
