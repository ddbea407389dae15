//! FLIP, a difference as people see it, by its authors' own implementation (C++, hence behind a feature of this crate).

use crate::Image;

/// Where the authors' own evaluator sees a picture from unless told otherwise: metres to the display, its pixels and its metres across.
#[cfg(feature = "flip")]
const DISPLAY: (f32, f32, f32) = (0.7, 3840.0, 0.7);

/// Mean LDR-FLIP of the pictures, which must have one resolution, as sRGB clamped to [0, 1], at 67.02 pixels per degree; none when
/// this crate was built without it.
#[cfg(feature = "flip")]
pub fn flip(picture: &Image, reference: &Image) -> Option<f64> {
    let prepared = |image: &Image| {
        let bytes: Vec<u8> =
            image.pixels.iter().flatten().map(|&value| crate::preview::srgb_byte(value)).collect();
        nv_flip::FlipImageRgb8::with_data(image.resolution.width(), image.resolution.height(), &bytes)
    };
    let (distance, pixels, width) = DISPLAY;
    let density = nv_flip::pixels_per_degree(distance, pixels, width);
    let map = nv_flip::flip(prepared(reference), prepared(picture), density);
    let values = map.to_vec();
    Some(values.iter().map(|&value| f64::from(value)).sum::<f64>() / values.len() as f64)
}

/// Not part of this build.
#[cfg(not(feature = "flip"))]
pub fn flip(_: &Image, _: &Image) -> Option<f64> {
    None
}

#[cfg(all(test, feature = "flip"))]
mod tests {
    use crate::metrics::tests::image;

    #[test]
    fn flip_runs_from_equal_to_opposite() {
        let of = |value: f32| image(32, vec![[value; 3]; 1024]);
        let flip = |a: f32, b: f32| super::flip(&of(a), &of(b)).unwrap();
        assert_eq!(flip(0.5, 0.5), 0.0);
        assert!(flip(0.0, 1.0) > 0.9);
        let slight = flip(0.5, 0.52);
        assert!(slight > 0.0 && slight < 0.1, "{slight}");
    }
}
