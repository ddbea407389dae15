//! The only door to transcendental functions, and the small numerics that everything else leans on.
//!
//! The platform's `sin` or `exp` may change with the C library or the compiler's target; these are `libm` or own polynomials of
//! plain multiplications and additions, so that one binary gives one answer on every machine. Square roots, rounding, minimum
//! and maximum are exact by IEEE 754 and need no door; neither do `f32::next_up` and `f32::next_down`.

use glam::{Vec2, Vec3};

/// 1 / pi.
pub const INV_PI: f32 = core::f32::consts::FRAC_1_PI;
/// 2 pi.
pub const TAU: f32 = core::f32::consts::TAU;
/// pi.
pub const PI: f32 = core::f32::consts::PI;
/// pi / 4.
pub const FRAC_PI_4: f32 = core::f32::consts::FRAC_PI_4;

/// Largest `f32` below 1.
pub const ONE_MINUS_EPSILON: f32 = 1.0 - f32::EPSILON / 2.0;

/// Sine of an angle in radians.
pub fn sin(x: f32) -> f32 {
    libm::sinf(x)
}

/// Cosine of an angle in radians.
pub fn cos(x: f32) -> f32 {
    libm::cosf(x)
}

/// Sine and cosine of an angle in radians.
pub fn sin_cos(x: f32) -> (f32, f32) {
    libm::sincosf(x)
}

/// Tangent of an angle in radians.
pub fn tan(x: f32) -> f32 {
    libm::tanf(x)
}

/// Arc sine; arguments beyond [-1, 1] by rounding are taken as the end of that range.
pub fn asin(x: f32) -> f32 {
    libm::asinf(x.clamp(-1.0, 1.0))
}

/// Arc cosine; arguments beyond [-1, 1] by rounding are taken as the end of that range.
pub fn acos(x: f32) -> f32 {
    libm::acosf(x.clamp(-1.0, 1.0))
}

/// Angle of the point (x, y) in (-pi, pi].
pub fn atan2(y: f32, x: f32) -> f32 {
    libm::atan2f(y, x)
}

/// e^x.
pub fn exp(x: f32) -> f32 {
    libm::expf(x)
}

/// Natural logarithm.
pub fn ln(x: f32) -> f32 {
    libm::logf(x)
}

/// x^y.
pub fn powf(x: f32, y: f32) -> f32 {
    libm::powf(x, y)
}

/// Cube root.
pub fn cbrt(x: f32) -> f32 {
    libm::cbrtf(x)
}

/// Sine in double precision, for what is computed once per frame.
pub fn sin_f64(x: f64) -> f64 {
    libm::sin(x)
}

/// Cosine in double precision, for what is computed once per frame.
pub fn cos_f64(x: f64) -> f64 {
    libm::cos(x)
}

/// Arc cosine in double precision; arguments beyond [-1, 1] by rounding are taken as the end of that range.
pub fn acos_f64(x: f64) -> f64 {
    libm::acos(x.clamp(-1.0, 1.0))
}

/// Angle of the point (x, y) in (-pi, pi], in double precision.
pub fn atan2_f64(y: f64, x: f64) -> f64 {
    libm::atan2(y, x)
}

/// Tangent in double precision, for what is computed once per frame.
pub fn tan_f64(x: f64) -> f64 {
    libm::tan(x)
}

/// Error function in double precision.
pub fn erf_f64(x: f64) -> f64 {
    libm::erf(x)
}

/// Sine and cosine of an angle in [-pi/4, pi/4], within 1e-7; about four times as fast as the general ones. The polynomials
/// are those of Moshier's Cephes library.
pub fn sin_cos_octant(x: f32) -> (f32, f32) {
    let z = x * x;
    let sin = ((-1.951_529_6e-4 * z + 8.332_161e-3) * z - 1.666_665_5e-1) * z * x + x;
    let cos = ((2.443_315_7e-5 * z - 1.388_731_6e-3) * z + 4.166_664_6e-2) * z * z - 0.5 * z + 1.0;
    (sin, cos)
}

