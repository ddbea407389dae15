//! What the halves of sample blocks say about the variance of their means.

use crate::Rgb;
use serde::{Deserialize, Serialize};

/// Keeps relative errors finite where the picture is black.
const RELATIVE_FLOOR: f64 = 0.01;

/// Highest level: blocks of 2^62 samples.
const LEVEL_MAX: usize = 62;

/// Sums over pairs of sibling blocks of one size, each pair in one pixel. With `a`, `b` the means of the two halves, a pair's
/// value is the mean of `(a - b)^2 / 4` over the channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LevelDifferences {
    /// How many pairs.
    pub pairs: u64,
    /// Of the values.
    pub squared: f64,
    /// Of the values' squares: how far single pairs decide.
    pub squared_spread: f64,
    /// Of the values with each channel over `a b + 0.01` (`a b` has the expectation of the true value's square).
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
            u128::from(level.pairs) <= pairs_max && sums.iter().all(|sum| sum.is_finite() && *sum >= 0.0)
        };
        self.levels.len() <= LEVEL_MAX && self.levels.iter().enumerate().all(fits)
    }

    /// Adds a pair: the means of the two halves of a block of `2^level` samples.
    pub(crate) fn add(&mut self, level: u32, left: [f64; 3], right: [f64; 3]) {
        let (mut squared, mut relative) = (0.0, 0.0);
        for (a, b) in left.into_iter().zip(right) {
            let square = (a - b) * (a - b) / 12.0;
            squared += square;
            relative += square / ((a * b).max(0.0) + RELATIVE_FLOOR);
        }
        // Sums that left the range of floats say nothing.
        if !(squared * squared).is_finite() || !(relative * relative).is_finite() {
            return;
        }
        let sums = self.level_mut(level);
        sums.pairs += 1;
        sums.squared += squared;
        sums.squared_spread += squared * squared;
        sums.relative += relative;
        sums.relative_spread += relative * relative;
    }

    /// Adds a pair of every pixel, from sums over the two halves of a block of `2^level` samples.
    pub(crate) fn add_pixels(&mut self, level: u32, left: &[Rgb], right: &[Rgb]) {
        let scale = 1.0 / (1_u64 << (level - 1)) as f64;
        let mean = |sum: &Rgb| sum.map(|value| f64::from(value) * scale);
        for (a, b) in left.iter().zip(right) {
            self.add(level, mean(a), mean(b));
        }
    }

    /// Adds other sums, level by level.
    pub fn add_all(&mut self, other: &Self) {
        for (level, more) in (1..).zip(&other.levels) {
            let sums = self.level_mut(level);
            sums.pairs += more.pairs;
            sums.squared += more.squared;
            sums.squared_spread += more.squared_spread;
            sums.relative += more.relative;
            sums.relative_spread += more.relative_spread;
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
