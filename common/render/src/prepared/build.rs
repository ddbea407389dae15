//! From a scene and a frame to what is traced.

use super::attributes::DeformedAttributes;
use super::deform::{Deformed, deformation_keys, is_deformed, is_skinned};
use super::look::Look;
use super::pose::Poses;
use super::track::Track;
use super::{Drawn, PrepareError, PreparedScene, World, emitters, report};
use crate::accel::{Accel, Geometry, InstanceDesc, TriangleMesh};
use crate::camera::Camera;
use crate::filter::FilterSampler;
use crate::sampler::Sequence;
use crate::texture::{SrgbTables, Textures};
use crate::transform::Jumps;
use farm_film::{FrameIndex, Resolution};
use farm_scene::{AlphaMode, Mesh, Scene, Settings};
use glam::DVec3;
use std::collections::BTreeMap;
use std::sync::Arc;

pub(super) fn prepare(
    scene: &Arc<Scene>,
    settings: &Settings,
    frame: FrameIndex,
) -> Result<PreparedScene, PrepareError> {
    let resolution = Resolution::new(settings.width, settings.height)?;
    scene.validate()?;
    let camera = scene
        .cameras
        .get(settings.camera as usize)
        .ok_or(PrepareError::Camera { camera: settings.camera, cameras: scene.cameras.len() })?;
    if !(settings.fps.is_finite() && settings.fps > 0.0) {
        return Err(PrepareError::FrameRate(settings.fps));
    }
    if let Some(clamp) = settings.clamp.filter(|clamp| !(clamp.is_finite() && *clamp > 0.0)) {
        return Err(PrepareError::Clamp(clamp));
    }
    let frame_time = f64::from(frame.0) / settings.fps;
    let mut track = Track::new(scene, frame_time, camera.shutter, middle_at_rest(scene));

    let mut stage = Stage::default();
    stage.draw_meshes(scene, &mut track);
    let mut shape_lights = Vec::new();
    for (index, light) in scene.lights.iter().enumerate() {
        if let Some(instance) = emitters::shape_instance(light, &mut track, &mut stage.geometries) {
            stage.instances.push(instance);
            shape_lights.push(index as u32);
        }
    }
    let light_places = emitters::place_lights(scene, &mut track);
    let camera_motion = track.camera_motion(camera.node);
    let moving = stage.moving();
    let is_moving = camera_motion.as_fixed().is_none()
        || moving.contains(&true)
        || light_places.iter().any(|place| place.as_fixed().is_none());
    let world = World { accel: Accel::build(stage.geometries, stage.instances), light_places };
    let srgb = SrgbTables::for_textures(&scene.textures, &scene.images);
    let textures = Textures { textures: &scene.textures, images: &scene.images, tables: &srgb };
    let lights = emitters::light_table(scene, &stage.drawn, &moving, &textures, &world, track.jumps());
    let mut prepared = PreparedScene {
        scene: scene.clone(),
        frame,
        resolution,
        settings: *settings,
        sequence: Sequence::Sobol,
        camera: Camera::new(camera.projection, camera.lens, camera_motion, settings.width, settings.height),
        filter: FilterSampler::new(settings.filter),
        world,
        lights,
        shape_lights,
        has_cutouts: stage.drawn.iter().any(|drawn| drawn.cutout),
        drawn: stage.drawn,
        deformed: stage.deformed,
        srgb,
        looks: scene.materials.iter().map(Look::of).collect(),
        is_moving,
        environment_is_visible: scene
            .environment
            .as_ref()
            .is_some_and(|environment| environment.visible_to_camera),
        report: Default::default(),
    };
    prepared.report = report::of(&prepared);
    Ok(prepared)
}

/// The middle of everything drawn, without animation: what the renderer's space is centred on, so that f32 has its finest
/// steps where the scene is, however far that is from the file's origin.
fn middle_at_rest(scene: &Scene) -> DVec3 {
    let pose = Poses::new(scene).rest();
    let mut low = DVec3::INFINITY;
    let mut high = DVec3::NEG_INFINITY;
    let boxes: Vec<_> = scene.meshes.iter().map(mesh_corners).collect();
    for (node, place) in scene.nodes.iter().zip(&pose.places) {
        for instance in &node.instances {
            for &corner in &boxes[instance.mesh as usize] {
                let point = place.world.transform_point3(corner);
                if point.is_finite() {
                    low = low.min(point);
                    high = high.max(point);
                }
            }
        }
    }
    if low.x <= high.x { low * 0.5 + high * 0.5 } else { DVec3::ZERO }
}

