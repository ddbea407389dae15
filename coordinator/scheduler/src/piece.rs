//! Parts of cells that have been begun: what is left of them, and who works on it.

use crate::plan::Cell;
use farm_film::SampleBlock;
use farm_job::LeaseId;
use std::sync::Arc;

/// Where a piece stands in planning order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct PieceKey {
    pub cell: Cell,
    /// First sample of its block.
    pub start: u64,
}

/// A dyadic part of a cell that is not durable yet. It is open when nobody holds it and nothing of it is being stored;
/// once durable it is removed.
#[derive(Clone, Debug)]
pub(crate) struct Piece {
    pub block: SampleBlock,
    /// Who renders it: nobody, one worker, or two when the second is a speculative duplicate.
    pub leases: Vec<LeaseId>,
    /// A result of exactly this block is on its way to the store.
    pub storing: bool,
    pub history: History,
}

/// What has happened to the samples of a piece; parts inherit it.
#[derive(Clone, Debug, Default)]
pub(crate) struct History {
    /// Leases so far.
    pub attempts: u32,
    /// Names of the workers that could not render it, one entry per failure.
    pub failures: Vec<Arc<str>>,
    /// Names of the workers whose result of it was rejected.
    pub rejected: Vec<Arc<str>>,
    /// Workers that vanished while they rendered it.
    pub losses: u32,
}

impl Piece {
    pub fn is_open(&self) -> bool {
        self.leases.is_empty() && !self.storing
    }
}

impl History {
    /// Takes over what happened to a piece that becomes part of this one.
    pub fn merge(&mut self, other: Self) {
        self.attempts = self.attempts.max(other.attempts);
        self.losses = self.losses.max(other.losses);
        self.failures.extend(other.failures);
        self.rejected.extend(other.rejected);
    }

    /// Whether a worker was tried in vain.
    pub fn disappointed(&self, name: &Arc<str>) -> bool {
        self.failures.contains(name) || self.rejected.contains(name)
    }

    /// Names of the workers it failed on, each once.
    pub fn failed_on(&self) -> Vec<&Arc<str>> {
        let mut names: Vec<_> = self.failures.iter().collect();
        names.sort();
        names.dedup();
        names
    }
}
