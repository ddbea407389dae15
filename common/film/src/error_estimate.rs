//! How wrong a picture still is, measured on its own merge tree.

use crate::decay::{AGEING_RELATIVE, AGEING_SQUARED, Decay, Observed, RATES, completed, variance_of_law};
use crate::{Differences, SampleBlock};
// The estimate decides where frames end: never the platform's functions.
use libm::{exp, exp2, hypot, log, log2};
use serde::{Deserialize, Serialize};

/// Standard deviations within which 95 % of a normal distribution lie.
const DEVIATIONS: f64 = 1.96;

/// Deviation of the logarithm of a squared error that each doubling of the samples ahead adds.
const DEVIATION_PER_DOUBLING: f64 = 0.05;

/// Where chance alone is left, estimates of relative errors fall by this power of the samples: the more there are, the better is known what
/// is divided by, and the more of the error is seen. From the benchmark set.
const RATE_SEEN: f64 = 0.9;

/// Share of chance in the error from which on it is more and more alone.
const CHANCE_ALONE: f64 = 0.95;

/// More doublings than any number of samples has.
const LEVELS: f64 = 64.0;

/// Estimated error of pixels against the picture that they converge to. Means are over pixels and channels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ErrorEstimate {
    /// Samples per pixel; where tiles have different numbers, the fewest.
    pub spp: u64,
    /// Root of the mean squared error, in radiance.
    pub rmse: f64,
    /// Mean of squared error over `value^2 + 0.01`.
    pub rel_mse: f64,
    /// The true root mean squared error lies within `rmse / rmse_band ..= rmse * rmse_band` in 95 % of all pictures.
    pub rmse_band: f64,
    /// The same for `rel_mse`.
    pub rel_mse_band: f64,
    /// At this number of samples the mean squared error falls as `spp^-rate`; 1 is that of independent samples.
    pub rate: f64,
    /// The same for `rel_mse`.
    pub rel_rate: f64,
    /// The parts of `rel_mse` that fall as `spp^-1`, `spp^-1.85` and `spp^-3`.
    pub rel_parts: [f64; 3],
}

/// When a picture will be good enough.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Prediction {
    /// Samples per pixel expected to be needed.
    pub spp: f64,
    /// The number lies within `spp / band ..= spp * band` in 95 % of all cases.
    pub band: f64,
}

impl ErrorEstimate {
    /// The error of a picture from those of its parts, each with a weight that goes with its pixels. None without parts.
    pub(crate) fn of_parts(parts: &[(f64, Self)]) -> Option<Self> {
        if let [(_, only)] = parts {
            return Some(*only);
        }
        let total: f64 = parts.iter().map(|(weight, _)| weight).sum();
        let mean = |value: &dyn Fn(&Self) -> f64| -> f64 {
            parts.iter().map(|(weight, part)| weight / total * value(part)).sum()
        };
        let mse = mean(&|part| part.rmse * part.rmse);
        let rel_mse = mean(&|part| part.rel_mse);
        // Parts are off independently; the rate of the sum is that of its parts by their share in it.
        let spread = |sum: f64, error: &dyn Fn(&Self) -> f64, band: &dyn Fn(&Self) -> f64| {
            let deviation = |(weight, part): &(f64, Self)| weight / total * error(part) * log(band(part));
            let squares: f64 = parts.iter().map(|part| deviation(part) * deviation(part)).sum();
            if sum > 0.0 { exp(squares.sqrt() / sum) } else { 1.0 }
        };
        let shared = |sum: f64, error: &dyn Fn(&Self) -> f64, value: &dyn Fn(&Self) -> f64| {
            if sum > 0.0 { mean(&|part| error(part) * value(part)) / sum } else { mean(value) }
        };
        let (squared, relative) = (|part: &Self| part.rmse * part.rmse, |part: &Self| part.rel_mse);
        Some(Self {
            spp: parts.iter().map(|(_, part)| part.spp).min()?,
            rmse: mse.sqrt(),
            rel_mse,
            rmse_band: spread(mse, &squared, &|part| part.rmse_band),
            rel_mse_band: spread(rel_mse, &relative, &|part| part.rel_mse_band),
            rate: shared(mse, &squared, &|part| part.rate),
            rel_rate: shared(rel_mse, &relative, &|part| part.rel_rate),
            rel_parts: std::array::from_fn(|index| mean(&|part| part.rel_parts[index])),
        })
    }

    /// What `rel_mse` will be after so many doublings of the samples.
    pub(crate) fn rel_mse_after(&self, doublings: u32) -> f64 {
        self.falling(RATES, f64::from(doublings))
    }

    fn falling(&self, rates: [f64; 3], doublings: f64) -> f64 {
        self.rel_parts.iter().zip(rates).map(|(part, rate)| part * exp2(-rate * doublings)).sum()
    }

    /// What the estimate will be after so many doublings, rather than the error.
    fn estimate_at(&self, doublings: f64) -> f64 {
        let share = if self.rel_mse > 0.0 { self.rel_parts[0] / self.rel_mse } else { 1.0 };
        let alone = ((share - CHANCE_ALONE) / (1.0 - CHANCE_ALONE)).clamp(0.0, 1.0);
        let [chance, edges, smooth] = RATES;
        self.falling([chance - alone * (chance - RATE_SEEN), edges, smooth], doublings)
    }

