//! Puts partials together, on a thread of its own: merging large tiles must not hold up heartbeats.

use crate::checkpoint::Spent;
use crate::open_frame::{Arrival, OpenFrame, Outlook};
use crate::outputs::{self, FinishedFrame, FrameSummary, OutputPlan, Outputs};
use crate::store::{Store, StoreError};
use crate::truth::Truths;
use bytes::Bytes;
use farm_film::{Counters, FilmTile, FrameIndex, Rgb, Tile};
use farm_job::{JobId, JobSpec};
use farm_scheduler::Delivery;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::sync::{mpsc, oneshot};
use tracing::warn;

/// Partials that wait to be merged; beyond this, workers have to wait.
const TASKS_MAX: usize = 64;

/// Pause before a frame that could not be written is tried again.
const RETRY_AFTER: Duration = Duration::from_secs(2);

/// A partial that was claimed.
pub struct Claimed {
    /// As it was claimed.
    pub delivery: Delivery,
    /// Name of whoever rendered it.
    pub worker: String,
    /// Its sums.
    pub tile: FilmTile,
    /// The file they came in.
    pub partial_exr: Bytes,
    /// What it took.
    pub spent: Spent,
    /// When it came.
    pub arrived: Instant,
}

/// What the assembly is asked.
pub enum Task {
    /// A job will send partials.
    Open(JobId, Arc<JobSpec>, Outputs),
    /// Partials that were safe before a restart, and when their frame was begun if that is known.
    Restore(JobId, FrameIndex, Vec<(FilmTile, Counters)>, Option<Instant>),
    /// Merge a partial, which is durable where there is a store.
    Add(Box<Claimed>),
    /// Every tile of a frame has so many samples per pixel.
    Round(JobId, FrameIndex, u64),
    /// Write a frame, which has all its samples: so many per pixel.
    Finish(JobId, FrameIndex, u64),
    /// Forget tiles of a frame, which are rendered again; their partials are gone.
    Reopen(JobId, FrameIndex, Vec<Tile>),
    /// Take a finished frame away, which is rendered again.
    Withdraw(JobId, FrameIndex),
    /// How it stands with the oldest open frame of a job.
    Outlook(JobId, oneshot::Sender<Option<Outlook>>),
    /// Forget a job.
    Close(JobId),
}

/// What is being stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum StorePart {
    /// Accepted results.
    Partials,
    /// Finished frames.
    Frames,
    /// What has become of a job.
    States,
}

/// What the assembly reports.
pub enum Report {
    /// A partial is part of its frame.
    Added {
        /// As it was claimed.
        delivery: Delivery,
        /// What it took.
        spent: Spent,
        /// When it came.
        arrived: Instant,
    },
    /// A frame is good enough with so many samples per pixel.
    Enough(JobId, FrameIndex, u64),
    /// Tiles of a frame have enough with so many samples per pixel.
    TilesEnded(JobId, FrameIndex, Vec<Tile>, u64),
    /// A partial cannot be part of its frame.
    Refused {
        /// As it was claimed.
        delivery: Delivery,
        /// Why.
        reason: String,
    },
    /// Whether a part of the store works; what cannot be stored is held and tried again.
    Store(StorePart, Result<(), String>),
    /// A frame is written, or cannot be.
    Frame {
        /// Whose.
        job: JobId,
        /// What became of it.
        outcome: Result<FrameSummary, String>,
    },
    /// A finished frame was taken away.
    Withdrawn(JobId, FrameIndex),
}

/// Starts the threads. Both end when the sender of tasks is dropped. With a store, whatever is reported is durable.
pub fn start(
    store: Option<Arc<Store>>,
    reports: mpsc::UnboundedSender<Report>,
) -> std::io::Result<mpsc::Sender<Task>> {
    let (task_sender, tasks) = mpsc::channel(TASKS_MAX);
    // Frames pile up only while the store fails, and then nothing more is given out.
    let (frame_sender, frames) = mpsc::unbounded_channel();
    let assembly = Assembly { jobs: BTreeMap::new(), reports: reports.clone(), frames: frame_sender };
    apart("assembly", assembly.run(tasks))?;
    apart("frame-writer", FrameWriter { store, reports }.run(frames))?;
    Ok(task_sender)
}

/// Runs a task on a thread of its own; among the others where the runtime has a single thread, as in simulations.
fn apart(name: &str, task: impl Future<Output = ()> + Send + 'static) -> std::io::Result<()> {
    let runtime = Handle::current();
    if runtime.runtime_flavor() == RuntimeFlavor::CurrentThread {
        runtime.spawn(task);
        return Ok(());
    }
    std::thread::Builder::new().name(name.to_owned()).spawn(move || runtime.block_on(task)).map(drop)
}

