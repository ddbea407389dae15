//! Where two pictures differ, to look at.

use crate::metrics::relative_errors;
use crate::preview::rgb_png;
use crate::{Image, ImageError};

/// Black, violet, red, orange, pale yellow: rising in lightness, so that it also reads in grey.
const COLORS: [[f64; 3]; 5] =
    [[0.0, 0.0, 4.0], [87.0, 16.0, 110.0], [188.0, 55.0, 84.0], [249.0, 142.0, 9.0], [252.0, 255.0, 164.0]];

/// A heat map of the relative error per pixel, as PNG bytes, and the error that its brightest colour stands for: the 99.9th
/// percentile. The colour scale is linear from no error (black).
pub fn difference_png(picture: &Image, reference: &Image) -> Result<(Vec<u8>, f64), ImageError> {
    let errors = relative_errors(picture, reference)?;
    let mut sorted = errors.clone();
    sorted.sort_by(f64::total_cmp);
    let brightest = sorted[(sorted.len() - 1) * 999 / 1000];
    let bytes: Vec<u8> = errors.iter().flat_map(|error| heat_color(error / brightest)).collect();
    Ok((rgb_png(reference.resolution, &bytes), brightest))
}

/// The colour of a share in [0, 1]; more is shown like 1, and 0/0 like 0.
pub fn heat_color(share: f64) -> [u8; 3] {
    let share = if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) };
    let place = share * (COLORS.len() - 1) as f64;
    let index = (place as usize).min(COLORS.len() - 2);
    let (low, high, t) = (COLORS[index], COLORS[index + 1], place - index as f64);
    [0, 1, 2].map(|channel| (low[channel] + (high[channel] - low[channel]) * t).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::tests::image;

    #[test]
    fn the_pixel_that_differs_stands_out() {
        let reference = image(4, vec![[1.0; 3]; 8]);
        let mut picture = reference.clone();
        for (pixel, value) in picture.pixels.iter_mut().zip([1.0, 1.5, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0]) {
            *pixel = [value; 3];
        }
        let (bytes, brightest) = difference_png(&picture, &reference).unwrap();
        assert!((brightest - (1.0f64 / 1.01).sqrt()).abs() < 1e-12);
        let map = image::load_from_memory(&bytes).unwrap().into_rgb8();
        assert_eq!(map.get_pixel(0, 0).0, [0, 0, 4]);
        assert_eq!(map.get_pixel(1, 0).0, [188, 55, 84]);
        assert_eq!(map.get_pixel(3, 1).0, [252, 255, 164]);
    }

    #[test]
    fn equal_pictures_are_dark_all_over() {
        let reference = image(2, vec![[1.0; 3]; 4]);
        let (bytes, brightest) = difference_png(&reference, &reference).unwrap();
        assert_eq!(brightest, 0.0);
        assert!(
            image::load_from_memory(&bytes).unwrap().into_rgb8().pixels().all(|pixel| pixel.0 == [0, 0, 4])
        );
    }
}
