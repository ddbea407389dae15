//! Where an object is while the shutter is open: affine maps and their interpolation over time.
//!
//! Everything here is computed in f64 with plain multiplications and additions and rounded once, so that the same time
//! gives the same bits everywhere, and a map and its inverse agree far below f32 resolution.

use glam::{DMat3, DQuat, DVec3, Mat3, Quat, Vec3};
use std::sync;

use crate::math;

/// A linear map followed by a translation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine {
    /// Linear part, column vectors; any matrix, also mirrored or singular.
    pub linear: Mat3,
    /// Metres.
    pub translation: Vec3,
}

impl Affine {
    /// No change of place.
    pub const IDENTITY: Self = Self { linear: Mat3::IDENTITY, translation: Vec3::ZERO };

    /// A linear map followed by a translation.
    pub const fn new(linear: Mat3, translation: Vec3) -> Self {
        Self { linear, translation }
    }

    /// The image of a point, rounded once.
    #[inline]
    pub fn point(&self, p: Vec3) -> Vec3 {
        self.point_f64(p.as_dvec3()).as_vec3()
    }

    /// The image of a point before rounding.
    #[inline]
    pub fn point_f64(&self, p: DVec3) -> DVec3 {
        self.vector_f64(p) + self.translation.as_dvec3()
    }

    /// The image of a direction, rounded once; its length changes with the map.
    #[inline]
    pub fn vector(&self, v: Vec3) -> Vec3 {
        self.vector_f64(v.as_dvec3()).as_vec3()
    }

    /// The image of a direction before rounding.
    #[inline]
    pub fn vector_f64(&self, v: DVec3) -> DVec3 {
        let m = &self.linear;
        m.x_axis.as_dvec3() * v.x + m.y_axis.as_dvec3() * v.y + m.z_axis.as_dvec3() * v.z
    }

    /// The image of a normal, unit length, on the same side of its surface also when the map mirrors; zero when the map
    /// flattens it away.
    #[inline]
    pub fn normal(&self, n: Vec3) -> Vec3 {
        #[cfg(feature = "mutations")]
        if crate::mutations::is_on(crate::mutations::Mutation::NormalAsDirection) {
            return (self.linear * n).normalize_or_zero();
        }
        self.normal_f64(n.as_dvec3()).as_vec3()
    }

    /// The image of a normal before rounding.
    #[inline]
    pub fn normal_f64(&self, n: DVec3) -> DVec3 {
        let [x, y, z] = self.columns();
        let sign = if self.mirrors() { -1.0 } else { 1.0 };
        unit((y.cross(z) * n.x + z.cross(x) * n.y + x.cross(y) * n.z) * sign)
    }

    /// Determinant of the linear part.
    #[inline]
    pub fn determinant(&self) -> f64 {
        let [x, y, z] = self.columns();
        x.dot(y.cross(z))
    }

    /// Whether the map turns left hands into right ones.
    #[inline]
    pub fn mirrors(&self) -> bool {
        self.determinant() < 0.0
    }

    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        self.linear.is_finite() && self.translation.is_finite()
    }

    /// The inverse; `None` when the map is singular or its inverse is not finite.
    #[inline]
    pub fn inverse(&self) -> Option<InverseAffine> {
        let [x, y, z] = self.columns();
        let (yz, zx, xy) = (y.cross(z), z.cross(x), x.cross(y));
        let scale = 1.0 / x.dot(yz);
        let inverse = InverseAffine {
            rows: [yz * scale, zx * scale, xy * scale],
            translation: self.translation.as_dvec3(),
        };
        let sum = inverse.rows[0].abs() + inverse.rows[1].abs() + inverse.rows[2].abs();
        let in_range = scale.is_finite() && sum.is_finite() && sum.max_element() < f64::from(f32::MAX);
        in_range.then_some(inverse)
    }

    fn columns(&self) -> [DVec3; 3] {
        [self.linear.x_axis.as_dvec3(), self.linear.y_axis.as_dvec3(), self.linear.z_axis.as_dvec3()]
    }
}

/// The inverse of an [`Affine`], kept in f64.
#[derive(Clone, Copy, Debug)]
pub struct InverseAffine {
    rows: [DVec3; 3],
    translation: DVec3,
}

