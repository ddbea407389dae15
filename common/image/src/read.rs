//! Pictures from anywhere: EXR of any ordinary kind, Radiance HDR, PNG, JPEG.

use crate::error::{ImageError, guarded};
use crate::{FrameMetadata, attribute};
use exr::image::{AnyChannels, FlatSamples, Layer};
use exr::meta::MetaData;
use exr::meta::attribute::IntegerBounds;
use exr::prelude::{ReadChannels, ReadLayers, Vec2};
use farm_film::{Resolution, Rgb};
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

/// Most pixels a picture may have: 3.2 GB of them. A small damaged file can announce any size.
const PIXELS_MAX: u64 = 1 << 28;

/// Samples, of all channels together, that any file may have: a small picture of one colour is compressed to next to nothing.
const SAMPLES_FREE: u64 = 1 << 24;

/// Samples beyond that, per byte of the file: one colour of half floats, as well as it is ever compressed.
const SAMPLES_PER_BYTE: u64 = 2048;

/// A picture from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Of the display window.
    pub resolution: Resolution,
    /// Linear values in scanline order; black where the file has none.
    pub pixels: Vec<Rgb>,
    /// What the file says about itself, when this farm wrote it.
    pub metadata: Option<FrameMetadata>,
}

/// Reads a picture: EXR (channels R, G, B or Y, also within one named layer; half, float or integer; any compression) or an
/// image whose values are sRGB-encoded (PNG, JPEG) or linear (Radiance HDR). Alpha is left aside.
pub fn read_image(path: &Path) -> Result<Image, ImageError> {
    let located = |fault: String| ImageError::Read { path: path.to_owned(), fault };
    if path.is_dir() {
        return Err(located("it is a directory".to_owned()));
    }
    let mut file = BufReader::new(File::open(path).map_err(|err| located(err.to_string()))?);
    let mut magic = [0; 4];
    let is_exr = file.read_exact(&mut magic).is_ok() && magic == *b"\x76\x2f\x31\x01";
    file.rewind().map_err(|err| located(err.to_string()))?;
    if is_exr {
        let bytes = file.get_ref().metadata().map_or(0, |found| found.len());
        guarded(|| read_exr(file, bytes)).map_err(|err| located(err.to_string()))
    } else {
        read_other(file).map_err(located)
    }
}

fn read_other(file: BufReader<File>) -> Result<Image, String> {
    let reader = image::ImageReader::new(file).with_guessed_format().map_err(|err| err.to_string())?;
    if reader.format().is_none() {
        return Err("it is neither EXR, Radiance HDR, PNG nor JPEG".to_owned());
    }
    let decoded = reader.decode().map_err(|err| err.to_string())?;
    let resolution = Resolution::new(decoded.width(), decoded.height()).map_err(|err| err.to_string())?;
    let is_linear = matches!(decoded.color(), image::ColorType::Rgb32F | image::ColorType::Rgba32F);
    let pixels = if is_linear {
        decoded.into_rgb32f().pixels().map(|pixel| pixel.0).collect()
    } else {
        let linear = |value: u16| srgb_to_linear(f64::from(value) / 65_535.0) as f32;
        decoded.into_rgb16().pixels().map(|pixel| pixel.0.map(linear)).collect()
    };
    Ok(Image { resolution, pixels, metadata: None })
}

