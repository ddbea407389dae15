//! A scene made ready for one frame: everything placed in time and space, trees built, lights tabled.

mod attributes;
mod build;
mod deform;
mod emission;
mod emitters;
mod look;
mod pieces;
mod pose;
mod report;
mod track;

pub(crate) use look::absorption;
pub use report::{Report, Usage};

use crate::accel::{Accel, Hit, Ray};
use crate::camera::Camera;
use crate::filter::FilterSampler;
use crate::light::Lights;
use crate::sampler::{Sampler, Sequence};
use crate::texture::{SrgbTables, Textures};
use crate::transform::MotionTransform;
use attributes::DeformedAttributes;
use farm_film::{FrameIndex, Resolution};
use farm_scene::{LightKind, Material, Mesh, Scene, SceneError, Settings};
use glam::Vec3;
use std::sync::Arc;

/// A scene that cannot be rendered as it was asked.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PrepareError {
    /// The scene's parts do not fit together.
    #[error("scene cannot be rendered: {0}")]
    Scene(#[from] SceneError),
    /// Width or height out of range.
    #[error(transparent)]
    Resolution(#[from] farm_film::TileError),
    /// A camera index past the end.
    #[error("camera {camera} is not in the scene, which has {cameras}")]
    Camera {
        /// The index asked for.
        camera: u32,
        /// How many there are.
        cameras: usize,
    },
    /// A frame rate that gives no time.
    #[error("{0} frames per second is no frame rate")]
    FrameRate(f64),
    /// A limit on samples that leaves nothing, or is none.
    #[error("samples cannot be limited to {0}: a limit is a finite number above 0")]
    Clamp(f32),
}

/// What one instance of the acceleration structure draws.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Drawn {
    mesh: u32,
    material: u32,
    /// Index into `PreparedScene::deformed`, where the mesh's own normals do not hold.
    deformed: Option<u32>,
    /// Whether alpha may let rays pass.
    cutout: bool,
}

impl Drawn {
    pub(crate) fn material(&self) -> u32 {
        self.material
    }
}

/// Where everything is.
pub(crate) struct World {
    pub accel: Accel,
    /// By index in `Scene::lights`.
    pub light_places: Vec<MotionTransform>,
}

/// One frame of a scene, ready to be traced. Immutable; shared by all threads.
pub struct PreparedScene {
    scene: Arc<Scene>,
    frame: FrameIndex,
    resolution: Resolution,
    pub(crate) settings: Settings,
    pub(crate) sequence: Sequence,
    pub(crate) camera: Camera,
    pub(crate) filter: FilterSampler,
    pub(crate) world: World,
    pub(crate) lights: Lights,
    /// Index in `Scene::lights` of the instances of `accel` that come after those in `drawn`.
    shape_lights: Vec<u32>,
    /// By instance of `accel`; analytic lights come after the last.
    drawn: Vec<Drawn>,
    deformed: Vec<DeformedAttributes>,
    srgb: SrgbTables,
    looks: Vec<look::Look>,
    /// Whether anything, the camera included, moves while the shutter is open.
    pub(crate) is_moving: bool,
    /// Whether any surface may let rays pass by its alpha.
    pub(crate) has_cutouts: bool,
    pub(crate) environment_is_visible: bool,
    report: Report,
}

impl PreparedScene {
    /// Makes `scene` ready for `frame`. Expensive: once per frame, not per unit.
    pub fn new(scene: &Arc<Scene>, settings: &Settings, frame: FrameIndex) -> Result<Self, PrepareError> {
        build::prepare(scene, settings, frame)
    }

    /// The same frame with another kind of random numbers, to measure what the usual ones are worth.
    pub fn with_sequence(mut self, sequence: Sequence) -> Self {
        self.sequence = sequence;
        self
    }

    /// The frame's width and height.
    pub fn resolution(&self) -> Resolution {
        self.resolution
    }

    /// What the frame uses and what was left out.
    pub fn report(&self) -> &Report {
        &self.report
    }

    pub(crate) fn sampler(&self, x: u32, y: u32, index: u64) -> Sampler {
        Sampler::with_sequence(self.sequence, self.settings.seed, self.frame.0, x, y, index)
    }

    pub(crate) fn textures(&self) -> Textures<'_> {
        Textures { textures: &self.scene.textures, images: &self.scene.images, tables: &self.srgb }
    }

    /// The analytic light that was met, if it was none of the meshes.
    pub(crate) fn shape_light(&self, hit: &Hit) -> Option<u32> {
        let shape = (hit.instance as usize).checked_sub(self.drawn.len())?;
        Some(self.shape_lights[shape])
    }

    /// Radiance of an analytic light on the side that a ray in `direction` met.
    pub(crate) fn shape_emission(&self, light: u32, hit: &Hit, ray: &Ray) -> Vec3 {
        // The front of a unit shape is +Z or outside; rectangles and disks shine along -Z.
        let normal = self.world.accel.surface(hit, ray.time).normal_geometric;
        let from_front = ray.direction.dot(normal) < 0.0;
        match self.scene.lights[light as usize].kind {
            LightKind::Sphere { radiance, .. } if from_front => radiance,
            LightKind::Rectangle { radiance, .. } | LightKind::Disk { radiance, .. } if !from_front => {
                radiance
            }
            _ => Vec3::ZERO,
        }
    }

    pub(crate) fn drawn(&self, instance: u32) -> &Drawn {
        &self.drawn[instance as usize]
    }

    pub(crate) fn mesh_and_material(&self, drawn: &Drawn) -> (&Mesh, &Material) {
        (&self.scene.meshes[drawn.mesh as usize], &self.scene.materials[drawn.material as usize])
    }
}
