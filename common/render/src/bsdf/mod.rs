//! Scattering of light at a point of a surface.
//!
//! | glTF material at a point | member |
//! | --- | --- |
//! | metallic 0, no reflecting interface (`specularFactor` 0 or index 1) | [`Lambert`] |
//! | metallic 1 | [`Conductor`] |
//! | anything between | [`MetallicRoughness`] |
//! | the transmitted share, without volume | [`Thin`] |
//! | the transmitted share, with volume | [`Dielectric`] |
//! | `extras.mirror` | [`Mirror`] |
//!
//! [`Bsdf::metallic_roughness`] chooses among the first three, [`Bsdf::transmissive`] between the next two. The transmitted share
//! of a material is (1 - metallic) transmission: a caller picks the transmissive member with that probability, and with the rest
//! an opaque one whose metallic is divided by the probability (see [`Surface::split`]). Constructors read no table.

mod conductor;
mod dielectric;
mod energy;
mod fresnel;
mod ggx;
mod lambert;
mod metallic_roughness;
mod mirror;
mod thin;

pub use conductor::Conductor;
pub use dielectric::Dielectric;
pub use fresnel::{Schlick, dielectric_reflectance};
pub use ggx::Ggx;
pub use lambert::Lambert;
pub use metallic_roughness::{MetallicRoughness, Surface};
pub use mirror::Mirror;
pub use thin::Thin;

use crate::math::Frame;
use glam::Vec3;

/// Beyond it an interface reflects everything, as 1 - 4/index rounds to 1, and the squares of Fresnel's equations overflow soon after.
const IOR_MAX: f32 = 1e9;

/// How light scatters at a point: a closed family.
///
/// Directions are unit vectors, point away from the surface, and live in the shading frame, whose normal is +z: `wo` towards where
/// the light goes, `wi` towards where it comes from. Opaque members are black from below (z <= 0); a surface that looks the same
/// from both sides turns its frame. Each member has the same two functions:
///
/// - `eval_pdf(wo, wi)` gives the scattering function f in 1/sr, without the cosine, and the density over solid angle with which
///   `sample(wo, _)` gives `wi`. Both are 0 for the delta part of a member. The density integrates to less than 1 where sampling
///   sometimes gives nothing;
/// - `sample(wo, u)` draws a direction by three numbers in [0, 1); `None` means the light is absorbed, and counts as a sample.
///
/// Except for refraction all are reciprocal; light that is refracted obeys f(wo, wi) eta^2 = f(wi, wo) with eta the index where
/// `wi` is over that where `wo` is. None gives back more light than it receives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bsdf {
    /// Ideal diffuse reflection.
    Lambert(Lambert),
    /// Metal, or any surface that only reflects.
    Conductor(Conductor),
    /// glTF's mixture of a metal and a coated diffuse base.
    MetallicRoughness(MetallicRoughness),
    /// Interface to the inside of a solid body: reflects and refracts.
    Dielectric(Dielectric),
    /// Infinitely thin sheet: reflects and lets through.
    Thin(Thin),
    /// Classic glossy mirror of distribution ray tracing.
    Mirror(Mirror),
}

/// A direction drawn from a [`Bsdf`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BsdfSample {
    /// Where light comes from.
    pub wi: Vec3,
    /// f |cos| / pdf, computed so that it is finite where its parts are not.
    pub weight: Vec3,
    /// Density over solid angle; for delta directions the probability of having been chosen.
    pub pdf: f32,
    /// Whether the direction was the only possible one; then no other strategy could have found it.
    pub delta: bool,
    /// Whether light comes from the other side of the surface.
    pub transmission: bool,
    /// Index of refraction where `wi` is over that where `wo` is; 1 unless refracted. The weight holds the factor 1/eta^2 by which
    /// radiance shrinks on its way into the thinner medium; roulette multiplies it back (throughput x eta^2).
    pub eta: f32,
}

impl BsdfSample {
    /// A direction on the same side from a continuous density.
    fn reflection(wi: Vec3, weight: Vec3, pdf: f32) -> Self {
        Self { wi, weight, pdf, delta: false, transmission: false, eta: 1.0 }
    }

