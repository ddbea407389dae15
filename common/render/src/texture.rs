//! Looking up images.

use crate::math;
use farm_scene::{Image, MagFilter, Pixels, Texture, TextureRef, Wrap};
use glam::{Vec2, Vec4};

/// Decoding of 8- and 16-bit sRGB (IEC 61966-2-1), built for the bit depths a scene uses.
#[derive(Default)]
pub(crate) struct SrgbTables {
    eight: Vec<f32>,
    sixteen: Vec<f32>,
}

impl SrgbTables {
    pub fn for_textures(textures: &[Texture], images: &[Image]) -> Self {
        let uses = |wide: bool| {
            textures.iter().filter(|texture| texture.srgb).any(|texture| {
                match images[texture.image as usize].pixels {
                    Pixels::Unorm8 { .. } => !wide,
                    Pixels::Unorm16 { .. } => wide,
                    Pixels::Float(_) => false,
                }
            })
        };
        let table = |used: bool, max: u32| {
            if used {
                (0..=max).map(|code| decode_srgb(code as f32 / max as f32)).collect()
            } else {
                Vec::new()
            }
        };
        Self { eight: table(uses(false), 255), sixteen: table(uses(true), 65_535) }
    }
}

fn decode_srgb(value: f32) -> f32 {
    if value <= 0.04045 { value / 12.92 } else { math::powf((value + 0.055) / 1.055, 2.4) }
}

/// Images and textures of a scene, ready for lookups.
pub(crate) struct Textures<'a> {
    pub textures: &'a [Texture],
    pub images: &'a [Image],
    pub tables: &'a SrgbTables,
}

impl Textures<'_> {
    /// RGBA at a texture coordinate of the mesh (v runs downwards); missing channels are 1, grey is spread.
    pub fn lookup(&self, reference: &TextureRef, uv: Vec2) -> Vec4 {
        let texture = &self.textures[reference.texture as usize];
        let image = &self.images[texture.image as usize];
        let uv = reference.matrix * uv + reference.offset;
        let (width, height) = (image.width as i32, image.height as i32);
        // A coordinate that is not finite or beyond counting looks up the corner.
        let scaled = |value: f32, size: i32| {
            let value = value - (value * 0.5).floor() * 2.0;
            if value.is_finite() { value * size as f32 } else { 0.0 }
        };
        let clamped = |value: f32, wrap: Wrap, size: i32| match wrap {
            Wrap::ClampToEdge => {
                if value.is_finite() {
                    value.clamp(-1.0, 2.0) * size as f32
                } else {
                    0.0
                }
            }
            Wrap::Repeat | Wrap::MirroredRepeat => scaled(value, size),
        };
        let x = clamped(uv.x, texture.wrap_u, width);
        let y = clamped(uv.y, texture.wrap_v, height);
        let texel = |x: i32, y: i32| {
            self.texel(image, texture.srgb, wrap(x, width, texture.wrap_u), wrap(y, height, texture.wrap_v))
        };
        match texture.filter {
            MagFilter::Nearest => texel(x.floor() as i32, y.floor() as i32),
            MagFilter::Linear => {
                let (x, y) = (x - 0.5, y - 0.5);
                let (x0, y0) = (x.floor(), y.floor());
                let (fx, fy) = (x - x0, y - y0);
                let (x0, y0) = (x0 as i32, y0 as i32);
                let top = texel(x0, y0) * (1.0 - fx) + texel(x0 + 1, y0) * fx;
                let bottom = texel(x0, y0 + 1) * (1.0 - fx) + texel(x0 + 1, y0 + 1) * fx;
                top * (1.0 - fy) + bottom * fy
            }
        }
    }

    fn texel(&self, image: &Image, srgb: bool, x: usize, y: usize) -> Vec4 {
        let pixel = y * image.width as usize + x;
        match &image.pixels {
            Pixels::Unorm8 { channels, data } => {
                let decode = |code: u8, color: bool| {
                    if color && srgb { self.tables.eight[usize::from(code)] } else { f32::from(code) / 255.0 }
                };
                spread(usize::from(*channels), data, pixel, decode)
            }
            Pixels::Unorm16 { channels, data } => {
                let decode = |code: u16, color: bool| {
                    if color && srgb {
                        self.tables.sixteen[usize::from(code)]
                    } else {
                        f32::from(code) / 65_535.0
                    }
                };
                spread(usize::from(*channels), data, pixel, decode)
            }
            Pixels::Float(data) => {
                let [r, g, b] = data[pixel];
                Vec4::new(r, g, b, 1.0)
            }
        }
    }
}

