//! How the variance of a mean falls with the number of samples, read off sibling differences.
//!
//! Let `V(n)` be the variance of the mean of an aligned block of `n` samples, and `a`, `b` the means of the block's two halves.
//! Nested scrambling makes the halves exchangeable, so both have the variance `V(n/2)` and some covariance `C`, which is negative
//! where the sequence is better than chance. Of their mean, `V(n) = (V(n/2) + C) / 2`; of their difference,
//! `D(n) = E (a - b)^2 / 4 = (V(n/2) - C) / 2`. The sum of both is `V(n/2)`, whatever `C` is:
//!
//! ```text
//! D(n) = V(n/2) - V(n)        V(n) = D(2n) + D(4n) + D(8n) + ..
//! ```
//!
//! Differences up to the block's own size are observed. Those beyond continue as they fell so far: with `V ~ n^-rate`,
//! `D(n/2) / D(n) = 2^rate` and `V(n) = D(n) / (2^rate - 1)`. Independent samples have rate 1 and `V = D`.

/// Rate of independent samples: what is assumed while nothing else is known.
const RATE_INDEPENDENT: f64 = 1.0;

/// Standard deviation of what is assumed: most pictures lie between independent samples and the double rate.
const RATE_PRIOR: f64 = 0.5;

/// Standard deviation by which the rate changes from one level to the next.
const RATE_DRIFT: f64 = 0.25;

/// Standard deviation of an observed rate around the trend: nets are better at some powers of two than at others.
const RATE_RIPPLE: f64 = 0.15;

/// Scrambled nets converge no slower than chance and, for smooth integrands, as `n^-3` (Owen 1997).
const RATES: std::ops::RangeInclusive<f64> = RATE_INDEPENDENT..=3.0;

/// A mean difference and how far it may be off.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Observed {
    /// `D(n)`, estimated.
    pub difference: f64,
    /// Variance of that, relative to its square.
    pub variance: f64,
}

impl Observed {
    /// From sums over pairs: of the values and of their squares. The square of a value has thrice the expectation of its
    /// variance over two: what chance alone does to the square of a normal variable.
    pub fn new(pairs: u64, sum: f64, sum_of_squares: f64) -> Option<Self> {
        (pairs > 0).then(|| Self {
            difference: sum / pairs as f64,
            variance: if sum > 0.0 { 2.0 / 3.0 * sum_of_squares / (sum * sum) } else { 0.0 },
        })
    }
}

/// The variance of means of aligned blocks.
#[derive(Clone, Debug)]
pub(crate) struct Decay {
    /// Entry `k` is of blocks of `2^k` samples.
    variances: Vec<f64>,
    /// `V ~ n^-rate` beyond the last entry.
    pub rate: f64,
    /// Standard deviation of `rate`.
    pub rate_deviation: f64,
    /// Standard deviation of the logarithm of the last variance.
    pub log_deviation: f64,
}

impl Decay {
    /// From differences of blocks of 2, 4, 8 .. samples. None without any.
    pub fn new(levels: &[Option<Observed>]) -> Option<Self> {
        let top = levels.iter().rposition(Option::is_some)?;
        let last = levels[top].expect("the last level that was observed");
        let (rate, rate_variance) = rate(&levels[..=top]);

        // What is left beyond the last level, then upwards to single samples. A level that nobody observed lies on the curve.
        let ratio = rate.exp2();
        let mut variances = vec![last.difference / (ratio - 1.0)];
        for level in levels[..=top].iter().rev() {
            let variance = variances[variances.len() - 1];
            let difference = level.map_or(variance * (ratio - 1.0), |level| level.difference);
            variances.push(variance + difference);
        }
        variances.reverse();

        // d log V / d rate; the factor 2 is for the error of the picture itself, which scatters as its estimate does.
        let slope = std::f64::consts::LN_2 * ratio / (ratio - 1.0);
        let log_variance =
            if last.difference > 0.0 { 2.0 * last.variance + slope * slope * rate_variance } else { 0.0 };
        Some(Self {
            variances,
            rate,
            rate_deviation: rate_variance.sqrt(),
            log_deviation: log_variance.sqrt(),
        })
    }

    /// Variance of the mean of an aligned block of `2^level` samples.
    pub fn variance(&self, level: u32) -> f64 {
        let last = self.variances.len() - 1;
        match self.variances.get(level as usize) {
            Some(variance) => *variance,
            None => self.variances[last] * (-self.rate * (f64::from(level) - last as f64)).exp2(),
        }
    }

    /// Covariance of the means of any two disjoint blocks whose smallest common block has `2^level` samples: that of the common
    /// block's halves, because nested scrambling exchanges parts of a half at will.
    pub fn covariance(&self, level: u32) -> f64 {
        2.0 * self.variance(level) - self.variance(level - 1)
    }
}

/// Follows the rate from level to level as a random walk that is observed with errors (a Kalman filter), so that a level in
/// which few pairs decide says little. Returns the rate and its variance.
fn rate(levels: &[Option<Observed>]) -> (f64, f64) {
    let (mut rate, mut variance) = (RATE_INDEPENDENT, RATE_PRIOR * RATE_PRIOR);
    for pair in levels.windows(2) {
        let [Some(half), Some(whole)] = [pair[0], pair[1]] else { continue };
        if half.difference <= 0.0 || whole.difference <= 0.0 {
            continue;
        }
        let observed = (half.difference / whole.difference).log2();
        let chance = (half.variance + whole.variance) / (std::f64::consts::LN_2 * std::f64::consts::LN_2);
        variance += RATE_DRIFT * RATE_DRIFT;
        let gain = variance / (variance + RATE_RIPPLE * RATE_RIPPLE + chance);
        rate += gain * (observed - rate);
        variance *= 1.0 - gain;
    }
    (rate.clamp(*RATES.start(), *RATES.end()), variance)
}
