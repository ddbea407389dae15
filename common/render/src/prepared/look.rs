//! From a material and a point on it to how light scatters there.

use super::PreparedScene;
use crate::bsdf::{self, Bsdf};
use crate::interaction::Interaction;
use crate::math;
use farm_scene::{Material, Surface, Textured, Volume};
use glam::Vec3;

/// What of a material is known before any ray meets it.
#[derive(Clone, Copy, Debug)]
pub(super) enum Look {
    /// Nothing is scattered.
    Unlit,
    /// The same everywhere, but for vertex colours.
    Uniform(Bsdf),
    /// Looked up, mixed or turned at every hit.
    Varying,
}

impl Look {
    pub fn of(material: &Material) -> Self {
        match &material.surface {
            Surface::Unlit => Self::Unlit,
            Surface::Mirror(_) => Self::Varying,
            Surface::MetallicRoughness { metallic, roughness, dielectric } => {
                let varies = dielectric.transmission.is_some()
                    || metallic.texture.is_some()
                    || roughness.texture.is_some()
                    || material.base_color.texture.is_some()
                    || dielectric.specular.is_some_and(|specular| {
                        specular.strength.texture.is_some() || specular.color.texture.is_some()
                    });
                if varies {
                    return Self::Varying;
                }
                let (specular, specular_color) = dielectric
                    .specular
                    .map_or((1.0, Vec3::ONE), |specular| (specular.strength.factor, specular.color.factor));
                Self::Uniform(Bsdf::metallic_roughness(&bsdf::Surface {
                    base_color: reflectance(material.base_color.factor.truncate()),
                    metallic: metallic.factor,
                    roughness: roughness.factor,
                    ior: dielectric.ior,
                    specular,
                    specular_color,
                }))
            }
        }
    }
}

/// A colour that gives back no more light than it receives.
fn reflectance(color: Vec3) -> Vec3 {
    color.clamp(Vec3::ZERO, Vec3::ONE)
}

impl PreparedScene {
    /// How light scatters at a point; none where nothing does. `pick` in [0, 1) chooses between parts that cannot be evaluated
    /// together, each with the probability of its share.
    pub(crate) fn bsdf(&self, at: &Interaction<'_>, pick: f32) -> Option<Bsdf> {
        match (&self.looks[at.material_index as usize], &at.material.surface) {
            (Look::Unlit, _) => None,
            (Look::Uniform(bsdf), _) if at.mesh.colors.is_none() => Some(*bsdf),
            (_, Surface::Mirror(mirror)) => Some(Bsdf::mirror(mirror, &at.frame)),
            (_, Surface::MetallicRoughness { dielectric, .. }) => {
                let surface = self.surface_at(at);
                let transmission = dielectric
                    .transmission
                    .map_or(0.0, |transmission| self.value(&transmission, at, 0).clamp(0.0, 1.0));
                let (probability, opaque) = surface.split(transmission);
                if pick < probability {
                    return Some(Bsdf::transmissive(&surface, at.material.volume.is_some()));
                }
                Some(Bsdf::metallic_roughness(&opaque))
            }
            (_, Surface::Unlit) => None,
        }
    }

    fn surface_at(&self, at: &Interaction<'_>) -> bsdf::Surface {
        let Surface::MetallicRoughness { metallic, roughness, dielectric } = &at.material.surface else {
            unreachable!("only metallic-roughness surfaces are looked up");
        };
        let (mut metallic_value, mut roughness_value) = (metallic.factor, roughness.factor);
        // One texture holds both: metal in blue, roughness in green.
        if let Some(texture) = &roughness.texture {
            let texel = self.textures().lookup(texture, at.corners.uv(at.mesh, texture.uv_set));
            roughness_value *= texel.y;
            metallic_value *= if metallic.texture == roughness.texture { texel.z } else { 1.0 };
        }
        if metallic.texture.is_some() && metallic.texture != roughness.texture {
            metallic_value = self.value(metallic, at, 2);
        }
        let (specular, specular_color) = match &dielectric.specular {
            None => (1.0, Vec3::ONE),
            Some(specular) => (self.value(&specular.strength, at, 3), self.color(&specular.color, at)),
        };
        bsdf::Surface {
            base_color: reflectance(self.base_color(at.material, at.mesh, &at.corners).truncate()),
            metallic: metallic_value.clamp(0.0, 1.0),
            roughness: roughness_value.clamp(0.0, 1.0),
            ior: dielectric.ior,
            specular: specular.clamp(0.0, 1.0),
            specular_color: specular_color.max(Vec3::ZERO),
        }
    }

    /// Factor times one channel of the texture.
    fn value(&self, textured: &Textured<f32>, at: &Interaction<'_>, channel: usize) -> f32 {
        let texel = textured.texture.map_or(1.0, |texture| {
            self.textures().lookup(&texture, at.corners.uv(at.mesh, texture.uv_set))[channel]
        });
        textured.factor * texel
    }

    fn color(&self, textured: &Textured<Vec3>, at: &Interaction<'_>) -> Vec3 {
        let texel = textured.texture.map_or(Vec3::ONE, |texture| {
            self.textures().lookup(&texture, at.corners.uv(at.mesh, texture.uv_set)).truncate()
        });
        textured.factor * texel
    }
}

/// Absorption of a medium, 1/m (KHR_materials_volume: white light has the attenuation colour after the attenuation distance).
pub(crate) fn absorption(volume: &Volume) -> Vec3 {
    /// Darkest attenuation colour: black would absorb at a distance of zero.
    const DARKEST: f32 = 1e-10;
    let color = volume.attenuation_color.clamp(Vec3::splat(DARKEST), Vec3::ONE);
    Vec3::from(color.to_array().map(|channel| -math::ln(channel))) / volume.attenuation_distance
}