impl InverseAffine {
    /// Brings a point back, rounded once.
    #[inline]
    pub fn point(&self, p: Vec3) -> Vec3 {
        self.rows_times(p.as_dvec3() - self.translation)
    }

    /// Brings a direction back, rounded once.
    #[inline]
    pub fn vector(&self, v: Vec3) -> Vec3 {
        self.rows_times(v.as_dvec3())
    }

    #[inline]
    fn rows_times(&self, v: DVec3) -> Vec3 {
        DVec3::new(self.rows[0].dot(v), self.rows[1].dot(v), self.rows[2].dot(v)).as_vec3()
    }
}

/// A place at one moment: stretched, then turned, then moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TransformKey {
    /// Metres.
    pub translation: Vec3,
    /// Rotation; normalised here.
    pub rotation: Quat,
    /// What is left of the linear part when the rotation is taken out; scale and shear.
    pub stretch: Mat3,
}

impl TransformKey {
    /// The map at this key.
    pub fn affine(&self) -> Affine {
        turned(unit_quaternion(self.rotation), self.stretch.as_dmat3(), self.translation)
    }
}

/// A place for every moment of the shutter: fixed, or keys spread uniformly over each piece between jumps.
#[derive(Clone, Debug)]
pub struct MotionTransform(Kind);

#[derive(Clone, Debug)]
enum Kind {
    Static(Affine),
    Keyed { keys: Vec<TransformKey>, arcs: Vec<Arc>, jumps: Jumps },
}

/// The shorter great arc between two unit quaternions: `q0 cos(f angle) + side sin(f angle)`.
#[derive(Clone, Copy, Debug)]
struct Arc {
    q0: DQuat,
    side: DQuat,
    angle: f64,
}

impl MotionTransform {
    /// A place that does not change.
    pub const fn fixed(affine: Affine) -> Self {
        Self(Kind::Static(affine))
    }

    /// Keys at the times `0, 1/(K-1), .. 1` of the shutter. Equal keys are a fixed place, and cost what one costs.
    ///
    /// # Panics
    /// Without any key.
    pub fn from_keys(keys: Vec<TransformKey>) -> Self {
        Self::with_jumps(keys, Jumps::default())
    }

    /// The same number of keys in each of the pieces that `jumps` cut the shutter into; see [`Jumps`].
    ///
    /// # Panics
    /// Without any key.
    pub fn with_jumps(keys: Vec<TransformKey>, jumps: Jumps) -> Self {
        assert!(!keys.is_empty(), "a moving place has at least one key");
        if keys.iter().all(|key| *key == keys[0]) {
            return Self::fixed(keys[0].affine());
        }
        let arcs = keys.windows(2).map(|pair| Arc::between(pair[0].rotation, pair[1].rotation)).collect();
        Self(Kind::Keyed { keys, arcs, jumps })
    }

    /// The place, if it does not change.
    #[inline]
    pub fn as_fixed(&self) -> Option<&Affine> {
        match &self.0 {
            Kind::Static(affine) => Some(affine),
            Kind::Keyed { .. } => None,
        }
    }

    /// The map at time `u` of the shutter, in [0, 1].
    #[inline]
    pub fn at(&self, u: f32) -> Affine {
        match &self.0 {
            Kind::Static(affine) => *affine,
            Kind::Keyed { keys, arcs, jumps } => {
                let (segment, f) = jumps.segment_at(u, keys.len());
                let (a, b, f) = (&keys[segment], &keys[segment + 1], f64::from(f));
                let lerp = |a: DVec3, b: DVec3| a * (1.0 - f) + b * f;
                let stretch = DMat3::from_cols(
                    lerp(a.stretch.x_axis.as_dvec3(), b.stretch.x_axis.as_dvec3()),
                    lerp(a.stretch.y_axis.as_dvec3(), b.stretch.y_axis.as_dvec3()),
                    lerp(a.stretch.z_axis.as_dvec3(), b.stretch.z_axis.as_dvec3()),
                );
                let translation = lerp(a.translation.as_dvec3(), b.translation.as_dvec3()).as_vec3();
                #[cfg(feature = "mutations")]
                let translation = crate::mutations::translation(translation, keys[0].translation);
                turned(arcs[segment].at(f), stretch, translation)
            }
        }
    }

