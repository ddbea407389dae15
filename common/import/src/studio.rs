//! Light for scenes that have none of their own.

use farm_scene::{Environment, Image, LightKind, Pixels, Scene, Surface};
use glam::{Quat, Vec3};

/// Size of the image: fine enough that its pixels are not seen as bands.
const WIDTH: u32 = 256;
const HEIGHT: u32 = 128;

/// Radiance straight above and straight below: dark enough that what the lamps light stands out from it.
const ABOVE: f32 = 0.5;
const BELOW: f32 = 0.1;

/// Brightest radiance of the key light, and where it stands: above, to the right and in front.
const KEY: f32 = 7.0;
const KEY_DIRECTION: Vec3 = Vec3::new(0.5, 0.7, 0.6);

/// The same of the fill light, for surfaces that the key light does not reach: to the left and in front.
const FILL: f32 = 3.0;
const FILL_DIRECTION: Vec3 = Vec3::new(-0.6, 0.1, 0.8);

/// A grey sky, brighter above, with soft key and fill lights: what is put around scenes that would be black without.
pub fn studio_environment() -> Environment {
    let lamps = [(KEY, KEY_DIRECTION.normalize()), (FILL, FILL_DIRECTION.normalize())];
    let radiance = |row: u32, column: u32| {
        let direction = direction((column as f32 + 0.5) / WIDTH as f32, (row as f32 + 0.5) / HEIGHT as f32);
        let sky = BELOW + (ABOVE - BELOW) * (0.5 + 0.5 * direction.y);
        let lit = lamps.map(|(strength, towards)| {
            let cos = direction.dot(towards).max(0.0);
            let soft = cos * cos;
            strength * (soft * soft) * (soft * soft)
        });
        sky + lit.iter().sum::<f32>()
    };
    let pixels =
        (0..HEIGHT).flat_map(|row| (0..WIDTH).map(move |column| [radiance(row, column); 3])).collect();
    let image =
        Image { name: "studio".to_owned(), width: WIDTH, height: HEIGHT, pixels: Pixels::Float(pixels) };
    Environment { image, intensity: 1.0, rotation: Quat::IDENTITY, visible_to_camera: true }
}

/// Direction of a point of a latitude-longitude image.
fn direction(u: f32, v: f32) -> Vec3 {
    let (sin_longitude, cos_longitude) = libm::sincosf((u - 0.5) * std::f32::consts::TAU);
    let (sin_latitude, cos_latitude) = libm::sincosf((0.5 - v) * std::f32::consts::PI);
    Vec3::new(cos_longitude * cos_latitude, sin_latitude, sin_longitude * cos_latitude)
}

/// Whether anything in the scene gives light.
pub fn is_lit(scene: &Scene) -> bool {
    let shines = |material: u32| {
        let material = &scene.materials[material as usize];
        let emits = material.emission.is_some_and(|emission| emission.radiance.factor != Vec3::ZERO);
        emits || matches!(material.surface, Surface::Unlit)
    };
    let light = |kind: LightKind| match kind {
        LightKind::Point { intensity } | LightKind::Spot { intensity, .. } => intensity != Vec3::ZERO,
        LightKind::Directional { irradiance } => irradiance != Vec3::ZERO,
        LightKind::Sphere { radiance, .. }
        | LightKind::Rectangle { radiance, .. }
        | LightKind::Disk { radiance, .. } => radiance != Vec3::ZERO,
    };
    scene.environment.is_some()
        || scene.lights.iter().any(|each| light(each.kind))
        || scene.nodes.iter().flat_map(|node| &node.instances).any(|instance| shines(instance.material))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_studio_is_brightest_at_its_key_light_and_never_black() {
        let Pixels::Float(pixels) = studio_environment().image.pixels else { panic!("float pixels") };
        let brightest =
            pixels.iter().map(|pixel| pixel[0]).enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        let (row, column) = (brightest.0 as u32 / WIDTH, brightest.0 as u32 % WIDTH);
        let found = direction((column as f32 + 0.5) / WIDTH as f32, (row as f32 + 0.5) / HEIGHT as f32);
        assert!(found.dot(KEY_DIRECTION.normalize()) > 0.98, "{found}");
        assert!(pixels.iter().all(|pixel| pixel[0] >= BELOW));
    }

    #[test]
    fn an_empty_scene_is_dark_and_an_environment_lights_it() {
        let mut scene = Scene::default();
        assert!(!is_lit(&scene));
        scene.environment = Some(studio_environment());
        assert!(is_lit(&scene));
    }
}
