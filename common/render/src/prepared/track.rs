//! The scene's poses over the open shutter, and how many keys a motion needs.

use super::pieces::{Piece, pieces};
use super::pose::{Place, Pose, Poses, slerp};
use crate::transform::{Affine, Jumps, MotionTransform, TransformKey};
use farm_scene::{Scene, Shutter};
use glam::{DAffine3, DMat3, DQuat, DVec3, Mat3, Quat, Vec3};
use std::collections::BTreeMap;

/// Each piece of the shutter is divided into this many steps; keys are at steps. A power of two.
pub(crate) const STEPS: u32 = 128;

/// Most segments of a rigid motion: 64 follow three full turns within the tolerance below.
const SEGMENTS_MAX: u32 = STEPS / 2;

/// Keys are added until a motion is met to this fraction of the moving thing's size: a hundredth of a pixel for something
/// that fills a frame of 1000 pixels.
pub(crate) const MOTION_TOLERANCE: f64 = 1e-5;

/// Poses over one frame's open shutter, computed as they are asked for.
pub(crate) struct Track<'a> {
    poses: Poses<'a>,
    is_open: bool,
    /// What jumps cut the shutter into; one piece if nothing jumps.
    pieces: Vec<Piece>,
    /// Moves the world so that the scene is near zero before it is rounded to f32.
    origin: DVec3,
    at_step: BTreeMap<Step, Pose>,
}

/// A moment at which things can have a key: `step` of [`STEPS`] in one of the shutter's pieces.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Step {
    pub piece: usize,
    pub step: u32,
}

impl<'a> Track<'a> {
    pub fn new(scene: &'a Scene, frame_time: f64, shutter: Shutter, origin: DVec3) -> Self {
        let (open, close) = (frame_time + shutter.open, frame_time + shutter.close);
        let is_open = open < close;
        Self {
            poses: Poses::new(scene),
            is_open,
            pieces: pieces(scene, open, close),
            origin,
            at_step: BTreeMap::new(),
        }
    }

    /// Times within the shutter at which something jumps.
    pub fn jumps(&self) -> Jumps {
        let times: Vec<f32> = self.pieces[1..].iter().map(|piece| piece.from).collect();
        Jumps::new(&times)
    }

    /// Number of the shutter's pieces.
    pub fn pieces(&self) -> usize {
        self.pieces.len()
    }

    /// Whether any time passes while the shutter is open.
    pub fn is_open(&self) -> bool {
        self.is_open
    }

    /// World space position that becomes zero.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// The pose at a step.
    pub fn at(&mut self, at: Step) -> &Pose {
        let (poses, piece) = (&self.poses, self.pieces[at.piece]);
        self.at_step.entry(at).or_insert_with(|| poses.at(piece.seconds(at.step)))
    }

    /// Fraction of the shutter's time at a step.
    fn fraction(&self, at: Step) -> f64 {
        let Piece { from, to, .. } = self.pieces[at.piece];
        let within = f64::from(at.step) / f64::from(STEPS);
        f64::from(from) + (f64::from(to) - f64::from(from)) * within
    }

    /// A node's motion, exact at its keys and met to [`MOTION_TOLERANCE`] of the box of `corners` (node space) in between.
    pub fn node_motion(
        &mut self,
        node: u32,
        motion_vector: Option<Vec3>,
        corners: &[DVec3; 8],
    ) -> MotionTransform {
        let drift = motion_vector.filter(|_| self.is_open()).map_or(DVec3::ZERO, Vec3::as_dvec3);
        self.motion(drift != DVec3::ZERO || self.poses.is_animated(node), corners, |track, step| {
            let mut place = track.at(step).places[node as usize];
            place.world.translation += drift * track.fraction(step);
            place
        })
    }

    /// The motion of something at a node whose linear part is derived from the node's place.
    pub fn scaled_motion(
        &mut self,
        node: u32,
        corners: &[DVec3; 8],
        linear: impl Fn(&Place) -> DMat3,
    ) -> MotionTransform {
        self.motion(self.poses.is_animated(node), corners, |track, step| {
            let mut place = track.at(step).places[node as usize];
            place.world.matrix3 = linear(&place);
            place
        })
    }

    /// The motion of what is drawn in world space and only drifts.
    pub fn drift_motion(&self, motion_vector: Option<Vec3>) -> MotionTransform {
        let key =
            |translation| TransformKey { translation, rotation: Quat::IDENTITY, stretch: Mat3::IDENTITY };
        match motion_vector.filter(|_| self.is_open()) {
            Some(drift) => MotionTransform::from_keys(vec![key(Vec3::ZERO), key(drift)]),
            None => MotionTransform::fixed(Affine::IDENTITY),
        }
    }

