//! Rays, hits, and the form of a ray that boxes and triangles are tested against.

use glam::Vec3;

/// A half line that ends at `origin + t_max * direction`.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// World space, metres.
    pub origin: Vec3,
    /// World space; any length but zero. Distances along the ray are multiples of it.
    pub direction: Vec3,
    /// Time within the shutter, in [0, 1].
    pub time: f32,
    /// Hits lie in [0, t_max]; may be infinite.
    pub t_max: f32,
}

impl Ray {
    /// An endless ray at the opening of the shutter.
    pub const fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction, time: 0.0, t_max: f32::INFINITY }
    }
}

/// Where a ray met a primitive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in multiples of the ray's direction.
    pub t: f32,
    /// Index into the list of instances that was built.
    pub instance: u32,
    /// Index into the primitives of the instance's geometry.
    pub primitive: u32,
    /// Triangles: weight of the second corner. Disk and rectangle: object-space x. Sphere: octahedral coordinate.
    pub u: f32,
    /// Triangles: weight of the third corner. Disk and rectangle: object-space y. Sphere: octahedral coordinate.
    pub v: f32,
}

/// Widens the far side of every box test. The bound of the rounding of one slab distance is `1 + 2 gamma(3)` (Ize 2013, "Robust
/// BVH Ray Traversal"); the rest of this factor covers that the sheared triangle test rounds a ray sideways by about as much.
const FAR_SLACK: f32 = 1.0 + 1.0 / (1 << 20) as f32;

/// A ray within the space of one tree, with all that does not change from box to box and from triangle to triangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocalRay {
    pub origin: [f32; 3],
    pub direction: [f32; 3],
    /// Reciprocal direction; infinite, and positive, where a component is zero.
    pub inverse_near: [f32; 3],
    /// The same, widened by [`FAR_SLACK`].
    pub inverse_far: [f32; 3],
    /// Axis order of the shear, dominant axis last (Woop, Benthin, Wald 2013).
    pub axes: [usize; 3],
    /// Shear constants.
    pub shear: [f32; 3],
    /// Time within the shutter.
    pub time: f32,
}

impl LocalRay {
    /// `None` if a component is not finite, or the direction is zero or so short or long that reciprocals leave f32.
    #[inline]
    pub fn new(origin: Vec3, direction: Vec3, time: f32) -> Option<Self> {
        // Adding zero turns -0 into +0, so that the side of a box that is met first does not hang on the sign of a zero.
        let direction = (direction + Vec3::ZERO).to_array();
        let magnitude = [direction[0].abs(), direction[1].abs(), direction[2].abs()];
        let kz = if magnitude[0] > magnitude[1] {
            if magnitude[0] > magnitude[2] { 0 } else { 2 }
        } else if magnitude[1] > magnitude[2] {
            1
        } else {
            2
        };
        let usable = origin.is_finite()
            && (1e-37..1e37).contains(&magnitude[kz])
            && magnitude.iter().all(|m| m.is_finite());
        if !usable {
            return None;
        }
        let (kx, ky) = ((kz + 1) % 3, (kz + 2) % 3);
        let (kx, ky) = if direction[kz] < 0.0 { (ky, kx) } else { (kx, ky) };
        let inverse_near = [1.0 / direction[0], 1.0 / direction[1], 1.0 / direction[2]];
        Some(Self {
            origin: origin.to_array(),
            direction,
            inverse_near,
            inverse_far: [
                inverse_near[0] * FAR_SLACK,
                inverse_near[1] * FAR_SLACK,
                inverse_near[2] * FAR_SLACK,
            ],
            axes: [kx, ky, kz],
            shear: [direction[kx] / direction[kz], direction[ky] / direction[kz], 1.0 / direction[kz]],
            time,
        })
    }

    /// The stretch of the ray within a box, with the arithmetic of the wide node test: rounding is monotone, so a box that
    /// holds another is never entered later or left earlier. A distance that is not a number comes from a ray within
    /// the plane of a side, which then does not bound it.
    #[inline(always)]
    pub fn slab(&self, low: [f32; 3], high: [f32; 3]) -> (f32, f32) {
        let (mut near, mut far) = (0.0f32, f32::MAX);
        for axis in 0..3 {
            let forward = self.inverse_near[axis] >= 0.0;
            let (first, last) = if forward { (low[axis], high[axis]) } else { (high[axis], low[axis]) };
            let enter = (first - self.origin[axis]) * self.inverse_near[axis];
            let leave = (last - self.origin[axis]) * self.inverse_far[axis];
            near = if enter > near { enter } else { near };
            far = if leave < far { leave } else { far };
        }
        (near, far)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ray_within_the_plane_of_a_side_meets_the_box_whatever_the_sign_of_its_zero() {
        for (face, zero) in [(-1.0, 0.0), (-1.0, -0.0), (1.0, 0.0), (1.0, -0.0)] {
            let ray =
                LocalRay::new(Vec3::new(face, 0.5, -3.0), Vec3::new(zero, -0.0, 1.0), 0.0).expect("a ray");
            let (near, far) = ray.slab([-1.0; 3], [1.0; 3]);
            assert!(near == 2.0 && far >= 4.0, "{near} {far}");
        }
    }

    #[test]
    fn ray_beside_a_box_misses_it() {
        let ray = LocalRay::new(Vec3::new(1.1, 0.0, -3.0), Vec3::Z, 0.0).expect("a ray");
        let (near, far) = ray.slab([-1.0; 3], [1.0; 3]);
        assert!(near > far);
    }

    #[test]
    fn unusable_rays_are_refused() {
        for direction in [Vec3::ZERO, Vec3::NAN, Vec3::X * f32::INFINITY] {
            assert!(LocalRay::new(Vec3::ZERO, direction, 0.0).is_none());
        }
        assert!(LocalRay::new(Vec3::NAN, Vec3::X, 0.0).is_none());
    }
}
