//! Replicates summed up: medians and spread, and whether the goals are met.

use super::study::{Checkpoint, Reference, TrueError};
use farm_scene::Filter;
use serde::Serialize;

/// Bounds of estimated over true error, where it is held against them.
pub const RATIO: std::ops::RangeInclusive<f64> = 0.8..=1.25;

/// Samples per pixel from which the estimate is held against [`RATIO`].
pub const RATIO_FROM: u64 = 64;

/// Samples per pixel from which the sequence must not be worse than independent samples.
pub const SEQUENCE_FROM: u64 = 16;

/// Bounds of the predicted over the real time to the end, predicted at a quarter of it.
pub const PREDICTION: std::ops::RangeInclusive<f64> = 0.8..=1.2;

/// Of one number over replicates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Half of the replicates lie below.
    pub median: f64,
    /// The smallest.
    pub low: f64,
    /// The largest.
    pub high: f64,
}

impl Spread {
    /// None without values.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_by(f64::total_cmp);
        let (low, high) = (*values.first()?, *values.last()?);
        let median = 0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2]);
        Some(Self { median, low, high })
    }
}

/// One number of samples.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    /// Samples per pixel.
    pub spp: u64,
    /// CPU seconds of one picture, median.
    pub seconds: f64,
    /// True root mean squared error.
    pub rmse: Spread,
    /// True mean of squared error over `value^2 + 0.01`.
    pub rel_mse: Spread,
    /// Estimated over true root mean squared error; none for a single sample.
    pub ratio: Option<Spread>,
    /// The same of the roots of the relative errors.
    pub rel_ratio: Option<Spread>,
    /// Share of the replicates whose true error lies in the estimate's band.
    pub in_band: Option<f64>,
    /// Estimated over true root mean squared error of tiles, over all tiles and replicates: median, 5 % and 95 %.
    pub tile_ratio: Option<Spread>,
    /// True root mean squared error of independent samples.
    pub independent: Option<Spread>,
}

/// One scene through one filter.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// Name of the scene.
    pub scene: &'static str,
    /// Name of the filter.
    pub filter: &'static str,
    /// By number of samples.
    pub points: Vec<Point>,
    /// Of the root mean squared error over CPU time, log over log, over the last four points.
    pub slope: f64,
    /// Predicted over real time until the last point's estimated relative error is reached, predicted two doublings before.
    pub prediction: Option<Spread>,
    /// Root mean squared error that the reference has left, which is subtracted.
    pub reference_rmse: f64,
}

/// How a filter is called in tables.
pub fn filter_name(filter: Filter) -> &'static str {
    match filter {
        Filter::Box => "box",
        Filter::Gaussian => "gaussian",
        Filter::BlackmanHarris => "blackman-harris",
    }
}

impl Outcome {
    /// Sums up replicates of the sequence, and of independent samples.
    pub fn new(
        scene: &'static str,
        filter: Filter,
        reference: &Reference,
        sobol: &[Vec<Checkpoint>],
        independent: &[Vec<Checkpoint>],
    ) -> Self {
        let count = sobol.first().map_or(0, Vec::len);
        let column = |runs: &'_ [Vec<Checkpoint>], index: usize| -> Vec<Checkpoint> {
            runs.iter().map(|run| run[index].clone()).collect()
        };
        let points: Vec<_> = (0..count)
            .map(|index| point(reference, &column(sobol, index), &column(independent, index)))
            .collect();
        Self {
            scene,
            filter: filter_name(filter),
            slope: slope(&points),
            points,
            prediction: Spread::of(sobol.iter().filter_map(|run| prediction(run))),
            reference_rmse: reference.rmse(),
        }
    }

    /// Goals that are not met, a sentence each.
    pub fn misses(&self) -> Vec<String> {
        let place = |point: &Point| format!("{}, {} filter, {} spp", self.scene, self.filter, point.spp);
        let mut misses = Vec::new();
        for point in &self.points {
            if let Some(ratio) = point.ratio.filter(|ratio| !RATIO.contains(&ratio.median))
                && point.spp >= RATIO_FROM
            {
                misses.push(format!("{}: estimated over true error is {:.2}", place(point), ratio.median));
            }
            if let Some(ratio) = point.rel_ratio.filter(|ratio| !RATIO.contains(&ratio.median))
                && point.spp >= RATIO_FROM
            {
                misses.push(format!(
                    "{}: roots of relative errors, estimated over true, are {:.2}",
                    place(point),
                    ratio.median
                ));
            }
            if let Some(independent) = point.independent.filter(|other| other.median < point.rmse.median)
                && point.spp >= SEQUENCE_FROM
            {
                let share = point.rmse.median / independent.median;
                misses.push(format!("{}: error is {share:.2} of that of independent samples", place(point)));
            }
        }
        if let Some(prediction) = self.prediction.filter(|ratio| !PREDICTION.contains(&ratio.median)) {
            misses.push(format!(
                "{}, {} filter: predicted time to the end is {:.2} of the real one",
                self.scene, self.filter, prediction.median
            ));
        }
        misses
    }
}

