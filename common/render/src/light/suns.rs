//! Directional lights, and how much of all chances goes to what is infinitely far.

use super::{EmitterGeometry, geometry::View};
use glam::{DVec3, Vec3};

/// A directional light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sun {
    /// Index in `Scene::lights`.
    pub light: u32,
    /// On a plane that faces it, W/m^2.
    pub irradiance: Vec3,
    /// Luminance of the irradiance.
    pub luminance: f64,
}

impl Sun {
    /// Unit direction towards the light; none where its transform has no axis.
    pub fn direction(&self, time: f32, geometry: &impl EmitterGeometry) -> Option<DVec3> {
        let direction = -geometry.placement(self.light, time).forward();
        (direction != DVec3::ZERO && direction.is_finite()).then_some(direction)
    }

    /// Irradiance at the receiver, in units of luminance; zero only below its horizon.
    pub fn importance(&self, view: &View, time: f32, geometry: &impl EmitterGeometry) -> f64 {
        let Some(direction) = self.direction(time, geometry) else { return 0.0 };
        self.luminance * view.normal.map_or(1.0, |normal| direction.dot(normal).max(0.0))
    }
}

/// How the chance is shared among strategies: half of it evenly among those that may give light, half by the estimated irradiance,
/// which cannot know what is in shadow.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Shares {
    total: f64,
    active: u32,
}

impl Shares {
    /// Takes a strategy's estimate into account.
    pub fn add(&mut self, estimate: f64) {
        self.total += estimate;
        self.active += u32::from(estimate > 0.0);
    }

    /// Probability of a strategy with this estimate, which has been added before.
    pub fn of(&self, estimate: f64) -> f64 {
        if estimate > 0.0 { 0.5 * (estimate / self.total + 1.0 / f64::from(self.active)) } else { 0.0 }
    }
}
