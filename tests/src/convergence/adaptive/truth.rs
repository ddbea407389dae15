//! What replicates converge to, and how far adaptive ones are from it.

use super::{Effort, Replicate, tiles};
use farm_film::Rgb;
use farm_render::PreparedScene;

/// What the replicates converge to: the mean of their full pictures, for each replicate that of the others.
pub(super) struct Truth {
    count: f64,
    /// Sums over replicates.
    sums: Vec<[f64; 3]>,
    /// Variance of single full pictures.
    variances: Vec<[f64; 3]>,
}

impl Truth {
    pub fn new(replicates: &[Replicate]) -> Self {
        let count = replicates.len() as f64;
        let full = || replicates.iter().map(|replicate| replicate.full());
        let pixels = replicates[0].stopped.pixels.len();
        let (mut sums, mut variances) = (vec![[0.0; 3]; pixels], vec![[0.0; 3]; pixels]);
        for picture in full() {
            for (sum, value) in sums.iter_mut().flatten().zip(picture.iter().flatten()) {
                *sum += f64::from(*value);
            }
        }
        for picture in full() {
            let values = picture.iter().flatten().zip(sums.iter().flatten());
            for (variance, (value, sum)) in variances.iter_mut().flatten().zip(values) {
                *variance += (f64::from(*value) - sum / count).powi(2) / (count - 1.0);
            }
        }
        Self { count, sums, variances }
    }

    /// Squared error of a picture in one channel of a pixel, and the true value; `own`: the full picture of the same replicate.
    fn square(&self, picture: &[Rgb], own: &[Rgb], pixel: usize, channel: usize) -> (f64, f64) {
        let others = self.count - 1.0;
        let truth = (self.sums[pixel][channel] - f64::from(own[pixel][channel])) / others;
        let square = (f64::from(picture[pixel][channel]) - truth).powi(2);
        (square - self.variances[pixel][channel] / others, truth)
    }

    pub fn rel_mse(&self, picture: &[Rgb], own: &[Rgb]) -> f64 {
        let all: Vec<usize> = (0..picture.len()).collect();
        self.rel_mse_of(picture, own, &all)
    }

    /// Of some pixels.
    pub fn rel_mse_of(&self, picture: &[Rgb], own: &[Rgb], pixels: &[usize]) -> f64 {
        let at = |pixel: usize, channel: usize| {
            let (square, truth) = self.square(picture, own, pixel, channel);
            square / (truth * truth + 0.01)
        };
        let sum: f64 = pixels.iter().map(|pixel| at(*pixel, 0) + at(*pixel, 1) + at(*pixel, 2)).sum();
        sum / (3 * pixels.len()) as f64
    }
}

/// How far the mean of adaptive pictures is from that of full ones.
pub(super) struct Bias {
    /// Of the whole picture.
    pub frame: f64,
    /// Standard error of that.
    pub frame_error: f64,
    /// Mean over tiles of the square of bias over noise, without what chance explains.
    pub square: f64,
    /// Standard error of that.
    pub square_error: f64,
}

impl Bias {
    pub fn new(scene: &PreparedScene, effort: Effort, replicates: &[Replicate], truth: &Truth) -> Self {
        let tiles = tiles(scene, effort);
        let (mut squares, mut chances) = (Vec::new(), Vec::new());
        for pixels in &tiles {
            let (bias, error) = difference(replicates, pixels);
            let noise = noise(replicates, truth, pixels);
            // A tile without noise has no samples that could decide anything.
            if noise > 0.0 {
                squares.push((bias * bias - error * error) / noise);
                chances.push(error * error / noise);
            }
        }
        let count = squares.len() as f64;
        let all: Vec<usize> = tiles.into_iter().flatten().collect();
        let (frame, frame_error) = difference(replicates, &all);
        let mean = truth.sums.iter().flatten().sum::<f64>() / (truth.count * 3.0 * truth.sums.len() as f64);
        Self {
            frame: frame / mean,
            frame_error: frame_error / mean,
            square: squares.iter().sum::<f64>() / count,
            // The square of a normal variable has twice its variance's square as variance.
            square_error: (2.0 * chances.iter().map(|chance| chance * chance).sum::<f64>()).sqrt() / count,
        }
    }
}

/// Adaptive minus full picture, mean over some pixels and all replicates, with its standard error.
fn difference(replicates: &[Replicate], pixels: &[usize]) -> (f64, f64) {
    let of_one = |replicate: &Replicate| {
        let full = replicate.full();
        let channel = |pixel: usize, channel: usize| {
            f64::from(replicate.adaptive.pixels[pixel][channel]) - f64::from(full[pixel][channel])
        };
        let sum: f64 = pixels.iter().map(|at| channel(*at, 0) + channel(*at, 1) + channel(*at, 2)).sum();
        sum / (3 * pixels.len()) as f64
    };
    let found: Vec<f64> = replicates.iter().map(of_one).collect();
    let count = found.len() as f64;
    let mean = found.iter().sum::<f64>() / count;
    let variance = found.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    (mean, (variance / count).sqrt())
}

/// Mean squared error of some pixels of adaptive pictures.
fn noise(replicates: &[Replicate], truth: &Truth, pixels: &[usize]) -> f64 {
    let square = |replicate: &Replicate, pixel: usize, channel: usize| {
        let own = replicate.full();
        truth.square(&replicate.adaptive.pixels, own, pixel, channel).0
    };
    let of_one = |replicate: &Replicate| -> f64 {
        pixels.iter().map(|at| (0..3).map(|channel| square(replicate, *at, channel)).sum::<f64>()).sum()
    };
    replicates.iter().map(of_one).sum::<f64>() / (3 * pixels.len() * replicates.len()) as f64
}
