//! Frames that end for their error, as the coordinator ends them.

use super::Picture;
use farm_film::{ErrorEstimate, Film, FilmTile};

/// A frame that ends once its estimated error is low enough.
pub(super) struct Run {
    film: Film,
    target: f64,
    /// After every round.
    errors: Vec<ErrorEstimate>,
    has_ended: bool,
}

impl Run {
    pub fn new(film: Film, target: f64) -> Self {
        Self { film, target, errors: Vec::new(), has_ended: false }
    }

    pub fn add(&mut self, partial: &FilmTile) {
        if !self.has_ended {
            self.film.add(partial.clone()).expect("a part of this film");
        }
    }

    pub fn check(&mut self) {
        if let Some(error) = self.film.error_estimate().filter(|_| !self.has_ended) {
            self.errors.push(error);
            self.has_ended = error.cautious() <= self.target;
        }
    }

    pub fn end_tiles(&mut self, spp: u64) {
        if !self.has_ended {
            for tile in self.film.tiles_that_end(spp, self.target) {
                assert!(self.film.end_tile(tile), "it has the samples that were asked about");
            }
        }
    }

    /// The end that was predicted at a quarter of the samples over the real one, and whether that was within the stated bounds. None for
    /// a frame that never reached its error.
    pub fn prediction(&self) -> Option<(f64, bool)> {
        let [.., before, end] = self.errors.as_slice() else { return None };
        let quarter = self.errors.iter().rfind(|error| 4 * error.spp <= end.spp)?;
        let predicted = quarter.predict_cautious(self.target).filter(|_| self.has_ended)?;
        // It would have ended anywhere within its last round.
        let is_within = predicted.spp / predicted.band <= end.spp as f64
            && predicted.spp * predicted.band > before.spp as f64;
        let rounds = self.errors.iter().map(|error| error.spp as f64);
        let at = rounds.clone().find(|spp| *spp >= predicted.spp).unwrap_or(predicted.spp);
        Some((at / end.spp as f64, is_within))
    }

    pub fn picture(self) -> Picture {
        let samples: f64 = self.film.tile_samples().map(|(tile, spp)| tile.area() as f64 * spp as f64).sum();
        Picture { pixels: self.film.pixels(), spp: samples / self.film.resolution().area() as f64 }
    }
}