    /// The segments between keys, by the index of their first key, with their ends in time; none for a fixed place.
    pub(crate) fn segments(&self) -> Vec<(usize, [f32; 2])> {
        match &self.0 {
            Kind::Static(_) => Vec::new(),
            Kind::Keyed { keys, jumps, .. } => jumps.segments(keys.len()),
        }
    }

    /// Where it jumps; nowhere if it is fixed.
    pub(crate) fn jumps(&self) -> &[f32] {
        match &self.0 {
            Kind::Static(_) => &[],
            Kind::Keyed { jumps, .. } => &jumps.0,
        }
    }

    /// How a segment between two keys bends: rotation angle in radians, and its two stretches.
    pub(crate) fn bend(&self, segment: usize) -> (f64, Mat3, Mat3) {
        match &self.0 {
            Kind::Static(affine) => (0.0, affine.linear, affine.linear),
            Kind::Keyed { keys, arcs, .. } => {
                (2.0 * arcs[segment].angle, keys[segment].stretch, keys[segment + 1].stretch)
            }
        }
    }

    /// Whether the map is singular or not finite whenever a key is reached.
    pub(crate) fn is_singular(&self) -> bool {
        match &self.0 {
            Kind::Static(affine) => affine.inverse().is_none(),
            Kind::Keyed { keys, .. } => keys.iter().all(|key| key.affine().inverse().is_none()),
        }
    }
}

impl Arc {
    fn between(from: Quat, to: Quat) -> Self {
        let (q0, q1) = (unit_quaternion(from), unit_quaternion(to));
        let q1 = if dot(q0, q1) < 0.0 { scaled(q1, -1.0) } else { q1 };
        let across = combine(q1, 1.0, q0, -dot(q0, q1));
        let sine = dot(across, across).sqrt();
        if sine == 0.0 {
            return Self { q0, side: DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), angle: 0.0 };
        }
        Self { q0, side: scaled(across, 1.0 / sine), angle: math::atan2_f64(sine, dot(q0, q1)) }
    }

    #[inline]
    fn at(&self, f: f64) -> DQuat {
        if self.angle == 0.0 {
            return self.q0;
        }
        let (sine, cosine) = (math::sin_f64(f * self.angle), math::cos_f64(f * self.angle));
        combine(self.q0, cosine, self.side, sine)
    }
}

/// Times within the shutter, in (0, 1) and ascending, at which things are somewhere else from one moment to the next. They cut the
/// shutter into pieces, each with as many keys as the others, spread uniformly over it; the last key of a piece is how things are just
/// before the jump, the first of the next how they are from then on. Nothing is interpolated across.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Jumps(sync::Arc<[f32]>);

impl Jumps {
    /// # Panics
    /// When the times are not ascending within (0, 1).
    pub fn new(times: &[f32]) -> Self {
        let ends = [0.0].iter().chain(times).zip(times.iter().chain(&[1.0]));
        assert!(ends.clone().all(|(a, b)| a < b), "jumps ascend within the shutter");
        Self(times.into())
    }

    /// The first key of the segment that holds time `u` among `keys`, and the place within it in [0, 1].
    #[inline]
    pub fn segment_at(&self, u: f32, keys: usize) -> (usize, f32) {
        if self.0.is_empty() {
            return uniform_segment(u, keys - 1);
        }
        let piece = self.0.partition_point(|&jump| jump <= u);
        let [from, to] = self.piece(piece);
        let per_piece = keys / self.pieces();
        let (segment, f) = uniform_segment((u - from) / (to - from), per_piece - 1);
        (piece * per_piece + segment, f)
    }

    /// Pieces of the shutter.
    pub fn pieces(&self) -> usize {
        self.0.len() + 1
    }