/// IEC 61966-2-1.
fn srgb_to_linear(encoded: f64) -> f64 {
    if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

fn read_exr<R: Read + Seek + Send>(mut file: BufReader<R>, bytes: u64) -> Result<Image, ImageError> {
    let meta = MetaData::read_from_buffered(&mut file, false)?;
    for header in &meta.headers {
        let Vec2(width, height) = header.layer_size;
        let pixels = (width as u64).saturating_mul(height as u64);
        if pixels > PIXELS_MAX {
            return Err(ImageError::TooLarge { pixels, allowed: PIXELS_MAX });
        }
        let samples = pixels.saturating_mul(header.channels.list.len() as u64);
        if samples > SAMPLES_FREE.saturating_add(bytes.saturating_mul(SAMPLES_PER_BYTE)) {
            return Err(ImageError::Exr(format!("it claims {samples} samples, far more than it can hold")));
        }
        if (header.chunk_count as u64).saturating_mul(8) > bytes {
            return Err(ImageError::Exr("it is shorter than its own table of contents".to_owned()));
        }
        if header.channels.list.iter().any(|channel| channel.sampling != Vec2(1, 1)) {
            return Err(ImageError::Exr("it has subsampled channels, which are not supported".to_owned()));
        }
    }
    file.rewind().map_err(|err| ImageError::Exr(err.to_string()))?;
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_buffered(file)?;
    assembled(&image.layer_data, image.attributes.display_window)
}

fn assembled(layer: &Layer<AnyChannels<FlatSamples>>, display: IntegerBounds) -> Result<Image, ImageError> {
    let side = |value: usize| u32::try_from(value).unwrap_or(u32::MAX);
    let resolution = Resolution::new(side(display.size.0), side(display.size.1))
        .map_err(|err| ImageError::Exr(err.to_string()))?;
    if resolution.area() as u64 > PIXELS_MAX {
        return Err(ImageError::TooLarge { pixels: resolution.area() as u64, allowed: PIXELS_MAX });
    }
    let channels = rgb_channels(&layer.channel_data)?;
    let mut pixels = vec![[0.0; 3]; resolution.area()];
    // Where the first data pixel lies in the display window.
    let origin = layer.attributes.layer_position;
    let x0 = i64::from(origin.0) - i64::from(display.position.0);
    let y0 = i64::from(origin.1) - i64::from(display.position.1);
    let (width, height) = (i64::from(resolution.width()), i64::from(resolution.height()));
    for y in y0.max(0)..(y0 + layer.size.1 as i64).min(height) {
        for x in x0.max(0)..(x0 + layer.size.0 as i64).min(width) {
            let from = (y - y0) as usize * layer.size.0 + (x - x0) as usize;
            pixels[(y * width + x) as usize] =
                channels.map(|channel| channel.value_by_flat_index(from).to_f32());
        }
    }
    let metadata = attribute::find(&layer.attributes).and_then(Result::ok);
    Ok(Image { resolution, pixels, metadata })
}

/// The three channels that show the picture: R, G, B, or Y thrice; plain, or of the first named layer that has them.
fn rgb_channels(channels: &AnyChannels<FlatSamples>) -> Result<[&FlatSamples; 3], ImageError> {
    let find = |prefix: &str, name: &str| {
        let wanted = format!("{prefix}{name}");
        channels.list.iter().find(|channel| channel.name.eq_case_insensitive(wanted.as_str()))
    };
    let mut prefixes = vec![String::new()];
    for channel in &channels.list {
        if let Some((layer, _)) = channel.name.to_string().rsplit_once('.') {
            prefixes.push(format!("{layer}."));
        }
    }
    for prefix in &prefixes {
        if let (Some(r), Some(g), Some(b)) = (find(prefix, "R"), find(prefix, "G"), find(prefix, "B")) {
            return Ok([&r.sample_data, &g.sample_data, &b.sample_data]);
        }
    }
    for prefix in &prefixes {
        if let (Some(y), None) = (find(prefix, "Y"), find(prefix, "RY")) {
            return Ok([&y.sample_data; 3]);
        }
    }
    let names: Vec<_> = channels.list.iter().map(|channel| channel.name.to_string()).collect();
    Err(ImageError::Exr(format!("it has neither channels R, G, B nor Y, but {}", names.join(", "))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::image::write::WritableImage;
    use exr::image::{AnyChannel, Encoding};
    use exr::meta::attribute::{Compression, LineOrder};
    use exr::meta::header::{ImageAttributes, LayerAttributes};
    use exr::prelude::{Blocks, f16};
    use std::path::PathBuf;

    const SIZE: (usize, usize) = (5, 3);

    struct Foreign {
        channels: Vec<(&'static str, FlatSamples)>,
        compression: Compression,
        data_at: (i32, i32),
        display: IntegerBounds,
    }

    fn values(scale: f32) -> Vec<f32> {
        (0..SIZE.0 * SIZE.1).map(|index| index as f32 * scale).collect()
    }

    fn rgb() -> Foreign {
        let channel = |name, scale| (name, FlatSamples::F32(values(scale)));
        Foreign {
            channels: vec![channel("R", 1.0), channel("G", 2.0), channel("B", 0.5)],
            compression: Compression::Uncompressed,
            data_at: (0, 0),
            display: IntegerBounds::from_dimensions(SIZE),
        }
    }

    impl Foreign {
        fn read(self) -> Result<Image, ImageError> {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("foreign.exr");
            let channels =
                self.channels.into_iter().map(|(name, data)| AnyChannel::new(name, data)).collect();
            let attributes = LayerAttributes {
                layer_position: Vec2(self.data_at.0, self.data_at.1),
                ..LayerAttributes::default()
            };
            let blocks = Blocks::Tiles(Vec2(2, 2));
            let encoding =
                Encoding { compression: self.compression, blocks, line_order: LineOrder::Increasing };
            let layer = Layer::new(SIZE, attributes, encoding, AnyChannels::sort(channels));
            let image = exr::image::Image::new(ImageAttributes::new(self.display), layer);
            image.write().to_file(&path).unwrap();
            read_image(&path)
        }
    }

    fn expected() -> Vec<Rgb> {
        values(1.0).into_iter().map(|value| [value, value * 2.0, value * 0.5]).collect()
    }

    #[test]
    fn every_lossless_compression_is_read() {
        for compression in [
            Compression::Uncompressed,
            Compression::RLE,
            Compression::ZIP1,
            Compression::ZIP16,
            Compression::PIZ,
        ] {
            let image = Foreign { compression, ..rgb() }.read().unwrap();
            assert_eq!(image.pixels, expected(), "{compression}");
            assert_eq!((image.resolution.width(), image.resolution.height()), (5, 3));
            assert_eq!(image.metadata, None);
        }
    }

    #[test]
    fn other_channels_and_types_are_read() {
        let half = |scale| FlatSamples::F16(values(scale).into_iter().map(f16::from_f32).collect());
        let with_alpha = vec![("A", half(9.0)), ("R", half(1.0)), ("G", half(2.0)), ("B", half(0.5))];
        assert_eq!(Foreign { channels: with_alpha, ..rgb() }.read().unwrap().pixels, expected());
        let layered =
            vec![("main.R", half(1.0)), ("main.G", half(2.0)), ("main.B", half(0.5)), ("Z", half(1.0))];
        assert_eq!(Foreign { channels: layered, ..rgb() }.read().unwrap().pixels, expected());
        let grey = vec![("Y", FlatSamples::U32((0..15).collect()))];
        let thrice: Vec<_> = values(1.0).into_iter().map(|value| [value; 3]).collect();
        assert_eq!(Foreign { channels: grey, ..rgb() }.read().unwrap().pixels, thrice);
        let depth = vec![("Z", half(1.0))];
        let err = Foreign { channels: depth, ..rgb() }.read().unwrap_err().to_string();
        assert!(err.contains("neither channels") && err.ends_with("but Z"), "{err}");
    }

    #[test]
    fn pixels_outside_the_data_window_are_black_and_those_outside_the_display_window_are_left_out() {
        // Data [-2, 3) x [1, 4) in a display window [-1, 5) x [0, 3).
        let display = IntegerBounds::new((-1, 0), (6, 3));
        let image = Foreign { data_at: (-2, 1), display, ..rgb() }.read().unwrap();
        assert_eq!((image.resolution.width(), image.resolution.height()), (6, 3));
        for (index, pixel) in image.pixels.iter().enumerate() {
            let (x, y) = (index as i32 % 6 - 1, index as i32 / 6);
            let inside = (-2..3).contains(&x) && (1..4).contains(&y);
            let value = if inside { ((y - 1) * 5 + x + 2) as f32 } else { 0.0 };
            assert_eq!(*pixel, [value, value * 2.0, value * 0.5], "at ({x}, {y})");
        }
    }

    #[test]
    fn png_is_decoded_from_srgb() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("grey.png");
        image::RgbImage::from_raw(2, 1, vec![0, 188, 255, 10, 1, 128]).unwrap().save(&path).unwrap();
        let [first, second] = read_image(&path).unwrap().pixels.try_into().unwrap();
        assert_eq!((first[0], first[2]), (0.0, 1.0));
        assert!((first[1] - 0.502_886).abs() < 1e-5, "{first:?}");
        assert!((second[0] - 10.0 / 255.0 / 12.92).abs() < 1e-7, "{second:?}");
        assert!((second[2] - 0.215_861).abs() < 1e-5, "{second:?}");
    }

    #[test]
    fn radiance_hdr_is_linear() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sky.hdr");
        let pixels = [image::Rgb([0.5f32, 1000.0, 0.0]), image::Rgb([2.0, 2.0, 0.25])];
        let file = File::create(&path).unwrap();
        image::codecs::hdr::HdrEncoder::new(file).encode(&pixels, 1, 2).unwrap();
        let read = read_image(&path).unwrap();
        assert_eq!((read.resolution.width(), read.resolution.height()), (1, 2));
        assert_eq!((read.pixels[0][1], read.pixels[1]), (1000.0, [2.0, 2.0, 0.25]));
    }

    #[test]
    fn what_is_no_picture_gets_a_sentence_that_names_it() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, bytes: &[u8]| -> PathBuf {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            path
        };
        let refusal = |path: &Path| {
            let sentence = read_image(path).unwrap_err().to_string();
            let name = path.file_name().unwrap().to_str().unwrap();
            assert!(sentence.contains(name), "{sentence:?} names {name}");
            sentence
        };
        assert!(refusal(&file("empty.exr", b"")).contains("neither EXR"));
        assert!(refusal(&file("text.exr", b"some text that is no picture")).contains("neither EXR"));
        assert!(refusal(&file("cut.exr", b"\x76\x2f\x31\x01\x02\0\0\0chan")).contains("EXR"));
        assert!(refusal(folder.path()).contains("directory"));
        refusal(&folder.path().join("missing.exr"));
    }
}
