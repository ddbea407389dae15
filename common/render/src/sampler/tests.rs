//! Laws of the sampler as a whole.

use super::*;

/// The set's points of samples `[first, first + count)` of a pixel.
fn points(pixel: (u32, u32), set: u32, first: u64, count: u64) -> Vec<[f32; 4]> {
    (first..first + count).map(|index| Sampler::new(7, 3, pixel.0, pixel.1, index).set(set)).collect()
}

/// Whether each of the `2^a x 2^b` boxes holds equally many points.
fn is_stratified(points: &[[f32; 4]], (i, a): (usize, u32), (j, b): (usize, u32)) -> bool {
    let mut counts = vec![0; 1 << (a + b)];
    for point in points {
        let cell = |u: f32, bits: u32| (u * (1_u32 << bits) as f32) as usize;
        counts[cell(point[i], a) << b | cell(point[j], b)] += 1;
    }
    counts.iter().all(|&count| count == counts[0])
}

#[test]
fn aligned_blocks_are_stratified_in_every_dimension_of_every_set() {
    for set in [0, 1, 5, 1000] {
        for k in 0..=10 {
            for block in [0, 1, 2, 5, 1 << 20] {
                let points = points((31, 977), set, block << k, 1 << k);
                for i in 0..4 {
                    assert!(
                        is_stratified(&points, (i, k), (i, 0)),
                        "set {set}, block {block} of 2^{k}, dimension {i}"
                    );
                }
            }
        }
    }
}

#[test]
fn aligned_blocks_put_one_point_into_each_elementary_interval() {
    for (pixel, set) in [((0, 0), 0), ((5, 9), 3), ((1919, 1079), 12)] {
        for k in [4, 6, 9] {
            for block in [0, 1, 6] {
                let points = points(pixel, set, block << k, 1 << k);
                for a in 0..=k {
                    assert!(
                        is_stratified(&points, (0, a), (1, k - a)),
                        "set {set}, block {block} of 2^{k}, a = {a}"
                    );
                }
            }
        }
    }
}

#[test]
fn blocks_of_four_dimensions_are_nets_of_quality_three() {
    let k = 10;
    let points = points((2, 2), 4, 3 << k, 1 << k);
    let mut intervals = 0;
    for shape in 0..8_u32.pow(4) {
        let digits: [u32; 4] = core::array::from_fn(|i| shape / 8_u32.pow(i as u32) % 8);
        if digits.iter().sum::<u32>() == k - 3 {
            let mut counts = [0; 128];
            for point in &points {
                let cell = (0..4)
                    .fold(0, |cell, i| cell << digits[i] | (point[i] * (1 << digits[i]) as f32) as usize);
                counts[cell] += 1;
            }
            assert!(counts.iter().all(|&count| count == 8), "shape {digits:?}");
            intervals += 1;
        }
    }
    assert_eq!(intervals, 120);
}

/// Correlation of two rows of numbers.
fn correlation(a: &[f32], b: &[f32]) -> f64 {
    let centred = |u: &f32| f64::from(*u) - 0.5;
    12.0 * a.iter().zip(b).map(|(a, b)| centred(a) * centred(b)).sum::<f64>() / a.len() as f64
}

#[test]
fn neighbours_in_any_part_of_the_address_are_uncorrelated() {
    let base = |n: u32| (0_u64, 0_u32, n % 128, n / 128, 0_u64, 0_u32);
    let row = |change: &dyn Fn(u32) -> (u64, u32, u32, u32, u64, u32), i: usize| -> Vec<f32> {
        (0..16_384)
            .map(|n| {
                let (seed, frame, x, y, index, set) = change(n);
                Sampler::new(seed, frame, x, y, index).set(set)[i]
            })
            .collect()
    };
    type Neighbour = fn(u32) -> (u64, u32, u32, u32, u64, u32);
    let neighbours: [(&str, Neighbour); 8] = [
        ("seed", |n| (1, 0, n % 128, n / 128, 0, 0)),
        ("high half of the seed", |n| (1 << 63, 0, n % 128, n / 128, 0, 0)),
        ("frame", |n| (0, 1, n % 128, n / 128, 0, 0)),
        ("column", |n| (0, 0, n % 128 + 1, n / 128, 0, 0)),
        ("row", |n| (0, 0, n % 128, n / 128 + 1, 0, 0)),
        ("pixel mirrored", |n| (0, 0, n / 128, n % 128 + 200, 0, 0)),
        ("index beyond 32 bits", |n| (0, 0, n % 128, n / 128, 1 << 32, 0)),
        ("set", |n| (0, 0, n % 128, n / 128, 0, 1)),
    ];
    for (what, neighbour) in neighbours {
        for (i, j) in [(0, 0), (1, 1), (2, 3), (3, 0)] {
            let r = correlation(&row(&base, i), &row(&neighbour, j));
            assert!(r.abs() < 5.0 / 128.0, "{what}: correlation {r} of dimensions {i} and {j}");
        }
    }
}

