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
//! Differences up to the block's own size are observed; those beyond have to continue them. A picture is part chance, which falls
//! as `1/n` however samples are placed, and part what a net resolves: edges, which fall as `n^-3/2` to `n^-2` in few dimensions, and
//! smooth changes, as `n^-3` (Owen 1997). So `V(n)` is a sum of such powers with parts that are not negative, fitted to what was
//! observed last; a power `n^-r` contributes `2^r - 1` times its part to `D(n)`. Independent samples have the first part only, and
//! `V = D`. A picture that seems to converge fast is thus expected to slow down, as pictures do.

use libm::exp2;

/// Exponents of the powers of `1/n` that variances are made of. The middle one is what fits the edges of the benchmark set best.
pub(crate) const RATES: [f64; 3] = [1.0, 1.85, 3.0];

/// Levels that are looked back on.
const WINDOW: usize = 8;

/// Relative deviation of a difference from a smooth law: nets are better at some powers of two than at others.
const RIPPLE: f64 = 0.3;

/// Relative deviation that each level of squared errors has gathered more than the one after it, because the law holds roughly only.
pub(crate) const AGEING_SQUARED: f64 = 0.1;

/// The same of relative errors: what they are divided by is known the worse the fewer samples a block has.
pub(crate) const AGEING_RELATIVE: f64 = 0.3;

/// Rounds in which deviations are taken relative to what was fitted in the last one.
const ROUNDS: usize = 6;

/// Relative deviation of differences that are taken over from another measure of the same pairs.
const LIKENESS: f64 = 0.3;

/// Deviation of the logarithm of an estimated variance: of the best, and what a single observed level adds. From the benchmark set, where
/// 95 % of the true errors lie within the band that follows.
const DEVIATION: f64 = 0.1;
const DEVIATION_OF_ONE_LEVEL: f64 = 1.0;

/// A mean difference and how far it may be off.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Observed {
    /// `D(n)`, estimated.
    difference: f64,
    /// Variance of that, relative to its square.
    pub variance: f64,
}

impl Observed {
    /// From sums over pairs: of the values and of their squares. The square of a value has one and a half times the expectation of
    /// its variance: what chance alone does to the square of a normal variable.
    pub fn new(pairs: u64, sum: f64, sum_of_squares: f64) -> Option<Self> {
        (pairs > 0).then(|| Self {
            difference: sum / pairs as f64,
            variance: if sum > 0.0 { 2.0 / 3.0 * sum_of_squares / (sum * sum) } else { 0.0 },
        })
    }
}

/// Completes the smaller levels of one measure by those of another, which falls alike but is observed further down.
pub(crate) fn completed(levels: &mut [Option<Observed>], other: &[Option<Observed>]) {
    let Some((first, known)) = levels.iter().enumerate().find_map(|(index, level)| Some((index, (*level)?)))
    else {
        return;
    };
    let Some(shared) = other.get(first).copied().flatten().filter(|shared| shared.difference > 0.0) else {
        return;
    };
    let scale = known.difference / shared.difference;
    for (level, other) in levels[..first].iter_mut().zip(other) {
        *level = other.map(|other| Observed {
            difference: other.difference * scale,
            variance: other.variance + LIKENESS * LIKENESS,
        });
    }
}

/// The variance of means of aligned blocks.
#[derive(Clone, Debug)]
pub(crate) struct Decay {
    /// Entry `k` is of blocks of `2^k` samples.
    variances: Vec<f64>,
    /// The parts of the last variance, by [`RATES`].
    parts: [f64; 3],
    /// Standard deviation of the logarithm of the last variance, and of the error of a single picture around it.
    pub deviation: f64,
}

impl Decay {
    /// From differences of blocks of 2, 4, 8 .. samples, of which each is so much less certain than the next. None without any.
    pub fn new(levels: &[Option<Observed>], ageing: f64) -> Option<Self> {
        let top = levels.iter().rposition(Option::is_some)?;
        let levels = &levels[..=top];
        let parts = fit(levels, ageing);
        let last = parts.iter().sum();

        // From the last variance up to that of single samples. A level that nobody observed lies on the curve.
        let mut variances = vec![last];
        for (age, level) in levels.iter().rev().enumerate() {
            let difference =
                level.map_or_else(|| dot(&differences(age as f64), &parts), |level| level.difference);
            variances.push(variances[age] + difference);
        }
        variances.reverse();

        let observed = levels.iter().flatten();
        let chance = levels[top].map_or(0.0, |level| level.variance);
        let law = variance_of_law(observed.count() as f64);
        // The error of a picture scatters around its variance as the estimate of that does.
        let deviation = (law + 2.0 * chance).sqrt();
        Some(Self { variances, parts, deviation: if last > 0.0 { deviation } else { 0.0 } })
    }

    /// Which share of the last variance falls with each of [`RATES`]; all as the first where there is none.
    pub fn shares(&self) -> [f64; 3] {
        let sum: f64 = self.parts.iter().sum();
        if sum > 0.0 { self.parts.map(|part| part / sum) } else { [1.0, 0.0, 0.0] }
    }