fn spread<T: Copy>(channels: usize, data: &[T], pixel: usize, decode: impl Fn(T, bool) -> f32) -> Vec4 {
    let values = &data[pixel * channels..(pixel + 1) * channels];
    match *values {
        [grey] => Vec3Grey(decode(grey, true)).with_alpha(1.0),
        [grey, alpha] => Vec3Grey(decode(grey, true)).with_alpha(decode(alpha, false)),
        [r, g, b] => Vec4::new(decode(r, true), decode(g, true), decode(b, true), 1.0),
        [r, g, b, a] => Vec4::new(decode(r, true), decode(g, true), decode(b, true), decode(a, false)),
        _ => unreachable!("an image has one to four channels"),
    }
}

struct Vec3Grey(f32);

impl Vec3Grey {
    fn with_alpha(self, alpha: f32) -> Vec4 {
        Vec4::new(self.0, self.0, self.0, alpha)
    }
}

fn wrap(index: i32, size: i32, wrap: Wrap) -> usize {
    let index = match wrap {
        Wrap::Repeat => index.rem_euclid(size),
        Wrap::ClampToEdge => index.clamp(0, size - 1),
        Wrap::MirroredRepeat => {
            let folded = index.rem_euclid(2 * size);
            if folded < size { folded } else { 2 * size - 1 - folded }
        }
    };
    index as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Mat2;

    fn look_up(image: Image, texture: Texture, uv: (f32, f32)) -> Vec4 {
        let (textures, images) = ([texture], [image]);
        let tables = SrgbTables::for_textures(&textures, &images);
        let reference = TextureRef { texture: 0, uv_set: 0, matrix: Mat2::IDENTITY, offset: Vec2::ZERO };
        Textures { textures: &textures, images: &images, tables: &tables }
            .lookup(&reference, Vec2::new(uv.0, uv.1))
    }

    fn row(values: &[u8]) -> Image {
        let pixels = Pixels::Unorm8 { channels: 1, data: values.to_vec() };
        Image { name: String::new(), width: values.len() as u32, height: 1, pixels }
    }

    fn texture(wrap: Wrap, filter: MagFilter, srgb: bool) -> Texture {
        Texture { image: 0, wrap_u: wrap, wrap_v: wrap, filter, srgb }
    }

    #[test]
    fn wrap_modes_continue_the_image_as_gltf_says() {
        let at = |wrap, u| {
            (look_up(row(&[0, 51, 102, 255]), texture(wrap, MagFilter::Nearest, false), (u, 0.5)).x * 255.0)
                .round()
        };
        for (wrap, expected) in [
            (Wrap::Repeat, [255.0, 0.0, 255.0, 0.0, 51.0]),
            (Wrap::MirroredRepeat, [0.0, 0.0, 255.0, 255.0, 102.0]),
            (Wrap::ClampToEdge, [0.0, 0.0, 255.0, 255.0, 255.0]),
        ] {
            let found = [-0.1, 0.1, 0.9, 1.1, 1.3].map(|u| at(wrap, u));
            assert_eq!(found, expected, "{wrap:?}");
        }
    }

    #[test]
    fn bilinear_lookup_meets_pixel_centres_and_their_middle() {
        let linear = texture(Wrap::ClampToEdge, MagFilter::Linear, false);
        assert_eq!(look_up(row(&[0, 255]), linear, (0.25, 0.5)).x, 0.0);
        assert_eq!(look_up(row(&[0, 255]), linear, (0.5, 0.5)).x, 0.5);
        assert_eq!(look_up(row(&[0, 255]), linear, (0.75, 0.5)).x, 1.0);
    }

    #[test]
    fn srgb_is_decoded_before_filtering_and_never_for_alpha() {
        let pixels = Pixels::Unorm8 { channels: 2, data: vec![188, 128] };
        let image = Image { name: String::new(), width: 1, height: 1, pixels };
        let found = look_up(image, texture(Wrap::Repeat, MagFilter::Linear, true), (0.5, 0.5));
        assert!((found.x - 0.5028865).abs() < 1e-5, "{found}");
        assert_eq!(found.w, 128.0 / 255.0);
    }

    #[test]
    fn hostile_coordinates_find_some_pixel() {
        for u in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30, 16_777_217.0] {
            for wrap in [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge] {
                let found = look_up(row(&[0, 255]), texture(wrap, MagFilter::Linear, false), (u, u));
                assert!((0.0..=1.0).contains(&found.x), "{u} {wrap:?}: {found}");
            }
        }
    }
}