    /// When the key `key` of `keys` holds. At the end of a piece that is the last moment before the jump.
    pub(crate) fn key_time(&self, key: usize, keys: usize) -> f32 {
        let per_piece = keys / self.pieces();
        let (piece, step) = (key / per_piece, key % per_piece);
        let [from, to] = self.piece(piece);
        if step > 0 && step + 1 == per_piece && piece + 1 < self.pieces() {
            return to.next_down();
        }
        from + (to - from) * (step as f32 / (per_piece.max(2) - 1) as f32)
    }

    /// The segments of `keys`: the index of the first key, and both ends in time.
    pub(crate) fn segments(&self, keys: usize) -> Vec<(usize, [f32; 2])> {
        let per_piece = keys / self.pieces();
        let ends = |key: usize| (key, [self.key_time(key, keys), self.key_time(key + 1, keys)]);
        (0..keys).filter(|key| key % per_piece + 1 < per_piece).map(ends).collect()
    }

    fn piece(&self, piece: usize) -> [f32; 2] {
        let from = if piece == 0 { 0.0 } else { self.0[piece - 1] };
        [from, self.0.get(piece).copied().unwrap_or(1.0)]
    }
}

/// The segment that holds `u` of `segments` uniform ones, and the place within it in [0, 1].
#[inline]
fn uniform_segment(u: f32, segments: usize) -> (usize, f32) {
    let x = u.clamp(0.0, 1.0) * segments as f32;
    let segment = (x as usize).min(segments - 1);
    (segment, x - segment as f32)
}

/// Unit length; zero for zero. Safe from overflow and underflow for everything that started as f32.
#[inline]
pub(crate) fn unit(v: DVec3) -> DVec3 {
    let length = v.dot(v).sqrt();
    if length > 0.0 { v / length } else { DVec3::ZERO }
}

fn turned(q: DQuat, stretch: DMat3, translation: Vec3) -> Affine {
    let rotation = rotation_matrix(q);
    let column = |v: DVec3| (rotation.x_axis * v.x + rotation.y_axis * v.y + rotation.z_axis * v.z).as_vec3();
    let linear = Mat3::from_cols(column(stretch.x_axis), column(stretch.y_axis), column(stretch.z_axis));
    Affine { linear, translation }
}

