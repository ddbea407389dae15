//! Light from infinitely far: latitude-longitude images of linear radiance.

use crate::error::{Fault, ImportError, Place};
use crate::fields::Fields;
use crate::source::{Source, read_file};
use farm_scene::{Environment, Image, Pixels};
use glam::Quat;
use image::codecs::hdr::HdrDecoder;
use image::{DynamicImage, ImageDecoder};
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Pixels of the largest environment: 16384 x 8192.
const PIXELS_MAX: u64 = 1 << 27;

/// Bytes of the largest environment file.
const FILE_BYTES_MAX: u64 = 4 << 30;

/// What had to be done to an environment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EnvironmentReport {
    /// Pixels with a value that was negative, infinite or no number; such values became 0.
    pub pixels_repaired: u64,
}

/// An OpenEXR environment that a scene names. It is decoded by whoever knows OpenEXR, and then becomes the scene's environment
/// through [`environment_from_pixels`].
#[derive(Clone, Debug, PartialEq)]
pub struct ExrEnvironment {
    /// The file, inside the scene's folder.
    pub path: PathBuf,
    /// Multiplies the image.
    pub intensity: f32,
    /// Environment space to world space.
    pub rotation: Quat,
    /// Whether camera rays see it or black.
    pub visible_to_camera: bool,
}

/// Decodes the Radiance file (`.hdr`) at `path`.
///
/// # Errors
/// When the file cannot be read, is no Radiance picture, or is absurdly large.
pub fn load_environment(path: &Path) -> Result<(Image, EnvironmentReport), ImportError> {
    let load = || {
        let bytes = read_file(path, FILE_BYTES_MAX).map_err(Fault::whole)?;
        decode(&bytes, &path.display().to_string()).map_err(Fault::whole)
    };
    load().map_err(|fault| fault.in_file(path))
}

/// An environment image from decoded pixels, rows from the top; values that are no radiance become 0.
///
/// # Errors
/// When there are not `width * height` pixels, or none, or absurdly many.
pub fn environment_from_pixels(
    name: &str,
    width: u32,
    height: u32,
    mut pixels: Vec<[f32; 3]>,
) -> Result<(Image, EnvironmentReport), ImportError> {
    let count = u64::from(width) * u64::from(height);
    if count == 0 || count > PIXELS_MAX || count != pixels.len() as u64 {
        let what = format!("environment of {width} x {height} pixels is empty, too large, or not all there");
        return Err(Fault::whole(what).in_file(Path::new(name)));
    }
    let mut report = EnvironmentReport::default();
    for pixel in &mut pixels {
        let radiance = pixel.map(|value| if value >= 0.0 && value.is_finite() { value } else { 0.0 });
        // A NaN differs from its replacement as well.
        if *pixel != radiance {
            *pixel = radiance;
            report.pixels_repaired += 1;
        }
    }
    Ok((Image { name: name.to_owned(), width, height, pixels: Pixels::Float(pixels) }, report))
}

fn decode(bytes: &[u8], name: &str) -> Result<(Image, EnvironmentReport), String> {
    if bytes.starts_with(b"\x76\x2f\x31\x01") {
        return Err("is an OpenEXR file; only Radiance files (.hdr) are read here".to_owned());
    }
    let broken = |err: image::ImageError| format!("is no Radiance picture (.hdr): {err}");
    let decoder = HdrDecoder::new(Cursor::new(bytes)).map_err(broken)?;
    let (width, height) = decoder.dimensions();
    // Run lengths stand for at most 127 pixels of one channel per two bytes.
    let count = u64::from(width) * u64::from(height);
    if count == 0 || count > PIXELS_MAX || count / 64 > bytes.len() as u64 {
        return Err(format!(
            "claims {width} x {height} pixels, which is more than it holds or than can be read"
        ));
    }
    let pixels = DynamicImage::from_decoder(decoder).map_err(broken)?.into_rgb32f();
    let pixels = pixels.pixels().map(|pixel| pixel.0).collect();
    environment_from_pixels(name, width, height, pixels).map_err(|err| err.fault)
}

/// The environment that a scene's `extras.environment` names.
pub(crate) enum Named {
    /// Decoded.
    Loaded(Environment, EnvironmentReport),
    /// To be decoded by others.
    Exr(ExrEnvironment),
}

/// Reads `extras.environment {uri, intensity, rotation, visibleToCamera}`; the rotation is about +Y, in radians.
pub(crate) fn read(extras: &Fields, place: &Place, source: &Source) -> Result<Option<Named>, Fault> {
    let Some(fields) = extras.object("environment", place)? else { return Ok(None) };
    let place = place.field("extras.environment");
    let uri = fields.text("uri", &place)?.ok_or_else(|| place.fault("has no uri"))?;
    let intensity = fields.not_negative("intensity", &place)?.unwrap_or(1.0);
    let half_angle = f64::from(fields.number("rotation", &place)?.unwrap_or(0.0)) / 2.0;
    let rotation = Quat::from_xyzw(0.0, libm::sin(half_angle) as f32, 0.0, libm::cos(half_angle) as f32);
    let visible_to_camera = fields.boolean("visibleToCamera", &place)?.unwrap_or(true);
    if uri.to_ascii_lowercase().ends_with(".exr") {
        let path = source.path_of(&uri, &place)?;
        return Ok(Some(Named::Exr(ExrEnvironment { path, intensity, rotation, visible_to_camera })));
    }
    let bytes = source.fetch(&uri, FILE_BYTES_MAX, &place)?;
    let name = if uri.starts_with("data:") { "environment" } else { &uri };
    let (image, report) =
        decode(&bytes, name).map_err(|what| place.fault(format!("file {name:?} {what}")))?;
    Ok(Some(Named::Loaded(Environment { image, intensity, rotation, visible_to_camera }, report)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_are_no_radiance_become_black_and_are_counted() {
        let pixels = vec![[1.0, 2.0, 3.0], [f32::NAN, 1.0, 1.0], [-1.0, f32::INFINITY, 5.0], [0.0; 3]];
        let (image, report) = environment_from_pixels("sky", 2, 2, pixels).expect("four pixels");
        let expected = vec![[1.0, 2.0, 3.0], [0.0, 1.0, 1.0], [0.0, 0.0, 5.0], [0.0; 3]];
        assert_eq!((image.pixels, report.pixels_repaired), (Pixels::Float(expected), 2));
        for (width, height) in [(2, 1), (0, 0), (u32::MAX, u32::MAX)] {
            environment_from_pixels("sky", width, height, vec![[0.0; 3]; 4])
                .expect_err("another number of pixels");
        }
    }

    #[test]
    fn radiance_files_are_decoded_and_liars_refused() {
        let header = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n";
        let mut file = header.as_bytes().to_vec();
        file.extend([128, 64, 0, 129, 0, 0, 0, 0]);
        let (image, _) = decode(&file, "sky").expect("two pixels");
        assert_eq!(image.pixels, Pixels::Float(vec![[1.0, 0.5, 0.0], [0.0; 3]]));
        let huge = header.replace("-Y 1 +X 2", "-Y 60000 +X 60000");
        assert!(decode(huge.as_bytes(), "sky").expect_err("no pixels").contains("60000"));
        assert!(decode(&file[..file.len() - 3], "sky").is_err());
        assert!(decode(b"\x76\x2f\x31\x01", "sky").expect_err("OpenEXR").contains("OpenEXR"));
    }
}