    /// The variance falls as `n^-rate` at the last level.
    pub fn rate(&self) -> f64 {
        self.shares().iter().zip(RATES).map(|(share, rate)| share * rate).sum()
    }

    /// Variance of the mean of an aligned block of `2^level` samples.
    pub fn variance(&self, level: u32) -> f64 {
        let beyond = f64::from(level) - (self.variances.len() as f64 - 1.0);
        match self.variances.get(level as usize) {
            Some(variance) => *variance,
            None => RATES.iter().zip(self.parts).map(|(rate, part)| part * exp2(-rate * beyond)).sum(),
        }
    }

    /// Covariance of the means of any two disjoint blocks whose smallest common block has `2^level` samples: that of the common
    /// block's halves, because nested scrambling exchanges parts of a half at will.
    pub fn covariance(&self, level: u32) -> f64 {
        2.0 * self.variance(level) - self.variance(level - 1)
    }
}

/// Variance of the logarithm of a variance that is read off so many levels, because none follows the law exactly.
pub(crate) fn variance_of_law(levels: f64) -> f64 {
    let few = DEVIATION_OF_ONE_LEVEL / levels;
    DEVIATION * DEVIATION + few * few
}

/// What parts of 1 of a variance give to the difference of blocks that are `2^age` times smaller.
fn differences(age: f64) -> [f64; 3] {
    RATES.map(|rate| (exp2(rate) - 1.0) * exp2(rate * age))
}

/// The parts of the variance at the last level: least squares of relative deviations, over parts that are not negative. Relative to
/// what is fitted: relative to what was observed, the smallest difference would decide.
fn fit(levels: &[Option<Observed>], ageing: f64) -> [f64; 3] {
    // Of each level what parts of 1 would give, what was seen, and its relative deviation.
    let mut observed = Vec::new();
    for (age, level) in levels.iter().rev().take(WINDOW).enumerate() {
        let Some(level) = level.filter(|level| level.difference > 0.0) else { continue };
        let age = age as f64;
        let deviation = (level.variance + RIPPLE * RIPPLE + ageing * ageing * age * age).sqrt();
        observed.push((differences(age), level.difference, deviation));
    }
    let mut parts = None;
    for _ in 0..ROUNDS {
        let row = |(of_one, seen, deviation): &([f64; 3], f64, f64)| {
            let unit = deviation * parts.map_or(*seen, |parts| dot(of_one, &parts));
            (of_one.map(|part| part / unit), seen / unit)
        };
        parts = Some(best_parts(&observed.iter().map(row).collect::<Vec<_>>()));
    }
    parts.unwrap_or_default()
}

/// Few enough parts to try all choices of those that are not zero; the first wins a tie: chance alone, then neighbouring powers.
fn best_parts(rows: &[([f64; 3], f64)]) -> [f64; 3] {
    let choices: [&[usize]; 7] = [&[0], &[1], &[2], &[0, 1], &[1, 2], &[0, 2], &[0, 1, 2]];
    let mut best = (f64::INFINITY, [0.0; 3]);
    for parts in choices.iter().filter_map(|chosen| least_squares(rows, chosen)) {
        let residual = |(row, target): &([f64; 3], f64)| {
            let off = dot(row, &parts) - target;
            off * off
        };
        let sum: f64 = rows.iter().map(residual).sum();
        if sum < best.0 * (1.0 - 1e-9) - 1e-12 || best.0.is_infinite() {
            best = (sum, parts);
        }
    }
    best.1
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Solves the normal equations of the `chosen` columns by elimination. None if they do not tell these columns apart, or if a part were
/// negative.
fn least_squares(rows: &[([f64; 3], f64)], chosen: &[usize]) -> Option<[f64; 3]> {
    let count = chosen.len();
    let mut system = [[0.0; 4]; 3];
    for (row, target) in rows {
        for (i, &a) in chosen.iter().enumerate() {
            for (j, &b) in chosen.iter().enumerate() {
                system[i][j] += row[a] * row[b];
            }
            system[i][3] += row[a] * target;
        }
    }
    for i in 0..count {
        let pivot = system[i];
        let diagonal: f64 = rows.iter().map(|(row, _)| row[chosen[i]] * row[chosen[i]]).sum();
        if pivot[i] <= 1e-9 * diagonal {
            return None;
        }
        for (_, row) in system.iter_mut().enumerate().take(count).filter(|(j, _)| *j != i) {
            let factor = row[i] / pivot[i];
            row.iter_mut().zip(pivot).for_each(|(value, other)| *value -= factor * other);
        }
    }
    let mut parts = [0.0; 3];
    for (i, &column) in chosen.iter().enumerate() {
        parts[column] = system[i][3] / system[i][i];
    }
    parts.iter().all(|part| *part >= 0.0).then_some(parts)
}
