//! What is known of a light, or of a group of lights, without looking at each: where, towards where, how strong.

use super::geometry::View;
use glam::{DVec3, Vec3};

/// Taken off cosines that bound directions, so that rounding to single precision cannot cull a light that is just visible.
pub(super) const CONE_SLACK: f64 = 1e-6;

/// Bounds of a group of lights (Conty Estevez and Kulla 2018, section 4.1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LightBounds {
    pub min: Vec3,
    pub max: Vec3,
    /// Unit axis of the cone that holds all emission axes.
    pub axis: Vec3,
    /// Cosine of that cone's half angle; -1 is every direction.
    pub cos_spread: f32,
    /// Cosine of the angle from an emission axis beyond which nothing is emitted.
    pub cos_falloff: f32,
    /// Brightest radiant intensity, relative to the table's unit; positive.
    pub power: f32,
    /// Whether the opposite axes count as well.
    pub two_sided: bool,
}

/// Cosine of max(0, a - b) for an angle a in [0, pi], given by its cosine, and b in [0, 2 pi), given by cosine and sine; a full half
/// turn or more leaves nothing of a. Free of branches that would be guessed wrongly: a tree asks at every node.
fn cos_beyond(cos_a: f64, (cos_b, sin_b): (f64, f64)) -> f64 {
    let difference = cos_a * cos_b + sine(cos_a) * sin_b;
    if (cos_a >= cos_b) | (sin_b < 0.0) { 1.0 } else { difference }
}

fn sine(cosine: f64) -> f64 {
    (1.0 - cosine * cosine).max(0.0).sqrt()
}

impl LightBounds {
    /// An upper estimate of the irradiance at the receiver: power, cosines at both ends and squared distance, each at its most
    /// favourable within the bounds (Conty Estevez and Kulla 2018, equation 3). Zero only where nothing can arrive.
    pub fn importance(&self, view: &View) -> f64 {
        let (min, max) = (self.min.as_dvec3(), self.max.as_dvec3());
        let to_centre = (min + max) * 0.5 - view.point;
        let radius_square = 0.25 * (max - min).length_squared();
        let square = to_centre.length_squared();
        let power = f64::from(self.power);
        if square <= radius_square {
            // Amidst the lights every direction is possible; a single point at no distance gives nothing.
            return if radius_square > 0.0 { power / radius_square } else { 0.0 };
        }
        let inverse_square = 1.0 / square;
        let direction = to_centre * inverse_square.sqrt();
        let sin_square = radius_square * inverse_square;
        let (cos_subtended, sin_subtended) = ((1.0 - sin_square).sqrt(), sin_square.sqrt());

        // The angle to the nearest emission axis, seen from the place in the box where it is smallest.
        let to_axis = -direction.dot(self.axis.as_dvec3());
        let to_axis = if self.two_sided { to_axis.abs() } else { to_axis };
        let cos_spread = f64::from(self.cos_spread);
        let sin_spread = sine(cos_spread);
        let tolerance = (
            cos_spread * cos_subtended - sin_spread * sin_subtended,
            sin_spread * cos_subtended + cos_spread * sin_subtended,
        );
        let emitted = cos_beyond(to_axis.clamp(-1.0, 1.0), tolerance);

        let received = view.normal.map_or(1.0, |normal| {
            cos_beyond(direction.dot(normal).clamp(-1.0, 1.0), (cos_subtended, sin_subtended))
        });
        // At the horizon the bound is not the cosine; a little is kept for what lies within its slack.
        let importance = power * emitted.max(CONE_SLACK) * received.max(CONE_SLACK) * inverse_square;
        let visible = (emitted > f64::from(self.cos_falloff)) & (received >= -CONE_SLACK);
        if visible { importance } else { 0.0 }
    }
}

/// One light while the table is built.
#[derive(Clone, Copy, Debug)]
pub(super) struct Item {
    /// Its bounds; `power` is not filled in yet.
    pub bounds: LightBounds,
    /// Brightest radiant intensity, in units of luminance.
    pub power: f64,
    /// Its index in the table.
    pub emitter: u32,
}

impl Item {
    /// Twice the centre of its box.
    pub fn centre(&self) -> DVec3 {
        self.bounds.min.as_dvec3() + self.bounds.max.as_dvec3()
    }

    /// Its axis times its power, with a fixed choice of sign where both sides count; none where every direction counts.
    pub fn weighted_axis(&self) -> DVec3 {
        let axis = self.bounds.axis.as_dvec3();
        if self.bounds.cos_spread <= -1.0 {
            return DVec3::ZERO;
        }
        let first = [axis.x, axis.y, axis.z].into_iter().find(|&value| value != 0.0).unwrap_or(0.0);
        let sign = if self.bounds.two_sided && first < 0.0 { -1.0 } else { 1.0 };
        axis * (self.power * sign)
    }
}

/// Bounds of several lights. `unit` divides their powers.
pub(super) fn unite(items: &[Item], unit: f64) -> LightBounds {
    let mut bounds = items[0].bounds;
    let mut power = 0.0;
    let mut sum = DVec3::ZERO;
    for item in items {
        bounds.min = bounds.min.min(item.bounds.min);
        bounds.max = bounds.max.max(item.bounds.max);
        bounds.cos_falloff = bounds.cos_falloff.min(item.bounds.cos_falloff);
        bounds.two_sided |= item.bounds.two_sided;
        power += item.power;
        sum += item.weighted_axis();
    }
    // What would vanish beside the strongest light must not become impossible.
    bounds.power = ((power / unit) as f32).max(f32::MIN_POSITIVE);
    if items.len() > 1 {
        bounds.axis = sum.normalize_or_zero().as_vec3();
        bounds.cos_spread = spread_about(items, bounds.axis, bounds.two_sided);
    }
    bounds
}

/// Cosine of the widest angle from an axis to the cones of the lights.
fn spread_about(items: &[Item], axis: Vec3, two_sided: bool) -> f32 {
    if axis == Vec3::ZERO {
        return -1.0;
    }
    let widest = items.iter().fold(1.0_f64, |widest, item| {
        let mut to_axis = axis.as_dvec3().dot(item.bounds.axis.as_dvec3()).clamp(-1.0, 1.0);
        if two_sided {
            to_axis = to_axis.abs();
        }
        let own = f64::from(item.bounds.cos_spread);
        let sum = if to_axis <= -own { -1.0 } else { to_axis * own - sine(to_axis) * sine(own) };
        widest.min(sum)
    });
    (widest - CONE_SLACK).max(-1.0) as f32
}
