//! Variance per pixel, from how much its value moved whenever its samples doubled.

use farm_film::{ErrorEstimate, Film, Resolution, Rgb, Tile};
use std::collections::BTreeMap;

/// Collects the movements of every pixel.
///
/// With `m(n)` the mean of `n` samples, `(m(n) - m(2n))^2` expects `V(n) - V(2n)`, which is in proportion to the variance
/// `V(2n)` of the picture. Earlier movements count as much as the decay of the error says they tell of the present one. The
/// mean over all pixels is brought to the estimated mean squared error of the picture, so that the map says where its error lies.
#[derive(Default)]
pub struct Variance {
    tiles: BTreeMap<Tile, TileVariance>,
}

struct TileVariance {
    samples: u64,
    /// Values at the last doubling.
    means: Vec<Rgb>,
    /// Sums of squared movements, on the scale of the last one.
    squares: Vec<Rgb>,
}

impl Variance {
    /// Looks at a picture of which every tile has twice the samples of the last time.
    pub fn doubled(&mut self, film: &Film, error: Option<&ErrorEstimate>) {
        let samples: BTreeMap<Tile, u64> = film.tile_samples().collect();
        let fade = decay(error);
        for resolved in film.resolve() {
            let now = samples[&resolved.tile];
            let tile = self.tiles.entry(resolved.tile).or_insert_with(|| TileVariance {
                samples: now,
                means: resolved.pixels.clone(),
                squares: vec![[0.0; 3]; resolved.pixels.len()],
            });
            if now != tile.samples {
                tile.samples = now;
                tile.take(&resolved.pixels, fade);
            }
        }
    }

    /// Forgets a tile, which is rendered again.
    pub fn forget(&mut self, tile: Tile) {
        self.tiles.remove(&tile);
    }

    /// Variance of every pixel in scanline order, with the mean squared error that was estimated for the picture as its mean.
    /// Before any doubling all pixels have that.
    pub fn finish(self, resolution: Resolution, error: Option<&ErrorEstimate>) -> Vec<Rgb> {
        let mut pixels = vec![[0.0; 3]; resolution.area()];
        for (tile, variance) in &self.tiles {
            for ((x, y), squares) in tile.pixels().zip(&variance.squares) {
                // In proportion to the present variance of the pixel.
                pixels[y as usize * resolution.width() as usize + x as usize] = *squares;
            }
        }
        let mean =
            pixels.iter().flatten().map(|value| f64::from(*value)).sum::<f64>() / (pixels.len() * 3) as f64;
        let wanted = error.map_or(0.0, |error| error.rmse * error.rmse);
        for value in pixels.iter_mut().flatten() {
            *value = if mean > 0.0 { (f64::from(*value) * (wanted / mean)) as f32 } else { wanted as f32 };
        }
        pixels
    }
}

impl TileVariance {
    fn take(&mut self, now: &[Rgb], fade: f32) {
        for ((mean, square), now) in self.means.iter_mut().zip(&mut self.squares).zip(now) {
            for channel in 0..3 {
                let moved = now[channel] - mean[channel];
                square[channel] = square[channel] * fade + moved * moved;
            }
            *mean = *now;
        }
    }
}

/// What is left of a variance when samples double.
fn decay(error: Option<&ErrorEstimate>) -> f32 {
    error.map_or(0.5, |error| libm::exp2(-error.rate) as f32)
}