/// Corners of the box around a mesh's finite positions; the origin eight times if there are none.
fn mesh_corners(mesh: &Mesh) -> [DVec3; 8] {
    let mut low = DVec3::INFINITY;
    let mut high = DVec3::NEG_INFINITY;
    for position in mesh.positions.iter().filter(|position| position.is_finite()) {
        low = low.min(position.as_dvec3());
        high = high.max(position.as_dvec3());
    }
    if low.x > high.x {
        return [DVec3::ZERO; 8];
    }
    std::array::from_fn(|corner| {
        let pick = |bit: usize, low: f64, high: f64| if corner >> bit & 1 == 0 { low } else { high };
        DVec3::new(pick(0, low.x, high.x), pick(1, low.y, high.y), pick(2, low.z, high.z))
    })
}

/// What goes into the acceleration structure.
#[derive(Default)]
struct Stage {
    geometries: Vec<Geometry>,
    instances: Vec<InstanceDesc>,
    drawn: Vec<Drawn>,
    deformed: Vec<DeformedAttributes>,
}

impl Stage {
    fn draw_meshes(&mut self, scene: &Scene, track: &mut Track<'_>) {
        // Instances of one undeformed mesh share its geometry.
        let mut shared: BTreeMap<u32, u32> = BTreeMap::new();
        for (index, node) in scene.nodes.iter().enumerate() {
            let index = index as u32;
            for instance in &node.instances {
                let mesh = &scene.meshes[instance.mesh as usize];
                let mut deformed = None;
                let geometry = if is_deformed(scene, index, mesh) {
                    let keys = deformation_keys(scene, track, index, mesh);
                    deformed = Some(self.deformed.len() as u32);
                    self.add_deformed(mesh, keys, track.jumps())
                } else {
                    *shared.entry(instance.mesh).or_insert_with(|| {
                        self.geometries.push(triangles(mesh, vec![mesh.positions.clone()], Jumps::default()));
                        self.geometries.len() as u32 - 1
                    })
                };
                let transform = if is_skinned(scene, index, mesh) {
                    track.drift_motion(node.motion_vector)
                } else {
                    track.node_motion(index, node.motion_vector, &mesh_corners(mesh))
                };
                self.instances.push(InstanceDesc { geometry, transform });
                let material = &scene.materials[instance.material as usize];
                let cutout = material.alpha_mode != AlphaMode::Opaque;
                self.drawn.push(Drawn { mesh: instance.mesh, material: instance.material, deformed, cutout });
            }
        }
    }

    fn add_deformed(&mut self, mesh: &Mesh, keys: Vec<Deformed>, jumps: Jumps) -> u32 {
        let jumps = if keys.len() == 1 { Jumps::default() } else { jumps };
        let mut positions = Vec::with_capacity(keys.len());
        let mut attributes = DeformedAttributes {
            jumps: jumps.clone(),
            normals: mesh.normals.is_some().then(Vec::new),
            tangents: mesh.tangents.is_some().then(Vec::new),
        };
        for key in keys {
            positions.push(key.positions);
            if let (Some(all), Some(normals)) = (&mut attributes.normals, key.normals) {
                all.push(normals);
            }
            if let (Some(all), Some(tangents)) = (&mut attributes.tangents, key.tangents) {
                all.push(tangents);
            }
        }
        self.geometries.push(triangles(mesh, positions, jumps));
        self.deformed.push(attributes);
        self.geometries.len() as u32 - 1
    }

    /// By instance: whether it moves or deforms while the shutter is open.
    fn moving(&self) -> Vec<bool> {
        let deforms = |geometry: &Geometry| matches!(geometry, Geometry::Triangles(mesh) if mesh.deforms());
        let moves = |instance: &InstanceDesc| {
            instance.transform.as_fixed().is_none() || deforms(&self.geometries[instance.geometry as usize])
        };
        self.instances.iter().map(moves).collect()
    }
}

fn triangles(mesh: &Mesh, keys: Vec<Vec<glam::Vec3>>, jumps: Jumps) -> Geometry {
    Geometry::Triangles(Arc::new(TriangleMesh { keys, jumps, triangles: mesh.triangles.clone() }))
}
