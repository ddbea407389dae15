//! Who renders what, until when.

use crate::Timestamp;
use crate::piece::PieceKey;
use farm_film::WorkUnit;
use farm_job::{JobId, LeaseId, WorkerId};
use std::collections::{BTreeMap, BTreeSet};

/// What a lease is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Work {
    /// Something that is missing.
    Piece(PieceKey),
    /// Something that is there, to compare.
    Check(WorkUnit),
}

/// One worker's claim on a unit.
#[derive(Clone, Debug)]
pub(crate) struct Lease {
    pub worker: WorkerId,
    pub job: JobId,
    pub work: Work,
    pub granted: Timestamp,
    /// When it ends unless it is renewed.
    pub deadline: Timestamp,
    /// Units that its worker renders one after another until this one is done.
    pub turns: u32,
    /// When its result should be there, by what was known of the speed when it was granted.
    pub expected: Timestamp,
    /// Nanoseconds of rendering that its job was charged.
    pub cost: u64,
}

/// All leases that have not ended.
#[derive(Debug)]
pub(crate) struct Leases {
    next: LeaseId,
    leases: BTreeMap<LeaseId, Lease>,
    /// Each lease at a moment not after its deadline; renewal does not touch this, so that a heartbeat is cheap.
    checks: BTreeSet<(Timestamp, LeaseId)>,
    /// Leases that are the only one on their piece, by when their result should be there.
    alone: BTreeSet<(Timestamp, LeaseId)>,
}

impl Leases {
    pub fn new(next: LeaseId) -> Self {
        Self { next, leases: BTreeMap::new(), checks: BTreeSet::new(), alone: BTreeSet::new() }
    }

    /// Adds a lease under the next name.
    pub fn add(&mut self, lease: Lease) -> LeaseId {
        let id = self.next;
        self.next = LeaseId(id.0 + 1);
        self.checks.insert((lease.deadline, id));
        self.leases.insert(id, lease);
        id
    }

    pub fn get(&self, id: LeaseId) -> Option<&Lease> {
        self.leases.get(&id)
    }

    /// Whether anything is being rendered.
    pub fn any(&self) -> bool {
        !self.leases.is_empty()
    }

    /// Puts a lease's end off, if it is this worker's.
    pub fn renew(&mut self, worker: WorkerId, id: LeaseId, deadline: Timestamp) {
        if let Some(lease) = self.leases.get_mut(&id).filter(|lease| lease.worker == worker) {
            lease.deadline = lease.deadline.max(deadline);
        }
    }

    /// Ends a lease. What stands in `checks` under it is dropped when its moment comes.
    pub fn remove(&mut self, id: LeaseId) -> Option<Lease> {
        let lease = self.leases.remove(&id)?;
        self.alone.remove(&(lease.expected, id));
        Some(lease)
    }

    /// The next moment at which a lease may end.
    pub fn next_check(&self) -> Option<Timestamp> {
        self.checks.first().map(|(moment, _)| *moment)
    }

    /// A lease whose deadline has come.
    pub fn expired(&mut self, now: Timestamp) -> Option<LeaseId> {
        while let Some(&(moment, id)) = self.checks.first().filter(|(moment, _)| *moment <= now) {
            self.checks.remove(&(moment, id));
            match self.leases.get(&id) {
                Some(lease) if lease.deadline > now => self.checks.insert((lease.deadline, id)),
                Some(_) => return Some(id),
                None => false,
            };
        }
        None
    }

    /// Notes whether a lease is the only one on its piece.
    pub fn set_alone(&mut self, id: LeaseId, alone: bool) {
        let Some(lease) = self.leases.get(&id) else { return };
        if alone {
            self.alone.insert((lease.expected, id));
        } else {
            self.alone.remove(&(lease.expected, id));
        }
    }

    /// Leases that are the only one on their piece: those that are overdue for longest, then those that end last.
    pub fn slowest(&self, now: Timestamp) -> impl Iterator<Item = (LeaseId, &Lease)> {
        let overdue = self.alone.range(..(now, LeaseId(0)));
        let last = self.alone.range((now, LeaseId(0))..).rev();
        overdue.chain(last).filter_map(|(_, id)| Some((*id, self.leases.get(id)?)))
    }

    /// Whether any lease is the only one on its piece.
    pub fn any_alone(&self) -> bool {
        !self.alone.is_empty()
    }
}
