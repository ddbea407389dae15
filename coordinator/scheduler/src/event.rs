//! What happened.

use crate::health::Reputation;
use farm_film::{FrameIndex, Tile, WorkUnit};
use farm_job::{Digest, JobId, JobSpec, LeaseId, WorkerId};
use std::time::Duration;

/// A finished unit as it came from a worker.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Delivery {
    /// The connection it came over.
    pub worker: WorkerId,
    /// The lease it answers; one that has ended or that is unknown is no obstacle.
    pub lease: LeaseId,
    /// The job it belongs to.
    pub job: JobId,
    /// What was rendered: the leased unit, or a smaller block of it from a worker that had to stop.
    pub unit: WorkUnit,
    /// Of the partial; the same for everyone who renders the same unit.
    pub digest: Digest,
}

/// Somebody delivered something of a frame before the coordinator started.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Origin {
    /// Which picture.
    pub frame: FrameIndex,
    /// Names the worker across connections.
    pub name: String,
    /// What, and the partial's digest; nothing of a frame that is finished, of which only who took part matters.
    pub part: Option<(WorkUnit, Digest)>,
}

/// What happened in the world.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A new job, or one that a restarted coordinator found in its store. An identifier of a job that has ended may come
    /// again and replaces it.
    JobSubmitted {
        /// Its name from now on.
        job: JobId,
        /// What is asked.
        spec: Box<JobSpec>,
        /// Frames whose finished picture is already stored.
        finished: Vec<FrameIndex>,
        /// Partials that are already durable, in any order; what is no part of the job is ignored.
        durable: Vec<WorkUnit>,
        /// Who delivered what of all that, in any order; what is no part of the job is ignored.
        origins: Vec<Origin>,
    },
    /// What was known of workers before the coordinator started.
    ReputationRecalled(Reputation),
    /// Trust a worker again that was not trusted, or was in quarantine.
    WorkerForgiven {
        /// Names it across connections.
        name: String,
    },
    /// Give out nothing more of the job for now.
    JobPaused {
        /// Which one.
        job: JobId,
    },
    /// Go on with a paused job.
    JobResumed {
        /// Which one.
        job: JobId,
    },
    /// Give the job up; what its workers hold is revoked.
    JobCancelled {
        /// Which one.
        job: JobId,
    },
    /// Try a failed job again; what it had is kept, its failures are forgotten.
    JobRequeued {
        /// Which one.
        job: JobId,
    },
    /// Forget a job that has ended.
    JobForgotten {
        /// Which one.
        job: JobId,
    },
    /// Jobs of higher priority go first.
    PriorityChanged {
        /// Which one.
        job: JobId,
        /// The new one.
        priority: i32,
    },
    /// The frame is good enough: end it after `spp` samples per pixel, which must be the end of one of its rounds (see
    /// [`crate::Action::RoundComplete`]); anything else is ignored. Units beyond it are revoked and no longer wanted.
    FrameTruncated {
        /// Which job.
        job: JobId,
        /// Which frame.
        frame: FrameIndex,
        /// Its new number of samples per pixel.
        spp: u64,
    },
    /// Some tiles of a frame get no more than their first `spp` samples per pixel. Ignored unless a round ends
    /// there, and where the frame is complete.
    TilesEnded {
        /// Which job.
        job: JobId,
        /// Which picture.
        frame: FrameIndex,
        /// Which part of it.
        tiles: Vec<Tile>,
        /// Samples per pixel.
        spp: u64,
    },
    /// A worker has connected; its fingerprint was checked.
    WorkerJoined {
        /// This connection.
        worker: WorkerId,
        /// Names the worker across its connections; a quarantine outlasts a reconnect.
        name: String,
        /// Units it renders at once, at least 1.
        slots: u32,
    },
    /// A worker is alive and holds these leases; each of them is renewed.
    Heartbeat {
        /// Which one.
        worker: WorkerId,
        /// Its leases, waiting ones included.
        leases: Vec<LeaseId>,
        /// Time of a message there and back, when one was measured.
        round_trip: Option<Duration>,
    },
    /// A worker finishes what it holds and takes no more.
    WorkerDraining {
        /// Which one.
        worker: WorkerId,
    },
    /// The connection is gone, whether with a farewell or without; what it held is open again.
    WorkerLeft {
        /// Which one.
        worker: WorkerId,
    },
    /// A worker cannot render this job at all, for example because the scene exceeds its memory. Nobody is to blame; it
    /// gets no more of it.
    JobRefused {
        /// Who refuses.
        worker: WorkerId,
        /// What.
        job: JobId,
        /// In the worker's words.
        reason: String,
    },
    /// A delivery that was claimed ([`crate::Scheduler::claim`]) is durable.
    UnitAccepted {
        /// As it was claimed.
        delivery: Delivery,
        /// Time its rendering took on one slot, without waiting or loading.
        render: Duration,
    },
    /// A delivery that was claimed could not be stored. Nobody is to blame; the unit is open again.
    StoreFailed {
        /// As it was claimed.
        delivery: Delivery,
    },
    /// A delivery, claimed or not, did not arrive as it was sent: wrong digest, truncated, malformed. It counts against
    /// the worker, not the unit. A tile that arrived well but holds what no tile may hold is a [`Event::UnitFailed`].
    ResultRejected {
        /// What came.
        delivery: Delivery,
        /// What was wrong with it.
        reason: String,
    },
    /// A worker could not render a unit. It counts against the worker, and the unit.
    UnitFailed {
        /// Who.
        worker: WorkerId,
        /// The lease, which ends.
        lease: LeaseId,
        /// In the worker's words.
        reason: String,
    },
    /// A worker gives a lease back unrendered, because it drains or was told to stop. Nobody is to blame.
    UnitReturned {
        /// Who.
        worker: WorkerId,
        /// The lease, which ends.
        lease: LeaseId,
    },
    /// Nothing but time has passed.
    Tick,
}
