//! The classic glossy mirror of distribution ray tracing.

use super::{BsdfSample, NOTHING};
use crate::math::Frame;
use glam::Vec3;

/// Below this side of the square single precision cannot tell its directions apart.
const SMOOTH: f32 = 1e-6;

/// Mirror direction plus a random point of a square: `normalize(r + roughness (x1 u + x2 v))` (after Cook, Porter and Carpenter 1984,
/// section 2.3; Shirley's formulation), with u, v orthonormal to r. Directions below the surface are absorbed.
///
/// The density of such directions over solid angle is exactly 1 / (roughness^2 cos^3) inside the square, cos the cosine to r: a point
/// at distance 1/cos on a plane that is seen under cos. So light sampling and multiple importance sampling work as for any other
/// member.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mirror {
    reflectance: Vec3,
    roughness: f32,
    /// What is taken from numbers in [0, 1).
    shift: f32,
    frame: Frame,
}

impl Mirror {
    /// `roughness` is the side of the square at distance 1. Centred, it spreads around the mirror direction; otherwise that is one of
    /// its corners. The square's orientation is defined in world space, so that it does not turn with the mesh's tangents: `frame` is
    /// the shading frame in world space.
    pub fn new(reflectance: Vec3, roughness: f32, centered: bool, frame: &Frame) -> Self {
        Self { reflectance, roughness, shift: if centered { 0.5 } else { 0.0 }, frame: *frame }
    }

    /// Whether it is a perfect mirror.
    pub fn is_delta(&self) -> bool {
        self.roughness < SMOOTH
    }

    /// The mirror direction and the square's sides, in the shading frame.
    fn square(&self, wo: Vec3) -> (Vec3, Vec3, Vec3) {
        let r = Vec3::new(-wo.x, -wo.y, wo.z);
        let (u, v) = basis_from_smallest(self.frame.to_world(r));
        (r, self.frame.to_local(u), self.frame.to_local(v))
    }

    /// See [`super::Bsdf`].
    pub fn eval_pdf(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        if wo.z <= 0.0 || wi.z <= 0.0 || self.is_delta() {
            return NOTHING;
        }
        let (r, u, v) = self.square(wo);
        let cos = wi.dot(r);
        let scale = 1.0 / (cos * self.roughness);
        let inside = |side: Vec3| (0.0..1.0).contains(&(wi.dot(side) * scale + self.shift));
        if cos <= 0.0 || !inside(u) || !inside(v) {
            return NOTHING;
        }
        let pdf = self.density(cos);
        (self.reflectance * (pdf / wi.z), pdf)
    }

    fn density(&self, cos: f32) -> f32 {
        1.0 / (self.roughness * self.roughness * cos * cos * cos)
    }

    /// See [`super::Bsdf`].
    pub fn sample(&self, wo: Vec3, x: [f32; 3]) -> Option<BsdfSample> {
        if wo.z <= 0.0 {
            return None;
        }
        if self.is_delta() {
            return Some(BsdfSample::mirror(wo, self.reflectance, 1.0));
        }
        let (r, u, v) = self.square(wo);
        let wi = (r + (u * (x[0] - self.shift) + v * (x[1] - self.shift)) * self.roughness).normalize();
        (wi.z > 0.0).then(|| BsdfSample::reflection(wi, self.reflectance, self.density(wi.dot(r))))
    }
}

/// Orthonormal to `r`: u = normalize(t x r), v = r x u, with t equal to r except that its component of smallest magnitude is 1.
fn basis_from_smallest(r: Vec3) -> (Vec3, Vec3) {
    let size = r.abs();
    let t = if size.x <= size.y && size.x <= size.z {
        r.with_x(1.0)
    } else if size.y <= size.z {
        r.with_y(1.0)
    } else {
        r.with_z(1.0)
    };
    let u = t.cross(r).normalize();
    (u, r.cross(u))
}

#[cfg(test)]
mod tests {
    use super::*;

    const WO: Vec3 = Vec3::new(0.48, 0.36, 0.8);

    fn mirror(roughness: f32, centered: bool) -> Mirror {
        Mirror::new(Vec3::new(0.9, 0.8, 0.7), roughness, centered, &Frame::from_z(Vec3::Z))
    }

    #[test]
    fn without_roughness_it_is_a_perfect_mirror_bit_for_bit() {
        let sample = mirror(0.0, true).sample(WO, [0.1, 0.9, 0.4]).unwrap();
        assert_eq!((sample.wi, sample.weight), (Vec3::new(-WO.x, -WO.y, WO.z), Vec3::new(0.9, 0.8, 0.7)));
        assert!(sample.delta && mirror(0.0, true).is_delta());
    }

    #[test]
    fn the_square_is_centred_unless_asked_otherwise() {
        let r = Vec3::new(-WO.x, -WO.y, WO.z);
        let middle = |m: Mirror, x: f32| m.sample(WO, [x, x, 0.0]).unwrap().wi;
        assert!((middle(mirror(0.3, true), 0.5) - r).length() < 1e-6);
        assert!((middle(mirror(0.3, false), 0.0) - r).length() < 1e-6);
        assert!((middle(mirror(0.3, false), 0.5) - r).length() > 0.1, "the lobe is shifted");
    }

    #[test]
    fn directions_below_the_surface_are_absorbed() {
        let grazing = Vec3::new(0.999, 0.0, 0.044_7).normalize();
        let bsdf = mirror(0.5, true);
        let above = (0..1024).filter(|i| {
            let x = [(i % 32) as f32 / 32.0, (i / 32) as f32 / 32.0, 0.0];
            bsdf.sample(grazing, x).is_some()
        });
        let share = above.count() as f32 / 1024.0;
        assert!((0.5..0.7).contains(&share), "{share}");
    }

    #[test]
    fn the_square_keeps_its_orientation_in_the_world() {
        let turned = Frame { x: Vec3::Y, y: -Vec3::X, z: Vec3::Z };
        let a = mirror(0.4, false).sample(WO, [0.7, 0.2, 0.0]).unwrap().wi;
        let wo = turned.to_local(Frame::from_z(Vec3::Z).to_world(WO));
        let b = Mirror::new(Vec3::ONE, 0.4, false, &turned).sample(wo, [0.7, 0.2, 0.0]).unwrap().wi;
        assert!((Frame::from_z(Vec3::Z).to_world(a) - turned.to_world(b)).length() < 1e-6);
    }
}