fn rotation_matrix(q: DQuat) -> DMat3 {
    let (x, y, z, w) = (q.x, q.y, q.z, q.w);
    DMat3::from_cols(
        DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
}

/// A quaternion of length zero turns nothing.
fn unit_quaternion(q: Quat) -> DQuat {
    let q = DQuat::from_xyzw(f64::from(q.x), f64::from(q.y), f64::from(q.z), f64::from(q.w));
    let length = dot(q, q).sqrt();
    if length > 0.0 { scaled(q, 1.0 / length) } else { DQuat::IDENTITY }
}

fn dot(a: DQuat, b: DQuat) -> f64 {
    a.x * b.x + a.y * b.y + a.z * b.z + a.w * b.w
}

fn scaled(q: DQuat, s: f64) -> DQuat {
    DQuat::from_xyzw(q.x * s, q.y * s, q.z * s, q.w * s)
}

fn combine(a: DQuat, s: f64, b: DQuat, t: f64) -> DQuat {
    DQuat::from_xyzw(a.x * s + b.x * t, a.y * s + b.y * t, a.z * s + b.z * t, a.w * s + b.w * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(rotation: Quat) -> TransformKey {
        TransformKey { translation: Vec3::ZERO, rotation, stretch: Mat3::IDENTITY }
    }

    fn turn(degrees: f32) -> MotionTransform {
        MotionTransform::from_keys(vec![
            key(Quat::IDENTITY),
            key(Quat::from_rotation_z(degrees.to_radians())),
        ])
    }

    #[test]
    fn quarter_turn_in_one_segment_keeps_the_radius_of_its_tip() {
        let motion = turn(90.0);
        for i in 0..=64 {
            let tip = motion.at(i as f32 / 64.0).point(Vec3::new(3.0, 0.0, 0.5));
            assert!((tip.truncate().length() - 3.0).abs() < 1e-6, "{tip}");
        }
        let half = motion.at(0.5).point(Vec3::X);
        assert!((half - Vec3::new(0.5f32.sqrt(), 0.5f32.sqrt(), 0.0)).length() < 1e-7, "{half}");
    }

    #[test]
    fn half_turn_does_not_collapse() {
        let tip = turn(180.0).at(0.5).point(Vec3::X);
        assert!((tip.length() - 1.0).abs() < 1e-6 && tip.x.abs() < 1e-6, "{tip}");
    }

    #[test]
    fn ends_of_a_motion_are_its_keys() {
        let keys = vec![
            TransformKey {
                translation: Vec3::new(1.0, 2.0, 3.0),
                rotation: Quat::from_rotation_x(0.3),
                stretch: Mat3::from_diagonal(Vec3::new(1.0, 2.0, 0.5)),
            },
            key(Quat::from_rotation_y(1.0)),
            key(Quat::from_rotation_y(-2.0)),
        ];
        let motion = MotionTransform::from_keys(keys.clone());
        assert_eq!(motion.at(0.0), keys[0].affine());
        for (u, key) in [(0.5, &keys[1]), (1.0, &keys[2])] {
            let (there, key) = (motion.at(u), key.affine());
            for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
                assert!((there.point(axis) - key.point(axis)).length() < 1e-6);
            }
        }
    }

    #[test]
    fn nothing_is_between_the_ends_of_a_jump() {
        let at = |x: f32| TransformKey { translation: Vec3::X * x, ..key(Quat::IDENTITY) };
        // Two keys in each of three pieces: still, moving, still again.
        let keys = [0.0, 0.0, 5.0, 7.0, -1.0, -1.0].map(at).to_vec();
        let jumps = Jumps::new(&[0.25, 0.75]);
        let motion = MotionTransform::with_jumps(keys.clone(), jumps.clone());
        let x = |u: f32| motion.at(u).translation.x;
        assert_eq!([0.0, 0.2, 0.25f32.next_down()].map(x), [0.0; 3]);
        assert_eq!([0.25, 0.5, 0.75, 1.0].map(x), [5.0, 6.0, -1.0, -1.0]);
        assert!((x(0.75f32.next_down()) - 7.0).abs() < 1e-5);
        let times: Vec<f32> = (0..6).map(|key| jumps.key_time(key, 6)).collect();
        assert_eq!(times, [0.0, 0.25f32.next_down(), 0.25, 0.75f32.next_down(), 0.75, 1.0]);
        assert_eq!(motion.segments().iter().map(|(key, _)| *key).collect::<Vec<_>>(), [0, 2, 4]);
    }

    #[test]
    fn equal_keys_are_a_fixed_place() {
        let motion = MotionTransform::from_keys(vec![key(Quat::from_rotation_x(0.7)); 3]);
        assert_eq!(motion.as_fixed(), Some(&key(Quat::from_rotation_x(0.7)).affine()));
    }

    #[test]
    fn inverse_brings_points_back_even_from_extreme_scales() {
        let linear = Mat3::from_cols(Vec3::X * 1e3, Vec3::new(1e-3, 1e-3, 0.0), Vec3::Z * -1.0);
        for scale in [1e-8, 1.0, 1e8] {
            let map = Affine::new(linear * scale, Vec3::new(5.0, -7.0, 9.0) * scale);
            let inverse = map.inverse().expect("a regular map");
            let p = Vec3::new(0.3, 0.6, -0.9);
            assert!((inverse.point(map.point(p)) - p).length() < 1e-2, "scale {scale}");
            assert!(map.mirrors());
        }
        assert!(Affine::new(Mat3::from_diagonal(Vec3::new(1.0, 1.0, 0.0)), Vec3::ZERO).inverse().is_none());
    }

    #[test]
    fn normals_stay_on_their_side_of_a_mirrored_surface() {
        let map = Affine::new(Mat3::from_diagonal(Vec3::new(-1.0, 2.0, 1.0)), Vec3::ZERO);
        assert_eq!(map.normal(Vec3::Z), Vec3::Z);
        let tangent = map.vector(Vec3::new(1.0, -1.0, 0.0));
        let normal = map.normal(Vec3::new(1.0, 1.0, 0.0).normalize());
        assert!(tangent.dot(normal).abs() < 1e-6 && (normal.length() - 1.0).abs() < 1e-6);
    }
}