#[test]
fn two_sets_of_one_pixel_fill_their_product_evenly() {
    let (first, second) = (points((8, 8), 0, 0, 4096), points((8, 8), 1, 0, 4096));
    let mut counts = [0_f64; 64];
    for (a, b) in first.iter().zip(&second) {
        counts[(a[0] * 8.0) as usize * 8 + (b[0] * 8.0) as usize] += 1.0;
    }
    let chi2: f64 = counts.iter().map(|count| (count - 64.0).powi(2) / 64.0).sum();
    assert!(chi2 < 120.0, "chi-square {chi2} at 49 degrees of freedom");
}

#[test]
fn the_ends_of_the_address_space_have_seeds_of_their_own() {
    let last = 65_535;
    let addresses = [
        (0, 0, 0, 0, 0),
        (0, (1 << 31) - 1, last, last, 0),
        (0, (1 << 31) - 1, last, last, 1 << 32),
        (0, (1 << 31) - 1, last, last, u64::MAX),
        (u64::MAX, u32::MAX, u32::MAX, u32::MAX, 1 << 32),
        (0, (1 << 31) - 1, last, last - 1, 1 << 32),
        (0, 0, last, last, 1 << 32),
    ];
    for sequence in [Sequence::Sobol, Sequence::Independent] {
        let mut seen: Vec<[f32; 4]> = Vec::new();
        for (seed, frame, x, y, index) in addresses {
            let numbers = Sampler::with_sequence(sequence, seed, frame, x, y, index).set(u32::MAX);
            assert!(numbers.iter().all(|u| (0.0..1.0).contains(u)));
            assert!(!seen.contains(&numbers), "{sequence:?}: {numbers:?} came twice");
            seen.push(numbers);
        }
    }
}

/// Root mean square error over `pixels` of the mean of a smooth function of two sets.
fn rmse(sequence: Sequence, samples: u64, pixels: u32) -> f64 {
    let squares: f64 = (0..pixels)
        .map(|x| {
            let sum: f64 = (0..samples)
                .map(|index| {
                    let sampler = Sampler::with_sequence(sequence, 1, 0, x, 0, index);
                    let value = |set| sampler.set(set).iter().map(|u| 2.0 * f64::from(*u)).product::<f64>();
                    0.5 * (value(0) + value(1))
                })
                .sum();
            (sum / samples as f64 - 1.0).powi(2)
        })
        .sum();
    (squares / f64::from(pixels)).sqrt()
}

#[test]
fn the_error_falls_nearly_with_the_number_of_samples() {
    let (few, many) = (rmse(Sequence::Sobol, 256, 64), rmse(Sequence::Sobol, 4096, 64));
    let independent = rmse(Sequence::Independent, 4096, 64);
    assert!(many < few / 12.0, "error {few} at 256 samples, {many} at 4096");
    assert!(many < independent / 20.0, "error {many}, independent {independent}");
}

#[test]
fn the_error_keeps_falling_past_the_sixteenth_bit_of_the_index() {
    let (before, after) = (rmse(Sequence::Sobol, 1 << 15, 8), rmse(Sequence::Sobol, 1 << 18, 8));
    assert!(after < before / 6.0, "error {before} at 2^15 samples, {after} at 2^18");
}

#[test]
fn independent_numbers_have_the_moments_of_uniform_ones() {
    let numbers: Vec<f64> = (0..20_000_u64)
        .flat_map(|index| Sampler::with_sequence(Sequence::Independent, 5, 1, 2, 3, index).set(9))
        .map(f64::from)
        .collect();
    let mean = numbers.iter().sum::<f64>() / numbers.len() as f64;
    let square = numbers.iter().map(|u| u * u).sum::<f64>() / numbers.len() as f64;
    assert!((mean - 0.5).abs() < 0.005 && (square - 1.0 / 3.0).abs() < 0.005, "moments {mean}, {square}");
}
