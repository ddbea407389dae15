//! The GGX distribution of microfacets with height-correlated Smith masking (Walter et al. 2007; Heitz 2014, "Understanding the
//! Masking-Shadowing Function in Microfacet-Based BRDFs").
//!
//! Everything is written with the length l(w) = sqrt(alpha^2 (x^2 + y^2) + z^2) of the direction stretched by the roughness, in which
//! neither grazing nor nearly smooth surfaces cancel: G1 = 2z / (z + l), G2 / (4 zo zi) = 0.5 / (zi l(wo) + zo l(wi)).

use crate::math;
use glam::Vec3;

/// Below this width in radians microfacets are a mirror: single precision could not tell the directions apart, no image could
/// show them, and the albedo is the same to one part in a million.
const SMOOTH: f32 = 1e-6;

/// A distribution of microfacet normals around +z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ggx {
    alpha: f32,
}

/// Scattering by perfectly reflecting microfacets of one normal.
#[derive(Clone, Copy, Debug)]
pub struct Reflection {
    /// D G2 / (4 cos cos), in 1/sr.
    pub scattering: f32,
    /// D G1 / (4 cos): density of directions mirrored at visible normals.
    pub pdf: f32,
}

impl Ggx {
    /// From perceptual roughness in [0, 1]: alpha = roughness^2, as glTF says.
    pub fn from_roughness(roughness: f32) -> Self {
        let roughness = roughness.clamp(0.0, 1.0);
        let alpha = roughness * roughness;
        #[cfg(feature = "mutations")]
        let alpha = crate::mutations::alpha(alpha, roughness);
        Self { alpha }
    }

    /// Width of the distribution: tangent of the typical slope.
    pub fn alpha(&self) -> f32 {
        self.alpha
    }

    /// Whether the surface is a perfect mirror.
    pub fn is_delta(&self) -> bool {
        self.alpha < SMOOTH
    }

    /// Area of microfacets per area and solid angle around the unit normal `h`.
    pub fn density(&self, h: Vec3) -> f32 {
        let alpha2 = self.alpha * self.alpha;
        let t = self.alpha / (h.x * h.x + h.y * h.y + alpha2 * h.z * h.z);
        t * t * math::INV_PI
    }

    fn stretched_length(&self, w: Vec3) -> f32 {
        (self.alpha * self.alpha * (w.x * w.x + w.y * w.y) + w.z * w.z).sqrt()
    }

    /// What microfacets of normal `h` send from `wi` to `wo`, on the same or on opposite sides, and how often.
    pub fn reflection(&self, wo: Vec3, wi: Vec3, h: Vec3) -> Reflection {
        let (zo, zi) = (wo.z.abs(), wi.z.abs());
        let (lo, li) = (self.stretched_length(wo), self.stretched_length(wi));
        let half_density = 0.5 * self.density(h);
        let scattering = half_density / (zi * lo + zo * li).max(f32::MIN_POSITIVE);
        Reflection { scattering, pdf: half_density / (zo + lo) }
    }

    /// G2(wo, wi) / G1(wo): what is left of a sample drawn from the visible normals.
    pub fn masking(&self, wo: Vec3, wi: Vec3) -> f32 {
        let (zo, zi) = (wo.z.abs(), wi.z.abs());
        let (lo, li) = (self.stretched_length(wo), self.stretched_length(wi));
        zi * (zo + lo) / (zi * lo + zo * li).max(f32::MIN_POSITIVE)
    }

    /// Density over solid angle with which `wo`, mirrored at the microfacets of [`Ggx::sample`], goes where `h` sends it.
    pub fn reflection_pdf(&self, wo: Vec3, h: Vec3) -> f32 {
        0.5 * self.density(h) / (wo.z.abs() + self.stretched_length(wo))
    }

    /// Draws a microfacet's normal among those visible from `wo`, z >= 0 (Dupuy and Benyoub 2023, "Sampling Visible GGX Normals with
    /// Spherical Caps"; with 1 - z^2 of the cap's point as a product, so that narrow lobes keep their shape).
    pub fn sample(&self, wo: Vec3, u: [f32; 2]) -> Vec3 {
        let stretched = Vec3::new(self.alpha * wo.x, self.alpha * wo.y, wo.z) / self.stretched_length(wo);
        let above = 1.0 + stretched.z;
        let below = (stretched.x * stretched.x + stretched.y * stretched.y) / above;
        let height = (1.0 - u[1]) * above;
        let cap = math::polar(math::safe_sqrt(u[1] * above * (height + below)), u[0]);
        let (x, y) = (cap.x + stretched.x, cap.y + stretched.y);
        Vec3::new(self.alpha * x, self.alpha * y, height).normalize()
    }
}

/// Mirrors `wo` at the microfacet with normal `h`.
pub fn reflect(wo: Vec3, h: Vec3) -> Vec3 {
    h * (2.0 * wo.dot(h)) - wo
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn projected_microfacets_cover_the_surface_once() {
        for roughness in [0.1, 0.5, 1.0] {
            let ggx = Ggx::from_roughness(roughness);
            let n = 20_000;
            // Over s = sin^2, the measure of projected solid angle; substituted s = t^4 to resolve the peak.
            let area: f64 = (0..n)
                .map(|i| (f64::from(i) + 0.5) / f64::from(n))
                .map(|t| {
                    let s = t.powi(4) as f32;
                    let h = Vec3::new(s.sqrt(), 0.0, (1.0 - s).sqrt());
                    std::f64::consts::PI * 4.0 * t.powi(3) * f64::from(ggx.density(h))
                })
                .sum::<f64>()
                / f64::from(n);
            assert!((area - 1.0).abs() < 1e-3, "roughness {roughness}: {area}");
        }
    }

    #[test]
    fn normals_are_unit_vectors_above_the_surface_whatever_the_numbers() {
        for roughness in [1e-3, 0.03, 0.5, 1.0] {
            let ggx = Ggx::from_roughness(roughness);
            for wo in [Vec3::Z, Vec3::new(1.0, 0.0, 1e-6).normalize(), Vec3::new(0.6, 0.0, 0.8)] {
                for u in [[0.0, 0.0], [0.3, math::ONE_MINUS_EPSILON], [math::ONE_MINUS_EPSILON, 0.5]] {
                    let h = ggx.sample(wo, u);
                    assert!((h.length() - 1.0).abs() < 1e-5 && h.z >= 0.0, "{roughness} {wo} {u:?}: {h}");
                }
            }
        }
    }
}
