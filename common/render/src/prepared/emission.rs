//! What surfaces give off, and where they are not there at all.

use super::PreparedScene;
use crate::accel::Hit;
use crate::interaction::{Corners, Interaction};
use crate::texture::Textures;
use farm_scene::{AlphaMode, Material, Mesh, Surface};
use glam::{Vec3, Vec4};

impl PreparedScene {
    /// Linear RGBA of the surface: factor x texture x vertex colour.
    pub(crate) fn base_color(&self, material: &Material, mesh: &Mesh, corners: &Corners) -> Vec4 {
        let mut color = material.base_color.factor * corners.color(mesh);
        if let Some(texture) = &material.base_color.texture {
            color *= self.textures().lookup(texture, corners.uv(mesh, texture.uv_set));
        }
        color
    }

    /// Whether a surface with alpha stops the ray that met it; `draw` is uniform in [0, 1) and only asked for where the
    /// surface is there by probability.
    pub(crate) fn is_there(&self, hit: &Hit, draw: impl FnOnce() -> f32) -> bool {
        let Some(drawn) = self.drawn.get(hit.instance as usize).filter(|drawn| drawn.cutout) else {
            return true;
        };
        let (mesh, material) = self.mesh_and_material(drawn);
        let coverage = self.coverage(material, mesh, &Corners::new(mesh, hit));
        coverage >= 1.0 || (coverage > 0.0 && draw() < coverage)
    }

    /// Radiance given off towards the viewer.
    pub(crate) fn emitted(&self, at: &Interaction<'_>) -> Vec3 {
        if matches!(at.material.surface, Surface::Unlit) {
            return self.base_color(at.material, at.mesh, &at.corners).truncate();
        }
        #[cfg(feature = "mutations")]
        if crate::mutations::is_on(crate::mutations::Mutation::EmitterTwoSided) {
            return emitted_by(&self.textures(), at.material, at.mesh, &at.corners);
        }
        if !(at.front || at.material.double_sided) {
            return Vec3::ZERO;
        }
        emitted_by(&self.textures(), at.material, at.mesh, &at.corners)
    }

    /// Radiance given off by a point of an emissive mesh on a side that emits, times the probability that it is there.
    pub(crate) fn emitted_at(&self, instance: u32, primitive: u32, u: f32, v: f32) -> Vec3 {
        let drawn = &self.drawn[instance as usize];
        let (mesh, material) = self.mesh_and_material(drawn);
        let corners = Corners::at(mesh, primitive, u, v);
        let radiance = emitted_by(&self.textures(), material, mesh, &corners);
        if drawn.cutout { radiance * self.coverage(material, mesh, &corners) } else { radiance }
    }

    /// Probability that the surface is there.
    fn coverage(&self, material: &Material, mesh: &Mesh, corners: &Corners) -> f32 {
        let alpha = self.base_color(material, mesh, corners).w;
        match material.alpha_mode {
            AlphaMode::Opaque => 1.0,
            AlphaMode::Mask { cutoff } => {
                if alpha >= cutoff {
                    1.0
                } else {
                    0.0
                }
            }
            AlphaMode::Blend => alpha.clamp(0.0, 1.0),
        }
    }
}

/// Radiance that the material gives off at a point of a mesh.
pub(super) fn emitted_by(
    textures: &Textures<'_>,
    material: &Material,
    mesh: &Mesh,
    corners: &Corners,
) -> Vec3 {
    let Some(emission) = &material.emission else { return Vec3::ZERO };
    match &emission.radiance.texture {
        Some(texture) => {
            let texel = textures.lookup(texture, corners.uv(mesh, texture.uv_set));
            emission.radiance.factor * texel.truncate()
        }
        None => emission.radiance.factor,
    }
}