enum FrameTask {
    Write { job: JobId, spec: Arc<JobSpec>, outputs: Outputs, finished: Box<FinishedFrame> },
    Look { job: JobId, frame: FrameIndex, plan: OutputPlan, spp: u64, pixels: Vec<Rgb> },
    Withdraw { job: JobId, outputs: Outputs, frame: FrameIndex },
}

struct FrameWriter {
    store: Option<Arc<Store>>,
    reports: mpsc::UnboundedSender<Report>,
}

impl FrameWriter {
    async fn run(self, mut frames: mpsc::UnboundedReceiver<FrameTask>) {
        let mut truths = Truths::default();
        while let Some(task) = frames.recv().await {
            let report = match task {
                FrameTask::Write { job, spec, outputs, mut finished } => {
                    if let Outputs::Files(plan) = &outputs {
                        truths.tell(job, plan, &mut finished);
                    }
                    Report::Frame { job, outcome: self.write(job, &spec, &outputs, &finished).await }
                }
                FrameTask::Look { job, frame, plan, spp, pixels } => {
                    truths.look(job, frame, &plan, spp, pixels);
                    continue;
                }
                FrameTask::Withdraw { job, outputs, frame } => {
                    self.withdraw(job, &outputs, frame).await;
                    Report::Withdrawn(job, frame)
                }
            };
            // Nobody listens any more: the coordinator ends.
            let _ = self.reports.send(report);
        }
    }

    async fn write(
        &self,
        job: JobId,
        spec: &JobSpec,
        outputs: &Outputs,
        finished: &FinishedFrame,
    ) -> Result<FrameSummary, String> {
        match (outputs, &self.store) {
            (Outputs::Files(plan), _) => outputs::write(spec, plan, finished).map_err(|err| err.to_string()),
            (Outputs::Store { scene_name }, Some(store)) => {
                let (exr, summary) = outputs::encode(job, spec, scene_name, finished);
                let (frame, exr) = (finished.frame, Bytes::from(exr));
                // All of it is safe as partials: there is time until the store has room for the frame.
                self.insist(|| store.put_frame(job, frame, exr.clone())).await?;
                for warning in finished.counters.warnings() {
                    warn!(%job, %frame, "{warning}");
                }
                Ok(summary)
            }
            (Outputs::Store { .. }, None) => unreachable!("frames go to a store where there is one"),
        }
    }

    async fn withdraw(&self, job: JobId, outputs: &Outputs, frame: FrameIndex) {
        let outcome = match (outputs, &self.store) {
            (Outputs::Files(plan), _) => outputs::withdraw(plan, frame).map_err(|err| err.to_string()),
            (Outputs::Store { .. }, Some(store)) => self.insist(|| store.remove_frame(job, frame)).await,
            (Outputs::Store { .. }, None) => Ok(()),
        };
        if let Err(error) = outcome {
            warn!(%job, %frame, error, "a wrong frame cannot be removed; it will be written over");
        }
    }

    /// Does something with the store until it is done, or until the store is another coordinator's.
    async fn insist<F: Future<Output = Result<(), StoreError>>>(
        &self,
        act: impl Fn() -> F,
    ) -> Result<(), String> {
        let tell = |outcome| drop(self.reports.send(Report::Store(StorePart::Frames, outcome)));
        let mut failed = false;
        loop {
            match act().await {
                Ok(()) => break,
                Err(error @ StoreError::TurnOver(_)) => return Err(error.to_string()),
                Err(error) => tell(Err(error.to_string())),
            }
            failed = true;
            tokio::time::sleep(RETRY_AFTER).await;
        }
        if failed {
            tell(Ok(()));
        }
        Ok(())
    }
}

struct Job {
    spec: Arc<JobSpec>,
    outputs: Outputs,
    frames: BTreeMap<FrameIndex, OpenFrame>,
}

struct Assembly {
    jobs: BTreeMap<JobId, Job>,
    reports: mpsc::UnboundedSender<Report>,
    frames: mpsc::UnboundedSender<FrameTask>,
}

