//! What is shown to people: jobs and workers as they are now.

use super::{ConvertError, seconds, text};
use crate::v1;
use farm_job::{JobId, JobSpec, JobState, WorkerId};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// One job as it is now.
#[derive(Clone, Debug, PartialEq)]
pub struct JobView {
    /// Which one.
    pub job: JobId,
    /// What was asked.
    pub spec: JobSpec,
    /// Token that its owner joined with; empty when it was submitted over a line that is open to all.
    pub owner: String,
    /// Where it is in its life.
    pub state: JobState,
    /// Why it failed, or why nothing of it is running; empty when there is nothing to say.
    pub reason: String,
    /// Samples of all pixels and frames that are safe.
    pub samples_done: u64,
    /// Samples of all pixels and frames.
    pub samples_total: u64,
    /// Frames whose files are written.
    pub frames_done: u64,
    /// All frames.
    pub frames_total: u64,
    /// Estimated error of the oldest open frame: root of the mean square, in radiance.
    pub error: Option<f64>,
    /// Its relative mean squared error.
    pub rel_mse: Option<f64>,
    /// Slope of log(error) over log(seconds), over the last four doublings of that frame.
    pub slope: Option<f64>,
    /// Samples per pixel that the errors speak of.
    pub spp: u64,
    /// Until the end: expected.
    pub eta: Option<Duration>,
    /// The end lies hardly before this.
    pub eta_low: Option<Duration>,
    /// The end lies hardly after this.
    pub eta_high: Option<Duration>,
    /// What has happened to its units.
    pub counts: JobCounts,
}

/// What has happened to units and results of a job since the coordinator started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct JobCounts {
    /// Results that were dropped, as their samples were there already.
    pub duplicates: u64,
    /// Units that a worker could not render, and results that were refused.
    pub failures: u64,
    /// Leases that ran out or went with their worker.
    pub expired: u64,
    /// Units that two workers rendered to the same bits.
    pub verified: u64,
    /// Units that were to be compared, but with nobody there to render them once more.
    pub unverified: u64,
}

/// One worker as it is now.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkerView {
    /// Which connection.
    pub worker: WorkerId,
    /// For people.
    pub name: String,
    /// Units it renders at once.
    pub slots: u32,
    /// Units it holds.
    pub held: u32,
    /// Units it delivered.
    pub units_done: u64,
    /// Pixel samples per second of all its slots.
    pub samples_per_s: f64,
    /// `working`, `idle`, `draining`, or why it gets nothing.
    pub state: String,
}

/// Something that has happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogView {
    /// When; to the millisecond once it has travelled.
    pub at: SystemTime,
    /// What, for people.
    pub text: String,
}

/// What one who watches a job is told.
#[derive(Clone, Debug, PartialEq)]
pub struct WatchView {
    /// The job as it is now.
    pub job: JobView,
    /// Everybody who is connected.
    pub workers: Vec<WorkerView>,
    /// What has happened since the last time.
    pub log: Vec<LogView>,
}

impl From<LogView> for v1::LogEntry {
    fn from(entry: LogView) -> Self {
        let since = entry.at.duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { unix_ms: u64::try_from(since.as_millis()).unwrap_or(u64::MAX), text: entry.text }
    }
}

impl TryFrom<v1::LogEntry> for LogView {
    type Error = ConvertError;

    fn try_from(entry: v1::LogEntry) -> Result<Self, ConvertError> {
        let at = UNIX_EPOCH.checked_add(Duration::from_millis(entry.unix_ms));
        Ok(Self {
            at: at.ok_or(ConvertError::Missing("moment of a log entry"))?,
            text: text("log entry", entry.text)?,
        })
    }
}

impl From<WatchView> for v1::WatchUpdate {
    fn from(view: WatchView) -> Self {
        Self {
            job: Some(view.job.into()),
            workers: view.workers.into_iter().map(Into::into).collect(),
            log: view.log.into_iter().map(Into::into).collect(),
        }
    }
}

impl TryFrom<v1::WatchUpdate> for WatchView {
    type Error = ConvertError;

