//! Makes results durable before anything is acknowledged: what waits is put together, as one put costs the same for one
//! result as for hundreds. While the store fails, results are held and tried again.

mod desk;
mod merging;

use crate::assembly::{Claimed, Report, Task};
use crate::store::{Holding, Store};
use desk::Desk;
use farm_film::{FrameIndex, Tile};
use farm_job::{JobId, JobSpec};
use farm_scheduler::Reputation;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use tokio::sync::{mpsc, oneshot};

/// Bytes of results that wait for the store. Beyond this they are turned away, and rendered again when the store works.
const WAITING_BYTES_MAX: usize = 1 << 30;

enum Order {
    Open(JobId, Arc<JobSpec>, Vec<(FrameIndex, Vec<Holding>)>),
    Keep(Box<Claimed>),
    Reopen(Reopened),
    Remember(Reputation, oneshot::Sender<()>),
    Finished(JobId, FrameIndex),
    Discard(JobId, oneshot::Sender<()>),
}

/// What is rendered again.
pub struct Reopened {
    /// Whose.
    pub job: JobId,
    /// Which picture.
    pub frame: FrameIndex,
    /// Which part of it.
    pub tiles: Vec<Tile>,
    /// The frame was finished, and all of it is rendered again.
    pub finished: bool,
}

/// Takes results that are to be kept.
pub struct Keeper {
    inbox: mpsc::UnboundedSender<Order>,
    waiting_bytes: Arc<AtomicUsize>,
}

impl Keeper {
    /// Starts to keep results in `store`, each of which goes on to `assembly` when it is durable. `origins`: keep as well who
    /// delivered them.
    pub fn start(
        store: Arc<Store>,
        origins: bool,
        assembly: mpsc::Sender<Task>,
        reports: mpsc::UnboundedSender<Report>,
    ) -> Self {
        // Bounded by the bytes in it.
        let (inbox, orders) = mpsc::unbounded_channel();
        let waiting_bytes = Arc::new(AtomicUsize::new(0));
        let desk = Desk::new(store, origins, assembly, reports, waiting_bytes.clone());
        tokio::spawn(desk.run(orders));
        Self { inbox, waiting_bytes }
    }

    /// Results of a job will come; `durable` is there already.
    pub fn open(&self, job: JobId, spec: Arc<JobSpec>, durable: Vec<(FrameIndex, Vec<Holding>)>) {
        // The desk lives as long as the program.
        let _ = self.inbox.send(Order::Open(job, spec, durable));
    }

    /// Keeps a result; gives it back when there is no room for it.
    pub fn keep(&self, claimed: Box<Claimed>) -> Result<(), Box<Claimed>> {
        let bytes = claimed.partial_exr.len();
        if self.waiting_bytes.fetch_add(bytes, Ordering::Relaxed) + bytes > WAITING_BYTES_MAX {
            self.waiting_bytes.fetch_sub(bytes, Ordering::Relaxed);
            return Err(claimed);
        }
        let _ = self.inbox.send(Order::Keep(claimed));
        Ok(())
    }

    /// Forgets what is kept of some tiles, or of a finished frame, and lets the assembly forget it.
    pub fn reopen(&self, reopened: Reopened) {
        let _ = self.inbox.send(Order::Reopen(reopened));
    }

    /// Keeps what is known of workers, before anything that is asked later; says when it is durable.
    pub fn remember(&self, reputation: Reputation, done: oneshot::Sender<()>) {
        let _ = self.inbox.send(Order::Remember(reputation, done));
    }

    /// A frame is finished and durable: its results are needed no more.
    pub fn finished(&self, job: JobId, frame: FrameIndex) {
        let _ = self.inbox.send(Order::Finished(job, frame));
    }

    /// Forgets all results of a job that was given up or forgotten; says when they are gone.
    pub fn discard(&self, job: JobId, done: oneshot::Sender<()>) {
        let _ = self.inbox.send(Order::Discard(job, done));
    }
}

/// Results of one frame go together.
type Key = (JobId, FrameIndex);
