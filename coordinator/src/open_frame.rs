//! A frame under way: whole pictures, one round after the other.
//!
//! Samples become part of the picture only once every tile has them, in the order of the rounds. So whatever is said of the
//! picture in between, and whether it ends there, or some of its tiles do, depends on the samples alone and never on who was
//! faster.

use crate::adaptive::Adaptive;
use crate::checkpoint::{Checkpoint, Spent};
use crate::forecast::{Cause, Forecast};
use crate::outputs::FinishedFrame;
use crate::variance::Variance;
use farm_film::{Counters, ErrorEstimate, Film, FilmTile, FrameIndex, Rgb, SampleBlock, Tile};
use farm_job::{JobSpec, WorkerId};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};
use tracing::debug;

/// A partial that came, beside its sums.
pub struct Arrival {
    /// Who rendered it.
    pub worker: WorkerId,
    /// What it took.
    pub spent: Spent,
    /// When it came.
    pub at: Instant,
}

/// One frame on its way.
pub struct OpenFrame {
    rounds: Vec<SampleBlock>,
    spec: JobSpec,
    /// All of the rounds that are complete.
    film: Film,
    /// What came of later rounds, by tile and first sample; merged within its round.
    held: BTreeMap<(Tile, u64), Held>,
    /// What the film's samples took.
    spent: BTreeMap<Tile, Spent>,
    workers: BTreeSet<WorkerId>,
    /// When the first unit was begun.
    begun: Option<Instant>,
    /// When the last part of the picture came.
    last: Option<Instant>,
    /// Samples per pixel of the picture.
    spp: u64,
    /// Samples per pixel that were decided on.
    end: Option<u64>,
    /// The same for tiles that have ended on their own.
    ended: BTreeMap<Tile, u64>,
    /// Of the picture.
    error: Option<ErrorEstimate>,
    checkpoints: Vec<Checkpoint>,
    variance: Option<Variance>,
}

struct Held {
    partial: FilmTile,
    spent: Spent,
    at: Option<Instant>,
}

/// What becomes of a frame after a round.
#[derive(Default)]
pub struct Round {
    /// It ends with this round.
    pub ends: bool,
    /// These tiles of it do.
    pub ended: Vec<Tile>,
    /// Its picture, for whoever wanted to see it.
    pub look: Option<Vec<Rgb>>,
}

/// How it stands with a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outlook {
    /// Samples per pixel that every tile has.
    pub spp: u64,
    /// Samples over all pixels that came, of later rounds too.
    pub samples: u64,
    /// Share of the pixels that get more: those of tiles that have not ended on their own.
    pub open: f64,
    /// What the others have, in samples over all pixels of the frame per pixel of the frame.
    pub ended_spp: f64,
    /// When its first unit was begun.
    pub begun: Option<Instant>,
    /// Estimated error of the picture of `spp` samples.
    pub error: Option<ErrorEstimate>,
    /// Slope of log(error) over log(seconds).
    pub slope: Option<f64>,
}

impl Outlook {
    /// Samples per pixel, mean over all pixels, once those that get more have `spp`.
    pub fn mean_spp(&self, spp: f64) -> f64 {
        self.open * spp + self.ended_spp
    }
}

impl OpenFrame {
    /// A frame of a job, before anything of it came.
    pub fn new(spec: &JobSpec) -> Result<Self, String> {
        let resolution = spec.resolution().map_err(|err| err.to_string())?;
        let film = Film::new(resolution, spec.tile_side, spec.spp).map_err(|err| err.to_string())?;
        Ok(Self {
            rounds: spec.rounds().map_err(|err| err.to_string())?,
            spec: spec.clone(),
            film,
            held: BTreeMap::new(),
            spent: BTreeMap::new(),
            workers: BTreeSet::new(),
            begun: None,
            last: None,
            spp: 0,
            end: None,
            ended: BTreeMap::new(),
            error: None,
            checkpoints: Vec::new(),
            variance: spec.variance.then(Variance::default),
        })
    }

    /// Takes a partial that came.
    pub fn add(&mut self, partial: FilmTile, arrival: Arrival) -> Result<(), String> {
        let Arrival { worker, spent, at } = arrival;
        self.hold(partial, spent, Some(at))?;
        self.workers.insert(worker);
        self.begin(spent.begun(at));
        Ok(())
    }

