//! The watertight triangle test of Woop, Benthin and Wald 2013 ("Watertight Ray/Triangle Intersection"), eight at a time.
//!
//! The wide part only decides which triangles may be hit; the few that are left are finished one by one, with f64 where
//! f32 cannot decide: an edge that the ray passes exactly through, products beyond the range of f32, and distances
//! so near to zero that rounding hides on which side the ray starts.

use glam::{DVec3, Vec3};

use super::{
    lanes::{Lanes, splat3},
    ray::LocalRay,
    tree::WIDTH,
};

/// Up to eight triangles of a leaf. Places without one repeat the last.
#[repr(C, align(64))]
#[derive(Clone)]
pub(super) struct Packet {
    /// Corner and axis: `corners[3 * corner + axis]`.
    corners: [[f32; WIDTH]; 9],
    /// Identity of the triangles within their tree.
    pub ids: [u32; WIDTH],
}

impl Packet {
    /// # Panics
    /// Without a triangle or with more than eight.
    #[inline]
    pub fn new(triangles: impl ExactSizeIterator<Item = (u32, [Vec3; 3])>) -> Self {
        let count = triangles.len();
        assert!((1..=WIDTH).contains(&count), "a packet holds one to eight triangles");
        let mut packet = Self { corners: [[0.0; WIDTH]; 9], ids: [0; WIDTH] };
        for (lane, (id, corners)) in triangles.enumerate() {
            let end = if lane + 1 == count { WIDTH } else { lane + 1 };
            for lane in lane..end {
                packet.ids[lane] = id;
                for (corner, p) in corners.iter().enumerate() {
                    for axis in 0..3 {
                        packet.corners[3 * corner + axis][lane] = p[axis];
                    }
                }
            }
        }
        packet
    }

    #[inline(always)]
    fn triangle(&self, lane: usize) -> [Vec3; 3] {
        [self.corner(0, lane), self.corner(3, lane), self.corner(6, lane)]
    }

    #[inline(always)]
    fn corner(&self, first: usize, lane: usize) -> Vec3 {
        let c = &self.corners;
        Vec3::new(c[first][lane], c[first + 1][lane], c[first + 2][lane])
    }
}

/// One ray's constants, spread over lanes.
#[derive(Clone, Copy)]
pub(super) struct TriangleRay<S> {
    origin: [S; 3],
    shear: [S; 3],
    axes: [usize; 3],
}

impl<S: Lanes> TriangleRay<S> {
    #[inline(always)]
    pub fn new(ray: &LocalRay) -> Self {
        Self {
            origin: splat3([ray.origin[ray.axes[0]], ray.origin[ray.axes[1]], ray.origin[ray.axes[2]]]),
            shear: splat3(ray.shear),
            axes: ray.axes,
        }
    }
}

impl<S: Lanes> TriangleRay<S> {
    /// A corner of each triangle as seen from the origin, axes in the order of the shear.
    #[inline(always)]
    fn relative(&self, packet: &Packet, corner: usize) -> [S; 3] {
        let corners = &packet.corners[3 * corner..3 * corner + 3];
        [
            S::load(&corners[self.axes[0]]).sub(self.origin[0]),
            S::load(&corners[self.axes[1]]).sub(self.origin[1]),
            S::load(&corners[self.axes[2]]).sub(self.origin[2]),
        ]
    }

    #[inline(always)]
    fn sheared(&self, p: [S; 3]) -> [S; 2] {
        [p[0].sub(self.shear[0].mul(p[2])), p[1].sub(self.shear[1].mul(p[2]))]
    }
}

/// A triangle that a ray meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Meeting {
    pub t: f32,
    /// Weight of the second corner.
    pub u: f32,
    /// Weight of the third corner.
    pub v: f32,
}

/// What the wide part found.
pub(super) struct Candidates {
    /// Lanes that may be hit.
    pub lanes: u32,
    /// Those among them that f32 cannot decide.
    unsure: u32,
    values: [[f32; WIDTH]; 3],
}

/// Below this determinant products may have lost bits to underflow. Scenes of any usual scale stay far above it.
const DETERMINANT_MIN: f32 = f32::from_bits((127 - 100) << 23);

/// `n` roundings (Higham 2002, section 3.1).
const fn gamma(n: u32) -> f32 {
    let unit = 0.5 * f32::EPSILON;
    n as f32 * unit / (1.0 - n as f32 * unit)
}

