//! What is said of a frame whose tiles ended on their own.

use farm_film::{BIAS_OVER_NOISE, Film};
use serde::Serialize;

/// How many samples the pixels of an adaptive frame got.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Adaptive {
    /// Samples per pixel of the tiles that got the fewest.
    pub spp_min: u64,
    /// Mean over all pixels.
    pub spp_mean: f64,
    /// Samples per pixel of the tiles that got the most.
    pub spp_max: u64,
    /// Tiles that got fewer than these.
    pub tiles_ended: usize,
    /// All tiles.
    pub tiles: usize,
    /// Tiles end on the word of samples that are part of the picture, which biases it: by at most this part of its noise, as was
    /// measured on the benchmark set.
    pub bias_over_noise: f64,
}

impl Adaptive {
    /// What a film holds.
    pub fn of(film: &Film) -> Self {
        let samples: Vec<_> = film.tile_samples().collect();
        let spp = || samples.iter().map(|(_, spp)| *spp);
        let spp_max = spp().max().unwrap_or(0);
        let total: f64 = samples.iter().map(|(tile, spp)| tile.area() as f64 * *spp as f64).sum();
        Self {
            spp_min: spp().min().unwrap_or(0),
            spp_mean: total / film.resolution().area() as f64,
            spp_max,
            tiles_ended: spp().filter(|spp| *spp < spp_max).count(),
            tiles: samples.len(),
            bias_over_noise: BIAS_OVER_NOISE,
        }
    }
}

impl std::fmt::Display for Adaptive {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} of {} tiles ended on their own: {} to {} spp, {:.1} on average; the bias of that was measured as at most {} % of the noise",
            self.tiles_ended,
            self.tiles,
            self.spp_min,
            self.spp_max,
            self.spp_mean,
            self.bias_over_noise * 100.0
        )
    }
}
