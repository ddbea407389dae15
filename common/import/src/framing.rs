//! A camera for scenes that have none: it shows everything there is at time 0.

use crate::pose::{Extent, extent};
use farm_scene::{Camera, Node, Projection, Scene, Shutter, Transform};
use glam::{DMat3, DQuat, DVec3};

/// 40 degrees, close to what the eye takes in without strain.
const YFOV: f32 = 0.698_131_7;

/// Tangent of half of it.
const TAN_HALF_YFOV: f64 = 0.363_970_234_266_202_36;

/// Room around the scene.
const MARGIN: f64 = 1.05;

/// Share of the box's surface that the open side must have, for the camera to look into it.
const OPEN_SHARE: f64 = 0.1;

/// Three-quarter view: from the front, a little from the right and from above.
const THREE_QUARTER: DVec3 = DVec3::new(0.5, 0.4, 1.0);

/// Adds a camera, and its node, that frames the scene; its shorter side fits whatever the picture's shape.
pub(crate) fn add_camera(scene: &mut Scene) {
    let around_origin = Extent { min: DVec3::NEG_ONE, max: DVec3::ONE, vector_area: DVec3::ZERO };
    let (translation, rotation) = view(&extent(scene).unwrap_or(around_origin));
    let name = "framing".to_owned();
    scene.cameras.push(Camera {
        name: name.clone(),
        node: scene.nodes.len() as u32,
        projection: Projection::Perspective { yfov: YFOV },
        lens: None,
        shutter: Shutter::default(),
    });
    scene.nodes.push(Node {
        name,
        parent: None,
        transform: Transform::Trs { translation, rotation, scale: DVec3::ONE },
        motion_vector: None,
        instances: vec![],
        skin: None,
        morph_weights: vec![],
    });
}

/// Where a camera stands that sees all of the box, and how it is turned.
fn view(extent: &Extent) -> (DVec3, DQuat) {
    let centre = extent.min + (extent.max - extent.min) / 2.0;
    let half = (extent.max - extent.min) / 2.0;
    let back = direction(extent).normalize();
    let right = DVec3::Y.cross(back).normalize();
    let up = back.cross(right);
    // Each corner must lie within the pyramid of view, above and beside.
    let mut distance: f64 = 0.0;
    for corner in 0..8 {
        let sign = |bit: i32| if corner & bit == 0 { -1.0 } else { 1.0 };
        let offset = half * DVec3::new(sign(1), sign(2), sign(4));
        let aside = offset.dot(right).abs().max(offset.dot(up).abs());
        distance = distance.max(offset.dot(back) + aside / TAN_HALF_YFOV * MARGIN);
    }
    // A single point has no size to go by.
    let distance = if distance > 0.0 { distance } else { 1.0 };
    (centre + back * distance, DQuat::from_mat3(&DMat3::from_cols(right, up, back)))
}

/// From the scene towards the camera: three-quarter, or straight into the side where the scene is open.
fn direction(extent: &Extent) -> DVec3 {
    let size = extent.max - extent.min;
    let surface = 2.0 * (size.x * size.y + size.y * size.z + size.z * size.x);
    let open = extent.vector_area;
    let sideways = open.with_y(0.0);
    if sideways.length() > OPEN_SHARE * surface && sideways.length() > open.y.abs() {
        sideways
    } else {
        THREE_QUARTER
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn framed(min: DVec3, max: DVec3, vector_area: DVec3) -> (DVec3, DQuat) {
        view(&Extent { min, max, vector_area })
    }

    #[test]
    fn all_corners_are_in_the_picture_at_any_scale() {
        for scale in [1.0, 1e-6, 1e6] {
            let (min, max) = (DVec3::new(-1.0, 0.0, 2.0) * scale, DVec3::new(3.0, 0.5, 9.0) * scale);
            let (eye, turn) = framed(min, max, DVec3::ZERO);
            let mut widest: f64 = 0.0;
            for corner in 0..8 {
                let pick = |bit: i32, axis: usize| if corner & bit == 0 { min[axis] } else { max[axis] };
                let seen = turn.inverse() * (DVec3::new(pick(1, 0), pick(2, 1), pick(4, 2)) - eye);
                assert!(seen.z < 0.0, "in front");
                widest = widest.max(seen.x.abs().max(seen.y.abs()) / -seen.z);
            }
            assert!(widest < TAN_HALF_YFOV && widest > 0.8 * TAN_HALF_YFOV, "{widest}");
        }
    }

    #[test]
    fn an_open_box_is_looked_into() {
        let (eye, _) = framed(DVec3::NEG_ONE, DVec3::ONE, DVec3::new(-4.0, 0.5, 0.0));
        assert!(eye.x < -3.0 && eye.y == 0.0 && eye.z.abs() < 1e-12, "{eye}");
        let (eye, _) = framed(DVec3::NEG_ONE, DVec3::ONE, DVec3::new(0.0, 4.0, 0.0));
        assert!(eye.x > 0.0 && eye.y > 0.0 && eye.z > 0.0, "a floor is seen from above: {eye}");
    }

    #[test]
    fn a_point_is_seen_from_somewhere() {
        let (eye, turn) = framed(DVec3::ONE, DVec3::ONE, DVec3::ZERO);
        assert!((eye.distance(DVec3::ONE) - 1.0).abs() < 1e-12 && turn.is_normalized());
    }
}
