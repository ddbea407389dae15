//! What the halves of sample blocks say about the variance of their means.

use serde::{Deserialize, Serialize};

/// Keeps relative errors finite where the picture is black.
const RELATIVE_FLOOR: f64 = 0.01;

/// Highest level: blocks of 2^62 samples.
const LEVEL_MAX: usize = 62;

/// Pixels on each side of one that are asked, within its tile, for what its value may be.
const NEIGHBOURS: usize = 2;

/// Sums over pairs of sibling blocks of one size, each pair in one pixel. With `a`, `b` the means of the two halves, a pair's
/// value is the mean of `(a - b)^2 / 4` over the channels, its relative value that over `value^2 + 0.01`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LevelDifferences {
    /// How many pairs.
    pub pairs: u64,
    /// Of the values.
    pub squared: f64,
    /// Of the values' squares: how far single pairs decide.
    pub squared_spread: f64,
    /// How many pairs have a relative value: all from the leaf upwards, none within it.
    pub relative_pairs: u64,
    /// Of the relative values.
    pub relative: f64,
    /// Of their squares.
    pub relative_spread: f64,
}

/// Sums of sibling differences by size of the block that two siblings make up: what remains of samples that were added up.
///
/// The sums of a tile over a block are, by definition, those of its left half plus those of its right half plus those of its
/// pixels' own pairs in scanline order. So they do not depend on the division of the work either.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Differences {
    /// Entry `k - 1` is of blocks of `2^k` samples.
    levels: Vec<LevelDifferences>,
}

/// Means of the two halves of a block of one pixel's samples.
pub(crate) type Halves = [[f64; 3]; 2];

impl Differences {
    /// Entry `k - 1` is of blocks of `2^k` samples; levels that were not observed have no pairs.
    pub fn levels(&self) -> &[LevelDifferences] {
        &self.levels
    }

    /// Whether these can be the sums of a block of `samples` samples of `pixels` pixels: finite, not negative, and of no more
    /// pairs than there are.
    pub fn fit(&self, pixels: usize, samples: u64) -> bool {
        let fits = |(index, level): (usize, &LevelDifferences)| {
            let sums = [level.squared, level.squared_spread, level.relative, level.relative_spread];
            let pairs_max = u128::from(samples >> (index + 1)) * pixels as u128;
            let pairs = u128::from(level.pairs.max(level.relative_pairs));
            pairs <= pairs_max && sums.iter().all(|sum| sum.is_finite() && *sum >= 0.0)
        };
        self.levels.len() <= LEVEL_MAX && self.levels.iter().enumerate().all(fits)
    }

    /// Adds other sums, level by level.
    pub fn add_all(&mut self, other: &Self) {
        for (level, more) in (1..).zip(&other.levels) {
            let sums = self.level_mut(level);
            sums.pairs += more.pairs;
            sums.squared += more.squared;
            sums.squared_spread += more.squared_spread;
            sums.relative_pairs += more.relative_pairs;
            sums.relative += more.relative;
            sums.relative_spread += more.relative_spread;
        }
    }

    /// Adds a pair that makes up a block of `2^level` samples.
    pub(crate) fn add(&mut self, level: u32, [left, right]: Halves) {
        let squared: f64 = left.into_iter().zip(right).map(|(a, b)| (a - b) * (a - b) / 12.0).sum();
        // Sums that left the range of floats say nothing.
        if (squared * squared).is_finite() {
            let sums = self.level_mut(level);
            sums.pairs += 1;
            sums.squared += squared;
            sums.squared_spread += squared * squared;
        }
    }

