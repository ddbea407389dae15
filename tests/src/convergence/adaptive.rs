//! What it gains that tiles end on their own, and how far it biases the picture.
//!
//! Every replicate is rendered in full once. The adaptive picture is made of the same samples, so the two differ only in where it
//! ended, and both have the same expectation unless ending there is a bias.

use super::stage::Stage;
use super::study::rendered;
use crate::scenes::Named;
use farm_film::{Film, FilmTile, LEAF_SAMPLES, Rgb, Tile};
use farm_render::PreparedScene;
use farm_scene::Filter;
use rayon::prelude::*;
use serde::Serialize;
use std::fmt::Write;

/// Replicate that says which error is wanted; none of those that are measured.
const SCOUT: u64 = 1 << 21;

/// Parts of a doubling after each of which a frame may end.
const PARTS: u64 = 16;

/// How much is measured.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Width and height of the pictures.
    pub resolution: [u32; 2],
    /// Side of a tile, pixels: small, so that a tile has few samples to decide on.
    pub tile_side: u32,
    /// Most samples per pixel, a power of two. The error that is wanted is that of half of them.
    pub spp_max: u64,
    /// Replicates.
    pub seeds: u64,
}

impl Effort {
    /// Samples per pixel over everything that is rendered.
    pub fn samples(self) -> u64 {
        self.spp_max / 2 + self.seeds * self.spp_max
    }
}

/// What was found for one scene.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// Its name.
    pub scene: &'static str,
    /// The relative mean squared error that was wanted.
    pub target: f64,
    /// Mean true relative mean squared error of the adaptive pictures.
    pub rel_mse: f64,
    /// Mean samples per pixel of the adaptive pictures.
    pub spp: f64,
    /// Samples per pixel after which uniform pictures have the same true error; none beyond the most.
    pub spp_uniform: Option<f64>,
    /// Bias of the mean of the whole picture, as a part of it.
    pub frame_bias: f64,
    /// Standard error of that.
    pub frame_bias_error: f64,
    /// Root mean square over tiles of the bias of a tile's mean over the noise of its pixels; what chance explains is subtracted.
    pub bias_over_noise: f64,
    /// What this is below in 95 % of all measurements.
    pub bias_over_noise_max: f64,
}

/// One replicate: pictures at every power of two from the leaf on, and the adaptive one.
struct Replicate {
    uniform: Vec<Vec<Rgb>>,
    adaptive: Vec<Rgb>,
    spp: f64,
}

/// Measures a scene. `done` hears of samples per pixel.
pub fn measure(named: Named, effort: Effort, done: &(dyn Fn(u64) + Sync)) -> Result<Outcome, String> {
    let scene = Stage::new(named)?.prepare(effort.resolution, Filter::Box)?;
    let mut scout = empty_film(&scene, effort, effort.spp_max / 2);
    for tile in scene.resolution().tiles(effort.tile_side) {
        scout.add(rendered(&scene, SCOUT, tile, 0..effort.spp_max / 2)).map_err(|err| err.to_string())?;
    }
    done(effort.spp_max / 2);
    let target = scout.error_estimate().ok_or("nothing is known of the error")?.rel_mse;
    let replicates: Vec<Replicate> =
        (0..effort.seeds).into_par_iter().map(|seed| replicate(&scene, effort, seed, target, done)).collect();
    Ok(sum_up(named.name, &scene, effort, target, &replicates))
}

fn empty_film(scene: &PreparedScene, effort: Effort, spp: u64) -> Film {
    Film::new(scene.resolution(), effort.tile_side, spp).expect("at least one sample")
}

fn replicate(
    scene: &PreparedScene,
    effort: Effort,
    seed: u64,
    target: f64,
    done: &(dyn Fn(u64) + Sync),
) -> Replicate {
    let (mut full, mut film) =
        (empty_film(scene, effort, effort.spp_max), empty_film(scene, effort, effort.spp_max));
    let (mut uniform, mut ended, mut spp) = (Vec::new(), false, 0);
    while spp < effort.spp_max {
        // Frames may end after a sixteenth of a doubling, tiles only after a whole one.
        let doubled: u64 = if spp == 0 { 0 } else { 1 << spp.ilog2() };
        let end = spp + (doubled / PARTS).max(LEAF_SAMPLES);
        for tile in scene.resolution().tiles(effort.tile_side) {
            let partial: FilmTile = rendered(scene, seed, tile, spp..end);
            if !ended {
                film.add(partial.clone()).expect("a part of this film");
            }
            full.add(partial).expect("a part of this film");
        }
        done(end - spp);
        spp = end;
        ended = ended || film.error_estimate().is_some_and(|error| error.rel_mse <= target);
        if !spp.is_power_of_two() {
            continue;
        }
        uniform.push(full.pixels());
        if !ended {
            for tile in film.tiles_that_end(spp, target) {
                assert!(film.end_tile(tile), "it has the samples that were asked about");
            }
        }
    }
    let samples: f64 = film.tile_samples().map(|(tile, spp)| tile.area() as f64 * spp as f64).sum();
    Replicate { uniform, adaptive: film.pixels(), spp: samples / scene.resolution().area() as f64 }
}