    /// The relative mean squared error that a picture is held to have when it is asked whether it may end: one standard deviation of
    /// the estimate above it. A picture is asked after every round and ends with the first that will do, so an estimate that is
    /// too small by chance would be picked out of all; without the margin pictures would be worse on average than they were asked to be.
    pub fn cautious(&self) -> f64 {
        self.rel_mse * self.margin()
    }

    /// The band has two deviations on each side.
    pub(crate) fn margin(&self) -> f64 {
        self.rel_mse_band.sqrt()
    }

    /// Samples per pixel after which the estimated `rel_mse` will be `target`; fewer than `spp` where it is below already. None for a target that
    /// is not positive and a picture without error.
    pub fn predict(&self, target: f64) -> Option<Prediction> {
        self.when(target, |doublings| self.estimate_at(doublings))
    }

    /// The same for [`Self::cautious`], which falls faster: what is known of the decay grows with the levels that it is read off. What
    /// rare samples do to the estimate is taken to stay, as they become known only when they are met.
    pub fn predict_cautious(&self, target: f64) -> Option<Prediction> {
        let now = log(self.rel_mse_band) / DEVIATIONS;
        let levels = log2(self.spp as f64);
        let of_law = |levels: f64| variance_of_law(levels.max(1.0));
        let chance = (now * now - of_law(levels)).max(0.0);
        let margin = |doublings: f64| {
            let deviation = (of_law(levels + doublings) + chance).sqrt().min(now);
            exp(0.5 * DEVIATIONS * deviation)
        };
        self.when(target, |doublings| self.estimate_at(doublings) * margin(doublings))
    }

    /// When a falling function of the doublings ahead will be `target`.
    fn when(&self, target: f64, error: impl Fn(f64) -> f64) -> Option<Prediction> {
        if target <= 0.0 || self.rel_mse <= 0.0 {
            return None;
        }
        // Between no and too many doublings.
        let (mut low, mut high) = (-LEVELS, LEVELS);
        while high - low > 1e-6 {
            let middle = 0.5 * (low + high);
            if error(middle) > target { low = middle } else { high = middle }
        }
        let doublings = 0.5 * (low + high);
        // The estimate then will be as far off as this one, and not in the same direction.
        let now = std::f64::consts::SQRT_2 * log(self.rel_mse_band);
        let ahead = DEVIATIONS * DEVIATION_PER_DOUBLING * doublings;
        Some(Prediction {
            spp: self.spp as f64 * exp2(doublings),
            band: exp(hypot(now, ahead) / self.rel_rate.max(1.0)),
        })
    }
}

/// Decay of the mean squared error and of the relative one.
pub(crate) struct Decays {
    squared: Decay,
    relative: Decay,
}

impl Decays {
    /// None where no two samples were compared.
    pub fn new(differences: &Differences) -> Option<Self> {
        let levels = differences.levels().iter();
        let (squared, mut relative): (Vec<_>, Vec<_>) = levels
            .map(|level| {
                (
                    Observed::new(level.pairs, level.squared.value(), level.squared_spread.value()),
                    Observed::new(
                        level.relative_pairs,
                        level.relative.value(),
                        level.relative_spread.value(),
                    ),
                )
            })
            .unzip();
        completed(&mut relative, &squared);
        Some(Self {
            squared: Decay::new(&squared, AGEING_SQUARED)?,
            relative: Decay::new(&relative, AGEING_RELATIVE)?,
        })
    }

    /// The error of the mean over the disjoint `blocks`.
    pub fn estimate(&self, blocks: &[SampleBlock]) -> ErrorEstimate {
        let spp = blocks.iter().map(|block| block.samples()).sum();
        let parts: Vec<_> = blocks.iter().copied().flat_map(powers_of_two).collect();
        let rel_mse = variance_of_mean(&self.relative, &parts);
        let band = |deviation: f64| exp(DEVIATIONS * deviation);
        ErrorEstimate {
            spp,
            rmse: variance_of_mean(&self.squared, &parts).sqrt(),
            rel_mse,
            rmse_band: band(self.squared.deviation / 2.0),
            rel_mse_band: band(self.relative.deviation),
            rate: self.squared.rate(),
            rel_rate: self.relative.rate(),
            rel_parts: self.relative.shares().map(|share| share * rel_mse),
        }
    }
}

/// First sample and level of aligned blocks of powers of two that make up `block`: several for a short last leaf.
fn powers_of_two(block: SampleBlock) -> impl Iterator<Item = (u64, u32)> {
    let mut start = block.start();
    std::iter::from_fn(move || {
        let left = block.end() - start;
        let level = left.checked_ilog2()?;
        let part = (start, level);
        start += 1 << level;
        Some(part)
    })
}

/// `sum_ij n_i n_j C_ij / n^2`. Not below the variance that the whole range filled up to a power of two would have.
fn variance_of_mean(decay: &Decay, parts: &[(u64, u32)]) -> f64 {
    let count = |level: u32| (1_u64 << level) as f64;
    let samples: f64 = parts.iter().map(|&(_, level)| count(level)).sum();
    let mut variance = 0.0;
    for (index, &(start, level)) in parts.iter().enumerate() {
        variance += count(level) * count(level) * decay.variance(level);
        for &(other, other_level) in &parts[..index] {
            let common = u64::BITS - (start ^ other).leading_zeros();
            variance += 2.0 * count(level) * count(other_level) * decay.covariance(common);
        }
    }
    (variance / (samples * samples)).max(decay.variance(log2(samples).ceil() as u32))
}
