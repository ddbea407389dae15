//! Lights at nodes: KHR_lights_punctual, with a radius where `extras` gives one, and the draft EXT_lights_area.

use crate::error::{Fault, Place};
use crate::fields::Fields;
use crate::references::light_of;
use crate::report::Warnings;
use farm_scene::{Light, LightKind};
use glam::Vec3;
use gltf::json::Root;
use gltf::json::extensions::scene::khr_lights_punctual as punctual;
use gltf::json::validation::Checked;
use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};

const AREA: &str = "EXT_lights_area";

/// The lights of the file's node `index`, which is imported as `node`.
pub(crate) fn read(root: &Root, index: usize, node: u32, warnings: &Warnings) -> Result<Vec<Light>, Fault> {
    let file_node = &root.nodes[index];
    let node_place = Place::new("node", index, file_node.name.as_deref());
    let mut lights = vec![];
    if let Some(light) = light_of(file_node) {
        let all: &[punctual::Light] = root.as_ref();
        let place = node_place.then("light", light, all[light].name.as_deref());
        let name = name_of(all[light].name.as_deref(), file_node);
        lights.push(Light { name, node, kind: read_punctual(&all[light], &place, warnings)? });
    }
    let extensions = file_node.extensions.as_ref().map(|it| &it.others);
    if let Some(reference) = Fields::of_extension(AREA, extensions, &node_place)? {
        let place = node_place.field(AREA);
        let all = root.extensions.as_ref().map(|it| &it.others);
        let all = Fields::of_extension(AREA, all, &Place::only("extensions"))?;
        let all = all.map(|all| all.objects("lights", &Place::only(AREA))).transpose()?.unwrap_or_default();
        let number = reference.count("light", &place)?.ok_or_else(|| place.fault("names no light"))? as usize;
        let len = all.len();
        let light = all.get(number);
        let light = light
            .ok_or_else(|| place.fault(format!("refers to light {number}, but there are only {len}")))?;
        let place = node_place.then(AREA, number, None);
        let name = name_of(light.text("name", &place)?.as_deref(), file_node);
        lights.push(Light { name, node, kind: read_area(light, &place)? });
    }
    Ok(lights)
}

fn name_of(light: Option<&str>, node: &gltf::json::Node) -> String {
    light.or(node.name.as_deref()).unwrap_or_default().to_owned()
}

/// Colour times strength, both checked.
fn strength(color: [f32; 3], intensity: f32, place: &Place) -> Result<Vec3, Fault> {
    let product = Vec3::from_array(color) * intensity;
    let fits = intensity >= 0.0 && color.iter().all(|&channel| channel >= 0.0) && product.is_finite();
    place.ensure(fits, || "has a color or intensity that is negative or too large".to_owned())?;
    Ok(product)
}

fn read_punctual(light: &punctual::Light, place: &Place, warnings: &Warnings) -> Result<LightKind, Fault> {
    let intensity = strength(light.color, light.intensity, place)?;
    if light.range.is_some() {
        warnings.add(place, "has a range, which light does not keep to; ignored");
    }
    let radius =
        Fields::of_extras(&light.extras).not_negative("radius", place)?.filter(|&radius| radius > 0.0);
    if radius.is_some() && !matches!(light.type_, Checked::Valid(punctual::Type::Point)) {
        warnings.add(place, "has a radius, which only a point light can have; ignored");
    }
    match (light.type_, radius) {
        (Checked::Valid(punctual::Type::Point), None) => Ok(LightKind::Point { intensity }),
        // A sphere of that radiance has that intensity: its disk as seen from afar is pi r^2.
        (Checked::Valid(punctual::Type::Point), Some(radius)) => {
            let radiance = intensity / (PI * radius * radius);
            place.field("extras.radius").ensure(radiance.is_finite(), || "is too small".to_owned())?;
            Ok(LightKind::Sphere { radiance, radius })
        }
        (Checked::Valid(punctual::Type::Directional), _) => {
            Ok(LightKind::Directional { irradiance: intensity })
        }
        (Checked::Valid(punctual::Type::Spot), _) => {
            let spot = light.spot.as_ref();
            let (inner_cone, outer_cone) =
                spot.map_or((0.0, FRAC_PI_4), |spot| (spot.inner_cone_angle, spot.outer_cone_angle));
            // Exporters write pi/2 in various precisions.
            let fits = inner_cone >= 0.0
                && inner_cone <= outer_cone
                && outer_cone > 0.0
                && outer_cone < FRAC_PI_2 * 1.001;
            place.field("spot").ensure(fits, || {
                format!("has cone angles {inner_cone} and {outer_cone}; 0 <= inner < outer <= pi/2 is wanted")
            })?;
            let outer_cone = outer_cone.min(FRAC_PI_2);
            Ok(LightKind::Spot { intensity, inner_cone: inner_cone.min(outer_cone), outer_cone })
        }
        (Checked::Invalid, _) => Err(place.fault("has a type other than point, spot or directional")),
    }
}

