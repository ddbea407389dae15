//! What the farm looks like from outside.

use farm_film::{FrameIndex, WorkUnit};
use farm_job::{JobId, JobState, WorkerId};
use serde::Serialize;
use std::time::Duration;

/// The farm at one moment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Status {
    /// Every job that was submitted, by identifier.
    pub jobs: Vec<JobStatus>,
    /// Every connected worker, by identifier.
    pub workers: Vec<WorkerStatus>,
    /// Why nothing is being rendered; none while something is.
    pub why_idle: Option<WhyIdle>,
}

/// One job.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JobStatus {
    /// Which one.
    pub job: JobId,
    /// For people.
    pub name: String,
    /// Where it is in its life.
    pub state: JobState,
    /// Higher goes first.
    pub priority: i32,
    /// Complete frames.
    pub frames_done: u64,
    /// All its frames.
    pub frames: u64,
    /// The first frame that has begun and is not complete.
    pub current: Option<FrameStatus>,
    /// Samples over all pixels and frames that are durable.
    pub samples_done: u128,
    /// Samples over all pixels and frames.
    pub samples: u128,
    /// Deliveries that were accepted.
    pub units_done: u64,
    /// Leases that are out.
    pub leases: u64,
    /// Units that a worker could not render, and results that were rejected.
    pub failures: u64,
    /// Leases that ran out or went with their worker.
    pub expired: u64,
    /// Results that were dropped because their samples were already there.
    pub duplicates: u64,
    /// Units that two workers rendered to the same bits.
    pub verified: u64,
    /// Units that were to be compared, but with nobody there to render them once more.
    pub unverified: u64,
    /// Time its accepted units took on their slots.
    pub render: Duration,
    /// Why it failed.
    pub fault: Option<String>,
    /// Why none of its units is being rendered; none while one is, and for a job that has ended.
    pub why_idle: Option<WhyIdle>,
}

/// One frame that has begun and is not complete.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct FrameStatus {
    /// Which one.
    pub frame: FrameIndex,
    /// Samples per pixel that every tile has: where [`crate::Event::FrameTruncated`] ends it at once. 0 at first.
    pub spp_complete: u64,
    /// Samples per pixel when all that was begun is complete: where [`crate::Event::FrameTruncated`] ends it without waste.
    pub spp_begun: u64,
}

/// One worker.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WorkerStatus {
    /// This connection.
    pub worker: WorkerId,
    /// Names it across connections.
    pub name: String,
    /// Units it renders at once.
    pub slots: u32,
    /// Leases it holds, waiting ones included.
    pub in_flight: u64,
    /// Pixel samples per second of all its slots together, smoothed; 0 before its first result.
    pub samples_per_s: f64,
    /// Units it delivered and that were accepted.
    pub units_done: u64,
    /// Units that failed there and results that were rejected.
    pub failures: u64,
    /// Time since it was last heard.
    pub silent_for: Duration,
    /// Takes no more work.
    pub draining: bool,
    /// Its results were wrong: it gets nothing any more.
    pub distrusted: bool,
    /// Time until it is forgiven.
    pub quarantined_for: Option<Duration>,
}

/// Why nothing is being rendered.
#[derive(Clone, Debug, PartialEq, Serialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum WhyIdle {
    /// There is nothing to do.
    #[error("no job is open: submit one")]
    NoJobs,
    /// Every open job, or this one, is paused.
    #[error("paused: resume it to go on")]
    Paused,
    /// Nobody is connected.
    #[error("no worker is connected: start one with worker --connect")]
    NoWorkers,
    /// Everybody connected takes no more work.
    #[error("every connected worker is draining: start another one")]
    Draining,
    /// Nobody connected is trusted at the moment.
    #[error("every connected worker is in quarantine after failures; the first is tried again in {} s", .soonest.as_secs())]
    Quarantined {
        /// Time until the first of them is tried again.
        soonest: Duration,
    },
    /// Everybody connected delivered wrong results.
    #[error("every connected worker has delivered wrong results: start another one")]
    Distrusted,
    /// Two results of the same unit differ, and nobody is there to tell which one is wrong.
    #[error(
        "workers rendered {unit} differently, and one more is needed to tell which of them is wrong: start another one"
    )]
    Disputed {
        /// Which one.
        unit: WorkUnit,
    },
    /// Nobody connected can render the job.
    #[error("every connected worker refuses the job: {reason}")]
    Refused {
        /// One worker's words.
        reason: String,
    },
    /// Other jobs go first.
    #[error("waits for job {ahead}, which goes first")]
    Behind {
        /// The one that has the workers.
        ahead: JobId,
    },
    /// All is rendered and on its way to the store.
    #[error("waits for the store")]
    Storing,
}
