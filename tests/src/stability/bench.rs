//! How a case reports: measured against expected, under a rule that is written down with it.

use super::measure::Measurement;
use farm_film::Counters;
use serde::Serialize;
use std::time::Instant;

/// Statistical checks that the suite may hold: the family over which [`FAMILY_ERROR`] is shared.
pub const FAMILY: u32 = 256;

/// Chance that any statistical check of a flawless renderer is red.
pub const FAMILY_ERROR: f64 = 1e-4;

/// Largest standard error that a statistical check may have, relative to the expected value: 0.5 % is then five of them.
pub const POWER: f64 = 1e-3;

/// Relative rounding of a value that went through single precision: a sample's value is a product of a few dozen factors each
/// rounded by 2^-24, so it may be off by `gamma(32)` = 32 x 2^-24 = 1.9e-6 though no two samples differ.
pub const ROUNDING: f64 = 1.9e-6;

/// Largest error of direct light, relative: the page's second bound beside the statistical one.
pub const DIRECT: f64 = 2e-3;

/// Standard errors that an estimate may be off: the two-sided normal quantile of Sidak's `1 - (1 - e)^(1/m)`.
pub fn family_z() -> f64 {
    let each = -f64::ln_1p(-FAMILY_ERROR) / f64::from(FAMILY);
    let each = -f64::exp_m1(-each);
    // Newton's method on the tail of the normal distribution, from a bound above: converges in a few steps.
    let mut z = 5.0;
    for _ in 0..20 {
        let tail = libm::erfc(z / std::f64::consts::SQRT_2);
        let slope = -(2.0 / std::f64::consts::PI).sqrt() * f64::exp(-z * z / 2.0);
        z -= (tail - each) / slope;
    }
    z
}

/// When a check is green.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Rule {
    /// Measured is expected, to the last bit.
    Exact,
    /// Within [`family_z`] standard errors and rounding, at most this far off relatively, with a standard error of at most `power`
    /// of the expected value.
    Statistical {
        /// Largest relative error.
        relative: f64,
        /// Largest relative standard error.
        power: f64,
    },
    /// At most this far off, relatively.
    Relative(f64),
    /// At most this far off.
    Absolute(f64),
    /// Measured is not above expected.
    AtMost,
    /// Measured is not below expected.
    AtLeast,
}

/// One line of the table.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The case's name on the list of cases.
    pub id: &'static str,
    /// The case in words.
    pub what: &'static str,
    /// What distinguishes this check from the case's others.
    pub parameters: String,
    /// The answer, or the bound that it is held against.
    pub expected: f64,
    /// What the renderer said.
    pub measured: f64,
    /// Between-replicate standard error of `measured`, where there is one.
    pub standard_error: Option<f64>,
    /// When it is green.
    pub rule: Rule,
    /// Samples taken.
    pub samples: u64,
    /// Samples that could not be taken at face value; any makes a check red.
    pub faults: u64,
    /// Wall time since the case's previous check.
    pub seconds: f64,
    /// Why it is red; none when it is green.
    pub fault: Option<String>,
}

impl Row {
    /// Distance to the expected value.
    pub fn error(&self) -> f64 {
        if self.measured == self.expected { 0.0 } else { self.measured - self.expected }
    }

    /// Distance relative to the expected value; none for zero.
    pub fn relative_error(&self) -> Option<f64> {
        (self.expected != 0.0).then(|| self.error() / self.expected.abs())
    }

    /// Distance in standard errors.
    pub fn sigmas(&self) -> Option<f64> {
        self.standard_error.filter(|&se| se > 0.0).map(|se| self.error() / se)
    }

    /// Whether the check is green.
    pub fn passed(&self) -> bool {
        self.fault.is_none()
    }

    /// How much of what its rule allows is used up: 1 is the limit. Zero where nothing is allowed, or a bound is merely kept.
    pub fn strain(&self) -> f64 {
        if !self.passed() {
            return f64::INFINITY;
        }
        let (error, size) = (self.error().abs(), self.expected.abs());
        let share = match self.rule {
            Rule::Relative(bound) => error / (bound * size),
            Rule::Absolute(bound) => error / bound,
            Rule::Statistical { .. } => {
                error / (family_z() * self.standard_error.unwrap_or(0.0) + ROUNDING * size)
            }
            Rule::Exact | Rule::AtMost | Rule::AtLeast => 0.0,
        };
        if share.is_finite() { share } else { 0.0 }
    }

    fn judge(&self) -> Option<String> {
        if self.faults > 0 {
            return Some(format!("{} samples were not finite or negative", self.faults));
        }
        if !self.measured.is_finite() || !self.expected.is_finite() {
            return Some("not finite".to_owned());
        }
        let (error, size) = (self.error().abs(), self.expected.abs());
        let red = |what: &str| Some(what.to_owned());
        match self.rule {
            Rule::Exact if error != 0.0 => red("not the same"),
            Rule::Relative(bound) if error > bound * size => Some(format!("more than {bound:e} off")),
            Rule::Absolute(bound) if error > bound => Some(format!("more than {bound:e} off")),
            Rule::AtMost if self.measured > self.expected => red("above the bound"),
            Rule::AtLeast if self.measured < self.expected => red("below the bound"),
            Rule::Statistical { relative, power } => {
                let se = self.standard_error.unwrap_or(f64::INFINITY);
                if se > power * size {
                    Some(format!("standard error above {power:e} of the value: would not see a bias"))
                } else if error > family_z() * se + ROUNDING * size {
                    red("too many standard errors off")
                } else if error > relative * size {
                    Some(format!("more than {relative:e} off"))
                } else {
                    None
                }
            }
            _ => None,
        }
    }
}

