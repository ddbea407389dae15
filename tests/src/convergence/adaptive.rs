//! What it gains that tiles end on their own, and how far it biases the picture.
//!
//! Every replicate is rendered in full once. The adaptive picture is made of the same samples, so the two differ only in where it
//! ended, and both have the same expectation unless ending there is a bias. Beside it stands the uniform picture that ends for the same
//! error, and how well its end was predicted.

mod run;
mod truth;

use super::stage::Stage;
use super::study::rendered;
use super::summary::{PREDICTION, Spread};
use crate::scenes::Named;
use farm_film::{ADAPTIVE_SPP_MIN, Film, FilmTile, LEAF_SAMPLES, Rgb, Tile};
use farm_render::PreparedScene;
use farm_scene::Filter;
use rayon::prelude::*;
use run::Run;
use serde::Serialize;
use std::fmt::Write;
use truth::{Bias, Truth};

/// Replicate that says which error is wanted; none of those that are measured.
const SCOUT: u64 = 1 << 21;

/// Parts of a doubling after each of which a frame may end.
const PARTS: u64 = 16;

/// The error that is wanted is the one after this part of the most samples, so that tiles can get more than others.
const LEAST_SHARE: u64 = 4;

/// How much is measured.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Width and height of the pictures.
    pub resolution: [u32; 2],
    /// Side of a tile, pixels: small, so that a tile has few samples to decide on.
    pub tile_side: u32,
    /// Most samples per pixel, a power of two.
    pub spp_max: u64,
    /// Replicates.
    pub seeds: u64,
}

