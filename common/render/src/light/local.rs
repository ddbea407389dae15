//! Lights of the scene's list that have a place.

use super::{bounds::CONE_SLACK, punctual::PointLight, shape::Shape};
use glam::Vec3;

/// A light with its index in `Scene::lights`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LocalLight {
    pub light: u32,
    pub kind: LocalKind,
}

/// What it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum LocalKind {
    Point(PointLight),
    Shape { shape: Shape, radiance: Vec3 },
}

impl LocalKind {
    /// Cosine of the angle from an emission axis beyond which nothing is emitted.
    pub fn cos_falloff(&self) -> f32 {
        match self {
            Self::Point(PointLight { cone: Some(cone), .. }) => cone.cos_outer - CONE_SLACK as f32,
            Self::Point(_) | Self::Shape { .. } => 0.0,
        }
    }
}
