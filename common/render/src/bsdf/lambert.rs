//! Ideal diffuse reflection.

use super::{BsdfSample, NOTHING};
use crate::math::INV_PI;
use crate::sampling;
use glam::Vec3;

/// Reflects evenly into all directions above the surface: f = albedo / pi.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lambert {
    albedo: Vec3,
}

impl Lambert {
    /// A surface that reflects the share `albedo` of what it receives, per channel in [0, 1].
    pub fn new(albedo: Vec3) -> Self {
        Self { albedo }
    }

    /// Share of light that is reflected.
    pub fn albedo(&self) -> Vec3 {
        self.albedo
    }

    /// See [`super::Bsdf`].
    pub fn eval_pdf(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return NOTHING;
        }
        (self.albedo * INV_PI, sampling::cosine_hemisphere_pdf(wi.z))
    }

    /// See [`super::Bsdf`].
    pub fn sample(&self, wo: Vec3, u: [f32; 3]) -> Option<BsdfSample> {
        let wi = sampling::cosine_hemisphere([u[0], u[1]]);
        let possible = wo.z > 0.0 && wi.z > 0.0;
        possible.then(|| BsdfSample::reflection(wi, self.albedo, sampling::cosine_hemisphere_pdf(wi.z)))
    }
}