    /// Something of the frame was begun then.
    pub fn begin(&mut self, at: Instant) {
        self.begun = Some(self.begun.map_or(at, |first| first.min(at)));
    }

    /// Takes a partial from before a restart.
    pub fn restore(&mut self, partial: FilmTile, counters: Counters) -> Result<(), String> {
        self.hold(partial, Spent { counters, ..Spent::default() }, None)
    }

    fn hold(
        &mut self,
        mut partial: FilmTile,
        mut spent: Spent,
        mut at: Option<Instant>,
    ) -> Result<(), String> {
        let (tile, block) = (partial.tile(), partial.block());
        // What comes after its tile has ended is no part of the picture, and does not count.
        if self.film.holds(tile, block) || self.ended.get(&tile).is_some_and(|end| block.start() >= *end) {
            return Ok(());
        }
        let same_tile = self.held.range((tile, 0)..=(tile, u64::MAX));
        if same_tile.clone().any(|(_, held)| held.partial.block().overlaps(block)) {
            return Err(format!("samples {block} of tile {tile} are on their way into the picture already"));
        }
        // Only within a round: pictures at the end of a round must stay apart.
        while let Some((parent, sibling)) = partial.block().parent().zip(partial.block().sibling())
            && self.rounds.iter().any(|round| round.contains(parent))
            && self.held.get(&(tile, sibling.start())).is_some_and(|held| held.partial.block() == sibling)
            && let Some(other) = self.held.remove(&(tile, sibling.start()))
        {
            partial = partial.merge(other.partial);
            spent = spent.plus(other.spent);
            at = at.max(other.at);
        }
        self.held.insert((tile, partial.block().start()), Held { partial, spent, at });
        Ok(())
    }

    /// Forgets all that came of a tile, which is rendered again.
    pub fn forget(&mut self, tile: Tile) {
        self.film.forget(tile);
        self.held.retain(|(other, _), _| *other != tile);
        self.spent.remove(&tile);
        if self.spec.stop.adaptive {
            // All tiles are forgotten together, as each may have decided about the others.
            self.ended.clear();
            (self.end, self.spp) = (None, 0);
        }
        if let Some(variance) = &mut self.variance {
            variance.forget(tile);
        }
    }

    /// Every tile has `[0, spp)`: makes them the picture, unless the frame has ended before. `look`: whether someone wants to see
    /// the picture of a checkpoint.
    pub fn round(&mut self, spp: u64, look: bool) -> Result<Round, String> {
        self.advance(spp)?;
        if self.end.is_some() || !self.is_whole() {
            return Ok(Round::default());
        }
        self.error = self.film.error_estimate();
        if let Some(error) = self.error {
            debug!(
                spp,
                rel_mse = error.rel_mse,
                band = error.rel_mse_band,
                rate = error.rel_rate,
                "round complete"
            );
        }
        let is_good = |(target, error): (f64, ErrorEstimate)| error.cautious() <= target;
        if self.spec.stop.error.zip(self.error).is_some_and(is_good) && spp >= self.spec.stop.spp_min {
            self.end = Some(spp);
        }
        if !spp.is_power_of_two() {
            return Ok(Round { ends: self.end.is_some(), ..Round::default() });
        }
        if let Some(variance) = &mut self.variance {
            variance.doubled(&self.film, self.error.as_ref());
        }
        self.check();
        let look = look.then(|| self.film.pixels());
        Ok(Round { ends: self.end.is_some(), ended: self.end_tiles(spp), look })
    }

    /// Ends the tiles that need no more samples for the error that is wanted, as the first `spp` samples tell.
    fn end_tiles(&mut self, spp: u64) -> Vec<Tile> {
        let Some(target) = self.spec.stop.error.filter(|_| self.spec.stop.adaptive) else {
            return Vec::new();
        };
        if self.end.is_some() || spp < self.spec.stop.spp_min {
            return Vec::new();
        }
        let ended = self.film.tiles_that_end(spp, target);
        for tile in &ended {
            assert!(self.film.end_tile(*tile), "the film was asked about the samples that it has");
            self.ended.insert(*tile, spp);
        }
        self.held.retain(|(tile, _), _| !self.ended.contains_key(tile));
        ended
    }

