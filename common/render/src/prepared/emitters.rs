//! The scene's lights: where they are, what they look like to rays, and the table from which they are sampled.

use super::emission::emitted_by;
use super::track::Track;
use super::{Drawn, World};
use crate::accel::{Geometry, InstanceDesc};
use crate::interaction::Corners;
use crate::light::{EmitterGeometry, EmitterTriangle, Lights, LightsBuilder, Placement, TriangleEmitter};
use crate::texture::Textures;
use crate::transform::{Jumps, MotionTransform};
use farm_scene::{Light, LightKind, Material, Mesh, Scene, Surface};
use glam::{DMat3, DVec3, Vec3};

impl EmitterGeometry for World {
    fn triangle(&self, instance: u32, primitive: u32, time: f32) -> EmitterTriangle {
        EmitterTriangle {
            corners: self.accel.triangle_vertices(instance, primitive, time),
            mirrored: self.accel.transform(instance).at(time).mirrors(),
        }
    }

    fn placement(&self, light: u32, time: f32) -> Placement {
        let place = self.light_places[light as usize].at(time);
        let linear = place.linear;
        Placement { origin: place.translation, x: linear.x_axis, y: linear.y_axis, z: linear.z_axis }
    }
}

/// Where every light is, by its index in the scene.
pub(super) fn place_lights(scene: &Scene, track: &mut Track<'_>) -> Vec<MotionTransform> {
    scene.lights.iter().map(|light| track.node_motion(light.node, None, &reach(light.kind))).collect()
}

/// Corners of a box around a light in its node's space.
fn reach(kind: LightKind) -> [DVec3; 8] {
    let size = match kind {
        LightKind::Sphere { radius, .. } | LightKind::Disk { radius, .. } => DVec3::splat(f64::from(radius)),
        LightKind::Rectangle { width, height, .. } => {
            DVec3::new(f64::from(width), f64::from(height), 0.0) * 0.5
        }
        // Without a size of their own, a metre's turn and shift decide how finely their motion is followed.
        LightKind::Point { .. } | LightKind::Spot { .. } | LightKind::Directional { .. } => DVec3::ONE,
    };
    std::array::from_fn(|corner| {
        let side = |bit: usize| if corner >> bit & 1 == 0 { -1.0 } else { 1.0 };
        size * DVec3::new(side(0), side(1), side(2))
    })
}

/// The shape of a light that has one, as rays meet it.
pub(super) fn shape_instance(
    light: &Light,
    track: &mut Track<'_>,
    geometries: &mut Vec<Geometry>,
) -> Option<InstanceDesc> {
    let (geometry, scale) = match light.kind {
        LightKind::Sphere { radius, .. } => (Geometry::Sphere, DVec3::splat(f64::from(radius))),
        LightKind::Disk { radius, .. } => (Geometry::Disk, DVec3::splat(f64::from(radius))),
        LightKind::Rectangle { width, height, .. } => {
            (Geometry::Rectangle, DVec3::new(f64::from(width) * 0.5, f64::from(height) * 0.5, 1.0))
        }
        LightKind::Point { .. } | LightKind::Spot { .. } | LightKind::Directional { .. } => return None,
    };
    let is_sphere = matches!(geometry, Geometry::Sphere);
    let transform = track.scaled_motion(light.node, &reach(light.kind), |place| {
        if is_sphere {
            // A sphere stays one: it takes the mean of its node's scales.
            let linear = place.world.matrix3;
            let mean = (linear.x_axis.length() + linear.y_axis.length() + linear.z_axis.length()) / 3.0;
            DMat3::from_quat(place.rotation) * DMat3::from_diagonal(scale * mean)
        } else {
            place.world.matrix3 * DMat3::from_diagonal(scale)
        }
    });
    geometries.push(geometry);
    Some(InstanceDesc { geometry: geometries.len() as u32 - 1, transform })
}

/// Everything that gives off light, ready to be sampled.
pub(super) fn light_table(
    scene: &Scene,
    drawn: &[Drawn],
    moving: &[bool],
    textures: &Textures<'_>,
    world: &World,
    jumps: Jumps,
) -> Lights {
    let mut builder = LightsBuilder::new(0.0, 1.0).jumping(jumps);
    for (instance, (drawn, &moving)) in drawn.iter().zip(moving).enumerate() {
        let (mesh, material) =
            (&scene.meshes[drawn.mesh as usize], &scene.materials[drawn.material as usize]);
        if material.emission.is_none() || matches!(material.surface, Surface::Unlit) {
            continue;
        }
        for primitive in 0..mesh.triangles.len() as u32 {
            builder.triangle(TriangleEmitter {
                instance: instance as u32,
                primitive,
                radiance: mean_radiance(textures, material, mesh, primitive),
                two_sided: material.double_sided,
                moving,
            });
        }
    }
    for (index, light) in scene.lights.iter().enumerate() {
        let moving = world.light_places[index].as_fixed().is_none();
        builder.light(index as u32, light.kind, moving);
    }
    if let Some(environment) = &scene.environment {
        builder.environment(environment.clone());
    }
    builder.build(world)
}

/// Radiance of a triangle, averaged over a few points of it where a texture varies.
fn mean_radiance(textures: &Textures<'_>, material: &Material, mesh: &Mesh, primitive: u32) -> Vec3 {
    /// Points per side of the triangle.
    const POINTS: u32 = 6;
    let textured = material.emission.is_some_and(|emission| emission.radiance.texture.is_some());
    if !textured {
        return emitted_by(textures, material, mesh, &Corners::at(mesh, primitive, 0.0, 0.0));
    }
    let mut sum = Vec3::ZERO;
    for i in 0..POINTS {
        for j in 0..POINTS - i {
            let at = |step: u32| (step as f32 + 1.0 / 3.0) / POINTS as f32;
            sum += emitted_by(textures, material, mesh, &Corners::at(mesh, primitive, at(i), at(j)));
        }
    }
    sum / (POINTS * (POINTS + 1) / 2) as f32
}