fn sum_up(
    name: &'static str,
    scene: &PreparedScene,
    effort: Effort,
    target: f64,
    replicates: &[Replicate],
) -> Outcome {
    let truth = Truth::new(replicates);
    let error_of = |picture: &dyn Fn(&Replicate) -> &Vec<Rgb>| {
        let errors = replicates.iter().enumerate().map(|(seed, replicate)| {
            truth.rel_mse(picture(replicate), replicates[seed].uniform.last().expect("at least the leaf"))
        });
        errors.sum::<f64>() / replicates.len() as f64
    };
    let rel_mse = error_of(&|replicate| &replicate.adaptive);
    let levels = replicates[0].uniform.len();
    let curve: Vec<_> = (0..levels)
        .map(|level| ((LEAF_SAMPLES << level) as f64, error_of(&|replicate| &replicate.uniform[level])))
        .collect();
    let bias = Bias::new(scene, effort, replicates, &truth);
    Outcome {
        scene: name,
        target,
        rel_mse,
        spp: replicates.iter().map(|replicate| replicate.spp).sum::<f64>() / replicates.len() as f64,
        spp_uniform: crossing(&curve, rel_mse),
        frame_bias: bias.frame,
        frame_bias_error: bias.frame_error,
        bias_over_noise: bias.square.max(0.0).sqrt(),
        bias_over_noise_max: (bias.square.max(0.0) + 2.0 * bias.square_error).sqrt(),
    }
}

/// Where a falling curve has a value, on straight lines between the logarithms of its points.
fn crossing(curve: &[(f64, f64)], value: f64) -> Option<f64> {
    curve.windows(2).find(|pair| pair[0].1 >= value && value >= pair[1].1).map(|pair| {
        let share = (pair[0].1 / value).ln() / (pair[0].1 / pair[1].1).ln();
        pair[0].0 * (pair[1].0 / pair[0].0).powf(share)
    })
}

/// What the replicates converge to: the mean of their full pictures, for each replicate that of the others.
struct Truth {
    count: f64,
    /// Sums over replicates.
    sums: Vec<[f64; 3]>,
    /// Variance of single full pictures.
    variances: Vec<[f64; 3]>,
}

impl Truth {
    fn new(replicates: &[Replicate]) -> Self {
        let count = replicates.len() as f64;
        let full = || replicates.iter().map(|replicate| replicate.uniform.last().expect("at least the leaf"));
        let pixels = replicates[0].adaptive.len();
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

    fn rel_mse(&self, picture: &[Rgb], own: &[Rgb]) -> f64 {
        let at = |pixel: usize, channel: usize| {
            let (square, truth) = self.square(picture, own, pixel, channel);
            square / (truth * truth + 0.01)
        };
        let sum: f64 = (0..picture.len()).map(|pixel| at(pixel, 0) + at(pixel, 1) + at(pixel, 2)).sum();
        sum / (3 * picture.len()) as f64
    }
}

/// How far the mean of adaptive pictures is from that of full ones.
struct Bias {
    frame: f64,
    frame_error: f64,
    /// Mean over tiles of the square of bias over noise, without what chance explains.
    square: f64,
    square_error: f64,
}

impl Bias {
    fn new(scene: &PreparedScene, effort: Effort, replicates: &[Replicate], truth: &Truth) -> Self {
        let width = scene.resolution().width();
        let tiles: Vec<Vec<usize>> = scene
            .resolution()
            .tiles(effort.tile_side)
            .map(|tile: Tile| tile.pixels().map(|(x, y)| (y * width + x) as usize).collect())
            .collect();
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
        let full = replicate.uniform.last().expect("at least the leaf");
        let channel = |pixel: usize, channel: usize| {
            f64::from(replicate.adaptive[pixel][channel]) - f64::from(full[pixel][channel])
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
        let own = replicate.uniform.last().expect("at least the leaf");
        truth.square(&replicate.adaptive, own, pixel, channel).0
    };
    let of_one = |replicate: &Replicate| -> f64 {
        pixels.iter().map(|at| (0..3).map(|channel| square(replicate, *at, channel)).sum::<f64>()).sum()
    };
    replicates.iter().map(of_one).sum::<f64>() / (3 * pixels.len() * replicates.len()) as f64
}

/// A table of one line per scene.
pub fn markdown(outcomes: &[Outcome]) -> String {
    let mut out = String::from(
        "| scene | relMSE wanted | reached | adaptive spp | uniform spp | gain | bias of the frame's mean | bias / noise of a tile (95 %) |\n\
         | --- | --- | --- | --- | --- | --- | --- | --- |\n",
    );
    for outcome in outcomes {
        let number = |value: Option<f64>, digits: usize| {
            value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
        };
        let _ = writeln!(
            out,
            "| {} | {:.2e} | {:.2e} | {:.0} | {} | {} | {:+.3} % +- {:.3} % | {:.3} (< {:.3}) |",
            outcome.scene,
            outcome.target,
            outcome.rel_mse,
            outcome.spp,
            number(outcome.spp_uniform, 0),
            number(outcome.spp_uniform.map(|spp| spp / outcome.spp), 2),
            outcome.frame_bias * 100.0,
            outcome.frame_bias_error * 100.0,
            outcome.bias_over_noise,
            outcome.bias_over_noise_max,
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_is_crossed_on_straight_lines_of_logarithms() {
        let curve = [(16.0, 1.0), (32.0, 0.5), (64.0, 0.125)];
        assert_eq!(crossing(&curve, 0.5), Some(32.0));
        assert!((crossing(&curve, 0.25).unwrap() - 32.0 * 2.0_f64.sqrt()).abs() < 1e-9);
        assert_eq!(crossing(&curve, 0.01), None);
    }

    /// A floor under a sky and one under a lamp, in short.
    #[test]
    fn the_error_is_reached_with_little_bias() {
        let effort = Effort { resolution: [32, 24], tile_side: 8, spp_max: 256, seeds: 6 };
        let outcome = measure(Named::find("lens-motion").unwrap(), effort, &|_| ()).unwrap();
        assert!(outcome.rel_mse < 1.5 * outcome.target, "{outcome:?}");
        assert!((64.0..256.0).contains(&outcome.spp), "{outcome:?}");
        assert!(outcome.frame_bias.abs() < 4.0 * outcome.frame_bias_error + 1e-3, "{outcome:?}");
    }
}
