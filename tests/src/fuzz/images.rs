//! Pictures: results of units, references, textures, environments.

use farm_film::{Counters, FilmTile, FrameIndex, Resolution, SampleBlock, Tile};
use farm_image::{PartialHeader, PartialLimits, encode_partial, read_image};
use farm_import::{ImportOptions, import, load_environment};
use image::{DynamicImage, ImageFormat};
use std::io::Cursor;
use std::path::Path;

pub(super) fn partials() -> Vec<Vec<u8>> {
    let partial = |x0: u32, width: u32, height: u32| {
        let tile = Tile::new(x0, 4, x0 + width, 4 + height).expect("a rectangle");
        let sums = (0..tile.area()).map(|pixel| [pixel as f32, 0.5, 2.0]).collect();
        let header = PartialHeader {
            resolution: Resolution::new(64, 48).expect("a resolution"),
            frame: FrameIndex(3),
            scene: [1; 32],
            settings: [2; 32],
            seed: 9,
            renderer: "tessera".to_owned(),
            counters: Counters { samples: 16, ..Counters::default() },
        };
        encode_partial(&FilmTile::new(tile, SampleBlock::new(0..16).expect("a block"), sums), &header)
    };
    vec![partial(8, 4, 4), partial(0, 16, 16), partial(63, 1, 1)]
}

pub(super) fn decode_partial(bytes: &[u8], _: &Path) -> bool {
    farm_image::decode_partial(bytes, PartialLimits::default()).is_ok()
}

/// Small pictures of every kind that is read.
pub(super) fn pictures() -> Vec<Vec<u8>> {
    [textures(), environments(), exrs()].concat()
}

fn exrs() -> Vec<Vec<u8>> {
    let image = image::Rgb32FImage::from_fn(9, 7, |x, y| image::Rgb([x as f32, y as f32, 0.25]));
    let mut pictures = partials();
    let mut bytes = Cursor::new(vec![]);
    let encoded = DynamicImage::ImageRgb32F(image).write_to(&mut bytes, ImageFormat::OpenExr);
    // Only where that format is part of the library.
    pictures.extend(encoded.is_ok().then(|| bytes.into_inner()));
    pictures
}

pub(super) fn decode_picture(bytes: &[u8], file: &Path) -> bool {
    std::fs::write(file, bytes).expect("a temporary file");
    read_image(file).is_ok()
}

pub(super) fn textures() -> Vec<Vec<u8>> {
    let image = DynamicImage::ImageRgba8(image::RgbaImage::from_fn(19, 13, |x, y| {
        image::Rgba([(x * 13) as u8, (y * 19) as u8, (x * y) as u8, 200])
    }));
    let encoded = |image: &DynamicImage, format: ImageFormat| {
        let mut bytes = Cursor::new(vec![]);
        image.write_to(&mut bytes, format).expect("a picture");
        bytes.into_inner()
    };
    vec![
        encoded(&image, ImageFormat::Png),
        encoded(&image.to_luma16().into(), ImageFormat::Png),
        encoded(&image.to_rgb8().into(), ImageFormat::Jpeg),
        encoded(&image.to_luma8().into(), ImageFormat::Jpeg),
    ]
}

/// A triangle that shows the picture.
pub(super) fn decode_texture(bytes: &[u8], file: &Path) -> bool {
    let positions = [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let positions: Vec<u8> = positions.iter().flat_map(|value| value.to_le_bytes()).collect();
    let encode = |bytes: &[u8]| base64::Engine::encode(&base64::engine::general_purpose::STANDARD, bytes);
    let document = serde_json::json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}], "images": [{"uri": format!("data:image/png;base64,{}", encode(bytes))}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3},
            {"bufferView": 0, "componentType": 5126, "type": "VEC2", "count": 3}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": format!("data:;base64,{}", encode(&positions))}]
    });
    std::fs::write(file, document.to_string()).expect("a temporary file");
    import(file, &ImportOptions::default()).is_ok()
}

pub(super) fn environments() -> Vec<Vec<u8>> {
    let pixels: Vec<image::Rgb<f32>> =
        (0..64 * 8).map(|pixel| image::Rgb([pixel as f32, 1.0, 0.5])).collect();
    let mut packed = vec![];
    image::codecs::hdr::HdrEncoder::new(&mut packed).encode(&pixels, 64, 8).expect("a picture");
    let mut plain = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 3\n".to_vec();
    plain.extend([128, 64, 0, 129].repeat(6));
    vec![packed, plain]
}

pub(super) fn decode_environment(bytes: &[u8], file: &Path) -> bool {
    std::fs::write(file, bytes).expect("a temporary file");
    load_environment(file).is_ok()
}