impl Assembly {
    async fn run(mut self, mut tasks: mpsc::Receiver<Task>) {
        while let Some(task) = tasks.recv().await {
            match task {
                Task::Open(job, spec, outputs) => {
                    // It is still open when a frame of it is rendered again.
                    self.jobs.entry(job).or_insert_with(|| Job { spec, outputs, frames: BTreeMap::new() });
                }
                Task::Restore(job, frame, partials, begun) => self.restore(job, frame, partials, begun),
                Task::Add(claimed) => self.add(*claimed),
                Task::Round(job, frame, spp) => self.round(job, frame, spp),
                Task::Finish(job, frame, spp) => self.finish(job, frame, spp),
                Task::Reopen(job, frame, tiles) => self.reopen(job, frame, &tiles),
                Task::Withdraw(job, frame) => {
                    let outputs = self.jobs.get(&job).map(|job| job.outputs.clone());
                    if let Some(outputs) = outputs {
                        let _ = self.frames.send(FrameTask::Withdraw { job, outputs, frame });
                    }
                }
                Task::Outlook(job, reply) => {
                    let oldest = self.jobs.get(&job).and_then(|job| job.frames.values().next());
                    let _ = reply.send(oldest.map(OpenFrame::outlook));
                }
                Task::Close(job) => {
                    self.jobs.remove(&job);
                }
            }
        }
    }

    fn add(&mut self, claimed: Claimed) {
        let Claimed { delivery, tile, spent, arrived, .. } = claimed;
        let arrival = Arrival { worker: delivery.worker, spent, at: arrived };
        let report = match self.merge(&delivery, tile, arrival) {
            Ok(()) => Report::Added { delivery, spent, arrived },
            Err(reason) => Report::Refused { delivery, reason },
        };
        let _ = self.reports.send(report);
    }

    fn restore(
        &mut self,
        job: JobId,
        frame: FrameIndex,
        partials: Vec<(FilmTile, Counters)>,
        begun: Option<Instant>,
    ) {
        let Some(job) = self.jobs.get_mut(&job) else { return };
        let Ok(mut open) = OpenFrame::new(&job.spec) else { return };
        for (tile, counters) in partials {
            // Whoever restored them has looked whether they fit; what overlaps is there already.
            let _ = open.restore(tile, counters);
        }
        begun.into_iter().for_each(|begun| open.begin(begun));
        job.frames.insert(frame, open);
    }

    fn merge(&mut self, delivery: &Delivery, tile: FilmTile, arrival: Arrival) -> Result<(), String> {
        let job = self.jobs.get_mut(&delivery.job).ok_or("its job has ended")?;
        let frame = match job.frames.entry(delivery.unit.frame) {
            std::collections::btree_map::Entry::Occupied(entry) => entry.into_mut(),
            std::collections::btree_map::Entry::Vacant(entry) => entry.insert(OpenFrame::new(&job.spec)?),
        };
        frame.add(tile, arrival)
    }

    fn round(&mut self, id: JobId, frame: FrameIndex, spp: u64) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        let Some(open) = job.frames.get_mut(&frame) else { return };
        let plan = match &job.outputs {
            Outputs::Files(plan) => Some(plan).filter(|plan| plan.reference.is_some()),
            Outputs::Store { .. } => None,
        };
        match open.round(spp, plan.is_some()) {
            Ok(round) => {
                if let Some((plan, pixels)) = plan.cloned().zip(round.look) {
                    let _ = self.frames.send(FrameTask::Look { job: id, frame, plan, spp, pixels });
                }
                if !round.ended.is_empty() {
                    let _ = self.reports.send(Report::TilesEnded(id, frame, round.ended, spp));
                }
                if round.ends {
                    let _ = self.reports.send(Report::Enough(id, frame, spp));
                }
            }
            Err(error) => warn!(job = %id, %frame, %error, "partials do not make up a picture"),
        }
    }

    fn reopen(&mut self, id: JobId, frame: FrameIndex, tiles: &[Tile]) {
        if let Some(open) = self.jobs.get_mut(&id).and_then(|job| job.frames.get_mut(&frame)) {
            tiles.iter().for_each(|tile| open.forget(*tile));
        }
    }

    fn finish(&mut self, id: JobId, frame: FrameIndex, spp: u64) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        let Some(open) = job.frames.remove(&frame) else { return };
        match open.finish(frame, spp) {
            Ok(finished) => {
                let (spec, outputs, finished) = (job.spec.clone(), job.outputs.clone(), Box::new(finished));
                let _ = self.frames.send(FrameTask::Write { job: id, spec, outputs, finished });
            }
            Err(reason) => {
                let _ = self.reports.send(Report::Frame { job: id, outcome: Err(reason) });
            }
        }
    }
}
