//! Boxes, and boxes that move.

use glam::Vec3;

use crate::transform::MotionTransform;

/// An axis-aligned box; empty when `low` exceeds `high`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Box3 {
    pub low: Vec3,
    pub high: Vec3,
}

impl Box3 {
    pub const EMPTY: Self = Self { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY };

    pub fn of(points: impl IntoIterator<Item = Vec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, |b, p| Self { low: b.low.min(p), high: b.high.max(p) })
    }

    pub fn union(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// Whether there is something in it, and it has an end.
    pub fn is_finite(self) -> bool {
        self.low.is_finite() && self.high.is_finite()
    }

    pub fn corners(self) -> [Vec3; 8] {
        let pick = |bit: usize, a: f32, b: f32| if bit == 0 { a } else { b };
        std::array::from_fn(|i| {
            Vec3::new(
                pick(i & 1, self.low.x, self.high.x),
                pick(i & 2, self.low.y, self.high.y),
                pick(i & 4, self.low.z, self.high.z),
            )
        })
    }

    /// Largest coordinate of each axis.
    pub fn reach(self) -> Vec3 {
        self.low.abs().max(self.high.abs())
    }

    fn grown(self, by: Vec3) -> Self {
        Self { low: self.low - by, high: self.high + by }
    }
}

/// What nodes of a tree keep: a box that stands, or one that moves.
pub(super) trait Bounds: Copy {
    const EMPTY: Self;
    fn union(self, other: Self) -> Self;
    /// The box in the middle of the shutter, which stands for the mean cost.
    fn middle(self) -> Box3;
    /// A box for every moment.
    fn whole(self) -> Box3;
}

impl Bounds for Box3 {
    const EMPTY: Self = Self::EMPTY;
    fn union(self, other: Self) -> Self {
        self.union(other)
    }
    fn middle(self) -> Box3 {
        self
    }
    fn whole(self) -> Box3 {
        self
    }
}

/// A box whose sides move on straight lines from the opening of the shutter to its closing.
#[derive(Clone, Copy, Debug)]
pub(super) struct MovingBox {
    pub open: Box3,
    pub close: Box3,
}

/// Covers the rounding of an interpolated side and of an interpolated vertex.
const LERP_PAD: f32 = 4.0 * f32::EPSILON;

/// Covers the rounding of a point that is taken through an instance's map.
const MAP_PAD: f32 = 8.0 * f32::EPSILON;

/// Straight pieces that a turning segment is cut into for its bounds.
const PIECES: usize = 16;

impl MovingBox {
    pub fn standing(b: Box3) -> Self {
        Self { open: b, close: b }
    }

    /// A moving box around boxes with their times, in order, between which everything moves on straight lines; or jumps, where no
    /// time is between.
    pub fn around(boxes: &[(f32, Box3)]) -> Self {
        let (mut open, mut close) = (boxes[0].1, boxes[boxes.len() - 1].1);
        let (mut down, mut up) = (Vec3::ZERO, Vec3::ZERO);
        for &(f, b) in boxes {
            down = down.max(open.low * (1.0 - f) + close.low * f - b.low);
            up = up.max(b.high - (open.high * (1.0 - f) + close.high * f));
        }
        for b in [&mut open, &mut close] {
            *b = Box3 { low: b.low - down, high: b.high + up };
        }
        // Both ends are padded alike: an interpolated side rounds on the scale of its larger end.
        let pad = open.reach().max(close.reach()) * LERP_PAD;
        Self { open: open.grown(pad), close: close.grown(pad) }
    }