    /// All of the frame is there, `[0, spp)` or what was decided on before.
    pub fn finish(mut self, frame: FrameIndex, spp: u64) -> Result<FinishedFrame, String> {
        self.advance(spp)?;
        self.error = self.film.error_estimate();
        self.check();
        let ended = match self.end {
            Some(_) => Cause::Error,
            None if self.spp < self.spec.spp => Cause::Time,
            None => Cause::Samples,
        };
        let (total, notes) = (self.total(), self.notes(ended));
        let resolution = self.film.resolution();
        Ok(FinishedFrame {
            frame,
            spp: self.spp,
            ended,
            adaptive: self.spec.stop.adaptive.then(|| Adaptive::of(&self.film)),
            counters: total.counters,
            render: self.span(),
            notes,
            variance: self.variance.map(|variance| variance.finish(resolution, self.error.as_ref())),
            checkpoints: self.checkpoints,
            error: self.error,
            film: self.film,
        })
    }

    /// What the frame's file says of how it came about.
    fn notes(&self, ended: Cause) -> serde_json::Map<String, serde_json::Value> {
        let mut notes = serde_json::Map::new();
        notes.insert("cpu_seconds".to_owned(), self.total().cpu.as_secs_f64().into());
        notes.insert("workers".to_owned(), self.workers.len().into());
        if !self.spec.stop.is_never() {
            notes.insert("stop".to_owned(), json!(self.spec.stop));
            notes.insert("ended".to_owned(), json!(ended));
        }
        if self.spec.stop.adaptive {
            notes.insert("adaptive".to_owned(), json!(Adaptive::of(&self.film)));
        }
        notes
    }

    /// How it stands with the frame.
    pub fn outlook(&self) -> Outlook {
        let held: Counters =
            self.held.values().fold(Counters::default(), |sum, held| sum.plus(held.spent.counters));
        let area = self.film.resolution().area() as f64;
        let ended = || self.ended.iter().map(|(tile, spp)| (tile.area() as f64 / area, *spp as f64));
        Outlook {
            spp: self.spp,
            samples: self.total().counters.plus(held).samples,
            open: 1.0 - ended().map(|(share, _)| share).sum::<f64>(),
            ended_spp: ended().map(|(share, spp)| share * spp).sum(),
            begun: self.begun,
            error: self.error,
            slope: self.checkpoints.last().and_then(|checkpoint| checkpoint.slope),
        }
    }

    /// Moves what belongs to the picture of `[0, spp)` there.
    fn advance(&mut self, spp: u64) -> Result<(), String> {
        let spp = self.end.map_or(spp, |end| end.min(spp));
        let is_due = |held: &Held| held.partial.block().end() <= spp;
        let due: Vec<_> = self.held.iter().filter(|(_, held)| is_due(held)).map(|(key, _)| *key).collect();
        for held in due.into_iter().filter_map(|key| self.held.remove(&key)) {
            let tile = held.partial.tile();
            self.film.add(held.partial).map_err(|err| err.to_string())?;
            let spent = self.spent.entry(tile).or_default();
            *spent = spent.plus(held.spent);
            self.last = self.last.max(held.at);
        }
        self.spp = self.spp.max(spp);
        Ok(())
    }

    /// Whether every tile has the present number of samples, or all that it gets: a store may hold several rounds as one.
    fn is_whole(&self) -> bool {
        let wanted = |tile: Tile| self.ended.get(&tile).copied().unwrap_or(self.spp);
        self.film.tile_samples().all(|(tile, spp)| spp == wanted(tile))
    }

    /// Notes how it stands now.
    fn check(&mut self) {
        let seconds = self.span().as_secs_f64();
        let mut checkpoint = Checkpoint::new(self.spp, seconds, self.total(), self.workers.len(), self.error);
        let now = self.begun.map_or(0.0, |begun| begun.elapsed().as_secs_f64());
        checkpoint.forecast = Forecast::of_frame(&self.spec, &self.outlook(), now);
        // What was rendered again is looked at again.
        self.checkpoints.retain(|before| before.spp < self.spp);
        self.checkpoints.push(checkpoint);
        Checkpoint::relate(&mut self.checkpoints);
    }

    fn total(&self) -> Spent {
        self.spent.values().fold(Spent::default(), |sum, spent| sum.plus(*spent))
    }

    /// From the first unit begun to the last that is part of the picture.
    fn span(&self) -> Duration {
        let span = self.begun.zip(self.last).map(|(begun, last)| last.saturating_duration_since(begun));
        span.unwrap_or(Duration::ZERO)
    }
}

#[cfg(test)]
#[path = "open_frame_tests.rs"]
mod tests;
