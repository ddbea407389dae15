//! Decides who renders which unit, and when. Reads no clock, socket or file: the same events give the same actions.
//!
//! ```text
//! scheduler.handle(now, event);                                  // tell it what happened,
//! while let Some(action) = scheduler.poll_action() { .. }        // do what it says,
//! wait_until(scheduler.next_deadline());                         // and send a `Tick` then, at the latest
//! ```
//!
//! A result is taken in two steps, so that two overlapping results are never both stored: [`Scheduler::claim`] asks
//! whether its samples are still open and reserves them; [`Event::UnitAccepted`], [`Event::StoreFailed`] or
//! [`Event::ResultRejected`] settles the claim.

mod action;
mod checks;
mod cost;
mod dispatch;
mod event;
mod health;
mod job;
mod lease;
mod membership;
mod piece;
mod plan;
mod policy;
mod progress;
mod provenance;
mod queue;
mod report;
mod results;
mod scheduler;
mod status;
#[cfg(test)]
mod testing;
mod time;
mod verify;
mod worker;

pub use action::{Action, JobFault, WhyDisconnect};
pub use event::{Delivery, Event, Origin};
pub use health::{Quarantined, Reputation};
pub use policy::{Config, HEARTBEAT, LEASE_TTL, TARGET_UNIT};
pub use results::Verdict;
pub use scheduler::Scheduler;
pub use status::{FrameStatus, JobStatus, Status, WhyIdle, WorkerStatus};
pub use time::Timestamp;