    /// Bounds of object-space bounds that a transform carries through the shutter.
    pub fn carried(object: Self, transform: &MotionTransform) -> Self {
        let segments = transform.segments();
        if segments.is_empty() {
            return Self {
                open: carried_at(object.open, transform, 0.0, 0.0),
                close: carried_at(object.close, transform, 0.0, 0.0),
            };
        }
        let object = object.whole();
        let mut boxes = Vec::with_capacity(segments.len() * (PIECES + 1));
        for (segment, [from, to]) in segments {
            let pad = sagitta(object, transform, segment);
            for piece in 0..=PIECES {
                let f = piece as f32 / PIECES as f32;
                let u = from * (1.0 - f) + to * f;
                boxes.push((u, carried_at(object, transform, u, pad)));
            }
        }
        Self::around(&boxes)
    }
}

impl Bounds for MovingBox {
    const EMPTY: Self = Self { open: Box3::EMPTY, close: Box3::EMPTY };
    fn union(self, other: Self) -> Self {
        Self { open: self.open.union(other.open), close: self.close.union(other.close) }
    }
    fn middle(self) -> Box3 {
        Box3 {
            low: self.open.low * 0.5 + self.close.low * 0.5,
            high: self.open.high * 0.5 + self.close.high * 0.5,
        }
    }
    fn whole(self) -> Box3 {
        self.open.union(self.close)
    }
}

fn carried_at(object: Box3, transform: &MotionTransform, u: f32, pad: f32) -> Box3 {
    let map = transform.at(u);
    // Rounding happens on the scale of the products, also where they cancel.
    let m = &map.linear;
    let reach = object.reach();
    let terms = m.x_axis.abs() * reach.x + m.y_axis.abs() * reach.y + m.z_axis.abs() * reach.z;
    let rounding = (terms + map.translation.abs()).max_element() * MAP_PAD;
    Box3::of(object.corners().map(|p| map.point(p))).grown(Vec3::splat(pad + rounding))
}

/// How far a point of the box may leave the straight line between two pieces: `h^2/8 max |q''|`, where
/// `q = R(f) (S0 (1-f) + S1 f) p + T(f)` turns by `angle` over the segment, so `|q''| <= angle^2 |S p| + 2 angle |(S1 - S0) p|`.
fn sagitta(object: Box3, transform: &MotionTransform, segment: usize) -> f32 {
    let (angle, s0, s1) = transform.bend(segment);
    let angle = angle as f32;
    if angle == 0.0 {
        return 0.0;
    }
    let worst = object.corners().into_iter().fold(0.0f32, |worst, p| {
        let (a, b) = (s0 * p, s1 * p);
        worst.max(angle * angle * a.length().max(b.length()) + 2.0 * angle * (b - a).length())
    });
    let h = 1.0 / PIECES as f32;
    worst * (h * h / 8.0) * 1.001
}

#[cfg(test)]
mod tests {
    use glam::{Mat3, Quat};

    use super::*;
    use crate::transform::TransformKey;

    #[test]
    fn carried_box_holds_its_corners_at_every_moment() {
        let key = |t: Vec3, q: Quat, s: Vec3| TransformKey {
            translation: t,
            rotation: q,
            stretch: Mat3::from_diagonal(s),
        };
        let motion = MotionTransform::from_keys(vec![
            key(Vec3::ZERO, Quat::IDENTITY, Vec3::ONE),
            key(Vec3::X * 5.0, Quat::from_rotation_z(3.0), Vec3::new(2.0, 1.0, 0.1)),
            key(Vec3::Y * -4.0, Quat::from_rotation_x(1.5), Vec3::splat(0.5)),
        ]);
        let object = Box3 { low: Vec3::new(-1.0, -2.0, 0.0), high: Vec3::new(3.0, 1.0, 1.0) };
        let bounds = MovingBox::carried(MovingBox::standing(object), &motion);
        for i in 0..=1000 {
            let u = i as f32 / 1000.0;
            let low = bounds.open.low * (1.0 - u) + bounds.close.low * u;
            let high = bounds.open.high * (1.0 - u) + bounds.close.high * u;
            for p in object.corners() {
                let q = motion.at(u).point(p);
                assert!(q.cmpge(low).all() && q.cmple(high).all(), "{u}: {q} outside {low} {high}");
            }
        }
    }
}
