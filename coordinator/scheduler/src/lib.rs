//! Decides who renders which unit, and when. Reads no clock, socket or file: the same events give the same actions.
//!
//! ```text
//! scheduler.handle(now, event);                                  // tell it what happened,
//! while let Some(action) = scheduler.poll_action() { .. }        // do what it says,
//! wait_until(scheduler.next_deadline());                         // and send a `Tick` then, at the latest
//! ```
//!
//! A result is taken in two steps, so that two overlapping results are never both stored: `claim` asks whether its
//! samples are still open and reserves them; `UnitAccepted`, `StoreFailed` or `ResultRejected` settles the claim.

mod action;
mod event;
mod policy;
mod status;
mod time;

pub use action::{Action, JobFault, WhyDisconnect};
pub use event::{Delivery, Event};
pub use policy::{Config, HEARTBEAT, LEASE_TTL, TARGET_UNIT};
pub use status::{JobStatus, Status, WhyIdle, WorkerStatus};
pub use time::Timestamp;

use farm_film::WorkUnit;
use farm_job::JobId;
use std::collections::VecDeque;

/// What to do with a result that has come in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// All its samples are open: verify it, store it, acknowledge it.
    Wanted,
    /// Some or all of its samples are there or on their way to the store, or its job or frame has ended: acknowledge it
    /// as not needed and drop it.
    NotNeeded,
    /// It is no unit of its job: refuse it.
    Foreign,
}

/// The mind of the farm.
#[derive(Debug)]
pub struct Scheduler {
    actions: VecDeque<Action>,
}

impl Scheduler {
    /// A farm without jobs and workers.
    pub fn new(config: Config) -> Self {
        let _ = config;
        Self { actions: VecDeque::new() }
    }

    /// Takes notice of an event. `now` never runs backwards; an earlier moment counts as the latest one seen.
    /// Names that are not known, any more or yet, are no error: messages cross on the wire.
    pub fn handle(&mut self, now: Timestamp, event: Event) {
        let _ = (now, event);
    }

    /// The next thing to do; none when all is done.
    pub fn poll_action(&mut self) -> Option<Action> {
        self.actions.pop_front()
    }

    /// When to send a [`Event::Tick`] if nothing happens before; never if none.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        None
    }

    /// Whether a result would be claimed, without claiming it.
    pub fn wants(&self, job: JobId, unit: &WorkUnit) -> Verdict {
        let _ = (job, unit);
        Verdict::NotNeeded
    }

    /// Takes a result off its worker's hands, whose lease ends with it, and reserves its samples if they are
    /// [`Verdict::Wanted`]. Then exactly one of [`Event::UnitAccepted`], [`Event::StoreFailed`] and
    /// [`Event::ResultRejected`] must follow for the same delivery, also when the worker has left meanwhile.
    pub fn claim(&mut self, now: Timestamp, delivery: &Delivery) -> Verdict {
        let _ = now;
        self.wants(delivery.job, &delivery.unit)
    }

    /// Everything one may want to show.
    pub fn status(&self, now: Timestamp) -> Status {
        let _ = now;
        Status { jobs: Vec::new(), workers: Vec::new(), why_idle: Some(WhyIdle::NoJobs) }
    }
}
