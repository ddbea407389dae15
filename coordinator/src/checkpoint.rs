//! What a frame has cost and how wrong it still is, at one moment of its life.

use crate::forecast::Forecast;
use farm_film::{Counters, ErrorEstimate};
use farm_image::Comparison;
use serde::Serialize;
use std::time::{Duration, Instant};

/// Checkpoints that a slope is taken over.
const SLOPE_OVER: usize = 4;

/// What some samples took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Spent {
    /// What was traced.
    pub counters: Counters,
    /// Time on slots of workers.
    pub busy: Duration,
    /// Processor time, as the workers measured it.
    pub cpu: Duration,
}

impl Spent {
    /// When what was delivered `at` this moment was begun.
    pub fn begun(self, at: Instant) -> Instant {
        at.checked_sub(self.busy).unwrap_or(at)
    }

    /// Sums of both.
    pub fn plus(self, other: Self) -> Self {
        Self {
            counters: self.counters.plus(other.counters),
            busy: self.busy.saturating_add(other.busy),
            cpu: self.cpu.saturating_add(other.cpu),
        }
    }
}

/// A frame at a moment when every tile had the same samples, or at its end. What was rendered beyond them is not part of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Checkpoint {
    /// Samples per pixel; the most, where tiles have ended on their own.
    pub spp: u64,
    /// Samples over all pixels.
    pub samples: u64,
    /// From the first unit begun to the last that is part of it.
    pub seconds: f64,
    /// Processor time of all workers.
    pub cpu_seconds: f64,
    /// Workers that had delivered something.
    pub workers: usize,
    /// Rays from the camera.
    pub rays_camera: u64,
    /// Rays that continue a path.
    pub rays_extension: u64,
    /// Rays that ask whether a light is visible.
    pub rays_shadow: u64,
    /// Estimated error.
    pub estimate: Option<ErrorEstimate>,
    /// Error against a reference, when one was given.
    pub truth: Option<Comparison>,
    /// `1 / (estimated mean squared error * processor seconds)`.
    pub efficiency: Option<f64>,
    /// Slope of log(estimated root mean squared error) over log(seconds), over the last four checkpoints; -0.5 is that of
    /// independent samples.
    pub slope: Option<f64>,
    /// When the frame would end, as it was expected then.
    pub forecast: Option<Forecast>,
}

impl Checkpoint {
    /// Of a picture that took `spent` within `seconds`.
    pub fn new(
        spp: u64,
        seconds: f64,
        spent: Spent,
        workers: usize,
        estimate: Option<ErrorEstimate>,
    ) -> Self {
        let cpu_seconds = spent.cpu.as_secs_f64();
        let cost = |error: ErrorEstimate| error.rmse * error.rmse * cpu_seconds;
        Self {
            spp,
            samples: spent.counters.samples,
            seconds,
            cpu_seconds,
            workers,
            rays_camera: spent.counters.rays_camera,
            rays_extension: spent.counters.rays_extension,
            rays_shadow: spent.counters.rays_shadow,
            estimate,
            truth: None,
            efficiency: estimate.map(cost).filter(|cost| *cost > 0.0).map(f64::recip),
            slope: None,
            forecast: None,
        }
    }

    /// Fills in the slope of the last of some checkpoints in order.
    pub fn relate(checkpoints: &mut [Self]) {
        let from = checkpoints.len().saturating_sub(SLOPE_OVER);
        let point = |checkpoint: &Self| Some((checkpoint.seconds, checkpoint.estimate?.rmse));
        let points: Vec<_> = checkpoints[from..].iter().filter_map(point).collect();
        if let Some(last) = checkpoints.last_mut() {
            last.slope = log_slope(&points);
        }
    }
}

/// Slope of the line of least squares through the logarithms of some points; none through fewer than two.
fn log_slope(points: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<_> =
        points.iter().filter(|(x, y)| *x > 0.0 && *y > 0.0).map(|(x, y)| (x.ln(), y.ln())).collect();
    let count = logs.len() as f64;
    let mean = |value: &dyn Fn(&(f64, f64)) -> f64| logs.iter().map(value).sum::<f64>() / count;
    let (x_mean, y_mean) = (mean(&|point| point.0), mean(&|point| point.1));
    let square: f64 = logs.iter().map(|(x, _)| (x - x_mean) * (x - x_mean)).sum();
    let product: f64 = logs.iter().map(|(x, y)| (x - x_mean) * (y - y_mean)).sum();
    (logs.len() > 1 && square > 0.0).then(|| product / square)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_of_a_power_law_is_its_exponent() {
        let law: Vec<_> = [1.0, 2.0, 4.5, 9.0].map(|x: f64| (x, 3.0 * x.powf(-0.7))).to_vec();
        assert!((log_slope(&law).unwrap() + 0.7).abs() < 1e-12);
        assert_eq!(log_slope(&law[..1]), None);
        assert_eq!(log_slope(&[(1.0, 0.0), (2.0, 0.0)]), None);
        assert_eq!(log_slope(&[(1.0, 0.5), (1.0, 0.6)]), None);
    }
}