impl Effort {
    /// Samples per pixel over everything that is rendered.
    pub fn samples(self) -> u64 {
        self.spp_max / LEAST_SHARE + self.seeds * self.spp_max
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
    /// The same of uniform pictures that ended for the same estimated error.
    pub rel_mse_uniform: f64,
    /// Mean samples per pixel of the adaptive pictures.
    pub spp: f64,
    /// The same of the uniform ones.
    pub spp_uniform: f64,
    /// Uniform over adaptive samples at equal true error.
    pub gain: f64,
    /// The same for an all-knowing choice of doublings.
    pub gain_possible: Option<f64>,
    /// Samples predicted at a quarter of the uniform pictures over those at their end, in ascending order.
    pub predicted: Vec<f64>,
    /// Share of these pictures that ended within the bounds stated then.
    pub predicted_in_bounds: f64,
    /// Bias of the mean of the whole picture, as a part of it.
    pub frame_bias: f64,
    /// Standard error of that.
    pub frame_bias_error: f64,
    /// Root mean square over tiles of the bias of a tile's mean over the noise of its pixels; what chance explains is subtracted.
    pub bias_over_noise: f64,
    /// What this is below in 95 % of all measurements.
    pub bias_over_noise_max: f64,
}

impl Outcome {
    fn prediction(&self) -> String {
        let Some(spread) = Spread::of(self.predicted.iter().copied()) else { return "- | -".to_owned() };
        let near = self.predicted.iter().filter(|ratio| PREDICTION.contains(ratio)).count();
        format!(
            "{:.2}, {:.2}..{:.2} | {:.0} %, {:.0} %",
            spread.median,
            spread.low,
            spread.high,
            near as f64 / self.predicted.len() as f64 * 100.0,
            self.predicted_in_bounds * 100.0
        )
    }
}

/// A picture and the samples per pixel that it took.
struct Picture {
    pixels: Vec<Rgb>,
    spp: f64,
}

/// One replicate.
struct Replicate {
    /// At every power of two from the leaf on.
    uniform: Vec<Vec<Rgb>>,
    /// Uniform, until its error is low enough.
    stopped: Picture,
    /// The same with tiles that end on their own.
    adaptive: Picture,
    /// How well the end of the uniform one was predicted: [`Run::prediction`].
    prediction: Option<(f64, bool)>,
}

impl Replicate {
    /// The last of the uniform pictures.
    fn full(&self) -> &Vec<Rgb> {
        self.uniform.last().expect("at least the leaf")
    }
}

/// Measures a scene. `done` hears of samples per pixel.
pub fn measure(named: Named, effort: Effort, done: &(dyn Fn(u64) + Sync)) -> Result<Outcome, String> {
    let scene = Stage::new(named)?.prepare(effort.resolution, Filter::Box)?;
    let enough = effort.spp_max / LEAST_SHARE;
    let mut scout = empty_film(&scene, effort, enough);
    for tile in scene.resolution().tiles(effort.tile_side) {
        scout.add(rendered(&scene, SCOUT, tile, 0..enough)).map_err(|err| err.to_string())?;
    }
    done(enough);
    let target = scout.error_estimate().ok_or("nothing is known of the error")?.cautious();
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
    let empty = || empty_film(scene, effort, effort.spp_max);
    let (mut full, mut uniform, mut spp) = (empty(), Vec::new(), 0);
    let (mut stopped, mut adaptive) = (Run::new(empty(), target), Run::new(empty(), target));
    while spp < effort.spp_max {
        // Frames may end after a sixteenth of a doubling, tiles only after a whole one.
        let doubled: u64 = if spp == 0 { 0 } else { 1 << spp.ilog2() };
        let end = spp + (doubled / PARTS).max(LEAF_SAMPLES);
        for tile in scene.resolution().tiles(effort.tile_side) {
            let partial: FilmTile = rendered(scene, seed, tile, spp..end);
            stopped.add(&partial);
            adaptive.add(&partial);
            full.add(partial).expect("a part of this film");
        }
        done(end - spp);
        spp = end;
        stopped.check();
        adaptive.check();
        if spp.is_power_of_two() {
            uniform.push(full.pixels());
            adaptive.end_tiles(spp);
        }
    }
    Replicate {
        uniform,
        prediction: stopped.prediction(),
        stopped: stopped.picture(),
        adaptive: adaptive.picture(),
    }
}

/// Mean over replicates.
fn mean(replicates: &[Replicate], value: impl Fn(&Replicate) -> f64) -> f64 {
    replicates.iter().map(value).sum::<f64>() / replicates.len() as f64
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
        mean(replicates, |replicate| truth.rel_mse(picture(replicate), replicate.full()))
    };
    let (rel_mse, rel_mse_uniform) =
        (error_of(&|replicate| &replicate.adaptive.pixels), error_of(&|replicate| &replicate.stopped.pixels));
    let levels = replicates[0].uniform.len();
    let curve: Vec<_> = (0..levels)
        .map(|level| ((LEAF_SAMPLES << level) as f64, error_of(&|replicate| &replicate.uniform[level])))
        .collect();
    let (spp, spp_uniform) = (
        mean(replicates, |replicate| replicate.adaptive.spp),
        mean(replicates, |replicate| replicate.stopped.spp),
    );
    let middle = curve
        .iter()
        .position(|(spp, _)| *spp as u64 == effort.spp_max / LEAST_SHARE)
        .expect("a power of two");
    let rate = (curve[middle - 1].1 / curve[middle + 1].1).log2() / 2.0;
    let predictions: Vec<(f64, bool)> =
        replicates.iter().filter_map(|replicate| replicate.prediction).collect();
    let mut predicted: Vec<f64> = predictions.iter().map(|(ratio, _)| *ratio).collect();
    predicted.sort_by(f64::total_cmp);
    let in_bounds = predictions.iter().filter(|(_, is_within)| *is_within).count();
    let bias = Bias::new(scene, effort, replicates, &truth);
    Outcome {
        scene: name,
        target,
        rel_mse,
        rel_mse_uniform,
        spp,
        spp_uniform,
        gain: spp_uniform / spp * (rel_mse_uniform / rel_mse).powf(1.0 / rate),
        gain_possible: possible(scene, effort, replicates, &truth, rel_mse_uniform)
            .map(|spp| spp_uniform / spp),
        predicted_in_bounds: in_bounds as f64 / predicted.len().max(1) as f64,
        predicted,
        frame_bias: bias.frame,
        frame_bias_error: bias.frame_error,
        bias_over_noise: bias.square.max(0.0).sqrt(),
        bias_over_noise_max: (bias.square.max(0.0) + 2.0 * bias.square_error).sqrt(),
    }
}