/// Sine and cosine of 2 pi u for u in [0, 1], within 2e-7; exact at quarter turns.
pub fn sin_cos_turns(u: f32) -> (f32, f32) {
    let quarter = (u * 4.0 + 0.5) as i32;
    let (sin, cos) = sin_cos_octant((u - quarter as f32 * 0.25) * TAU);
    // Without branches: which quarter it is, is as good as random.
    let (sin, cos) = if quarter & 1 == 0 { (sin, cos) } else { (cos, sin) };
    let negate_if_second_bit = |x: f32, q: i32| f32::from_bits(x.to_bits() ^ ((q as u32 & 2) << 30));
    (negate_if_second_bit(sin, quarter), negate_if_second_bit(cos, quarter + 1))
}

/// Square root of `x`, or 0 where rounding has made it negative.
pub fn safe_sqrt(x: f32) -> f32 {
    x.max(0.0).sqrt()
}

/// Bound of the relative error of `n` roundings in a row: n e / (1 - n e), e = 2^-24 (Higham 2002, lemma 3.1).
pub const fn gamma(n: u32) -> f32 {
    const HALF_ULP: f32 = f32::EPSILON / 2.0;
    let ne = n as f32 * HALF_ULP;
    ne / (1.0 - ne)
}

/// a b - c d rounded once more than the exact value: the products are exact in double precision.
pub fn difference_of_products(a: f32, b: f32, c: f32, d: f32) -> f32 {
    (f64::from(a) * f64::from(b) - f64::from(c) * f64::from(d)) as f32
}

/// Cross product without cancellation, see [`difference_of_products`].
pub fn cross(a: Vec3, b: Vec3) -> Vec3 {
    Vec3::new(
        difference_of_products(a.y, b.z, a.z, b.y),
        difference_of_products(a.z, b.x, a.x, b.z),
        difference_of_products(a.x, b.y, a.y, b.x),
    )
}

/// Luminance of linear Rec. 709.
pub fn luminance(rgb: Vec3) -> f32 {
    0.2126 * rgb.x + 0.7152 * rgb.y + 0.0722 * rgb.z
}

/// The upper 24 bits as a fraction in [0, 1): never 1, not even for `u32::MAX`.
pub fn unit_f32(bits: u32) -> f32 {
    const STEP: f32 = 1.0 / (1 << 24) as f32;
    (bits >> 8) as f32 * STEP
}

/// The upper 24 bits as a fraction in [0, 1), see [`unit_f32`].
pub fn unit_f32_from_u64(bits: u64) -> f32 {
    unit_f32((bits >> 32) as u32)
}

/// Two unit vectors that make a right-handed orthonormal basis with the unit vector `n`: x cross y = n (Duff et al. 2017,
/// "Building an Orthonormal Basis, Revisited", listing 3).
pub fn orthonormal_basis(n: Vec3) -> (Vec3, Vec3) {
    let sign = 1.0_f32.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    let x = Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x);
    let y = Vec3::new(b, sign + n.y * n.y * a, -n.y);
    (x, y)
}

/// An orthonormal, right-handed frame; `z` is usually a normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// First tangent.
    pub x: Vec3,
    /// Second tangent.
    pub y: Vec3,
    /// The direction that the frame was made for.
    pub z: Vec3,
}

impl Frame {
    /// A frame around the unit vector `z`.
    pub fn from_z(z: Vec3) -> Self {
        let (x, y) = orthonormal_basis(z);
        Self { x, y, z }
    }

    /// The vector's coordinates in this frame.
    pub fn to_local(&self, v: Vec3) -> Vec3 {
        Vec3::new(v.dot(self.x), v.dot(self.y), v.dot(self.z))
    }

    /// The vector that has these coordinates in this frame.
    pub fn to_world(&self, v: Vec3) -> Vec3 {
        self.x * v.x + self.y * v.y + self.z * v.z
    }
}