/// How much work a run may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// For the test command: minutes, and no check that is about wall time.
    Short,
    /// All of it.
    Full,
}

/// Collects the rows of one case.
#[derive(Debug)]
pub struct Bench {
    id: &'static str,
    what: &'static str,
    effort: Effort,
    since: Instant,
    rows: Vec<Row>,
}

impl Bench {
    /// An empty sheet for a case.
    pub fn new(id: &'static str, what: &'static str, effort: Effort) -> Self {
        Self { id, what, effort, since: Instant::now(), rows: Vec::new() }
    }

    /// Whether time does not matter much, and wall time may be judged.
    pub fn is_full(&self) -> bool {
        self.effort == Effort::Full
    }

    /// `short`, or `full` in a full run.
    pub fn pick<T>(&self, short: T, full: T) -> T {
        if self.is_full() { full } else { short }
    }

    /// The rows so far.
    pub fn into_rows(self) -> Vec<Row> {
        self.rows
    }

    fn push(&mut self, parameters: impl Into<String>, expected: f64, found: &Measurement, rule: Rule) {
        let mut row = Row {
            id: self.id,
            what: self.what,
            parameters: parameters.into(),
            expected,
            measured: found.mean,
            standard_error: found.standard_error,
            rule,
            samples: found.counters.samples,
            faults: found.counters.faults(),
            seconds: self.since.elapsed().as_secs_f64(),
            fault: None,
        };
        row.fault = row.judge();
        self.rows.push(row);
        self.since = Instant::now();
    }

    /// A check by the suite's statistics: [`family_z`] standard errors, a standard error of at most [`POWER`].
    pub fn statistical(&mut self, parameters: impl Into<String>, expected: f64, found: Measurement) {
        self.push(parameters, expected, &found, Rule::Statistical { relative: f64::INFINITY, power: POWER });
    }

    /// The same with the bound that holds for direct light besides.
    pub fn direct(&mut self, parameters: impl Into<String>, expected: f64, found: Measurement) {
        self.push(parameters, expected, &found, Rule::Statistical { relative: DIRECT, power: POWER });
    }

    /// The same with another power, which the case has to justify.
    pub fn coarse(&mut self, parameters: impl Into<String>, expected: f64, found: Measurement, power: f64) {
        self.push(parameters, expected, &found, Rule::Statistical { relative: f64::INFINITY, power });
    }

    /// A check against a fixed relative tolerance.
    pub fn relative(
        &mut self,
        parameters: impl Into<String>,
        expected: f64,
        found: impl Into<Measurement>,
        tolerance: f64,
    ) {
        self.push(parameters, expected, &found.into(), Rule::Relative(tolerance));
    }

    /// A check against a fixed absolute tolerance.
    pub fn absolute(
        &mut self,
        parameters: impl Into<String>,
        expected: f64,
        found: impl Into<Measurement>,
        tolerance: f64,
    ) {
        self.push(parameters, expected, &found.into(), Rule::Absolute(tolerance));
    }

    /// A check to the last bit.
    pub fn exact(&mut self, parameters: impl Into<String>, expected: f64, found: impl Into<Measurement>) {
        self.push(parameters, expected, &found.into(), Rule::Exact);
    }

    /// A check against a bound from above.
    pub fn at_most(&mut self, parameters: impl Into<String>, bound: f64, found: impl Into<Measurement>) {
        self.push(parameters, bound, &found.into(), Rule::AtMost);
    }

    /// A check against a bound from below.
    pub fn at_least(&mut self, parameters: impl Into<String>, bound: f64, found: impl Into<Measurement>) {
        self.push(parameters, bound, &found.into(), Rule::AtLeast);
    }

    /// A check of something that holds or does not.
    pub fn holds(&mut self, parameters: impl Into<String>, holds: bool) {
        self.exact(parameters, 1.0, f64::from(u8::from(holds)));
    }

    /// A red row for a case that fell over.
    pub fn fell(&mut self, reason: String) {
        self.push("", 0.0, &Measurement::from(1.0), Rule::Exact);
        if let Some(row) = self.rows.last_mut() {
            row.fault = Some(reason);
        }
    }
}

impl From<f64> for Measurement {
    fn from(mean: f64) -> Self {
        Self { mean, standard_error: None, counters: Counters::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(expected: f64, mean: f64, se: f64, faults: u64) -> bool {
        let mut bench = Bench::new("T0", "a made-up case", Effort::Short);
        let counters = Counters { nan: faults, ..Counters::default() };
        bench.statistical("", expected, Measurement { mean, standard_error: Some(se), counters });
        bench.into_rows()[0].passed()
    }

    #[test]
    fn the_family_shares_one_error() {
        let each = libm::erfc(family_z() / std::f64::consts::SQRT_2);
        let family = 1.0 - (1.0 - each).powi(FAMILY as i32);
        assert!((family / FAMILY_ERROR - 1.0).abs() < 1e-6, "{family}");
        assert!((4.9..5.2).contains(&family_z()));
    }

    #[test]
    fn a_bias_of_half_a_percent_is_red_and_noise_is_green() {
        assert!(verdict(1.0, 1.0 + 4.0 * 9e-4, 9e-4, 0), "four standard errors happen");
        assert!(!verdict(1.0, 1.0 + 6.0 * 8e-4, 8e-4, 0), "six do not");
        assert!(!verdict(1.0, 1.0, 2e-3, 0), "too weak to see a bias");
        assert!(!verdict(1.0, 1.0, 5e-4, 1), "a NaN that was swallowed");
        assert!(!verdict(1.0, f64::NAN, 5e-4, 0));
        assert!(verdict(1.0, 1.0 + 1e-6, 0.0, 0), "rounding is no bias");
    }
}
