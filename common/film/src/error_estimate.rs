//! How wrong a picture still is, measured on its own merge tree.

use serde::{Deserialize, Serialize};

/// Estimated error of a frame's current pixels against the picture it converges to.
///
/// From the two halves `a`, `b` of every pixel's samples: `(a - b)^2 / 4` has the expectation `V(n/2)/2`, which is the
/// variance of the mean of both for independent samples and an upper bound for a convergent quasi-Monte Carlo sequence.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ErrorEstimate {
    /// Samples per pixel that the estimate speaks of.
    pub spp: u64,
    /// Root of the mean squared error over pixels and channels, in radiance.
    pub rmse: f64,
    /// Mean over pixels and channels of squared error over `value^2 + 0.01`.
    pub rel_mse: f64,
}

/// Sums from which an estimate is made; adds up over tiles.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ErrorSums {
    squared: f64,
    relative: f64,
    values: u64,
}

impl ErrorSums {
    /// Adds one channel of one pixel whose two halves have these sums over `half` samples each.
    pub(crate) fn add(&mut self, left: f32, right: f32, half: u64) {
        let (a, b) = (f64::from(left) / half as f64, f64::from(right) / half as f64);
        let squared = (a - b) * (a - b) / 4.0;
        let mean = (a + b) / 2.0;
        self.squared += squared;
        self.relative += squared / (mean * mean + 0.01);
        self.values += 1;
    }

    /// Adds another tile's sums.
    pub(crate) fn plus(self, other: Self) -> Self {
        Self {
            squared: self.squared + other.squared,
            relative: self.relative + other.relative,
            values: self.values + other.values,
        }
    }

    /// The estimate for a picture of `spp` samples; none while nothing was added.
    pub(crate) fn estimate(self, spp: u64) -> Option<ErrorEstimate> {
        (self.values > 0).then(|| ErrorEstimate {
            spp,
            rmse: (self.squared / self.values as f64).sqrt(),
            rel_mse: self.relative / self.values as f64,
        })
    }
}
