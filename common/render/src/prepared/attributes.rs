//! Normals and tangents of what is drawn, at rest or deformed.

use crate::accel::SurfacePoint;
use crate::interaction::Corners;
use crate::prepared::{Drawn, PreparedScene};
use crate::transform::Jumps;
use glam::{Vec3, Vec4};

/// Attributes of a deforming mesh at keys uniform over each piece of the shutter.
pub(crate) struct DeformedAttributes {
    pub jumps: Jumps,
    pub normals: Option<Vec<Vec<Vec3>>>,
    pub tangents: Option<Vec<Vec<Vec4>>>,
}

fn blend_keys<T>(keys: &[Vec<T>], jumps: &Jumps, time: f32, corners: &Corners) -> T
where
    T: Copy + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>,
{
    if let [only] = keys {
        return corners.blend(only);
    }
    let (segment, fraction) = jumps.segment_at(time, keys.len());
    corners.blend(&keys[segment]) * (1.0 - fraction) + corners.blend(&keys[segment + 1]) * fraction
}

impl PreparedScene {
    /// The unit shading normal as the file has it, normal map included; none where it is flat or no direction.
    pub(crate) fn shading_normal(
        &self,
        drawn: &Drawn,
        surface: &SurfacePoint,
        corners: &Corners,
        time: f32,
    ) -> Option<Vec3> {
        let (mesh, material) = self.mesh_and_material(drawn);
        let deformed = drawn.deformed.map(|index| &self.deformed[index as usize]);
        let smooth = match deformed {
            Some(attributes) => {
                let keys = attributes.normals.as_ref();
                keys.map(|keys| blend_keys(keys, &attributes.jumps, time, corners))
            }
            None => mesh.normals.as_ref().map(|normals| corners.blend(normals)),
        };
        let smooth = smooth.and_then(|normal| unit(surface.object_to_world.normal(normal)));
        let Some(map) = &material.normal_map else { return smooth };
        let normal = smooth.unwrap_or(surface.normal_geometric);
        let tangent = match deformed {
            Some(attributes) => {
                let keys = attributes.tangents.as_ref();
                keys.map(|keys| blend_keys(keys, &attributes.jumps, time, corners))
            }
            None => mesh.tangents.as_ref().map(|tangents| corners.blend(tangents)),
        };
        let mapped = tangent.and_then(|tangent| {
            let texel = self.textures().lookup(&map.texture, corners.uv(mesh, map.texture.uv_set));
            let tilt = (texel.truncate() * 2.0 - Vec3::ONE) * Vec3::new(map.scale, map.scale, 1.0);
            let along = unit(surface.object_to_world.vector(tangent.truncate()))?;
            let across = normal.cross(along) * if tangent.w < 0.0 { -1.0 } else { 1.0 };
            unit(along * tilt.x + across * tilt.y + normal * tilt.z)
        });
        mapped.or(smooth)
    }
}

/// `v` made unit, whatever its scale; none for zero or no number.
fn unit(v: Vec3) -> Option<Vec3> {
    let largest = v.abs().max_element();
    if !(largest > 0.0 && largest.is_finite()) {
        return None;
    }
    Some((v / largest).normalize())
}
