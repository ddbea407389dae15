//! Finished frames as EXR files.

use crate::error::ImageError;
use crate::{attribute, write_file_with};
use exr::image::write::WritableImage;
use exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Layer};
use exr::meta::attribute::{Compression, IntegerBounds, LineOrder};
use exr::meta::header::LayerAttributes;
use exr::prelude::{Blocks, SmallVec, Text, f16};
use farm_film::{Counters, ErrorEstimate, FrameIndex, Resolution, Rgb};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Largest finite value of a 16-bit float.
const HALF_MAX: f32 = 65_504.0;

/// What a finished frame says about itself, as a JSON attribute of its file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameMetadata {
    /// The scene's name, for people.
    pub scene_name: String,
    /// Digest of the scene.
    #[serde(with = "crate::digest::hex")]
    pub scene: [u8; 32],
    /// Digest of the settings.
    #[serde(with = "crate::digest::hex")]
    pub settings: [u8; 32],
    /// Which picture of the sequence.
    pub frame: FrameIndex,
    /// Samples per pixel.
    pub spp: u64,
    /// Seed of the job's samples.
    pub seed: u64,
    /// Fingerprint of the renderer.
    pub renderer: String,
    /// What was traced, over all units.
    pub counters: Counters,
    /// Estimated error; none when there were too few samples to tell.
    pub error: Option<ErrorEstimate>,
    /// Wall time from the first unit to the last, in seconds.
    pub seconds: f64,
    /// Anything else worth knowing; its names must differ from those above.
    #[serde(flatten)]
    pub extra: serde_json::Map<String, serde_json::Value>,
}

/// How the frame's own channels are stored. Passes are always 32 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SampleFormat {
    /// 32-bit floats.
    #[default]
    Float,
    /// 16-bit floats, at most 65504.
    Half,
}

/// An image layer beside the picture itself.
#[derive(Clone, Copy, Debug)]
pub enum Pass<'a> {
    /// Channels `name.R`, `name.G`, `name.B`.
    Rgb(&'a str, &'a [Rgb]),
    /// One channel called `name`.
    Scalar(&'a str, &'a [f32]),
}

/// A resolved frame.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Width and height.
    pub resolution: Resolution,
    /// Mean radiance in scanline order.
    pub pixels: &'a [Rgb],
    /// Further layers, each with one value per pixel.
    pub passes: &'a [Pass<'a>],
}

/// Writes `frame` as a ZIP-compressed EXR. Values beyond the format's range (and infinite ones) are stored as its largest, so
/// the file never holds an infinity; returns how many of the picture's values that were. The file appears whole or not at all.
pub fn write_frame(
    path: &Path,
    frame: &Frame,
    metadata: &FrameMetadata,
    format: SampleFormat,
) -> Result<u64, ImageError> {
    let (image, clamped) = image_of(frame, metadata, format);
    write_file_with(path, |out| image.write().to_buffered(out).map_err(|err| err.to_string()))?;
    Ok(clamped)
}

/// The bytes that [`write_frame`] would write, and how many of the picture's values were beyond the format's range.
pub fn encode_frame(frame: &Frame, metadata: &FrameMetadata, format: SampleFormat) -> (Vec<u8>, u64) {
    let (image, clamped) = image_of(frame, metadata, format);
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write().to_buffered(&mut bytes).expect("a valid picture can be written to memory");
    (bytes.into_inner(), clamped)
}

type FrameImage = exr::image::Image<Layer<AnyChannels<FlatSamples>>>;

fn image_of(frame: &Frame, metadata: &FrameMetadata, format: SampleFormat) -> (FrameImage, u64) {
    let (layer, clamped) = layer_of(frame, metadata, format);
    let window = IntegerBounds::from_dimensions(layer.size);
    (exr::image::Image::new(exr::meta::header::ImageAttributes::new(window), layer), clamped)
}

fn layer_of(
    frame: &Frame,
    metadata: &FrameMetadata,
    format: SampleFormat,
) -> (Layer<AnyChannels<FlatSamples>>, u64) {
    let area = frame.resolution.area();
    assert_eq!(frame.pixels.len(), area, "one value per pixel of the frame");
    let mut channels = SmallVec::new();
    let mut clamped = 0;
    for (name, channel) in ["R", "G", "B"].iter().zip(0..) {
        let (samples, beyond) = samples(frame.pixels.iter().map(|pixel| pixel[channel]), format);
        clamped += beyond;
        channels.push(AnyChannel::new(*name, samples));
    }
    for pass in frame.passes {
        match *pass {
            Pass::Scalar(name, values) => {
                assert_eq!(values.len(), area, "one value per pixel in pass {name}");
                channels.push(AnyChannel::new(name, FlatSamples::F32(values.to_vec())));
            }
            Pass::Rgb(name, values) => {
                assert_eq!(values.len(), area, "one value per pixel in pass {name}");
                for (suffix, channel) in ["R", "G", "B"].iter().zip(0..) {
                    let values = values.iter().map(|value| value[channel]).collect();
                    let name = Text::new_or_panic(format!("{name}.{suffix}"));
                    channels.push(AnyChannel::new(name, FlatSamples::F32(values)));
                }
            }
        }
    }
    let mut attributes = LayerAttributes::default();
    attribute::insert(&mut attributes, metadata);
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let size = (frame.resolution.width() as usize, frame.resolution.height() as usize);
    (Layer::new(size, attributes, encoding, AnyChannels::sort(channels)), clamped)
}