    /// The mirror direction, chosen with the given probability.
    fn mirror(wo: Vec3, weight: Vec3, probability: f32) -> Self {
        Self { delta: true, ..Self::reflection(Vec3::new(-wo.x, -wo.y, wo.z), weight, probability) }
    }
}

/// Nothing is scattered from one direction into the other.
const NOTHING: (Vec3, f32) = (Vec3::ZERO, 0.0);

/// Calls the same function of whatever member it is.
macro_rules! each {
    ($bsdf:expr, $member:ident => $call:expr) => {
        match $bsdf {
            Bsdf::Lambert($member) => $call,
            Bsdf::Conductor($member) => $call,
            Bsdf::MetallicRoughness($member) => $call,
            Bsdf::Dielectric($member) => $call,
            Bsdf::Thin($member) => $call,
            Bsdf::Mirror($member) => $call,
        }
    };
}

impl Bsdf {
    /// The simplest member for glTF's opaque metallic-roughness surface.
    pub fn metallic_roughness(surface: &Surface) -> Self {
        if surface.metallic >= 1.0 {
            return Self::Conductor(Conductor::new(surface.base_color, surface.roughness));
        }
        let full = MetallicRoughness::new(surface);
        if full.is_diffuse() {
            Self::Lambert(Lambert::new(surface.base_color))
        } else {
            Self::MetallicRoughness(full)
        }
    }

    /// The transmissive part of a glTF surface: `solid` when the mesh has a volume. Nothing enters a medium of infinite index, which 0
    /// stands for.
    pub fn transmissive(surface: &Surface, solid: bool) -> Self {
        let Surface { base_color, roughness, ior, .. } = *surface;
        if ior == 0.0 || ior > IOR_MAX {
            Self::Conductor(Conductor::new(Vec3::ONE, roughness))
        } else if solid {
            Self::Dielectric(Dielectric::new(base_color, roughness, ior))
        } else {
            Self::Thin(Thin::new(base_color, roughness, ior))
        }
    }

    /// The classic glossy mirror; `frame` is the shading frame in world space, see [`Mirror::new`].
    pub fn mirror(mirror: &farm_scene::Mirror, frame: &Frame) -> Self {
        Self::Mirror(Mirror::new(mirror.reflectance, mirror.roughness, mirror.centered, frame))
    }

    /// Scattering function in 1/sr, without the cosine, and density over solid angle of `sample`: what light sampling needs, for
    /// little more than the price of one of them.
    pub fn eval_pdf(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        each!(self, member => member.eval_pdf(wo, wi))
    }

    /// Scattering function in 1/sr, without the cosine.
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Vec3 {
        self.eval_pdf(wo, wi).0
    }

    /// Density over solid angle of `sample`.
    pub fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        self.eval_pdf(wo, wi).1
    }

    /// Draws a direction; `None` means absorbed.
    pub fn sample(&self, wo: Vec3, u: [f32; 3]) -> Option<BsdfSample> {
        each!(self, member => member.sample(wo, u))
    }

    /// Whether light that is sampled directly can never be seen: everything goes in delta directions.
    pub fn is_delta(&self) -> bool {
        match self {
            Self::Lambert(_) => false,
            Self::Conductor(conductor) => conductor.ggx().is_delta(),
            Self::MetallicRoughness(mixed) => mixed.is_delta(),
            Self::Dielectric(dielectric) => dielectric.is_delta(),
            Self::Thin(thin) => thin.is_delta(),
            Self::Mirror(mirror) => mirror.is_delta(),
        }
    }

    /// Whether directions below the surface can carry light.
    pub fn transmits(&self) -> bool {
        matches!(self, Self::Dielectric(_) | Self::Thin(_))
    }

    /// The same without its diffuse part: what distribution ray tracing of 1984 recurses into. `None` when nothing is left.
    pub fn without_diffuse(&self) -> Option<Self> {
        match self {
            Self::Lambert(_) => None,
            Self::MetallicRoughness(mixed) => Some(Self::Conductor(*mixed.specular())),
            other => Some(*other),
        }
    }
}

#[cfg(test)]
mod tests;
