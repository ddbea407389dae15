//! Cameras with their lenses and shutters.

use crate::error::{Fault, Place};
use crate::fields::Fields;
use farm_scene::{Camera, Lens, Projection, Shutter};
use gltf::json::Root;
use gltf::json::camera::Type;
use gltf::json::validation::Checked;
use std::collections::BTreeSet;
use std::f32::consts::PI;

/// Half the height of the sensor of a 35 mm camera, metres: that of a lens whose focal length is not given.
const HALF_SENSOR_HEIGHT: f64 = 0.012;

/// The camera of the file's node `index`, which is imported as `node`.
pub(crate) fn read(
    root: &Root,
    index: usize,
    node: u32,
    taken: &mut BTreeSet<String>,
) -> Result<Option<Camera>, Fault> {
    let Some(camera) = root.nodes[index].camera else { return Ok(None) };
    let node_name = root.nodes[index].name.as_deref();
    let node_place = Place::new("node", index, node_name);
    let camera_index = camera.value();
    let camera = &root.cameras[camera_index];
    let place = node_place.then("camera", camera_index, camera.name.as_deref());
    let projection = read_projection(camera, &place)?;
    let extensions = camera.extensions.as_ref().map(|it| &it.others);
    let extension = Fields::of_extension("EXT_camera_physical", extensions, &place)?;
    let extras = Fields::of_extras(&camera.extras);
    let lens = LensFields { extension, extras: &extras, place: &place }.read(projection)?;
    let shutter = read_shutter(&extras, &place)?;
    let given = [node_name, camera.name.as_deref()].into_iter().flatten().find(|name| !name.is_empty());
    let name = unique(given.map_or_else(|| format!("camera {camera_index}"), str::to_owned), taken);
    Ok(Some(Camera { name, node, projection, lens, shutter }))
}

/// `name`, or `name 2`, `name 3` when others have it already.
pub(crate) fn unique(name: String, taken: &mut BTreeSet<String>) -> String {
    if taken.insert(name.clone()) {
        return name;
    }
    let numbered = (2..).map(|number: u64| format!("{name} {number}")).find(|name| !taken.contains(name));
    let numbered = numbered.expect("there are more numbers than names");
    taken.insert(numbered.clone());
    numbered
}

fn read_projection(camera: &gltf::json::Camera, place: &Place) -> Result<Projection, Fault> {
    match (&camera.type_, &camera.perspective, &camera.orthographic) {
        (Checked::Valid(Type::Perspective), Some(perspective), _) => {
            let yfov = perspective.yfov;
            place.field("perspective.yfov").ensure(yfov > 0.0 && yfov < PI, || {
                format!("is {yfov}, but must be an angle between 0 and pi")
            })?;
            Ok(Projection::Perspective { yfov })
        }
        (Checked::Valid(Type::Orthographic), _, Some(orthographic)) => {
            let ymag = orthographic.ymag;
            place.field("orthographic.ymag").ensure(ymag > 0.0 && ymag.is_finite(), || {
                format!("is {ymag}, but must be a number greater than 0")
            })?;
            Ok(Projection::Orthographic { ymag })
        }
        _ => {
            Err(place.fault("must be of type perspective or orthographic, and have a property of that name"))
        }
    }
}

struct LensFields<'a> {
    extension: Option<Fields>,
    extras: &'a Fields,
    place: &'a Place<'a>,
}

impl LensFields<'_> {
    /// A value of the extension, or else of the extras.
    fn positive(&self, key: &str) -> Result<Option<f32>, Fault> {
        let extension = self.extension.as_ref().map(|fields| fields.positive(key, self.place)).transpose()?;
        match extension.flatten() {
            Some(value) => Ok(Some(value)),
            None => self.extras.positive(key, self.place),
        }
    }

    fn read(&self, projection: Projection) -> Result<Option<Lens>, Fault> {
        let (focus_distance, f_stop) = (self.positive("focusDistance")?, self.positive("fStop")?);
        let focal_length = self.positive("focalLength")?;
        let aperture_radius = match (self.extras.not_negative("apertureRadius", self.place)?, f_stop) {
            (Some(radius), _) => radius,
            (None, None) => 0.0,
            (None, Some(f_stop)) => {
                let focal_length = focal_length.map_or_else(|| self.focal_length_of(projection), Ok)?;
                focal_length / (2.0 * f_stop)
            }
        };
        let blades = self.extras.count("apertureBlades", self.place)?.unwrap_or(0);
        let blades_place = self.place.field("extras.apertureBlades");
        blades_place.ensure(!matches!(blades, 1 | 2), || {
            "must be 0 for a round aperture, or at least 3".to_owned()
        })?;
        let rotation = self.extras.number("apertureRotation", self.place)?.unwrap_or(0.0);
        let anamorphic_ratio = self.extras.positive("anamorphicRatio", self.place)?.unwrap_or(1.0);
        Ok((aperture_radius > 0.0).then_some(Lens {
            aperture_radius,
            focus_distance: focus_distance.unwrap_or(f32::INFINITY),
            blades,
            rotation,
            anamorphic_ratio,
        }))
    }

    fn focal_length_of(&self, projection: Projection) -> Result<f32, Fault> {
        match projection {
            Projection::Perspective { yfov } => {
                Ok((HALF_SENSOR_HEIGHT / libm::tan(f64::from(yfov) / 2.0)) as f32)
            }
            Projection::Orthographic { .. } => Err(self
                .place
                .fault("has an fStop but no focalLength, which an orthographic camera needs with it")),
        }
    }
}