/// `size` is a rectangle's height or a disk's diameter; `intensity` is in nits.
fn read_area(light: &Fields, place: &Place) -> Result<LightKind, Fault> {
    let color = light.numbers("color", place)?.unwrap_or([1.0; 3]);
    let radiance = strength(color, light.not_negative("intensity", place)?.unwrap_or(1.0), place)?;
    let size = light.positive("size", place)?.unwrap_or(1.0);
    match light.text("type", place)?.as_deref() {
        Some("rect") => {
            let rect = light.object("rect", place)?;
            let aspect =
                rect.map(|rect| rect.positive("aspect", place)).transpose()?.flatten().unwrap_or(1.0);
            Ok(LightKind::Rectangle { radiance, width: size * aspect, height: size })
        }
        Some("disk") => Ok(LightKind::Disk { radiance, radius: size / 2.0 }),
        _ => Err(place.fault("has a type other than rect or disk")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn light(extensions: &str, node: &str) -> Result<LightKind, String> {
        let json = format!(
            r#"{{"asset": {{"version": "2.0"}}, "extensions": {{{extensions}}}, "nodes": [{{"extensions": {{{node}}}}}]}}"#
        );
        let root = Root::from_str(&json).expect(extensions);
        let lights = read(&root, 0, 0, &Warnings::default());
        lights
            .map(|lights| lights[0].kind)
            .map_err(|fault| format!("{}: {}", fault.place.unwrap_or_default(), fault.what))
    }

    fn punctual(light_json: &str) -> Result<LightKind, String> {
        light(
            &format!(r#""KHR_lights_punctual": {{"lights": [{light_json}]}}"#),
            r#""KHR_lights_punctual": {"light": 0}"#,
        )
    }

    fn area(light_json: &str) -> Result<LightKind, String> {
        light(
            &format!(r#""EXT_lights_area": {{"lights": [{light_json}]}}"#),
            r#""EXT_lights_area": {"light": 0}"#,
        )
    }

    #[test]
    fn a_radius_turns_a_point_into_a_sphere_of_the_same_intensity() {
        let point = punctual(r#"{"type": "point", "color": [1, 0.5, 0], "intensity": 4}"#);
        assert_eq!(point, Ok(LightKind::Point { intensity: Vec3::new(4.0, 2.0, 0.0) }));
        let sphere = punctual(r#"{"type": "point", "intensity": 4, "extras": {"radius": 2}}"#);
        assert_eq!(sphere, Ok(LightKind::Sphere { radiance: Vec3::splat(1.0 / PI), radius: 2.0 }));
        let negative = punctual(r#"{"type": "point", "extras": {"radius": -2}}"#).expect_err("negative");
        assert!(negative.starts_with("node 0 / light 0 / extras.radius"), "{negative}");
    }

    #[test]
    fn spots_and_suns_keep_their_units() {
        let sun = punctual(r#"{"type": "directional", "intensity": 3}"#);
        assert_eq!(sun, Ok(LightKind::Directional { irradiance: Vec3::splat(3.0) }));
        let spot = punctual(r#"{"type": "spot", "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.2}}"#);
        assert_eq!(spot, Ok(LightKind::Spot { intensity: Vec3::ONE, inner_cone: 0.1, outer_cone: 0.2 }));
        assert!(
            punctual(r#"{"type": "spot", "spot": {"innerConeAngle": 0.3, "outerConeAngle": 0.2}}"#).is_err()
        );
        assert!(punctual(r#"{"type": "beam"}"#).expect_err("unknown").contains("type other than"));
        assert!(punctual(r#"{"type": "point", "intensity": -1}"#).is_err());
    }

    #[test]
    fn area_lights_are_rectangles_and_disks_in_nits() {
        let rect = area(r#"{"type": "rect", "intensity": 10, "size": 2, "rect": {"aspect": 1.5}}"#);
        assert_eq!(rect, Ok(LightKind::Rectangle { radiance: Vec3::splat(10.0), width: 3.0, height: 2.0 }));
        let disk = area(r#"{"type": "disk", "size": 3}"#);
        assert_eq!(disk, Ok(LightKind::Disk { radiance: Vec3::ONE, radius: 1.5 }));
        assert!(
            area(r#"{"type": "disk", "size": 0}"#).expect_err("no size").contains("EXT_lights_area 0 / size")
        );
        assert!(area(r#"{"type": "tube"}"#).is_err());
    }
}
