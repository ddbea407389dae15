//! What the shell must now do.

use crate::Timestamp;
use farm_film::{FrameIndex, Tile, WorkUnit};
use farm_job::{JobId, JobSpecError, LeaseId, WorkerId};

/// Why a job was given up.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum JobFault {
    /// The specification is not one.
    #[error(transparent)]
    Spec(#[from] JobSpecError),
    /// A unit failed wherever it was tried.
    #[error("{unit} failed {times} times, on {}: {reason}", .workers.join(", "))]
    UnitFailed {
        /// Which one.
        unit: WorkUnit,
        /// How often.
        times: u32,
        /// Names of the workers it failed on.
        workers: Vec<String>,
        /// The last worker's words.
        reason: String,
    },
    /// Worker after worker vanished while rendering a unit.
    #[error(
        "{times} workers vanished one after another while they rendered {unit}; it may exceed their memory"
    )]
    UnitLost {
        /// Which one.
        unit: WorkUnit,
        /// How often.
        times: u32,
    },
}

/// What the shell must now do.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Let the worker render the unit.
    Grant {
        /// Who.
        worker: WorkerId,
        /// Its claim.
        lease: LeaseId,
        /// Whose.
        job: JobId,
        /// What.
        unit: WorkUnit,
        /// 1 for the first try of this unit.
        attempt: u32,
        /// When the claim ends unless a heartbeat renews it.
        deadline: Timestamp,
    },
    /// Tell the worker that the unit is no longer needed. It may deliver it nevertheless.
    Revoke {
        /// Who.
        worker: WorkerId,
        /// Which claim.
        lease: LeaseId,
    },
    /// Every pixel of the frame has samples `[0, spp)`: the moment to estimate the error, show a picture, or stop.
    /// Comes once per round, in order, also for the last one, and before [`Action::FrameComplete`]; again after a tile of it
    /// was [`Action::Reopened`].
    RoundComplete {
        /// Whose.
        job: JobId,
        /// Which one.
        frame: FrameIndex,
        /// Samples per pixel.
        spp: u64,
    },
    /// Every sample of the frame is durable, and what of it was to be compared is.
    FrameComplete {
        /// Whose.
        job: JobId,
        /// Which one.
        frame: FrameIndex,
        /// Its samples per pixel: the job's, or less after [`crate::Event::FrameTruncated`].
        spp: u64,
    },
    /// Every frame of the job is complete.
    JobDone {
        /// Which one.
        job: JobId,
    },
    /// The job is given up.
    JobFailed {
        /// Which one.
        job: JobId,
        /// Why.
        fault: JobFault,
    },
    /// The worker gets nothing until then; it stays connected. To be remembered: [`crate::Scheduler::reputation`].
    Quarantine {
        /// Who.
        worker: WorkerId,
        /// Forgiven at this moment.
        until: Timestamp,
        /// The last thing that went wrong.
        reason: String,
    },
    /// A worker's results are wrong, and it gets nothing any more, over whatever connection. What it had a hand in is
    /// [`Action::Reopened`] after this. To be remembered: [`crate::Scheduler::reputation`].
    Distrust {
        /// Names it across connections.
        name: String,
        /// How that was seen.
        reason: String,
    },
    /// Forget all that is there of these tiles: some of it came from a worker that delivers wrong results. They are rendered
    /// again, and so is what others delivered of them, because the samples of a tile are one sum.
    Reopened {
        /// Whose.
        job: JobId,
        /// Which picture.
        frame: FrameIndex,
        /// Which part of it.
        tiles: Vec<Tile>,
        /// The frame was complete and all of it is rendered again. Its job may have been done, and runs again.
        finished: bool,
    },
    /// Close the connection: the worker has been silent for too long, or has drained.
    Disconnect {
        /// Who.
        worker: WorkerId,
        /// Which of the two.
        why: WhyDisconnect,
    },
}

/// Why a connection is closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhyDisconnect {
    /// No heartbeat came; what it held is open again.
    Silent,
    /// It holds nothing any more and wants nothing.
    Drained,
}