    fn try_from(update: v1::WatchUpdate) -> Result<Self, ConvertError> {
        Ok(Self {
            job: update.job.ok_or(ConvertError::Missing("job status"))?.try_into()?,
            workers: update.workers.into_iter().map(TryInto::try_into).collect::<Result<_, _>>()?,
            log: update.log.into_iter().map(TryInto::try_into).collect::<Result<_, _>>()?,
        })
    }
}

impl From<JobView> for v1::JobStatus {
    fn from(view: JobView) -> Self {
        Self {
            job: view.job.0,
            spec: Some(view.spec.into()),
            owner: view.owner,
            state: wire_state(view.state).into(),
            reason: view.reason,
            samples_done: view.samples_done,
            samples_total: view.samples_total,
            frames_done: view.frames_done,
            frames_total: view.frames_total,
            error: view.error,
            eta_seconds: view.eta.map(|eta| eta.as_secs_f64()),
            eta_low_seconds: view.eta_low.map(|eta| eta.as_secs_f64()),
            eta_high_seconds: view.eta_high.map(|eta| eta.as_secs_f64()),
            rel_mse: view.rel_mse,
            slope: view.slope,
            spp: view.spp,
            counts: Some(view.counts.into()),
        }
    }
}

fn wire_state(state: JobState) -> v1::JobState {
    match state {
        JobState::Running => v1::JobState::Running,
        JobState::Paused => v1::JobState::Paused,
        JobState::Done => v1::JobState::Done,
        JobState::Failed => v1::JobState::Failed,
        JobState::Cancelled => v1::JobState::Cancelled,
    }
}

impl TryFrom<v1::JobStatus> for JobView {
    type Error = ConvertError;

    fn try_from(status: v1::JobStatus) -> Result<Self, ConvertError> {
        let time = |value: f64| seconds("remaining time", value);
        let state = match status.state() {
            v1::JobState::Running => JobState::Running,
            v1::JobState::Paused => JobState::Paused,
            v1::JobState::Done => JobState::Done,
            v1::JobState::Failed => JobState::Failed,
            v1::JobState::Cancelled => JobState::Cancelled,
            v1::JobState::Unspecified => {
                return Err(ConvertError::Unknown { family: "job state", value: status.state });
            }
        };
        Ok(Self {
            job: JobId(status.job),
            spec: status.spec.ok_or(ConvertError::Missing("job specification"))?.try_into()?,
            owner: text("owner", status.owner)?,
            state,
            reason: text("reason", status.reason)?,
            samples_done: status.samples_done,
            samples_total: status.samples_total,
            frames_done: status.frames_done,
            frames_total: status.frames_total,
            error: status.error,
            rel_mse: status.rel_mse,
            slope: status.slope,
            spp: status.spp,
            eta: status.eta_seconds.map(time).transpose()?,
            eta_low: status.eta_low_seconds.map(time).transpose()?,
            eta_high: status.eta_high_seconds.map(time).transpose()?,
            counts: status.counts.unwrap_or_default().into(),
        })
    }
}

impl From<JobCounts> for v1::JobCounts {
    fn from(counts: JobCounts) -> Self {
        let JobCounts { duplicates, failures, expired, verified, unverified } = counts;
        Self { duplicates, failures, expired, verified, unverified }
    }
}

impl From<v1::JobCounts> for JobCounts {
    fn from(counts: v1::JobCounts) -> Self {
        let v1::JobCounts { duplicates, failures, expired, verified, unverified } = counts;
        Self { duplicates, failures, expired, verified, unverified }
    }
}

impl From<WorkerView> for v1::WorkerStatus {
    fn from(view: WorkerView) -> Self {
        Self {
            worker: view.worker.0,
            name: view.name,
            slots: view.slots,
            held: view.held,
            units_done: view.units_done,
            samples_per_s: view.samples_per_s,
            state: view.state,
        }
    }
}

impl TryFrom<v1::WorkerStatus> for WorkerView {
    type Error = ConvertError;

    fn try_from(status: v1::WorkerStatus) -> Result<Self, ConvertError> {
        Ok(Self {
            worker: WorkerId(status.worker),
            name: text("worker name", status.name)?,
            slots: status.slots,
            held: status.held,
            units_done: status.units_done,
            samples_per_s: status.samples_per_s,
            state: text("worker state", status.state)?,
        })
    }
}
