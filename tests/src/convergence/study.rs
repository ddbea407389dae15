//! Replicates of one scene: pictures, times and estimated errors at every power of two of samples, and a reference.

use farm_film::{ErrorEstimate, Film, FilmTile, LEAF_SAMPLES, Rgb, SampleBlock, Tile};
use farm_render::{PreparedScene, render};
use rayon::prelude::*;
use rustix::time::{ClockId, clock_gettime};

/// Side of the film's tiles, in pixels: several to a picture, so that estimates per tile are measured as well.
const TILE_SIDE: u32 = 16;

/// First replicate of those that make up a reference.
const REFERENCE: u64 = 1 << 20;

/// A picture on its way.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    /// Samples per pixel.
    pub spp: u64,
    /// CPU time that the picture took.
    pub seconds: f64,
    /// What the film says of it.
    pub estimate: Option<ErrorEstimate>,
    /// The picture.
    pub pixels: Vec<Rgb>,
    /// Estimated root mean squared error of every tile, with the positions of its pixels.
    pub tiles: Vec<(Vec<usize>, f64)>,
}

/// Renders `count` replicates with checkpoints at every power of two up to `spp_max`, one replicate per thread at a time. `done` hears of
/// the samples per pixel as they are rendered.
pub fn replicates(
    scene: &PreparedScene,
    count: u64,
    spp_max: u64,
    done: &(dyn Fn(u64) + Sync),
) -> Vec<Vec<Checkpoint>> {
    (0..count).into_par_iter().map(|replicate| checkpoints(scene, replicate, spp_max, done)).collect()
}

fn checkpoints(
    scene: &PreparedScene,
    replicate: u64,
    spp_max: u64,
    done: &(dyn Fn(u64) + Sync),
) -> Vec<Checkpoint> {
    let mut found = Vec::new();
    // Below the leaf every number of samples is a picture of its own.
    for spp in (0..).map(|level| 1 << level).take_while(|spp| *spp < LEAF_SAMPLES.min(spp_max + 1)) {
        let mut film = empty_film(scene, spp);
        let begun = cpu_seconds();
        add_block(scene, replicate, 0..spp, &mut film);
        found.push(checkpoint(&film, spp, cpu_seconds() - begun));
        done(spp);
    }
    if spp_max < LEAF_SAMPLES {
        return found;
    }
    let mut film = empty_film(scene, spp_max);
    let begun = cpu_seconds();
    let mut spp = 0;
    while spp < spp_max {
        let end = (2 * spp).max(LEAF_SAMPLES);
        add_block(scene, replicate, spp..end, &mut film);
        found.push(checkpoint(&film, end, cpu_seconds() - begun));
        done(end - spp);
        spp = end;
    }
    found
}

fn empty_film(scene: &PreparedScene, spp: u64) -> Film {
    Film::new(scene.resolution(), TILE_SIDE, spp).expect("at least one sample")
}

/// Renders samples of a replicate and adds them as if it were the only one.
fn add_block(scene: &PreparedScene, replicate: u64, samples: std::ops::Range<u64>, film: &mut Film) {
    for tile in scene.resolution().tiles(TILE_SIDE) {
        film.add(rendered(scene, replicate, tile, samples.clone())).expect("a part of this film");
    }
}

/// Samples of a replicate as if it were the only one.
pub(super) fn rendered(
    scene: &PreparedScene,
    replicate: u64,
    tile: Tile,
    samples: std::ops::Range<u64>,
) -> FilmTile {
    let block = |from: u64| {
        SampleBlock::new(samples.start + from..samples.end + from).expect("doubling gives blocks of the tree")
    };
    let rendered = render(scene, tile, block(replicate << 32), &|| false).expect("nobody stops it").tile;
    FilmTile::new(tile, block(0), rendered.sums().to_vec()).with_differences(rendered.differences().clone())
}

fn checkpoint(film: &Film, spp: u64, seconds: f64) -> Checkpoint {
    let width = film.resolution().width();
    let pixels_of = |tile: Tile| tile.pixels().map(|(x, y)| (y * width + x) as usize).collect();
    Checkpoint {
        spp,
        seconds,
        estimate: film.error_estimate(),
        pixels: film.pixels(),
        tiles: film.tile_errors().map(|(tile, error)| (pixels_of(tile), error.rmse)).collect(),
    }
}

