//! Previews: tone-mapped 8-bit PNGs to look at.

use crate::{ImageError, write_file};
use farm_film::{Resolution, Rgb};
use image::ImageEncoder;
use std::path::Path;

/// The luminance that the average of a picture is brought to: photographers' middle grey.
const MIDDLE_GREY: f64 = 0.18;

/// Where the curve of [`tone_mapped`] leaves the straight line.
const SHOULDER: f64 = 0.6;

/// How bright a preview is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Exposure {
    /// The log-average luminance becomes middle grey (Reinhard et al. 2002, "Photographic tone reproduction", equations 1
    /// and 2), taken over the pixels brighter than a thousandth of the mean, so that a dark background does not count.
    #[default]
    Auto,
    /// Radiance times `2^stops`; 0 shows it as it is.
    Stops(f64),
}

/// The preview as PNG bytes: radiance times exposure, then per channel the curve `x` up to 0.6 and
/// `0.6 + 0.4 (1 - exp(-(x - 0.6) / 0.4))` above (smooth, and below 1 for any radiance), then sRGB. Values that are not a
/// number are shown black.
pub fn preview_png(resolution: Resolution, pixels: &[Rgb], exposure: Exposure) -> Vec<u8> {
    let scale = match exposure {
        Exposure::Auto => automatic_scale(pixels),
        Exposure::Stops(stops) => stops.exp2(),
    };
    let bytes =
        pixels.iter().flatten().map(|&value| tone_mapped(f64::from(value) * scale)).collect::<Vec<_>>();
    rgb_png(resolution, &bytes)
}

/// Writes [`preview_png`] to a file, whole or not at all.
pub fn write_preview(
    path: &Path,
    resolution: Resolution,
    pixels: &[Rgb],
    exposure: Exposure,
) -> Result<(), ImageError> {
    write_file(path, &preview_png(resolution, pixels, exposure))
}

/// A PNG of sRGB bytes, three per pixel.
pub fn rgb_png(resolution: Resolution, bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    image::codecs::png::PngEncoder::new(&mut out)
        .write_image(bytes, resolution.width(), resolution.height(), image::ExtendedColorType::Rgb8)
        .expect("three bytes per pixel can be written to memory");
    out
}

fn automatic_scale(pixels: &[Rgb]) -> f64 {
    let luminances = || pixels.iter().map(|&pixel| luminance(pixel)).filter(|value| value.is_finite());
    let mean = luminances().sum::<f64>() / pixels.len() as f64;
    let (mut sum, mut count) = (0.0, 0u64);
    for value in luminances().filter(|&value| value > mean / 1000.0) {
        sum += value.ln();
        count += 1;
    }
    if count == 0 { 1.0 } else { MIDDLE_GREY / (sum / count as f64).exp() }
}

/// Rec. 709.
fn luminance(pixel: Rgb) -> f64 {
    0.2126 * f64::from(pixel[0]) + 0.7152 * f64::from(pixel[1]) + 0.0722 * f64::from(pixel[2])
}

fn tone_mapped(value: f64) -> u8 {
    let room = 1.0 - SHOULDER;
    let curved =
        if value > SHOULDER { SHOULDER + room * (1.0 - (-(value - SHOULDER) / room).exp()) } else { value };
    // A NaN becomes 0 by the cast.
    (linear_to_srgb(curved.max(0.0)) * 255.0).round() as u8
}

/// A linear value clamped to [0, 1] as an sRGB byte.
#[cfg(feature = "flip")]
pub(crate) fn srgb_byte(value: f32) -> u8 {
    (linear_to_srgb(f64::from(value).clamp(0.0, 1.0)) * 255.0).round() as u8
}

/// IEC 61966-2-1.
fn linear_to_srgb(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(pixels: &[Rgb], exposure: Exposure) -> Vec<u8> {
        let resolution = Resolution::new(pixels.len() as u32, 1).unwrap();
        let png = preview_png(resolution, pixels, exposure);
        image::load_from_memory(&png).unwrap().into_rgb8().into_raw()
    }

    #[test]
    fn exposure_of_zero_stops_shows_radiance_as_it_is() {
        assert_eq!(shown(&[[0.0, 0.18, 0.5]], Exposure::Stops(0.0)), [0, 118, 188]);
        assert_eq!(shown(&[[0.0, 0.09, 0.25]], Exposure::Stops(1.0)), [0, 118, 188]);
    }

    #[test]
    fn highlights_roll_off_and_faults_are_black() {
        let ramp: Vec<_> = (0..200).map(|step| [step as f32 * 0.02; 3]).collect();
        let bytes = shown(&ramp, Exposure::Stops(0.0));
        assert!(bytes.windows(2).all(|pair| pair[0] <= pair[1]));
        assert!(bytes.windows(6).all(|window| window[3] - window[0] < 40), "no jumps");
        assert_eq!(shown(&[[f32::INFINITY, f32::NAN, -1.0]], Exposure::Stops(0.0)), [255, 0, 0]);
    }

    #[test]
    fn automatic_exposure_does_not_depend_on_the_light_or_the_background() {
        let scene = [[0.2, 0.3, 0.4], [0.05, 0.1, 0.3], [0.5, 0.2, 0.1], [0.0; 3], [0.0; 3]];
        let brighter = scene.map(|pixel| pixel.map(|value| value * 4096.0));
        assert_eq!(shown(&scene, Exposure::Auto), shown(&brighter, Exposure::Auto));
        assert_eq!(shown(&scene, Exposure::Auto)[..9], shown(&scene[..3], Exposure::Auto));
        assert_eq!(shown(&[[7.0; 3]; 2], Exposure::Auto), [118; 6]);
        assert_eq!(shown(&[[0.0; 3]; 2], Exposure::Auto), [0; 6]);
    }
}