    fn motion(
        &mut self,
        moves: bool,
        corners: &[DVec3; 8],
        place: impl Fn(&mut Self, Step) -> Place + Copy,
    ) -> MotionTransform {
        if !(moves && self.is_open()) {
            let world = place(self, Step { piece: 0, step: 0 }).world;
            return MotionTransform::fixed(self.rebased(world));
        }
        let mut segments = 1;
        let all_met = |track: &mut Self, segments| {
            (0..track.pieces()).all(|piece| {
                track.is_met(segments, corners, |track, step| place(track, Step { piece, step }))
            })
        };
        while segments < SEGMENTS_MAX && !all_met(self, segments) {
            segments *= 2;
        }
        self.keyed(segments, place)
    }

    /// A motion with this many segments per piece of the shutter.
    fn keyed(&mut self, segments: u32, place: impl Fn(&mut Self, Step) -> Place) -> MotionTransform {
        let stride = (STEPS / segments) as usize;
        let steps = (0..self.pieces())
            .flat_map(|piece| (0..=STEPS).step_by(stride).map(move |step| Step { piece, step }));
        let keys = steps.map(|step| {
            let place = place(self, step);
            self.key(&place)
        });
        let keys = keys.collect();
        MotionTransform::with_jumps(keys, self.jumps())
    }

    /// Whether the motion within one piece of the shutter is met by that many segments.
    fn is_met(
        &mut self,
        segments: u32,
        corners: &[DVec3; 8],
        place: impl Fn(&mut Self, u32) -> Place,
    ) -> bool {
        let width = STEPS / segments;
        (0..segments).all(|segment| {
            let (from, to) = (place(self, segment * width), place(self, (segment + 1) * width));
            let size = box_size(&from.world, corners);
            // At every step in between, up to eight of them.
            let stride = (width / 8).max(1);
            (1..width).step_by(stride as usize).all(|step| {
                let truth = place(self, segment * width + step).world;
                let met = interpolate(&from, &to, f64::from(step) / f64::from(width));
                let error = corners
                    .iter()
                    .map(|&corner| (truth.transform_point3(corner) - met.transform_point3(corner)).length())
                    .fold(0.0, f64::max);
                error <= MOTION_TOLERANCE * size
            })
        })
    }

    /// World space to the renderer's space, in f32.
    pub fn rebased(&self, world: DAffine3) -> Affine {
        Affine::new(world.matrix3.as_mat3(), (world.translation - self.origin).as_vec3())
    }

    fn key(&self, place: &Place) -> TransformKey {
        TransformKey {
            translation: (place.world.translation - self.origin).as_vec3(),
            rotation: place.rotation.as_quat(),
            stretch: place.stretch().as_mat3(),
        }
    }

    /// A camera's motion: position and direction only, whatever the nodes above it scale or mirror.
    pub fn camera_motion(&mut self, node: u32) -> MotionTransform {
        let rigid = |place: &Place| {
            let rotation = view_rotation(place.world.matrix3);
            let world = DAffine3::from_rotation_translation(rotation, place.world.translation);
            Place { rotation, world }
        };
        if !self.is_open() || !self.poses.is_animated(node) {
            let place = rigid(&self.at(Step { piece: 0, step: 0 }).places[node as usize]);
            return MotionTransform::fixed(self.rebased(place.world));
        }
        self.keyed(SEGMENTS_MAX, |track, step| rigid(&track.at(step).places[node as usize]))
    }
}

/// The transform halfway between two places, as the renderer interpolates it.
fn interpolate(from: &Place, to: &Place, t: f64) -> DAffine3 {
    let rotation = slerp(from.rotation, to.rotation, t);
    let stretch = from.stretch() * (1.0 - t) + to.stretch() * t;
    let translation = from.world.translation * (1.0 - t) + to.world.translation * t;
    DAffine3 { matrix3: DMat3::from_quat(rotation) * stretch, translation }
}

/// Length of the diagonal of a box in the world.
fn box_size(world: &DAffine3, corners: &[DVec3; 8]) -> f64 {
    let points = corners.map(|corner| world.transform_point3(corner));
    let (low, high) =
        points.iter().fold((points[0], points[0]), |(low, high), p| (low.min(*p), high.max(*p)));
    (high - low).length()
}

/// Rotation of a camera whose node has this linear part: looks along -Z, +Y as far up as that allows.
fn view_rotation(linear: DMat3) -> DQuat {
    let back = linear.z_axis.normalize_or(DVec3::Z);
    let up = (linear.y_axis - back * back.dot(linear.y_axis)).normalize_or(back.any_orthonormal_vector());
    DQuat::from_mat3(&DMat3::from_cols(up.cross(back), up, back))
}