fn cpu_seconds() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// What the pictures converge to, and how far that is off itself.
pub struct Reference {
    pixels: Vec<[f64; 3]>,
    /// Mean squared error of `pixels`, from the spread of the pictures that they are the mean of.
    mse: f64,
    /// The same over `value^2 + 0.01`.
    rel_mse: f64,
    /// Squared error of single pixels, mean over channels.
    by_pixel: Vec<f64>,
}

/// Errors against a reference whose own error is subtracted.
#[derive(Clone, Copy, Debug)]
pub struct TrueError {
    /// Root mean squared error.
    pub rmse: f64,
    /// Mean of squared error over `value^2 + 0.01`.
    pub rel_mse: f64,
}

impl Reference {
    /// The mean of `count` pictures of `spp` samples each, none of which is among [`replicates`].
    pub fn new(scene: &PreparedScene, count: u64, spp: u64, done: &(dyn Fn(u64) + Sync)) -> Self {
        let picture = |replicate: u64| {
            let mut film = empty_film(scene, spp);
            add_block(scene, REFERENCE + replicate, 0..spp, &mut film);
            done(spp);
            film.pixels()
        };
        let pictures: Vec<Vec<Rgb>> = (0..count).into_par_iter().map(picture).collect();
        let n = count as f64;
        let mut pixels = vec![[0.0; 3]; pictures[0].len()];
        for picture in &pictures {
            for (sum, value) in pixels.iter_mut().flatten().zip(picture.iter().flatten()) {
                *sum += f64::from(*value) / n;
            }
        }
        let spread = |pixel: usize, channel: usize| {
            let squares = pictures
                .iter()
                .map(|picture| (f64::from(picture[pixel][channel]) - pixels[pixel][channel]).powi(2));
            squares.sum::<f64>() / (n * (n - 1.0))
        };
        let mean = |value: &dyn Fn(usize, usize) -> f64| mean_over(pixels.len(), value);
        let relative = |pixel: usize, channel: usize| spread(pixel, channel) / floor(pixels[pixel][channel]);
        let (mse, rel_mse) = (mean(&spread), mean(&relative));
        let by_pixel =
            (0..pixels.len()).map(|pixel| (0..3).map(|channel| spread(pixel, channel)).sum::<f64>() / 3.0);
        let by_pixel = by_pixel.collect();
        Self { pixels, mse, rel_mse, by_pixel }
    }

    /// How far a picture is off.
    pub fn error(&self, picture: &[Rgb]) -> TrueError {
        let square = |pixel: usize, channel: usize| {
            (f64::from(picture[pixel][channel]) - self.pixels[pixel][channel]).powi(2)
        };
        let mse = mean_over(picture.len(), &square) - self.mse;
        let relative =
            |pixel: usize, channel: usize| square(pixel, channel) / floor(self.pixels[pixel][channel]);
        let rel_mse = mean_over(picture.len(), &relative) - self.rel_mse;
        TrueError { rmse: mse.max(0.0).sqrt(), rel_mse: rel_mse.max(0.0) }
    }

    /// Root mean squared error of a part of a picture.
    pub fn rmse_of(&self, picture: &[Rgb], part: &[usize]) -> f64 {
        let square = |pixel: usize| {
            let channels = picture[pixel].iter().zip(self.pixels[pixel]);
            channels.map(|(x, r)| (f64::from(*x) - r).powi(2)).sum::<f64>() / 3.0 - self.by_pixel[pixel]
        };
        (part.iter().map(|pixel| square(*pixel)).sum::<f64>() / part.len() as f64).max(0.0).sqrt()
    }

    /// Root mean squared error of the reference itself.
    pub fn rmse(&self) -> f64 {
        self.mse.sqrt()
    }
}

fn floor(value: f64) -> f64 {
    value * value + 0.01
}

fn mean_over(pixels: usize, value: &dyn Fn(usize, usize) -> f64) -> f64 {
    let sum: f64 = (0..pixels)
        .flat_map(|pixel| (0..3).map(move |channel| (pixel, channel)))
        .map(|(p, c)| value(p, c))
        .sum();
    sum / (3 * pixels) as f64
}
