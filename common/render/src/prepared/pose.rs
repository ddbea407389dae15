//! Where every node is at one moment: animation channels and the hierarchy (glTF 2.0, 3.11 and appendix C).
//!
//! All of it in f64, so that a scene far from its origin keeps its detail until the origin is moved to the scene.

use crate::math;
use farm_scene::{Channel, Interpolation, Path, Scene, Transform};
use glam::{DAffine3, DMat3, DQuat, DVec3, DVec4};

/// A node's place in the world, with the rotation kept apart so that it can be interpolated as one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place {
    /// Product of the rotations from the root down; unit.
    pub rotation: DQuat,
    /// Node space to world space.
    pub world: DAffine3,
}

impl Place {
    const ORIGIN: Self = Self { rotation: DQuat::IDENTITY, world: DAffine3::IDENTITY };

    /// What is left of the linear part when the rotation is taken out: `linear = rotation * stretch`.
    pub fn stretch(&self) -> DMat3 {
        DMat3::from_quat(self.rotation.conjugate()) * self.world.matrix3
    }
}

/// All nodes at one moment.
pub(crate) struct Pose {
    /// By node.
    pub places: Vec<Place>,
    /// Morph target weights by node; as many as `Node::morph_weights`.
    pub morph_weights: Vec<Vec<f32>>,
}

/// The scene's nodes over time.
pub(crate) struct Poses<'a> {
    scene: &'a Scene,
    animated: Vec<bool>,
}

impl<'a> Poses<'a> {
    pub fn new(scene: &'a Scene) -> Self {
        let mut animated = vec![false; scene.nodes.len()];
        for channel in &scene.channels {
            if !matches!(channel.path, Path::MorphWeights { .. }) {
                animated[channel.node as usize] = true;
            }
        }
        for index in 0..animated.len() {
            if let Some(parent) = scene.nodes[index].parent {
                animated[index] |= animated[parent as usize];
            }
        }
        Self { scene, animated }
    }

    /// Whether the node can move at all: it or a node above it is animated.
    pub fn is_animated(&self, node: u32) -> bool {
        self.animated[node as usize]
    }

    /// The pose without any animation.
    pub fn rest(&self) -> Pose {
        self.place(self.scene.nodes.iter().map(|node| node.transform).collect(), self.rest_weights())
    }

    /// The pose at `time`, in seconds.
    pub fn at(&self, time: f64) -> Pose {
        let mut local: Vec<Transform> = self.scene.nodes.iter().map(|node| node.transform).collect();
        let mut weights = self.rest_weights();
        for channel in &self.scene.channels {
            let node = channel.node as usize;
            if let Path::MorphWeights { targets, values } = &channel.path {
                animate_weights(channel, *targets as usize, values, time, &mut weights[node]);
            } else if let Transform::Trs { translation, rotation, scale } = &mut local[node] {
                animate_transform(channel, time, translation, rotation, scale);
            }
        }
        self.place(local, weights)
    }

    fn rest_weights(&self) -> Vec<Vec<f32>> {
        self.scene.nodes.iter().map(|node| node.morph_weights.clone()).collect()
    }

    fn place(&self, local: Vec<Transform>, morph_weights: Vec<Vec<f32>>) -> Pose {
        let mut places: Vec<Place> = Vec::with_capacity(local.len());
        for (node, transform) in self.scene.nodes.iter().zip(local) {
            let parent = node.parent.map_or(Place::ORIGIN, |parent| places[parent as usize]);
            let (own, rotation) = match transform {
                Transform::Trs { translation, rotation, scale } => {
                    (DAffine3::from_scale_rotation_translation(scale, rotation, translation), rotation)
                }
                Transform::Matrix(matrix) => (DAffine3::from_mat4(matrix), DQuat::IDENTITY),
            };
            let rotation = normalize_or_identity(parent.rotation * rotation);
            places.push(Place { rotation, world: parent.world * own });
        }
        Pose { places, morph_weights }
    }
}

