//! How far a picture is from a reference. Every sum is taken in f64.

use crate::{Image, ImageError};
use farm_film::Rgb;
use serde::{Deserialize, Serialize};

/// Keeps relative errors finite where the reference is black.
const RELATIVE_FLOOR: f64 = 0.01;

/// The share of pixels, those with the largest error, that the trimmed mean leaves out: fireflies.
const TRIMMED_SHARE: f64 = 0.001;

/// Distances of a picture `x` from a reference `r`; means are over pixels and channels unless said otherwise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Mean of `(x - r)^2`.
    pub mse: f64,
    /// Root of `mse`.
    pub rmse: f64,
    /// Mean of `(x - r)^2 / (r^2 + 0.01)`.
    pub rel_mse: f64,
    /// The same without the 0.1 % of pixels (rounded down) whose share in it is largest.
    pub rel_mse_trimmed: f64,
    /// Mean of `|x - r| / (|r| + 0.01)`.
    pub mape: f64,
    /// `10 log10(p^2 / mse)` in dB with `p` the reference's largest value; none for equal pictures or a black reference.
    pub psnr: Option<f64>,
    /// Largest `|x - r|`.
    pub max_abs: f64,
    /// Mean of the picture per channel.
    pub mean: [f64; 3],
    /// Mean of the reference per channel.
    pub mean_reference: [f64; 3],
    /// Mean LDR-FLIP (Andersson et al. 2020) of the sRGB-encoded pictures clamped to [0, 1], at 67 pixels per degree; none where it
    /// was not asked for, and when the program was built without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flip: Option<f64>,
    /// Without the reference's own error; none when the reference does not state it, or is not independent of the picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrected: Option<Corrected>,
}

/// Errors of a picture after those of its reference are taken off: the expected square of the difference of two independent
/// estimates of one value is the sum of their variances.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Corrected {
    /// Mean squared error that the reference states of itself.
    pub reference_mse: f64,
    /// Relative mean squared error that the reference states of itself.
    pub reference_rel_mse: f64,
    /// Root of `mse` less that of the reference; 0 where that is larger.
    pub rmse: f64,
    /// `rel_mse` less that of the reference; 0 where that is larger.
    pub rel_mse: f64,
}

impl Corrected {
    fn new(picture: &Image, reference: &Image, mse: f64, rel_mse: f64) -> Option<Self> {
        let of_reference = reference.metadata.as_ref()?;
        let error = of_reference.error?;
        // Pictures of one seed share their samples.
        if picture.metadata.as_ref().is_some_and(|of_picture| of_picture.seed == of_reference.seed) {
            return None;
        }
        let reference_mse = error.rmse * error.rmse;
        Some(Self {
            reference_mse,
            reference_rel_mse: error.rel_mse,
            rmse: (mse - reference_mse).max(0.0).sqrt(),
            rel_mse: (rel_mse - error.rel_mse).max(0.0),
        })
    }
}

/// Compares pixel by pixel, by everything but FLIP, which takes its time ([`crate::flip()`]). Refuses pictures of another resolution
/// and values that are not finite.
pub fn compare(picture: &Image, reference: &Image) -> Result<Comparison, ImageError> {
    check(picture, reference)?;
    let mut relative: Vec<f64> = pairs(picture, reference)
        .map(|(x, r)| mean3(|channel| relative_square(x[channel], r[channel])))
        .collect();
    let rel_mse = mean(relative.iter().copied());
    let kept = relative.len() - (relative.len() as f64 * TRIMMED_SHARE) as usize;
    relative.sort_by(f64::total_cmp);
    let rel_mse_trimmed = mean(relative[..kept].iter().copied());

    let difference = |x: Rgb, r: Rgb, channel: usize| f64::from(x[channel]) - f64::from(r[channel]);
    let mse = mean(pairs(picture, reference).map(|(x, r)| mean3(|c| difference(x, r, c).powi(2))));
    let mape = mean(
        pairs(picture, reference)
            .map(|(x, r)| mean3(|c| difference(x, r, c).abs() / (f64::from(r[c]).abs() + RELATIVE_FLOOR))),
    );
    let max_abs = pairs(picture, reference)
        .flat_map(|(x, r)| [0, 1, 2].map(|c| difference(x, r, c).abs()))
        .fold(0.0, f64::max);
    let peak = reference.pixels.iter().flatten().fold(0.0, |peak, &value| f64::max(peak, value.into()));
    let channel_means =
        |image: &Image| [0, 1, 2].map(|c| mean(image.pixels.iter().map(|pixel| pixel[c].into())));
    Ok(Comparison {
        width: reference.resolution.width(),
        height: reference.resolution.height(),
        mse,
        rmse: mse.sqrt(),
        rel_mse,
        rel_mse_trimmed,
        mape,
        psnr: (mse > 0.0 && peak > 0.0).then(|| 10.0 * (peak * peak / mse).log10()),
        max_abs,
        mean: channel_means(picture),
        mean_reference: channel_means(reference),
        flip: None,
        corrected: Corrected::new(picture, reference, mse, rel_mse),
    })
}

/// Per pixel, the root of the mean over channels of `(x - r)^2 / (r^2 + 0.01)`, after the same checks as [`compare`].
pub(crate) fn relative_errors(picture: &Image, reference: &Image) -> Result<Vec<f64>, ImageError> {
    check(picture, reference)?;
    Ok(pairs(picture, reference)
        .map(|(x, r)| mean3(|channel| relative_square(x[channel], r[channel])).sqrt())
        .collect())
}