/// Finds the triangles of a packet that a ray may meet at `t_max` or before.
#[inline(always)]
pub(super) fn candidates<S: Lanes>(packet: &Packet, ray: &TriangleRay<S>, t_max: f32) -> Candidates {
    let (a, b, c) = (ray.relative(packet, 0), ray.relative(packet, 1), ray.relative(packet, 2));
    let ([ax, ay], [bx, by], [cx, cy]) = (ray.sheared(a), ray.sheared(b), ray.sheared(c));
    let u = cx.mul(by).sub(cy.mul(bx));
    let v = ax.mul(cy).sub(ay.mul(cx));
    let w = bx.mul(ay).sub(by.mul(ax));

    // Inside when no two edges disagree; a zero agrees with both.
    let (zero, low, high) = (S::splat(0.0), w.min(v.min(u)), w.max(v.max(u)));
    let inside = !(low.less(zero) & zero.less(high)) & 0xFF;
    if inside == 0 {
        return Candidates { lanes: 0, unsure: 0, values: [[0.0; WIDTH]; 3] };
    }

    let determinant = u.add(v).add(w);
    let size = determinant.abs();
    let (az, bz, cz) = (a[2].mul(ray.shear[2]), b[2].mul(ray.shear[2]), c[2].mul(ray.shear[2]));
    let t = u.mul(az).add(v.mul(bz)).add(w.mul(cz)).div(determinant);

    // The error of t (Pharr, Jakob, Humphreys 2023, section 6.8.4): the sign of a smaller t means nothing.
    let (max_x, max_y, max_z) = (largest(ax, bx, cx), largest(ay, by, cy), largest(az, bz, cz));
    let reach = largest(a[2], b[2], c[2]);
    let (by5, by3) = (S::splat(gamma(5)), S::splat(gamma(3)));
    let error_x = by5.mul(max_x.add(reach));
    let error_y = by5.mul(max_y.add(reach));
    let error_edge = S::splat(2.0)
        .mul(S::splat(gamma(2)).mul(max_x).mul(max_y).add(error_y.mul(max_x)).add(error_x.mul(max_y)));
    let max_edge = largest(u, v, w);
    let error = S::splat(3.0)
        .mul(by3.mul(max_edge).mul(max_z).add(error_edge.mul(max_z)).add(by3.mul(max_z).mul(max_edge)))
        .div(size);

    let on_edge = low.equal(zero) | high.equal(zero);
    let tiny = !S::splat(DETERMINANT_MIN).at_most(size);
    let near_zero = !error.less(t.abs());
    let unsure = (on_edge | tiny | near_zero) & inside;
    let in_time = t.at_most(S::splat(t_max));
    let lanes = inside & (in_time | unsure);
    let mut values = [[0.0; WIDTH]; 3];
    if lanes != 0 {
        t.store(&mut values[0]);
        v.div(determinant).store(&mut values[1]);
        w.div(determinant).store(&mut values[2]);
    }
    Candidates { lanes, unsure, values }
}

#[inline(always)]
fn largest<S: Lanes>(a: S, b: S, c: S) -> S {
    a.abs().max(b.abs()).max(c.abs())
}

/// Finishes one candidate: `None` if it is not hit after all, else where, never before the ray enters the triangle's own box.
///
/// Holding on to that box makes the answer independent of the tree: every node that holds the triangle is entered no
/// later than the triangle is met, so no order of visits can cull it behind a hit that is equally near.
#[inline(always)]
pub(super) fn finish(packet: &Packet, found: &Candidates, lane: usize, ray: &LocalRay) -> Option<Meeting> {
    let corners = packet.triangle(lane);
    let [t, u, v] = &found.values;
    let mut meeting = Meeting { t: t[lane], u: u[lane], v: v[lane] };
    if found.unsure & (1 << lane) != 0 {
        meeting = decide(&corners, ray)?;
    }
    if meeting.t.is_nan() || meeting.t < 0.0 {
        return None;
    }
    let (low, high) =
        (corners[0].min(corners[1]).min(corners[2]), corners[0].max(corners[1]).max(corners[2]));
    let (near, far) = ray.slab(low.to_array(), high.to_array());
    // Adding zero makes -0 the same number as +0 in every bit.
    meeting.t = meeting.t.max(near) + 0.0;
    (near <= far).then_some(meeting)
}

/// Edge functions of the same sheared corners in f64, which holds their products exactly, and the distance from the plane of the
/// unsheared ones. Neighbours see the same corners, so what one leaves to the other the other takes.
#[cold]
#[inline(never)]
fn decide(corners: &[Vec3; 3], ray: &LocalRay) -> Option<Meeting> {
    let [kx, ky, kz] = ray.axes;
    let [sx, sy, _] = ray.shear;
    let origin = Vec3::from_array(ray.origin);
    let sheared = corners.map(|p| {
        let p = p - origin;
        (f64::from(p[kx] - sx * p[kz]), f64::from(p[ky] - sy * p[kz]))
    });
    let [(ax, ay), (bx, by), (cx, cy)] = sheared;
    let (u, v, w) = (cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax);
    if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
        return None;
    }
    let determinant = u + v + w;
    if determinant == 0.0 || !determinant.is_finite() {
        return None;
    }
    let t = plane_distance(corners, ray)?;
    Some(Meeting { t, u: (v / determinant) as f32, v: (w / determinant) as f32 })
}

/// Where a ray meets the plane of a triangle, to within the rounding of the result.
fn plane_distance(corners: &[Vec3; 3], ray: &LocalRay) -> Option<f32> {
    let [a, b, c] = corners.map(|p| p.as_dvec3());
    let origin = Vec3::from_array(ray.origin).as_dvec3();
    let direction = Vec3::from_array(ray.direction).as_dvec3();
    let normal = normal_f64(a, b, c);
    let along = normal.dot(direction);
    let t = normal.dot(a - origin) / along;
    (along != 0.0 && t.is_finite()).then_some(t as f32)
}

/// Twice the area as a vector towards the front.
#[inline]
pub(super) fn normal_f64(a: DVec3, b: DVec3, c: DVec3) -> DVec3 {
    (b - a).cross(c - a)
}
