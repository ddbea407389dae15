//! What a job has cost so far.

use crate::checkpoint::Spent;
use farm_job::WorkerId;
use std::collections::BTreeSet;
use std::time::{Duration, Instant};

/// Sums over the accepted units of one job.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// What they took.
    pub spent: Spent,
    /// How many units.
    pub units: u64,
    /// Connections that delivered at least one of them.
    pub workers: BTreeSet<WorkerId>,
    span: Option<(Instant, Instant)>,
}

impl Tally {
    /// A unit was accepted that came at `arrived`.
    pub fn add(&mut self, worker: WorkerId, spent: Spent, arrived: Instant) {
        let begun = spent.begun(arrived);
        let (first, last) = self.span.unwrap_or((begun, arrived));
        self.span = Some((first.min(begun), last.max(arrived)));
        self.spent = self.spent.plus(spent);
        self.units += 1;
        self.workers.insert(worker);
    }

    /// From the first unit begun to the last finished.
    pub fn span(&self) -> Duration {
        self.span.map_or(Duration::ZERO, |(first, last)| last - first)
    }

    /// Since the first unit was begun.
    pub fn running(&self) -> Option<Duration> {
        self.span.map(|(first, _)| first.elapsed())
    }
}
