//! How much an interface reflects.

use glam::Vec3;

/// Schlick's approximation (1994): f0 + (f90 - f0) (1 - cos)^5.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Schlick {
    /// Reflectance at normal incidence.
    pub f0: Vec3,
    /// Reflectance at grazing incidence.
    pub f90: f32,
}

impl Schlick {
    /// Reflectance at an angle to the microfacet's normal.
    pub fn at(&self, cos: f32) -> Vec3 {
        self.f0 + (Vec3::splat(self.f90) - self.f0) * schlick_weight(cos)
    }

    /// Mean over all directions, weighed by the cosine: the integral of 2 mu F(mu).
    pub fn mean(&self) -> Vec3 {
        self.f0 + (Vec3::splat(self.f90) - self.f0) * SCHLICK_MEAN
    }
}

/// Integral of 2 mu (1 - mu)^5 over [0, 1].
pub const SCHLICK_MEAN: f32 = 1.0 / 21.0;

/// (1 - cos)^5.
pub fn schlick_weight(cos: f32) -> f32 {
    let x = (1.0 - cos).clamp(0.0, 1.0);
    let x2 = x * x;
    x2 * x2 * x
}

/// Reflectance at normal incidence of an interface whose indices have the ratio `ior`. An index of 0 stands for an infinite one.
pub fn normal_reflectance(ior: f32) -> f32 {
    let r = (ior - 1.0) / (ior + 1.0);
    r * r
}

/// What Fresnel's equations say of a ray that meets an interface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interface {
    /// Share that is reflected, unpolarised.
    pub reflectance: f32,
    /// Cosine of the refracted ray times the relative index; 0 when everything is reflected.
    pub eta_cos_t: f32,
}

/// Fresnel's equations for light that comes at cosine `cos_i` >= 0 and goes into a medium whose index is `eta` times that of where
/// it is.
///
/// With g = eta cos_t and k = eta^2 - 1 the amplitudes are k / (c + g)^2 and k ((eta^2 + 1) c^2 - 1) / (eta^2 c + g)^2, which neither
/// cancel for eta near 1 nor reflect anything at eta = 1.
pub fn interface(cos_i: f32, eta: f32) -> Interface {
    let c = cos_i.min(1.0);
    let (k, eta2) = ((eta - 1.0) * (eta + 1.0), eta * eta);
    let g2 = k + c * c;
    if g2 < 0.0 {
        return Interface { reflectance: 1.0, eta_cos_t: 0.0 };
    }
    let g = g2.sqrt();
    if k == 0.0 {
        return Interface { reflectance: 0.0, eta_cos_t: g };
    }
    let (s, p) = (c + g, eta2 * c + g);
    let (r_s, r_p) = (k / (s * s), k * ((eta2 + 1.0) * c * c - 1.0) / (p * p));
    Interface { reflectance: (0.5 * (r_s * r_s + r_p * r_p)).min(1.0), eta_cos_t: g }
}

/// Share of unpolarised light that is reflected at cosine `cos_i` by a medium of relative index `eta`.
pub fn dielectric_reflectance(cos_i: f32, eta: f32) -> f32 {
    interface(cos_i, eta).reflectance
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_close(what: &str, value: f32, expected: f32, relative: f32) {
        assert!((value - expected).abs() <= relative * expected.abs(), "{what}: {value}, not {expected}");
    }

    #[test]
    fn glass_reflects_as_the_tables_say() {
        let brewster = 56.309_93_f32.to_radians().cos();
        let schlick = Schlick { f0: Vec3::splat(normal_reflectance(1.5)), f90: 1.0 };
        assert_close("head on", dielectric_reflectance(1.0, 1.5), 0.04, 1e-6);
        assert_close("60 degrees", dielectric_reflectance(0.5, 1.5), 0.089_186_7, 1e-6);
        assert_close("60 degrees, Schlick", schlick.at(0.5).x, 0.07, 1e-6);
        assert_close("Brewster's angle", dielectric_reflectance(brewster, 1.5), 0.073_964_5, 1e-6);
        assert_close("Brewster's angle, Schlick", schlick.at(brewster).x, 0.056_808_7, 1e-6);
    }

    #[test]
    fn reflectance_head_on_follows_the_index() {
        for (ior, f0) in [(2.42, 0.172_395), (100.0, 0.960_788)] {
            assert_close("exact", dielectric_reflectance(1.0, ior), f0, 1e-5);
            assert_close("Schlick's f0", normal_reflectance(ior), f0, 1e-5);
        }
        // 1.0001 itself is only known to half a unit in the last place.
        assert_close("1.0001", dielectric_reflectance(1.0, 1.0001), 2.499_75e-9, 1e-3);
        assert_eq!(dielectric_reflectance(1.0, 1.0), 0.0);
        assert_eq!(dielectric_reflectance(1e-6, 1.0), 0.0);
        assert_eq!(normal_reflectance(0.0), 1.0, "stands for an infinite index");
    }

    #[test]
    fn beyond_the_critical_angle_everything_is_reflected() {
        let degrees = |d: f32| d.to_radians().cos();
        assert!(dielectric_reflectance(degrees(41.80), 1.0 / 1.5) < 0.98);
        assert_eq!(dielectric_reflectance(degrees(41.82), 1.0 / 1.5), 1.0);
        assert_eq!(dielectric_reflectance(0.0, 1.5), 1.0);
        assert_eq!(dielectric_reflectance(0.0, 1.0 / 1.5), 1.0);
    }

    #[test]
    fn the_way_back_reflects_as_much() {
        for i in 1..100 {
            let c = i as f32 / 100.0;
            let there = interface(c, 1.5);
            let back = interface(there.eta_cos_t / 1.5, 1.0 / 1.5);
            assert!((there.reflectance - back.reflectance).abs() < 1e-4, "cosine {c}");
        }
    }

    #[test]
    fn schlicks_mean_is_its_integral() {
        let n = 10_000;
        let mean: f64 = (0..n)
            .map(|i| (f64::from(i) + 0.5) / f64::from(n))
            .map(|mu| 2.0 * mu * f64::from(schlick_weight(mu as f32)))
            .sum::<f64>()
            / f64::from(n);
        assert!((mean - f64::from(SCHLICK_MEAN)).abs() < 1e-6, "{mean}");
    }
}