fn point(reference: &Reference, sobol: &[Checkpoint], independent: &[Checkpoint]) -> Point {
    let truths: Vec<TrueError> = sobol.iter().map(|checkpoint| reference.error(&checkpoint.pixels)).collect();
    let estimated = || sobol.iter().zip(&truths).filter_map(|(found, truth)| Some((found.estimate?, *truth)));
    let ratios: Vec<_> =
        estimated().map(|(estimate, truth)| (estimate.rmse / truth.rmse, estimate.rmse_band)).collect();
    let within = ratios.iter().filter(|(ratio, band)| (1.0 / band..=*band).contains(ratio)).count();
    let tiles = sobol.iter().flat_map(|found| {
        found.tiles.iter().map(move |(part, estimate)| estimate / reference.rmse_of(&found.pixels, part))
    });
    Point {
        spp: sobol[0].spp,
        seconds: Spread::of(sobol.iter().map(|found| found.seconds)).map_or(0.0, |spread| spread.median),
        rmse: Spread::of(truths.iter().map(|truth| truth.rmse)).expect("at least one replicate"),
        rel_mse: Spread::of(truths.iter().map(|truth| truth.rel_mse)).expect("at least one replicate"),
        ratio: Spread::of(ratios.iter().map(|(ratio, _)| *ratio)),
        rel_ratio: Spread::of(estimated().map(|(estimate, truth)| (estimate.rel_mse / truth.rel_mse).sqrt())),
        in_band: (!ratios.is_empty()).then(|| within as f64 / ratios.len() as f64),
        tile_ratio: inner(tiles.filter(|ratio| ratio.is_finite()).collect()),
        independent: Spread::of(independent.iter().map(|found| reference.error(&found.pixels).rmse)),
    }
}

/// Median and the bounds between which 90 % lie.
fn inner(mut values: Vec<f64>) -> Option<Spread> {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get((share * (values.len().max(1) - 1) as f64).round() as usize).copied();
    Some(Spread { median: at(0.5)?, low: at(0.05)?, high: at(0.95)? })
}

fn slope(points: &[Point]) -> f64 {
    let last = &points[points.len().saturating_sub(4)..];
    let logs: Vec<_> = last.iter().map(|point| (point.seconds.ln(), point.rmse.median.ln())).collect();
    let n = logs.len() as f64;
    let (x, y) = logs.iter().fold((0.0, 0.0), |(x, y), log| (x + log.0 / n, y + log.1 / n));
    let (xx, xy) = logs
        .iter()
        .fold((0.0, 0.0), |(xx, xy), log| (xx + (log.0 - x) * (log.0 - x), xy + (log.0 - x) * (log.1 - y)));
    xy / xx
}

/// Predicted time over the real one. The target is what the estimate is at the end; known is what a quarter of the samples say.
fn prediction(run: &[Checkpoint]) -> Option<f64> {
    let [.., known, _, end] = run else { return None };
    let predicted = known.estimate?.predict(end.estimate?.rel_mse)?;
    Some(known.seconds * predicted.spp / known.spp as f64 / end.seconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_median_lies_between_the_middle_two() {
        assert_eq!(Spread::of([3.0, 1.0, 2.0]), Some(Spread { median: 2.0, low: 1.0, high: 3.0 }));
        assert_eq!(Spread::of([4.0, 1.0, 2.0, 3.0]).unwrap().median, 2.5);
        assert_eq!(Spread::of([]), None);
    }
}
