//! Importance sampling of the pixel filter: a sample belongs to one pixel, and its position follows the filter.
//!
//! All three filters are positive and separable, so every sample weighs the same and one inverted distribution serves both axes.

use crate::math;
use farm_scene::Filter;

/// Bins of a tabulated filter: bin masses are exact and the density inside a bin is taken as constant, which moves a sample by
/// at most a bin's width of 0.003 pixels.
const BINS: usize = 1024;

/// Half the width of the tabulated filters, in pixels.
const RADIUS: f64 = 1.5;

/// Standard deviation of the Gaussian, in pixels.
const SIGMA: f64 = 0.5;

/// Draws sample positions that follow a pixel filter.
#[derive(Clone, Debug)]
pub struct FilterSampler {
    table: Option<Table>,
}

impl FilterSampler {
    /// Prepares a filter.
    pub fn new(filter: Filter) -> Self {
        let table = match filter {
            Filter::Box => None,
            Filter::Gaussian => Some(Table::new(gaussian_cdf)),
            Filter::BlackmanHarris => Some(Table::new(blackman_harris_cdf)),
        };
        Self { table }
    }

    /// Offset from the pixel's centre in pixels, for `u` uniform in [0, 1)^2. Monotone in both coordinates.
    pub fn sample(&self, u: [f32; 2]) -> [f32; 2] {
        match &self.table {
            None => u.map(|u| u - 0.5),
            Some(table) => u.map(|u| table.invert(u)),
        }
    }

    /// Largest offset along an axis, in pixels.
    pub fn radius(&self) -> f32 {
        if self.table.is_some() { RADIUS as f32 } else { 0.5 }
    }
}

/// A one-dimensional distribution over [-RADIUS, RADIUS], ready to be inverted.
#[derive(Clone, Debug)]
struct Table {
    /// Probability of lying below each bin's left edge; one more than there are bins.
    cdf: Vec<f32>,
    /// For each slice of [0, 1): the bin in which its lower end lies.
    first_bin: Vec<u16>,
}

impl Table {
    fn new(cdf_at: impl Fn(f64) -> f64) -> Self {
        let edge = |i: usize| RADIUS * (2.0 * i as f64 / BINS as f64 - 1.0);
        let mut cdf: Vec<f32> = (0..=BINS).map(|i| cdf_at(edge(i)) as f32).collect();
        cdf[0] = 0.0;
        cdf[BINS] = 1.0;
        let mut bin = 0;
        let first_bin = (0..BINS)
            .map(|slice| {
                while cdf[bin + 1] <= slice as f32 / BINS as f32 {
                    bin += 1;
                }
                bin as u16
            })
            .collect();
        Self { cdf, first_bin }
    }

    fn invert(&self, u: f32) -> f32 {
        let mut bin = usize::from(self.first_bin[((u * BINS as f32) as usize).min(BINS - 1)]);
        while self.cdf[bin + 1] <= u && bin + 1 < BINS {
            bin += 1;
        }
        let (low, high) = (self.cdf[bin], self.cdf[bin + 1]);
        let position = bin as f32 + (u - low) / (high - low);
        position * (2.0 * RADIUS as f32 / BINS as f32) - RADIUS as f32
    }
}

/// Distribution of the Gaussian cut at the radius.
fn gaussian_cdf(x: f64) -> f64 {
    let scale = core::f64::consts::FRAC_1_SQRT_2 / SIGMA;
    0.5 + 0.5 * math::erf_f64(x * scale) / math::erf_f64(RADIUS * scale)
}

/// Distribution of the four-term Blackman-Harris window (Harris 1978, table 1), integrated term by term.
fn blackman_harris_cdf(x: f64) -> f64 {
    const TERMS: [f64; 4] = [0.35875, 0.48829, 0.14128, 0.01168];
    let angle = core::f64::consts::PI * x / RADIUS;
    let waves = TERMS[1] * math::sin_f64(angle)
        + TERMS[2] / 2.0 * math::sin_f64(2.0 * angle)
        + TERMS[3] / 3.0 * math::sin_f64(3.0 * angle);
    0.5 + (angle + waves / TERMS[0]) / core::f64::consts::TAU
}

#[cfg(test)]
mod tests {
    use super::*;

    const N: usize = 200_000;

    fn offsets(filter: Filter) -> Vec<f64> {
        let sampler = FilterSampler::new(filter);
        (0..N).map(|i| f64::from(sampler.sample([(i as f32 + 0.5) / N as f32, 0.5])[0])).collect()
    }

    fn moment(xs: &[f64], power: i32) -> f64 {
        xs.iter().map(|x| x.powi(power)).sum::<f64>() / xs.len() as f64
    }

    /// Second moment of a density that need not be normalised, by the midpoint rule.
    fn second_moment_of(density: impl Fn(f64) -> f64) -> f64 {
        let xs = (0..30_000).map(|i| RADIUS * (2.0 * (f64::from(i) + 0.5) / 30_000.0 - 1.0));
        let (mass, moment) =
            xs.fold((0.0, 0.0), |(mass, moment), x| (mass + density(x), moment + x * x * density(x)));
        moment / mass
    }

    fn assert_follows(filter: Filter, cdf: impl Fn(f64) -> f64) {
        let mut xs = offsets(filter);
        xs.sort_by(f64::total_cmp);
        let distance = xs
            .iter()
            .enumerate()
            .map(|(i, x)| (cdf(*x) - (i as f64 + 0.5) / N as f64).abs())
            .fold(0.0, f64::max);
        assert!(distance < 2e-5, "{filter:?}: Kolmogorov-Smirnov distance {distance}");
    }

    #[test]
    fn offsets_follow_their_filter() {
        assert_follows(Filter::Box, |x| x + 0.5);
        assert_follows(Filter::Gaussian, gaussian_cdf);
        assert_follows(Filter::BlackmanHarris, blackman_harris_cdf);
    }

    #[test]
    fn filters_are_centred_and_as_wide_as_their_density_says() {
        let gaussian = second_moment_of(|x| f64::from(math::exp((-x * x / (2.0 * SIGMA * SIGMA)) as f32)));
        let blackman_harris = second_moment_of(|x| {
            let a = core::f64::consts::PI * x / RADIUS;
            0.35875
                + 0.48829 * math::cos_f64(a)
                + 0.14128 * math::cos_f64(2.0 * a)
                + 0.01168 * math::cos_f64(3.0 * a)
        });
        for (filter, expected) in [
            (Filter::Box, 1.0 / 12.0),
            (Filter::Gaussian, gaussian),
            (Filter::BlackmanHarris, blackman_harris),
        ] {
            let xs = offsets(filter);
            assert!(moment(&xs, 1).abs() < 1e-6, "{filter:?}: mean {}", moment(&xs, 1));
            assert!(
                (moment(&xs, 2) - expected).abs() < 1e-5,
                "{filter:?}: variance {}, not {expected}",
                moment(&xs, 2)
            );
        }
    }

    #[test]
    fn offsets_are_monotone_and_stay_inside() {
        for filter in [Filter::Box, Filter::Gaussian, Filter::BlackmanHarris] {
            let sampler = FilterSampler::new(filter);
            let xs = offsets(filter);
            assert!(xs.is_sorted(), "{filter:?}");
            for u in [0.0, 1e-9, math::ONE_MINUS_EPSILON] {
                assert!(sampler.sample([u, u])[1].abs() <= sampler.radius(), "{filter:?} at {u}");
            }
        }
    }
}