/// Values as the format can hold them, and how many were out of its range.
fn samples(values: impl Iterator<Item = f32>, format: SampleFormat) -> (FlatSamples, u64) {
    let largest = match format {
        SampleFormat::Float => f32::MAX,
        SampleFormat::Half => HALF_MAX,
    };
    let mut beyond = 0;
    let within = values.map(|value| {
        beyond += u64::from(value.abs() > largest);
        // NaN stays what it is: it must be seen.
        if value > largest {
            largest
        } else if value < -largest {
            -largest
        } else {
            value
        }
    });
    let samples = match format {
        SampleFormat::Float => FlatSamples::F32(within.collect()),
        SampleFormat::Half => FlatSamples::F16(within.map(f16::from_f32).collect()),
    };
    (samples, beyond)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::read_image;

    pub(crate) fn metadata() -> FrameMetadata {
        FrameMetadata {
            scene_name: "Küche \"1\"".to_owned(),
            scene: [1; 32],
            settings: [0xfe; 32],
            frame: FrameIndex(24),
            spp: 64,
            seed: u64::MAX,
            renderer: "tessera 0.1.0".to_owned(),
            counters: Counters { samples: 77, ..Counters::default() },
            error: Some(ErrorEstimate {
                spp: 64,
                rmse: 0.125,
                rel_mse: 1.0e-3,
                rmse_band: 1.05,
                rel_mse_band: 1.1,
                rate: 1.5,
                rel_rate: 1.4,
                rel_parts: [7.0e-4, 3.0e-4, 0.0],
            }),
            seconds: 1.5,
            extra: serde_json::Map::from_iter([("camera".to_owned(), "front".into())]),
        }
    }

    fn pixels(resolution: Resolution) -> Vec<Rgb> {
        (0..resolution.area()).map(|index| [index as f32 * 0.31, -0.0, 1.0e-40 * index as f32]).collect()
    }

    #[test]
    fn a_frame_comes_back_bit_for_bit_with_its_metadata() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frame.exr");
        let resolution = Resolution::new(37, 41).unwrap();
        let pixels = pixels(resolution);
        let variance = vec![[0.5, 0.25, 1.0]; resolution.area()];
        let depth = vec![3.0; resolution.area()];
        let passes = [Pass::Rgb("variance", &variance), Pass::Scalar("Z", &depth)];
        let frame = Frame { resolution, pixels: &pixels, passes: &passes };
        assert_eq!(write_frame(&path, &frame, &metadata(), SampleFormat::Float).unwrap(), 0);
        let encoded = encode_frame(&frame, &metadata(), SampleFormat::Float);
        assert_eq!(encoded, (std::fs::read(&path).unwrap(), 0));
        let image = read_image(&path).unwrap();
        assert_eq!(image.resolution, resolution);
        let bits = |pixels: &[Rgb]| pixels.iter().flatten().map(|value| value.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&image.pixels), bits(&pixels));
        assert_eq!(image.metadata, Some(metadata()));
    }

    #[test]
    fn a_fire_keeps_its_value_in_float_and_is_clamped_and_counted_in_half() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fire.exr");
        let resolution = Resolution::new(3, 1).unwrap();
        let write = |pixels: &[Rgb], format| {
            let frame = Frame { resolution, pixels, passes: &[] };
            let clamped = write_frame(&path, &frame, &metadata(), format).unwrap();
            (clamped, read_image(&path).unwrap().pixels)
        };
        let fire = [[1.0e6, 65_504.0, 65_519.0], [-1.0e6, 0.5, f32::INFINITY], [0.0; 3]];
        let (clamped, read) = write(&fire, SampleFormat::Float);
        assert_eq!((clamped, read[0][0], read[1][2]), (1, 1.0e6, f32::MAX));
        let (clamped, read) = write(&fire, SampleFormat::Half);
        assert_eq!(clamped, 4);
        assert_eq!(read, [[65_504.0; 3], [-65_504.0, 0.5, 65_504.0], [0.0; 3]]);
    }

    #[test]
    fn a_frame_that_cannot_be_written_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let resolution = Resolution::new(2, 2).unwrap();
        let frame = Frame { resolution, pixels: &[[0.0; 3]; 4], passes: &[] };
        let path = folder.path().join("missing").join("frame.exr");
        let err = write_frame(&path, &frame, &metadata(), SampleFormat::Float).unwrap_err();
        assert!(err.to_string().contains("does not exist"), "{err}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