    /// Adds relative values of pairs, one per pixel of a tile of `width` columns.
    ///
    /// What the squared error is divided by is unknown itself. The pair's mean is what a wrong value would hide behind: a
    /// firefly is as bright as it is wrong. The product `a b` of the halves has the expectation of the true value's square, but is
    /// zero where one half found nothing. So the part of the mean's square that the halves do not share is believed only as
    /// far as the neighbourhood has it too.
    pub(crate) fn add_relative(&mut self, level: u32, width: usize, pixels: &[Halves]) {
        let means: Vec<_> =
            pixels.iter().map(|[a, b]| std::array::from_fn(|c| 0.5 * (a[c] + b[c]))).collect();
        let around = neighbourhoods(&means, width);
        let sums = self.level_mut(level);
        for (([a, b], mean), around) in pixels.iter().zip(&means).zip(&around) {
            let relative = |c: usize| {
                let (square, believed) =
                    ((a[c] - b[c]) * (a[c] - b[c]) / 4.0, (around[c] / mean[c]).min(1.0));
                let value = if mean[c] > 0.0 { a[c] * b[c] + square * believed * believed } else { 0.0 };
                square / (value.max(0.0) + RELATIVE_FLOOR)
            };
            let relative = (relative(0) + relative(1) + relative(2)) / 3.0;
            if (relative * relative).is_finite() {
                sums.relative_pairs += 1;
                sums.relative += relative;
                sums.relative_spread += relative * relative;
            }
        }
    }

    fn level_mut(&mut self, level: u32) -> &mut LevelDifferences {
        let index = level as usize - 1;
        if self.levels.len() <= index {
            self.levels.resize(index + 1, LevelDifferences::default());
        }
        &mut self.levels[index]
    }
}

/// Mean over the square of pixels around each one, cut at the tile's edges.
fn neighbourhoods(values: &[[f64; 3]], width: usize) -> Vec<[f64; 3]> {
    let rows = along(values, values.len() / width, |row, x| row * width + x, width);
    along(&rows, width, |column, y| y * width + column, values.len() / width)
}

/// Means along each of `lines` lines of `length` values.
fn along(
    values: &[[f64; 3]],
    lines: usize,
    index: impl Fn(usize, usize) -> usize,
    length: usize,
) -> Vec<[f64; 3]> {
    let mut means = vec![[0.0; 3]; values.len()];
    for line in 0..lines {
        for at in 0..length {
            let window = at.saturating_sub(NEIGHBOURS)..(at + NEIGHBOURS + 1).min(length);
            let scale = 1.0 / window.len() as f64;
            let mean = &mut means[index(line, at)];
            for other in window {
                let value = values[index(line, other)];
                (0..3).for_each(|c| mean[c] += scale * value[c]);
            }
        }
    }
    means
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_neighbourhood_is_a_square_cut_at_the_edges() {
        let values: Vec<_> = (0..35).map(|i| [f64::from(i % 7), f64::from(i / 7), 1.0]).collect();
        let means = neighbourhoods(&values, 7);
        let close = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
        assert!(close(means[2 * 7 + 3], [3.0, 2.0, 1.0]), "{:?}", means[17]);
        assert!(close(means[0], [1.0, 1.0, 1.0]), "{:?}", means[0]);
        assert!(close(means[34], [5.0, 3.0, 1.0]), "{:?}", means[34]);
    }

    #[test]
    fn a_firefly_does_not_excuse_itself() {
        // One half of one pixel is a hundred times too bright; the true value is 1 everywhere.
        let mut pixels = vec![[[1.0; 3]; 2]; 25];
        pixels[12][1] = [100.0; 3];
        let mut differences = Differences::default();
        differences.add_relative(5, 5, &pixels);
        let truth = 49.5 * 49.5 / 1.01;
        let found = differences.levels()[4].relative;
        assert!(found > truth / 150.0 && found <= truth, "{found}, {truth}");
        assert!(found > 10.0 * 49.5 * 49.5 / (50.5 * 50.5), "{found}");
        // And a pixel that agrees with itself is taken at its word, whatever is around it.
        let mut lamp = vec![[[0.0; 3]; 2]; 25];
        lamp[12] = [[2.0; 3], [2.2; 3]];
        let mut differences = Differences::default();
        differences.add_relative(5, 5, &lamp);
        let expected = 0.01 / (2.1 * 2.1 + 0.01);
        assert!((differences.levels()[4].relative / expected - 1.0).abs() < 0.01);
    }
}