fn check(picture: &Image, reference: &Image) -> Result<(), ImageError> {
    if picture.resolution != reference.resolution {
        return Err(ImageError::Resolutions { picture: picture.resolution, reference: reference.resolution });
    }
    check_finite("picture", picture)?;
    check_finite("reference", reference)
}

fn check_finite(which: &'static str, image: &Image) -> Result<(), ImageError> {
    let width = image.resolution.width() as usize;
    let mut at_fault =
        (0..).zip(&image.pixels).filter(|(_, pixel)| !pixel.iter().all(|value| value.is_finite()));
    match at_fault.next() {
        None => Ok(()),
        Some((first, _)) => Err(ImageError::NotFinite {
            which,
            count: 1 + at_fault.count(),
            x: first % width,
            y: first / width,
        }),
    }
}

fn pairs<'a>(picture: &'a Image, reference: &'a Image) -> impl ExactSizeIterator<Item = (Rgb, Rgb)> + 'a {
    picture.pixels.iter().copied().zip(reference.pixels.iter().copied())
}

fn relative_square(x: f32, r: f32) -> f64 {
    let (x, r) = (f64::from(x), f64::from(r));
    (x - r) * (x - r) / (r * r + RELATIVE_FLOOR)
}

fn mean3(value: impl Fn(usize) -> f64) -> f64 {
    (value(0) + value(1) + value(2)) / 3.0
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use farm_film::Resolution;

    pub(crate) fn image(width: u32, pixels: Vec<Rgb>) -> Image {
        let resolution = Resolution::new(width, pixels.len() as u32 / width).unwrap();
        Image { resolution, pixels, metadata: None }
    }

    fn assert_close(a: f64, b: f64) {
        assert!((a - b).abs() <= 1e-12 * b.abs().max(1.0), "{a} is not {b}");
    }

    #[test]
    fn values_worked_out_by_hand() {
        let reference = image(2, vec![[1.0, 0.0, 2.0], [0.5, 0.5, 0.5]]);
        let picture = image(2, vec![[1.5, 0.25, 2.0], [0.5, 0.0, 0.5]]);
        let found = compare(&picture, &reference).unwrap();
        // Differences: 0.5, 0.25, 0 and 0, -0.5, 0.
        assert_close(found.mse, (0.25 + 0.0625 + 0.25) / 6.0);
        assert_close(found.rmse, 0.09375f64.sqrt());
        assert_close(found.rel_mse, (0.25 / 1.01 + 0.0625 / 0.01 + 0.25 / 0.26) / 6.0);
        assert_close(found.rel_mse_trimmed, found.rel_mse);
        assert_close(found.mape, (0.5 / 1.01 + 0.25 / 0.01 + 0.5 / 0.51) / 6.0);
        assert_close(found.psnr.unwrap(), 10.0 * (4.0f64 / 0.09375).log10());
        assert_close(found.max_abs, 0.5);
        assert_eq!((found.mean[1], found.mean_reference[1]), (0.125, 0.25));
    }

    #[test]
    fn trimming_drops_a_thousandth_of_the_pixels() {
        let reference = image(50, vec![[1.0; 3]; 2000]);
        let mut picture = reference.clone();
        picture.pixels[7] = [1.0e6; 3];
        picture.pixels[1999] = [2.0e6; 3];
        picture.pixels[300] = [1.1; 3];
        let found = compare(&picture, &reference).unwrap();
        assert!(found.rel_mse > 1.0e9);
        assert_close(found.rel_mse_trimmed, (f64::from(1.1f32) - 1.0).powi(2) / 1.01 / 1998.0);
    }

    #[test]
    fn sums_do_not_lose_small_errors_among_many_pixels() {
        // In f32 the sum of these squares would stall.
        let reference = image(2000, vec![[0.0; 3]; 4_000_000]);
        let picture = image(2000, vec![[0.001; 3]; 4_000_000]);
        let exact = f64::from(0.001f32).powi(2);
        assert!((compare(&picture, &reference).unwrap().mse / exact - 1.0).abs() < 1e-9);
    }

    #[test]
    fn equal_pictures_have_no_distance() {
        let picture = image(1, vec![[0.25; 3]; 5]);
        let found = compare(&picture, &picture).unwrap();
        assert_eq!(
            (found.mse, found.rel_mse, found.mape, found.max_abs, found.psnr),
            (0.0, 0.0, 0.0, 0.0, None)
        );
        let json = serde_json::to_string(&found).unwrap();
        assert_eq!(serde_json::from_str::<Comparison>(&json).unwrap(), found);
    }

    #[test]
    fn pictures_that_cannot_be_compared_get_a_sentence() {
        let small = image(2, vec![[0.0; 3]; 4]);
        let wide = image(4, vec![[0.0; 3]; 4]);
        let err = compare(&small, &wide).unwrap_err().to_string();
        assert_eq!(err, "a picture of 2x2 pixels cannot be compared with a reference of 4x1");
        let mut broken = small.clone();
        broken.pixels[3] = [0.0, f32::NAN, 0.0];
        broken.pixels[2] = [f32::INFINITY, 0.0, 0.0];
        let err = compare(&small, &broken).unwrap_err().to_string();
        assert_eq!(err, "the reference has 2 pixels that are not finite, the first at (0, 1)");
        assert!(compare(&broken, &small).unwrap_err().to_string().starts_with("the picture has 2"));
    }
}
