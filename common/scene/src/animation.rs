//! What changes over time.

use glam::{Quat, Vec3};
use serde::{Deserialize, Serialize};

/// One animated property of one node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Channel {
    /// Index into `Scene::nodes`; for TRS paths its transform is `Transform::Trs`.
    pub node: u32,
    /// Strictly increasing key times, seconds; never empty. Before the first and after the last the value stays.
    pub times: Vec<f32>,
    /// How values between keys are found.
    pub interpolation: Interpolation,
    /// The property and its values.
    pub path: Path,
}

/// How values between keys are found (glTF 2.0, appendix C).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Interpolation {
    /// The last key's value.
    Step,
    /// A straight line; for rotations the shorter great arc.
    Linear,
    /// Hermite spline with tangents at the keys.
    CubicSpline,
}

/// Values at the keys. For `CubicSpline` each key has three: in-tangent, value, out-tangent.
pub type Keyframes<T> = Vec<T>;

/// The property and its values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Path {
    /// Metres.
    Translation(Keyframes<Vec3>),
    /// Unit quaternions (tangents are not).
    Rotation(Keyframes<Quat>),
    /// Factors.
    Scale(Keyframes<Vec3>),
    /// Morph target weights, `targets` of them in a row per value.
    MorphWeights {
        /// Weights per value.
        targets: u32,
        /// All values in a row.
        values: Keyframes<f32>,
    },
}