fn normalize_or_identity(q: DQuat) -> DQuat {
    let length = q.length();
    if length > 0.0 && length.is_finite() { q / length } else { DQuat::IDENTITY }
}

/// Where a time lies among the keys.
enum Span {
    At(usize),
    Between { index: usize, fraction: f64, seconds: f64 },
}

fn span(times: &[f32], time: f64) -> Span {
    let after = times.partition_point(|&key| f64::from(key) <= time);
    if after == 0 {
        return Span::At(0);
    }
    if after == times.len() {
        return Span::At(times.len() - 1);
    }
    let (from, to) = (f64::from(times[after - 1]), f64::from(times[after]));
    Span::Between { index: after - 1, fraction: (time - from) / (to - from), seconds: to - from }
}

/// The channel's value at `time`, from values that can be added and scaled; `blend` is the linear kind.
fn value_at<T: Copy + std::ops::Add<Output = T> + std::ops::Mul<f64, Output = T>>(
    channel: &Channel,
    time: f64,
    get: impl Fn(usize) -> T,
    blend: impl Fn(T, T, f64) -> T,
) -> T {
    let cubic = channel.interpolation == Interpolation::CubicSpline;
    // A cubic key is (in-tangent, value, out-tangent).
    let value = |key: usize| if cubic { get(3 * key + 1) } else { get(key) };
    match (span(&channel.times, time), channel.interpolation) {
        (Span::At(key), _) => value(key),
        (Span::Between { index, .. }, Interpolation::Step) => value(index),
        (Span::Between { index, fraction, .. }, Interpolation::Linear) => {
            blend(value(index), value(index + 1), fraction)
        }
        (Span::Between { index, fraction: t, seconds }, Interpolation::CubicSpline) => {
            let (t2, t3) = (t * t, t * t * t);
            let (out_tangent, in_tangent) = (get(3 * index + 2), get(3 * (index + 1)));
            value(index) * (2.0 * t3 - 3.0 * t2 + 1.0)
                + out_tangent * (seconds * (t3 - 2.0 * t2 + t))
                + value(index + 1) * (3.0 * t2 - 2.0 * t3)
                + in_tangent * (seconds * (t3 - t2))
        }
    }
}

fn animate_transform(
    channel: &Channel,
    time: f64,
    translation: &mut DVec3,
    rotation: &mut DQuat,
    scale: &mut DVec3,
) {
    let straight = |a: DVec3, b: DVec3, t: f64| a * (1.0 - t) + b * t;
    match &channel.path {
        Path::Translation(values) => {
            *translation = value_at(channel, time, |i| values[i].as_dvec3(), straight);
        }
        Path::Scale(values) => *scale = value_at(channel, time, |i| values[i].as_dvec3(), straight),
        Path::Rotation(values) => {
            let get = |i: usize| DVec4::from(values[i].as_dquat());
            let arc =
                |a: DVec4, b: DVec4, t: f64| DVec4::from(slerp(DQuat::from_vec4(a), DQuat::from_vec4(b), t));
            *rotation = normalize_or_identity(DQuat::from_vec4(value_at(channel, time, get, arc)));
        }
        Path::MorphWeights { .. } => {}
    }
}

fn animate_weights(channel: &Channel, targets: usize, values: &[f32], time: f64, weights: &mut Vec<f32>) {
    weights.resize(targets, 0.0);
    for (target, weight) in weights.iter_mut().enumerate() {
        let get = |i: usize| f64::from(values[i * targets + target]);
        *weight = value_at(channel, time, get, |a, b, t| a * (1.0 - t) + b * t) as f32;
    }
}