/// Samples per pixel that would do for a mean error, if it were known how the true errors of all tiles fall.
fn possible(
    scene: &PreparedScene,
    effort: Effort,
    replicates: &[Replicate],
    truth: &Truth,
    wanted: f64,
) -> Option<f64> {
    let first = (ADAPTIVE_SPP_MIN / LEAF_SAMPLES).ilog2() as usize;
    // Of every tile: its share of the pixels, and errors from the first level on at which it may end.
    let tiles: Vec<(f64, Vec<f64>)> = tiles(scene, effort)
        .into_iter()
        .map(|pixels| {
            let error = |level: usize| {
                mean(replicates, |replicate| {
                    truth.rel_mse_of(&replicate.uniform[level], replicate.full(), &pixels)
                })
            };
            let share = pixels.len() as f64 / scene.resolution().area() as f64;
            (share, (first..replicates[0].uniform.len()).map(error).collect())
        })
        .collect();
    let mut doublings = vec![0; tiles.len()];
    let mut left: f64 = tiles.iter().map(|(share, errors)| share * errors[0]).sum();
    let mut spp = ADAPTIVE_SPP_MIN as f64;
    while left > wanted {
        let gain = |index: usize| {
            let (made, errors) = (doublings[index], &tiles[index].1);
            Some(errors.get(made)? - errors.get(made + 1)?)
        };
        let worth = |index: usize| Some((index, gain(index)? / f64::from(1_u32 << doublings[index])));
        let offers = (0..tiles.len()).filter_map(worth);
        let (best, _) = offers.max_by(|(_, a), (_, b)| a.total_cmp(b))?;
        left -= tiles[best].0 * gain(best)?;
        spp += tiles[best].0 * (ADAPTIVE_SPP_MIN << doublings[best]) as f64;
        doublings[best] += 1;
    }
    Some(spp)
}

/// Positions of the pixels of every tile.
fn tiles(scene: &PreparedScene, effort: Effort) -> Vec<Vec<usize>> {
    let width = scene.resolution().width();
    let pixels = |tile: Tile| tile.pixels().map(|(x, y)| (y * width + x) as usize).collect();
    scene.resolution().tiles(effort.tile_side).map(pixels).collect()
}

/// A table of one line per scene.
pub fn markdown(outcomes: &[Outcome]) -> String {
    let mut out = String::from(
        "| scene | true relMSE: uniform, adaptive | spp: uniform, adaptive | gain at equal error | possible | bias of the mean | bias / noise of a tile (95 %) | predicted / real end: median, range | within 20 %, within bounds |\n\
         | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n",
    );
    for outcome in outcomes {
        let possible = outcome.gain_possible.map_or_else(|| "-".to_owned(), |gain| format!("{gain:.2}"));
        let _ = writeln!(
            out,
            "| {} | {:.2e}, {:.2e} | {:.0}, {:.0} | {:.2} | {possible} | {:+.3} % +- {:.3} % | {:.3} (< {:.3}) | {} |",
            outcome.scene,
            outcome.rel_mse_uniform,
            outcome.rel_mse,
            outcome.spp_uniform,
            outcome.spp,
            outcome.gain,
            outcome.frame_bias * 100.0,
            outcome.frame_bias_error * 100.0,
            outcome.bias_over_noise,
            outcome.bias_over_noise_max,
            outcome.prediction(),
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A floor under a sky and one under a lamp, in short.
    #[test]
    fn the_error_is_reached_with_little_bias() {
        let effort = Effort { resolution: [32, 24], tile_side: 8, spp_max: 512, seeds: 6 };
        let outcome = measure(Named::find("lens-motion").unwrap(), effort, &|_| ()).unwrap();
        assert!(outcome.rel_mse < 1.2 * outcome.target, "{outcome:?}");
        assert!((64.0..512.0).contains(&outcome.spp), "{outcome:?}");
        assert!(outcome.frame_bias.abs() < 4.0 * outcome.frame_bias_error + 1e-3, "{outcome:?}");
    }
}
