//! Materials, as glTF and its extensions express them.

use super::{Gltf, number, numbers};
use serde_json::{Value, json};

/// Index of a material.
#[derive(Clone, Copy, Debug)]
pub struct Material(pub(super) usize);

impl Gltf {
    /// Pure Lambert of this reflectance.
    pub fn diffuse(&mut self, name: &str, reflectance: [f32; 3]) -> Material {
        let extensions = self.no_specular();
        self.material(json!({
            "name": name,
            "doubleSided": true,
            "pbrMetallicRoughness": pbr(reflectance, 0.0, 1.0),
            "extensions": extensions,
        }))
    }

    /// GGX metal of this reflectance at normal incidence; `alpha = roughness^2`.
    pub fn metal(&mut self, name: &str, reflectance: [f32; 3], roughness: f32) -> Material {
        self.material(json!({
            "name": name,
            "doubleSided": true,
            "pbrMetallicRoughness": pbr(reflectance, 1.0, roughness),
        }))
    }

    /// Lambert under a dielectric coat of index 1.5.
    pub fn plastic(&mut self, name: &str, reflectance: [f32; 3], roughness: f32) -> Material {
        self.material(json!({
            "name": name,
            "doubleSided": true,
            "pbrMetallicRoughness": pbr(reflectance, 0.0, roughness),
        }))
    }

    /// Clear, smooth, solid glass of this index of refraction.
    pub fn glass(&mut self, name: &str, ior: f32) -> Material {
        let thickness = self.scale.said(1.0);
        self.extensions.extend(["KHR_materials_transmission", "KHR_materials_volume", "KHR_materials_ior"]);
        self.material(json!({
            "name": name,
            "pbrMetallicRoughness": pbr([1.0; 3], 0.0, 0.0),
            "extensions": {
                "KHR_materials_transmission": { "transmissionFactor": 1.0 },
                "KHR_materials_volume": { "thicknessFactor": thickness },
                "KHR_materials_ior": { "ior": number(ior) },
            },
        }))
    }

    /// Emits `color * strength` W/sr/m^2 from its front side and reflects nothing.
    pub fn emitter(&mut self, name: &str, color: [f32; 3], strength: f32) -> Material {
        self.extensions.insert("KHR_materials_emissive_strength");
        let mut extensions = self.no_specular();
        extensions["KHR_materials_emissive_strength"] = json!({ "emissiveStrength": number(strength) });
        self.material(json!({
            "name": name,
            "pbrMetallicRoughness": pbr([0.0; 3], 0.0, 1.0),
            "emissiveFactor": numbers(&color),
            "extensions": extensions,
        }))
    }

    fn no_specular(&mut self) -> Value {
        self.extensions.insert("KHR_materials_specular");
        json!({ "KHR_materials_specular": { "specularFactor": 0.0 } })
    }

    fn material(&mut self, material: Value) -> Material {
        self.materials.push(material);
        Material(self.materials.len() - 1)
    }
}

fn pbr(color: [f32; 3], metallic: f32, roughness: f32) -> Value {
    json!({
        "baseColorFactor": numbers(&[color[0], color[1], color[2], 1.0]),
        "metallicFactor": number(metallic),
        "roughnessFactor": number(roughness),
    })
}
