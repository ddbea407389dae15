//! Units of one job that are rendered a second time, to compare.
//!
//! ```text
//! accepted --chosen--> waiting --granted--> leased --same digest--> settled
//!                        ^  ^                 |  |
//!                        |  `-- lease ends ---'  `--other digest--> disputed: waiting for one more, until two agree
//!                        `------------------------------------------------'
//! ```

use farm_film::{FrameIndex, WorkUnit};
use farm_job::{Digest, LeaseId};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// A unit whose result is compared.
#[derive(Clone, Debug)]
struct Check {
    /// Who delivered which digest. The first one is what was accepted; no two are equal, else it would be settled.
    votes: Vec<(Arc<str>, Digest)>,
    /// Who could not render it.
    failed: Vec<Arc<str>>,
    /// Who renders it now.
    lease: Option<LeaseId>,
    attempts: u32,
}

/// How a vote ended a check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Settled {
    /// Those whose digest was another than that of two who agree.
    pub liars: Vec<Arc<str>>,
    /// A lease that is pointless now.
    pub displaced: Option<LeaseId>,
}

/// What became of a vote.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Vote {
    /// The unit is not being compared, or this worker has been heard on it.
    Pointless,
    /// Nobody agrees with it yet.
    Disputed,
    /// Two agree.
    Settled(Settled),
}

/// Units of one job that are being compared.
#[derive(Clone, Debug, Default)]
pub(crate) struct Checks {
    open: BTreeMap<WorkUnit, Check>,
    /// Those that nobody renders.
    waiting: BTreeSet<WorkUnit>,
}

impl Checks {
    /// Begins to compare an accepted unit.
    pub fn begin(&mut self, unit: WorkUnit, name: Arc<str>, digest: Digest) {
        let votes = vec![(name, digest)];
        self.open.insert(unit, Check { votes, failed: Vec::new(), lease: None, attempts: 0 });
        self.waiting.insert(unit);
    }

    pub fn is_empty(&self) -> bool {
        self.open.is_empty()
    }

    /// Whether there is anything to give out.
    pub fn any_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Those that nobody renders, in planning order.
    pub fn waiting(&self) -> impl Iterator<Item = WorkUnit> + '_ {
        self.waiting.iter().copied()
    }

    /// Whether something of a frame is being compared.
    pub fn any_of(&self, frame: FrameIndex) -> bool {
        self.open.keys().any(|unit| unit.frame == frame)
    }

    /// Whether a worker has not been heard on a unit, so that its digest would tell something.
    pub fn may(&self, unit: &WorkUnit, name: &Arc<str>) -> bool {
        self.open.get(unit).is_some_and(|check| {
            !check.failed.contains(name) && check.votes.iter().all(|(voter, _)| voter != name)
        })
    }

    /// Whether those who were heard on a unit disagree.
    pub fn is_disputed(&self, unit: &WorkUnit) -> bool {
        self.open.get(unit).is_some_and(|check| check.votes.len() > 1)
    }

    /// A unit that was rendered differently and that nobody renders now.
    pub fn disputed(&self) -> Option<WorkUnit> {
        self.waiting().find(|unit| self.is_disputed(unit))
    }

    /// Notes that a worker renders a unit once more; the number of leases it has had for that.
    pub fn lease(&mut self, unit: &WorkUnit, lease: LeaseId) -> u32 {
        let check = self.open.get_mut(unit).expect("a check is leased while it is open");
        check.lease = Some(lease);
        check.attempts += 1;
        self.waiting.remove(unit);
        check.attempts
    }

    /// Ends a lease.
    pub fn release(&mut self, unit: &WorkUnit, lease: LeaseId) {
        if let Some(check) = self.open.get_mut(unit).filter(|check| check.lease == Some(lease)) {
            check.lease = None;
            self.waiting.insert(*unit);
        }
    }

    /// Notes that a worker cannot render a unit.
    pub fn fail(&mut self, unit: &WorkUnit, name: Arc<str>) {
        if let Some(check) = self.open.get_mut(unit) {
            check.failed.push(name);
        }
    }

    /// Takes a worker's digest of a unit.
    pub fn vote(&mut self, unit: &WorkUnit, name: &Arc<str>, digest: Digest) -> Vote {
        let heard = |check: &Check| check.votes.iter().any(|(voter, _)| voter == name);
        let Some(check) = self.open.get_mut(unit).filter(|check| !heard(check)) else {
            return Vote::Pointless;
        };
        if check.votes.iter().all(|(_, other)| *other != digest) {
            check.votes.push((name.clone(), digest));
            return Vote::Disputed;
        }
        let displaced = check.lease;
        let liars = check.votes.iter().filter(|(_, other)| *other != digest);
        let liars = liars.map(|(voter, _)| voter.clone()).collect();
        self.remove(unit);
        Vote::Settled(Settled { liars, displaced })
    }

    /// Stops comparing a unit.
    pub fn remove(&mut self, unit: &WorkUnit) -> Option<LeaseId> {
        self.waiting.remove(unit);
        self.open.remove(unit)?.lease
    }

    /// Stops comparing the units that match; the leases on them.
    pub fn remove_if(&mut self, pointless: impl Fn(&WorkUnit) -> bool) -> Vec<LeaseId> {
        let units: Vec<_> = self.open.keys().filter(|unit| pointless(unit)).copied().collect();
        units.iter().filter_map(|unit| self.remove(unit)).collect()
    }

    /// Forgets what a worker said about what others delivered.
    pub fn unhear(&mut self, name: &Arc<str>) {
        for check in self.open.values_mut().filter(|check| check.votes[0].0 != *name) {
            check.votes.retain(|(voter, _)| voter != name);
        }
    }

    /// Every lease, in planning order.
    pub fn leases(&self) -> impl Iterator<Item = LeaseId> + '_ {
        self.open.values().filter_map(|check| check.lease)
    }
}
