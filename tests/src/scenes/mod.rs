//! The project's own scenes, made by code: deterministic, small, and each with one difficulty.

pub mod gltf;
mod open;
mod rooms;
pub mod shapes;

use gltf::Gltf;
pub use gltf::Scale;

/// A scene that can be made at any scale.
#[derive(Clone, Copy)]
pub struct Named {
    /// What it is called, and its file before the ending.
    pub name: &'static str,
    /// What it is hard for.
    pub about: &'static str,
    make: fn(Scale) -> Gltf,
}

/// Every scene. The first is the picture of the README; the others make the benchmark set.
pub const SCENES: [Named; 9] = [
    Named { name: "cornell", about: "all four effects at once", make: rooms::cornell },
    Named {
        name: "cornell-diffuse",
        about: "interreflection between diffuse walls",
        make: rooms::cornell_diffuse,
    },
    Named { name: "glossy-metals", about: "GGX metals of roughness 0.05 to 0.5", make: rooms::glossy_metals },
    Named {
        name: "lens-motion",
        about: "thin lens, translation and rotation in the shutter",
        make: open::lens_motion,
    },
    Named {
        name: "million-triangles",
        about: "1,002,528 triangles in one mesh",
        make: open::million_triangles,
    },
    Named { name: "many-lights", about: "500 small emitters", make: open::many_lights },
    Named { name: "slit", about: "an interior lit through a slit of 6 cm", make: rooms::slit },
    Named {
        name: "glass-caustic",
        about: "light that passes only through smooth glass",
        make: rooms::glass_caustic,
    },
    Named {
        name: "sun-sky",
        about: "an environment with a small sun",
        make: |scale| open::sun_sky(scale, SKY),
    },
];

/// The environment of `sun-sky`, in a file beside it.
const SKY: &str = "sky.hdr";

impl Named {
    /// The scene called `name`.
    pub fn find(name: &str) -> Option<Self> {
        SCENES.into_iter().find(|scene| scene.name == name)
    }

    /// The scene as GLB, all lengths times `2^k`.
    pub fn glb(self, scale: Scale) -> Vec<u8> {
        (self.make)(scale).into_glb()
    }

    /// The scene as a glTF text that needs no other file but [`Self::companion`].
    pub fn text(self, scale: Scale) -> String {
        (self.make)(scale).into_text()
    }

    /// A file that must lie beside the scene.
    pub fn companion(self) -> Option<(&'static str, Vec<u8>)> {
        (self.name == "sun-sky").then(|| (SKY, open::sky()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    fn parts(glb: &[u8]) -> (Value, &[u8]) {
        let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
        (serde_json::from_slice(&glb[20..20 + length]).unwrap(), &glb[28 + length..])
    }

    #[test]
    fn the_scene_of_the_readme_is_the_one_that_is_checked_in() {
        let made = Named::find("cornell").unwrap().text(Scale(0));
        assert!(made.len() < 60_000, "{} bytes", made.len());
        let read = |text: &str| serde_json::from_str::<Value>(text).unwrap();
        let checked_in = include_str!("../../scenes/cornell.gltf");
        assert!(read(&made) == read(checked_in), "remake it: scenes --out tests/scenes --text cornell");
    }

    #[test]
    fn the_million_triangles_are_there() {
        let (document, _) = parts(&Named::find("million-triangles").unwrap().glb(Scale(0)));
        let indices = document["meshes"][0]["primitives"][0]["indices"].as_u64().unwrap() as usize;
        assert_eq!(document["accessors"][indices]["count"], 3 * 1_002_528);
    }

    #[test]
    fn a_scaled_scene_differs_in_powers_of_two_only() {
        for scene in SCENES.iter().filter(|scene| scene.name != "million-triangles") {
            for k in [20, -20] {
                let (base, scaled) = (scene.glb(Scale(0)), scene.glb(Scale(k)));
                let ((base, base_bin), (scaled, scaled_bin)) = (parts(&base), parts(&scaled));
                assert_scaled(&base, &scaled, k, scene.name);
                let floats = |bin: &[u8]| -> Vec<[u8; 4]> {
                    bin.chunks_exact(4).map(|word| word.try_into().unwrap()).collect()
                };
                for (a, b) in floats(base_bin).into_iter().zip(floats(scaled_bin)) {
                    let same_up_to_scale = f32::from_le_bytes(a) * 2.0f32.powi(k) == f32::from_le_bytes(b);
                    assert!(a == b || same_up_to_scale, "{}: {a:?} and {b:?}", scene.name);
                }
            }
        }
    }

    /// Every number is the same, or the same times `2^k`, to the last bit; bounds are those of f32 vertices, and read as such.
    fn assert_scaled(base: &Value, scaled: &Value, k: i32, place: &str) {
        match (base, scaled) {
            (Value::Object(a), Value::Object(b)) => {
                assert!(a.keys().eq(b.keys()), "{place}");
                for (key, value) in a {
                    assert_scaled(value, &b[key], k, &format!("{place}.{key}"));
                }
            }
            (Value::Array(a), Value::Array(b)) => {
                assert_eq!(a.len(), b.len(), "{place}");
                for (index, value) in a.iter().enumerate() {
                    assert_scaled(value, &b[index], k, &format!("{place}[{index}]"));
                }
            }
            (Value::Number(a), Value::Number(b)) => {
                let [a, b] = [a, b].map(|value| value.as_f64().unwrap());
                let is_length =
                    ["translation", "scale", "Distance", "apertureRadius", "motionVector", "znear"]
                        .iter()
                        .any(|name| place.contains(name));
                let is_bound = (place.contains(".min[") || place.contains(".max[")) && a != b;
                let factor =
                    if is_length || is_bound || place.contains("thickness") { 2.0f64.powi(k) } else { 1.0 };
                let same = if is_bound { (a * factor) as f32 == b as f32 } else { a * factor == b };
                assert!(same, "{place}: {a} and {b}");
            }
            (a, b) => assert_eq!(a, b, "{place}"),
        }
    }
}