/// The vector (sin, cos) of `turn` scaled by `radius`, as (radius cos, radius sin).
pub fn polar(radius: f32, turn: f32) -> Vec2 {
    let (sin, cos) = sin_cos_turns(turn);
    Vec2::new(radius * cos, radius * sin)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_basis(n: Vec3) {
        let (x, y) = orthonormal_basis(n);
        for (what, dot, expected) in [
            ("x.y", x.dot(y), 0.0),
            ("x.n", x.dot(n), 0.0),
            ("y.n", y.dot(n), 0.0),
            ("x.x", x.dot(x), 1.0),
            ("y.y", y.dot(y), 1.0),
        ] {
            assert!((dot - expected).abs() <= 4e-7, "{what} = {dot} for normal {n:?}");
        }
        assert!((x.cross(y) - n).length() <= 1e-6, "left-handed for normal {n:?}");
    }

    #[test]
    fn a_basis_is_orthonormal_and_right_handed_for_any_normal() {
        let mut state = 1_u32;
        let mut next = || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            unit_f32(state) * 2.0 - 1.0
        };
        for i in 0..1_000_000 {
            // Every fourth normal lies close to the south pole, where the older construction broke down.
            let squash = if i % 4 == 0 { 1e-3 } else { 1.0 };
            let v = Vec3::new(next() * squash, next() * squash, if i % 4 == 0 { -1.0 } else { next() });
            if v.length_squared() > 1e-4 {
                assert_basis(v.normalize());
            }
        }
    }

    #[test]
    fn a_basis_is_exact_at_the_poles_and_next_to_them() {
        let south = Vec3::new(0.0, 0.0, -1.0);
        let third = 1.0 / 3.0_f32.sqrt();
        for n in [
            Vec3::Z,
            south,
            Vec3::new(-0.0, -0.0, 1.0),
            Vec3::new(-0.0, 0.0, -1.0),
            Vec3::new(0.0, 0.0, (-1.0_f32).next_up()),
            Vec3::new(1.0, 0.0, -0.0),
            Vec3::new(0.0, -1.0, 0.0),
            Vec3::new(-1.0, -0.0, -0.0),
            Vec3::splat(third),
            Vec3::splat(third.next_up()),
            Vec3::splat(third.next_down()),
        ] {
            assert_basis(n);
        }
        let frame = Frame::from_z(south);
        assert_eq!((frame.x.dot(frame.y), frame.x.dot(south), frame.y.dot(south)), (0.0, 0.0, 0.0));
    }

    #[test]
    fn a_frame_gives_back_what_it_was_given() {
        let frame = Frame::from_z(Vec3::new(0.6, -0.64, 0.48));
        let v = Vec3::new(-0.3, 0.8, 2.0);
        assert!((frame.to_world(frame.to_local(v)) - v).length() < 1e-6);
        assert!((frame.to_local(frame.z) - Vec3::Z).length() < 1e-6);
    }

    #[test]
    fn the_largest_integer_becomes_a_fraction_below_one() {
        assert_eq!(unit_f32(u32::MAX), ONE_MINUS_EPSILON);
        assert_eq!(unit_f32_from_u64(u64::MAX), ONE_MINUS_EPSILON);
        assert_eq!(unit_f32(0), 0.0);
        assert_eq!(unit_f32(1 << 31), 0.5);
    }

    #[test]
    fn turns_agree_with_double_precision() {
        for i in 0..=100_000 {
            let u = i as f32 / 100_000.0;
            let (sin, cos) = sin_cos_turns(u);
            let angle = f64::from(u) * core::f64::consts::TAU;
            assert!((f64::from(sin) - sin_f64(angle)).abs() < 2e-7, "sine of {u} turns");
            assert!((f64::from(cos) - cos_f64(angle)).abs() < 2e-7, "cosine of {u} turns");
        }
        assert_eq!(sin_cos_turns(0.25), (1.0, 0.0));
        assert_eq!(sin_cos_turns(0.5), (0.0, -1.0));
    }

    #[test]
    fn products_that_nearly_cancel_keep_their_difference() {
        let (a, b) = (1.0 + f32::EPSILON, 1.0 - f32::EPSILON);
        assert_eq!(difference_of_products(a, b, 1.0, 1.0), -(f32::EPSILON * f32::EPSILON));
        assert_eq!(a * b - 1.0, 0.0, "what plain arithmetic makes of it");
    }

    #[test]
    fn rounding_outside_the_domain_is_forgiven() {
        assert_eq!(safe_sqrt(-1e-9), 0.0);
        assert_eq!(acos(1.0_f32.next_up()), 0.0);
        assert!(asin(-1.0_f32.next_up().next_down().next_down()).is_finite());
        assert!(gamma(3) > 3.0 * f32::EPSILON / 2.0 && gamma(3) < 1.8e-7);
    }
}
