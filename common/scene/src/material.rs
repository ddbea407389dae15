//! How surfaces look: factors and the textures that multiply them.

use crate::TextureRef;
use glam::{Vec3, Vec4};
use serde::{Deserialize, Serialize};

/// A factor and the texture that multiplies it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Textured<T> {
    /// The constant part.
    pub factor: T,
    /// Multiplies `factor`; which channels is said where the value is used.
    pub texture: Option<TextureRef>,
}

impl<T> Textured<T> {
    /// A value without a texture.
    pub const fn constant(factor: T) -> Self {
        Self { factor, texture: None }
    }
}

/// What is done with the base colour's alpha.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum AlphaMode {
    /// Alpha is ignored.
    #[default]
    Opaque,
    /// Nothing is there where alpha is below the cutoff.
    Mask {
        /// Usually 0.5.
        cutoff: f32,
    },
    /// The surface is there with probability alpha.
    Blend,
}

/// A tangent-space normal map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NormalMap {
    /// Linear RGB: n = normalize((2 rgb - 1) * (scale, scale, 1)).
    pub texture: TextureRef,
    /// Strength of the tilt.
    pub scale: f32,
}

/// The dielectric interface's strength and tint (KHR_materials_specular).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Specular {
    /// Multiplies reflection; texture channel A.
    pub strength: Textured<f32>,
    /// Multiplies reflection at normal incidence; texture RGB, sRGB.
    pub color: Textured<Vec3>,
}

/// The dielectric interface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dielectric {
    /// Index of refraction; 1.5 unless said otherwise, >= 1, or 0 for a mirror of infinite index.
    pub ior: f32,
    /// Strength and tint; none means 1 and white.
    pub specular: Option<Specular>,
    /// Share of light that enters and goes straight on through; texture channel R. None: nothing does.
    pub transmission: Option<Textured<f32>>,
}

/// What is inside a closed transmissive mesh; without it a transmissive surface is infinitely thin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Volume {
    /// Metres after which light has the attenuation colour; infinite means clear.
    pub attenuation_distance: f32,
    /// Colour of white light after that distance.
    pub attenuation_color: Vec3,
}

/// Classic glossy mirror of distribution ray tracing: the mirror direction, perturbed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mirror {
    /// Multiplies what is reflected, per channel in [0, 1].
    pub reflectance: Vec3,
    /// Side of the square around the mirror direction's tip over which directions spread.
    pub roughness: f32,
    /// Whether the square is centred on the mirror direction; otherwise it starts there, which shifts the lobe.
    pub centered: bool,
}

/// How a surface scatters light.
#[expect(
    clippy::large_enum_variant,
    reason = "a scene has few materials, and nearly all are of the large kind"
)]
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Surface {
    /// glTF's metallic-roughness model.
    MetallicRoughness {
        /// 0 dielectric .. 1 metal; texture channel B.
        metallic: Textured<f32>,
        /// Perceptual roughness, alpha = roughness^2; texture channel G (the same texture as `metallic`).
        roughness: Textured<f32>,
        /// The dielectric part.
        dielectric: Dielectric,
    },
    /// The base colour is emitted as it is; nothing is scattered (KHR_materials_unlit).
    Unlit,
    /// Classic glossy mirror; the base colour is not used.
    Mirror(Mirror),
}

/// Light that a surface gives off by itself.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Emission {
    /// Radiance, W/sr/m^2; texture RGB, sRGB.
    pub radiance: Textured<Vec3>,
}

/// A surface's look.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// For messages.
    pub name: String,
    /// Linear RGB and alpha; texture RGBA, sRGB. Multiplied by vertex colours.
    pub base_color: Textured<Vec4>,
    /// Scattering.
    pub surface: Surface,
    /// Inside of closed transmissive meshes.
    pub volume: Option<Volume>,
    /// Tilt of the shading normal.
    pub normal_map: Option<NormalMap>,
    /// Light given off; none means dark. Given off by the front only, unless double-sided.
    pub emission: Option<Emission>,
    /// Use of alpha.
    pub alpha_mode: AlphaMode,
    /// Whether the back looks like the front. A single-sided surface is black and opaque from behind, and does not emit
    /// there; a transmissive one is always seen from both sides.
    pub double_sided: bool,
}

impl Material {
    /// A white, rough dielectric: glTF's default without its metal.
    pub fn lambert(name: &str, albedo: Vec3) -> Self {
        let specular = Specular { strength: Textured::constant(0.0), color: Textured::constant(Vec3::ONE) };
        Self {
            name: name.to_owned(),
            base_color: Textured::constant(albedo.extend(1.0)),
            surface: Surface::MetallicRoughness {
                metallic: Textured::constant(0.0),
                roughness: Textured::constant(1.0),
                dielectric: Dielectric { ior: 1.5, specular: Some(specular), transmission: None },
            },
            volume: None,
            normal_map: None,
            emission: None,
            alpha_mode: AlphaMode::Opaque,
            double_sided: true,
        }
    }

    /// A metal whose reflectance at normal incidence is `f0`.
    pub fn metal(name: &str, f0: Vec3, roughness: f32) -> Self {
        let surface = Surface::MetallicRoughness {
            metallic: Textured::constant(1.0),
            roughness: Textured::constant(roughness),
            dielectric: Dielectric { ior: 1.5, specular: None, transmission: None },
        };
        Self { surface, ..Self::lambert(name, f0) }
    }

    /// A black one-sided emitter.
    pub fn emitter(name: &str, radiance: Vec3) -> Self {
        Self {
            emission: Some(Emission { radiance: Textured::constant(radiance) }),
            double_sided: false,
            ..Self::lambert(name, Vec3::ZERO)
        }
    }
}