fn read_shutter(extras: &Fields, place: &Place) -> Result<Shutter, Fault> {
    let open = f64::from(extras.number("shutterOpen", place)?.unwrap_or(0.0));
    let close = extras.number("shutterClose", place)?.map_or(open.max(0.0), f64::from);
    place
        .field("extras.shutterClose")
        .ensure(open <= close, || format!("is {close}, which is before shutterOpen at {open}"))?;
    Ok(Shutter { open, close })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The camera of a node, with more properties of it.
    fn camera(more: &str) -> Result<Camera, String> {
        let json = format!(
            r#"{{"asset": {{"version": "2.0"}}, "nodes": [{{"name": "eye", "camera": 0}}],
            "cameras": [{{"type": "perspective", "perspective": {{"yfov": 1.0, "znear": 0.1}} {more}}}]}}"#
        );
        let root = Root::from_str(&json).expect(more);
        let read = read(&root, 0, 4, &mut BTreeSet::new());
        read.map(|camera| camera.expect("it is there"))
            .map_err(|fault| format!("{}: {}", fault.place.unwrap_or_default(), fault.what))
    }

    #[test]
    fn a_camera_without_lens_is_sharp_and_takes_stills() {
        let plain = camera("").expect("valid");
        assert_eq!(
            (plain.name.as_str(), plain.node, plain.lens, plain.shutter),
            ("eye", 4, None, Shutter::default())
        );
        assert_eq!(plain.projection, Projection::Perspective { yfov: 1.0 });
    }

    #[test]
    fn lens_comes_from_the_extension_then_from_extras() {
        let extension = r#""extensions": {"EXT_camera_physical":
            {"focalLength": 0.05, "sensorSize": [0.036, 0.024], "fStop": 2, "focusDistance": 3}}"#;
        let lens = camera(&format!(", {extension}")).expect("valid").lens.expect("a lens");
        assert_eq!((lens.aperture_radius, lens.focus_distance, lens.blades), (0.0125, 3.0, 0));
        let extras = r#""extras": {"apertureRadius": 0.02, "fStop": 8, "apertureBlades": 6, "apertureRotation": 0.5,
            "anamorphicRatio": 2, "shutterOpen": -0.01, "shutterClose": 0.01}"#;
        let both = camera(&format!(", {extension}, {extras}")).expect("valid");
        let expected = Lens {
            aperture_radius: 0.02,
            focus_distance: 3.0,
            blades: 6,
            rotation: 0.5,
            anamorphic_ratio: 2.0,
        };
        assert_eq!(both.lens, Some(expected));
        assert!((both.shutter.open + 0.01).abs() < 1e-9 && (both.shutter.close - 0.01).abs() < 1e-9);
        // Without a focal length: that of a sensor of 24 mm height behind this field of view.
        let stop =
            camera(r#", "extras": {"fStop": 1, "focusDistance": 2}"#).expect("valid").lens.expect("a lens");
        assert!((stop.aperture_radius - 0.012 / 0.5_f32.tan() / 2.0).abs() < 1e-7);
        assert_eq!(camera(r#", "extras": {"focusDistance": 2}"#).expect("valid").lens, None);
    }

    #[test]
    fn wrong_kinds_and_ranges_name_the_camera() {
        for (extras, expected) in [
            (
                r#"{"fStop": "2"}"#,
                "node 0 \"eye\" / camera 0 / extras.fStop: must be a number greater than 0",
            ),
            (r#"{"focusDistance": 0}"#, "extras.focusDistance"),
            (r#"{"apertureRadius": -1}"#, "extras.apertureRadius"),
            (r#"{"apertureRadius": 1e300}"#, "extras.apertureRadius"),
            (r#"{"apertureBlades": 2}"#, "extras.apertureBlades"),
            (r#"{"apertureBlades": 4.5}"#, "extras.apertureBlades"),
            (r#"{"anamorphicRatio": 0}"#, "extras.anamorphicRatio"),
            (r#"{"shutterOpen": 1, "shutterClose": 0.5}"#, "extras.shutterClose"),
        ] {
            let what = camera(&format!(r#", "extras": {extras}"#)).expect_err(extras);
            assert!(what.contains(expected), "{extras}: {what}");
        }
    }

    #[test]
    fn names_are_made_unique() {
        let mut taken = BTreeSet::new();
        let names: Vec<String> =
            ["a", "a", "a 2", "a"].map(|name| unique(name.to_owned(), &mut taken)).to_vec();
        assert_eq!(names, ["a", "a 2", "a 2 2", "a 3"]);
    }
}
