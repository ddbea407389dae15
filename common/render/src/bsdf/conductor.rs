//! Reflection by microfacets: metals.

use super::energy::{self, Compensation};
use super::fresnel::Schlick;
use super::ggx::{Ggx, reflect};
use super::{BsdfSample, Lambert, NOTHING};
use crate::math::INV_PI;
use glam::Vec3;

/// GGX microfacets that reflect by Schlick's approximation, each ray once.
///
/// Rough metals lose the light that would bounce between microfacets; on request it is given back as a broad lobe (Kulla and Conty
/// 2017, "Revisiting Physically Based Shading at Imageworks"). The default is without, as glTF's appendix B has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conductor {
    fresnel: Schlick,
    ggx: Ggx,
    compensated: bool,
}

impl Conductor {
    /// A metal of reflectance `f0` head on and 1 at grazing angles; perceptual roughness in [0, 1].
    pub fn new(f0: Vec3, roughness: f32) -> Self {
        Self::with_fresnel(Schlick { f0, f90: 1.0 }, roughness)
    }

    /// Any reflectance.
    pub fn with_fresnel(fresnel: Schlick, roughness: f32) -> Self {
        Self { fresnel, ggx: Ggx::from_roughness(roughness), compensated: false }
    }

    /// Whether light that bounces between microfacets is given back.
    #[must_use]
    pub fn compensated(self, compensated: bool) -> Self {
        Self { compensated, ..self }
    }

    /// The microfacets.
    pub fn ggx(&self) -> &Ggx {
        &self.ggx
    }

    /// The reflectance.
    pub fn fresnel(&self) -> &Schlick {
        &self.fresnel
    }

    /// See [`super::Bsdf`].
    pub fn eval_pdf(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        if wo.z <= 0.0 || wi.z <= 0.0 || self.ggx.is_delta() {
            return NOTHING;
        }
        let sum = wo + wi;
        let length = sum.length();
        let facets = self.ggx.reflection(wo, wi, sum / length);
        // Both directions are of unit length, so half that of their sum is the cosine to the microfacet, the same either way.
        let single = self.fresnel.at(0.5 * length) * facets.scattering;
        match self.compensation(wo) {
            None => (single, facets.pdf),
            Some(lost) => (
                single + self.multiple(&lost, wi) * INV_PI,
                (1.0 - lost.at_wo) * facets.pdf + lost.at_wo * wi.z * INV_PI,
            ),
        }
    }

    /// See [`super::Bsdf`].
    pub fn sample(&self, wo: Vec3, u: [f32; 3]) -> Option<BsdfSample> {
        if wo.z <= 0.0 {
            return None;
        }
        if self.ggx.is_delta() {
            return Some(BsdfSample::mirror(wo, self.fresnel.at(wo.z), 1.0));
        }
        match self.compensation(wo) {
            None => self.sample_single(wo, [u[0], u[1]]),
            Some(lost) => self.sample_both(wo, u, lost.at_wo),
        }
    }

    fn sample_single(&self, wo: Vec3, u: [f32; 2]) -> Option<BsdfSample> {
        let h = self.ggx.sample(wo, u);
        let wi = reflect(wo, h);
        (wi.z > 0.0).then(|| {
            let weight = self.fresnel.at(wo.dot(h)) * self.ggx.masking(wo, wi);
            BsdfSample::reflection(wi, weight, self.ggx.reflection_pdf(wo, h))
        })
    }

    /// The broad lobe carries about the share of light that the sharp one loses.
    fn sample_both(&self, wo: Vec3, u: [f32; 3], broad: f32) -> Option<BsdfSample> {
        let uv = [u[0], u[1]];
        let drawn =
            if u[2] < broad { Lambert::new(Vec3::ONE).sample(wo, u) } else { self.sample_single(wo, uv) }?;
        let (f, pdf) = self.eval_pdf(wo, drawn.wi);
        Some(BsdfSample::reflection(drawn.wi, f * (drawn.wi.z / pdf), pdf))
    }

    fn compensation(&self, wo: Vec3) -> Option<Compensation> {
        if self.compensated { energy::compensation(&self.ggx, wo.z) } else { None }
    }

    /// pi times the broad lobe.
    fn multiple(&self, lost: &Compensation, wi: Vec3) -> Vec3 {
        let fresnel = self.fresnel.mean();
        let colour = fresnel * fresnel * (1.0 - lost.mean) / (Vec3::ONE - fresnel * lost.mean);
        colour * (lost.at_wo * energy::lost(&self.ggx, wi.z) / lost.mean)
    }
}