/// Along the shorter great arc.
pub(crate) fn slerp(a: DQuat, b: DQuat, t: f64) -> DQuat {
    let cosine = a.dot(b);
    let (b, cosine) = if cosine < 0.0 { (-b, -cosine) } else { (b, cosine) };
    // Nearly parallel: the chord is the arc to rounding.
    if cosine > 1.0 - 1e-9 {
        return normalize_or_identity(a * (1.0 - t) + b * t);
    }
    let angle = math::acos_f64(cosine);
    let sine = math::sin_f64(angle);
    (a * (math::sin_f64((1.0 - t) * angle) / sine)) + (b * (math::sin_f64(t * angle) / sine))
}

#[cfg(test)]
mod tests {
    use super::*;
    use farm_scene::Node;
    use glam::{Quat, Vec3};

    fn node(parent: Option<u32>) -> Node {
        Node {
            name: String::new(),
            parent,
            transform: Transform::IDENTITY,
            motion_vector: None,
            instances: Vec::new(),
            skin: None,
            morph_weights: Vec::new(),
        }
    }

    fn animated(interpolation: Interpolation, path: Path) -> Scene {
        let channel = Channel { node: 0, times: vec![1.0, 3.0], interpolation, path };
        Scene { nodes: vec![node(None), node(Some(0))], channels: vec![channel], ..Scene::default() }
    }

    fn child_origin(scene: &Scene, time: f64) -> DVec3 {
        Poses::new(scene).at(time).places[1].world.translation
    }

    #[test]
    fn values_stay_before_the_first_and_after_the_last_key() {
        let path = Path::Translation(vec![Vec3::X, Vec3::X * 3.0]);
        for interpolation in [Interpolation::Step, Interpolation::Linear] {
            let scene = animated(interpolation, path.clone());
            assert_eq!(child_origin(&scene, -5.0), DVec3::X);
            assert_eq!(child_origin(&scene, 9.0), DVec3::X * 3.0);
            let middle = if interpolation == Interpolation::Step { 1.0 } else { 2.0 };
            assert_eq!(child_origin(&scene, 2.0), DVec3::X * middle);
        }
    }

    #[test]
    fn a_cubic_spline_passes_its_keys_with_its_tangents() {
        let values = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Y, Vec3::X * 3.0, Vec3::ZERO];
        let scene = animated(Interpolation::CubicSpline, Path::Translation(values));
        assert_eq!(child_origin(&scene, 1.0), DVec3::X);
        assert_eq!(child_origin(&scene, 3.0), DVec3::X * 3.0);
        let slope = (child_origin(&scene, 1.0 + 1e-6) - child_origin(&scene, 1.0)) / 1e-6;
        assert!((slope - DVec3::Y).length() < 1e-4, "out-tangent {slope}");
        let slope = (child_origin(&scene, 3.0) - child_origin(&scene, 3.0 - 1e-6)) / 1e-6;
        assert!((slope - DVec3::Y).length() < 1e-4, "in-tangent {slope}");
    }

    #[test]
    fn a_rotation_turns_at_constant_speed_along_the_shorter_arc() {
        let quarter =
            Quat::from_xyzw(0.0, 0.0, std::f32::consts::FRAC_1_SQRT_2, std::f32::consts::FRAC_1_SQRT_2);
        let scene = animated(Interpolation::Linear, Path::Rotation(vec![Quat::IDENTITY, -quarter]));
        for (time, degrees) in [(1.0, 0.0f64), (1.5, 22.5), (2.0, 45.0), (3.0, 90.0)] {
            let x = Poses::new(&scene).at(time).places[1].world.matrix3.x_axis;
            let expected = DVec3::new(degrees.to_radians().cos(), degrees.to_radians().sin(), 0.0);
            assert!((x - expected).length() < 1e-6, "{time}: {x}");
        }
    }

    #[test]
    fn what_is_below_an_animated_node_is_animated() {
        let scene = animated(Interpolation::Step, Path::Scale(vec![Vec3::ONE, Vec3::ZERO]));
        let poses = Poses::new(&scene);
        assert!(poses.is_animated(0) && poses.is_animated(1));
        assert_eq!(poses.at(3.0).places[1].world.matrix3, DMat3::ZERO);
    }
}
