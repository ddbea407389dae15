//! Puts partials together, on a thread of its own: merging large tiles must not hold up heartbeats.

use crate::outputs::{self, FinishedFrame, FrameSummary, OutputPlan};
use crate::store::{Store, StoredJob};
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

/// Finished frames that wait to be written.
const FRAMES_MAX: usize = 4;

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
    Open(JobId, Arc<JobSpec>, OutputPlan),
    /// Partials that were safe before a restart.
    Restore(JobId, FrameIndex, Vec<(FilmTile, Counters)>),
    /// Keep a partial and merge it.
    Add(Box<Claimed>),
    /// Write a frame, which has all its samples.
    Finish(JobId, FrameIndex),
    /// Forget tiles of a frame, which are rendered again.
    Reopen(JobId, FrameIndex, Vec<Tile>),
    /// Take a finished frame away, which is rendered again.
    Withdraw(JobId, FrameIndex),
    /// How wrong the oldest open frame of a job still is.
    Estimate(JobId, oneshot::Sender<Option<ErrorEstimate>>),
    /// Forget a job.
    Close(JobId),
    /// Keep what has become of a job.
    Record(Box<StoredJob>),
    /// See whether the store works again.
    Probe,
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
    /// A partial cannot be kept at present.
    NotStored {
        /// As it was claimed.
        delivery: Delivery,
        /// Why.
        reason: String,
    },
    /// Whether the store works.
    Probed(Result<(), String>),
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
) -> std::io::Result<(mpsc::Sender<Task>, mpsc::UnboundedReceiver<Report>)> {
    let (task_sender, tasks) = mpsc::channel(TASKS_MAX);
    // There is at most one report per claimed partial or finished frame, and reports are small.
    let (reports, report_receiver) = mpsc::unbounded_channel();
    let (frame_sender, frames) = mpsc::channel(FRAMES_MAX);
    let assembly = Assembly {
        store: store.clone(),
        jobs: BTreeMap::new(),
        reports: reports.clone(),
        frames: frame_sender,
    };
    std::thread::Builder::new().name("assembly".to_owned()).spawn(move || assembly.run(tasks))?;
    std::thread::Builder::new().name("frame-writer".to_owned()).spawn(move || {
        write_frames(frames, store.as_deref(), &reports);
    })?;
    Ok((task_sender, report_receiver))
}

enum FrameTask {
    Write { job: JobId, spec: Arc<JobSpec>, plan: OutputPlan, finished: Box<FinishedFrame> },
    Withdraw { job: JobId, plan: OutputPlan, frame: FrameIndex },
}

fn write_frames(
    mut frames: mpsc::Receiver<FrameTask>,
    store: Option<&Store>,
    reports: &mpsc::UnboundedSender<Report>,
) {
    while let Some(task) = frames.blocking_recv() {
        let (job, spec, plan, finished) = match task {
            FrameTask::Write { job, spec, plan, finished } => (job, spec, plan, finished),
            FrameTask::Withdraw { job, plan, frame } => {
                if let Err(error) = outputs::withdraw(&plan, frame) {
                    warn!(%job, %frame, %error, "a wrong frame cannot be removed; it will be written over");
                }
                let _ = reports.send(Report::Withdrawn(job, frame));
                continue;
            }
        };
        let mut outcome = outputs::write(&spec, &plan, &finished);
        if let Some(store) = store {
            // All of it is safe as partials: there is time until the disk has room again.
            while let Err(error) = &outcome {
                warn!(%job, frame = %finished.frame, %error, "frame cannot be written; trying again");
                std::thread::sleep(RETRY_AFTER);
                outcome = outputs::write(&spec, &plan, &finished);
            }
            store.remove_partials(job, finished.frame);
        }
        // Nobody listens any more: the coordinator ends.
        let _ = reports.send(Report::Frame { job, outcome: outcome.map_err(|err| err.to_string()) });
    }
}

struct Job {
    spec: Arc<JobSpec>,
    plan: OutputPlan,
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
    store: Option<Arc<Store>>,
    jobs: BTreeMap<JobId, Job>,
    reports: mpsc::UnboundedSender<Report>,
    frames: mpsc::Sender<FrameTask>,
}

impl Assembly {
    fn run(mut self, mut tasks: mpsc::Receiver<Task>) {
        while let Some(task) = tasks.blocking_recv() {
            match task {
                Task::Open(job, spec, plan) => {
                    // It is still open when a frame of it is rendered again.
                    self.jobs.entry(job).or_insert_with(|| Job { spec, plan, frames: BTreeMap::new() });
                }
                Task::Restore(job, frame, partials) => self.restore(job, frame, partials),
                Task::Add(claimed) => self.add(*claimed),
                Task::Finish(job, frame) => self.finish(job, frame),
                Task::Reopen(job, frame, tiles) => self.reopen(job, frame, &tiles),
                Task::Withdraw(job, frame) => {
                    let plan = self.jobs.get(&job).map(|job| job.plan.clone());
                    if let Some(plan) = plan {
                        let _ = self.frames.blocking_send(FrameTask::Withdraw { job, plan, frame });
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
                Task::Record(job) => {
                    let Some(Err(error)) = self.store.as_ref().map(|store| store.put_job(&job)) else {
                        continue;
                    };
                    warn!(job = %job.job, %error, "job cannot be recorded");
                }
                Task::Probe => {
                    let works = self.store.as_ref().map_or(Ok(()), |store| store.probe());
                    let _ = self.reports.send(Report::Probed(works.map_err(|err| err.to_string())));
                }
            }
        }
    }

    fn add(&mut self, claimed: Claimed) {
        let Claimed { delivery, tile, partial_exr, counters, render, arrived } = claimed;
        if let Some(store) = &self.store
            && let Err(error) = store.put_partial(delivery.job, &delivery.unit, &partial_exr)
        {
            let _ = self.reports.send(Report::NotStored { delivery, reason: error.to_string() });
            return;
        }
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
        // What is left behind is written over or, after a restart, merged again; so it must go.
        while let Some(Err(error)) = self.store.as_ref().map(|store| store.remove_tiles(job_id, frame, tiles))
        {
            warn!(job = %job_id, %frame, %error, "wrong partials cannot be removed; trying again");
            std::thread::sleep(RETRY_AFTER);
        }
    }

    fn finish(&mut self, job_id: JobId, frame: FrameIndex) {
        let Some(job) = self.jobs.get_mut(&job_id) else { return };
        let Some(open) = job.frames.remove(&frame) else { return };
        let render = open.span.map_or(Duration::ZERO, |(first, last)| last - first);
        let counters = open.counters.into_values().fold(Counters::default(), Counters::plus);
        let finished = Box::new(FinishedFrame { frame, film: open.film, counters, render });
        let (spec, plan) = (job.spec.clone(), job.plan.clone());
        let _ = self.frames.blocking_send(FrameTask::Write { job: job_id, spec, plan, finished });
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
