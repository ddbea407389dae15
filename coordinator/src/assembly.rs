//! Puts partials together, on a thread of its own: merging large tiles must not hold up heartbeats.

use crate::outputs::{self, FinishedFrame, FrameSummary, Outputs};
use crate::store::{Store, StoreError};
use bytes::Bytes;
use farm_film::{Accepted, Counters, ErrorEstimate, Film, FilmTile, FrameIndex, Tile};
use farm_job::{JobId, JobSpec};
use farm_scheduler::Delivery;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};
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
    /// Its sums.
    pub tile: FilmTile,
    /// The file they came in.
    pub partial_exr: Bytes,
    /// What was traced.
    pub counters: Counters,
    /// Time its rendering took.
    pub render: Duration,
    /// When it came.
    pub arrived: Instant,
}

/// What the assembly is asked.
pub enum Task {
    /// A job will send partials.
    Open(JobId, Arc<JobSpec>, Outputs),
    /// Partials that were safe before a restart.
    Restore(JobId, FrameIndex, Vec<(FilmTile, Counters)>),
    /// Merge a partial, which is durable where there is a store.
    Add(Box<Claimed>),
    /// Write a frame, which has all its samples.
    Finish(JobId, FrameIndex),
    /// Forget tiles of a frame, which are rendered again; their partials are gone.
    Reopen(JobId, FrameIndex, Vec<Tile>),
    /// Take a finished frame away, which is rendered again.
    Withdraw(JobId, FrameIndex),
    /// How wrong the oldest open frame of a job still is.
    Estimate(JobId, oneshot::Sender<Option<ErrorEstimate>>),
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
        /// Time its rendering took.
        render: Duration,
        /// What was traced.
        counters: Counters,
        /// When it came.
        arrived: Instant,
    },
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
    std::thread::Builder::new().name("assembly".to_owned()).spawn(move || assembly.run(tasks))?;
    let writer = FrameWriter { store, runtime: tokio::runtime::Handle::current(), reports };
    std::thread::Builder::new().name("frame-writer".to_owned()).spawn(move || writer.run(frames))?;
    Ok(task_sender)
}

enum FrameTask {
    Write { job: JobId, spec: Arc<JobSpec>, outputs: Outputs, finished: Box<FinishedFrame> },
    Withdraw { job: JobId, outputs: Outputs, frame: FrameIndex },
}

struct FrameWriter {
    store: Option<Arc<Store>>,
    runtime: tokio::runtime::Handle,
    reports: mpsc::UnboundedSender<Report>,
}

impl FrameWriter {
    fn run(self, mut frames: mpsc::UnboundedReceiver<FrameTask>) {
        while let Some(task) = frames.blocking_recv() {
            let report = match task {
                FrameTask::Write { job, spec, outputs, finished } => {
                    Report::Frame { job, outcome: self.write(job, &spec, &outputs, &finished) }
                }
                FrameTask::Withdraw { job, outputs, frame } => {
                    self.withdraw(job, &outputs, frame);
                    Report::Withdrawn(job, frame)
                }
            };
            // Nobody listens any more: the coordinator ends.
            let _ = self.reports.send(report);
        }
    }

    fn write(
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
                self.insist(|| store.put_frame(job, frame, exr.clone()))?;
                self.runtime.block_on(store.remove_partials(job, frame));
                for warning in finished.counters.warnings() {
                    warn!(%job, %frame, "{warning}");
                }
                Ok(summary)
            }
            (Outputs::Store { .. }, None) => unreachable!("frames go to a store where there is one"),
        }
    }

    fn withdraw(&self, job: JobId, outputs: &Outputs, frame: FrameIndex) {
        let outcome = match (outputs, &self.store) {
            (Outputs::Files(plan), _) => outputs::withdraw(plan, frame).map_err(|err| err.to_string()),
            (Outputs::Store { .. }, store) => {
                store.as_ref().map_or(Ok(()), |store| self.insist(|| store.remove_frame(job, frame)))
            }
        };
        if let Err(error) = outcome {
            warn!(%job, %frame, error, "a wrong frame cannot be removed; it will be written over");
        }
    }

    /// Does something with the store until it is done, or until the store is another coordinator's.
    fn insist<F: Future<Output = Result<(), StoreError>>>(&self, act: impl Fn() -> F) -> Result<(), String> {
        let tell = |outcome| drop(self.reports.send(Report::Store(StorePart::Frames, outcome)));
        let mut failed = false;
        loop {
            match self.runtime.block_on(act()) {
                Ok(()) => break,
                Err(error @ StoreError::TurnOver(_)) => return Err(error.to_string()),
                Err(error) => tell(Err(error.to_string())),
            }
            failed = true;
            std::thread::sleep(RETRY_AFTER);
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

struct OpenFrame {
    film: Film,
    /// What was traced for each tile.
    counters: BTreeMap<Tile, Counters>,
    /// When the first unit began and the last one came.
    span: Option<(Instant, Instant)>,
}

struct Assembly {
    jobs: BTreeMap<JobId, Job>,
    reports: mpsc::UnboundedSender<Report>,
    frames: mpsc::UnboundedSender<FrameTask>,
}

impl Assembly {
    fn run(mut self, mut tasks: mpsc::Receiver<Task>) {
        while let Some(task) = tasks.blocking_recv() {
            match task {
                Task::Open(job, spec, outputs) => {
                    // It is still open when a frame of it is rendered again.
                    self.jobs.entry(job).or_insert_with(|| Job { spec, outputs, frames: BTreeMap::new() });
                }
                Task::Restore(job, frame, partials) => self.restore(job, frame, partials),
                Task::Add(claimed) => self.add(*claimed),
                Task::Finish(job, frame) => self.finish(job, frame),
                Task::Reopen(job, frame, tiles) => self.reopen(job, frame, &tiles),
                Task::Withdraw(job, frame) => {
                    let outputs = self.jobs.get(&job).map(|job| job.outputs.clone());
                    if let Some(outputs) = outputs {
                        let _ = self.frames.send(FrameTask::Withdraw { job, outputs, frame });
                    }
                }
                Task::Estimate(job, reply) => {
                    let frames = self.jobs.get(&job).into_iter().flat_map(|job| job.frames.values());
                    let estimate = frames.filter_map(|frame| frame.film.error_estimate()).next();
                    let _ = reply.send(estimate);
                }
                Task::Close(job) => {
                    self.jobs.remove(&job);
                }
            }
        }
    }

    fn add(&mut self, claimed: Claimed) {
        let Claimed { delivery, tile, counters, render, arrived, .. } = claimed;
        let report = match self.merge(&delivery, tile, counters, arrived.checked_sub(render), arrived) {
            Ok(()) => Report::Added { delivery, render, counters, arrived },
            Err(reason) => Report::Refused { delivery, reason },
        };
        let _ = self.reports.send(report);
    }

    fn restore(&mut self, job: JobId, frame: FrameIndex, partials: Vec<(FilmTile, Counters)>) {
        let Some(job) = self.jobs.get_mut(&job) else { return };
        let Ok(mut open) = OpenFrame::new(&job.spec) else { return };
        for (tile, counters) in partials {
            // Whoever restored them has looked whether they fit.
            let window = tile.tile();
            if open.film.add(tile) == Ok(Accepted::New) {
                open.count(window, counters);
            }
        }
        job.frames.insert(frame, open);
    }

    fn merge(
        &mut self,
        delivery: &Delivery,
        tile: FilmTile,
        counters: Counters,
        begun: Option<Instant>,
        arrived: Instant,
    ) -> Result<(), String> {
        let job = self.jobs.get_mut(&delivery.job).ok_or("its job has ended")?;
        let frame = match job.frames.entry(delivery.unit.frame) {
            std::collections::btree_map::Entry::Occupied(entry) => entry.into_mut(),
            std::collections::btree_map::Entry::Vacant(entry) => entry.insert(OpenFrame::new(&job.spec)?),
        };
        frame.film.add(tile).map_err(|err| err.to_string())?;
        frame.count(delivery.unit.tile, counters);
        let begun = begun.unwrap_or(arrived);
        let (first, last) = frame.span.unwrap_or((begun, arrived));
        frame.span = Some((first.min(begun), last.max(arrived)));
        Ok(())
    }

    fn reopen(&mut self, job_id: JobId, frame: FrameIndex, tiles: &[Tile]) {
        if let Some(open) = self.jobs.get_mut(&job_id).and_then(|job| job.frames.get_mut(&frame)) {
            for tile in tiles {
                open.film.forget(*tile);
                open.counters.remove(tile);
            }
        }
    }

    fn finish(&mut self, job_id: JobId, frame: FrameIndex) {
        let Some(job) = self.jobs.get_mut(&job_id) else { return };
        let Some(open) = job.frames.remove(&frame) else { return };
        let render = open.span.map_or(Duration::ZERO, |(first, last)| last - first);
        let counters = open.counters.into_values().fold(Counters::default(), Counters::plus);
        let finished = Box::new(FinishedFrame { frame, film: open.film, counters, render });
        let (spec, outputs) = (job.spec.clone(), job.outputs.clone());
        let _ = self.frames.send(FrameTask::Write { job: job_id, spec, outputs, finished });
    }
}

impl OpenFrame {
    fn new(spec: &JobSpec) -> Result<Self, String> {
        let resolution = spec.resolution().map_err(|err| err.to_string())?;
        let film = Film::new(resolution, spec.tile_side, spec.spp).map_err(|err| err.to_string())?;
        Ok(Self { film, counters: BTreeMap::new(), span: None })
    }

    fn count(&mut self, tile: Tile, counters: Counters) {
        let sum = self.counters.entry(tile).or_default();
        *sum = sum.plus(counters);
    }
}
