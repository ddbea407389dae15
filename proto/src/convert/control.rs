//! What is shown to people: jobs and workers as they are now.

use super::{ConvertError, seconds, text};
use crate::v1;
use farm_job::{JobId, JobSpec, JobState, WorkerId};
use std::time::Duration;

/// One job as it is now.
#[derive(Clone, Debug, PartialEq)]
pub struct JobView {
    /// Which one.
    pub job: JobId,
    /// What was asked.
    pub spec: JobSpec,
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
    /// Until the end, at the present speed.
    pub eta: Option<Duration>,
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

impl From<JobView> for v1::JobStatus {
    fn from(view: JobView) -> Self {
        Self {
            job: view.job.0,
            spec: Some(view.spec.into()),
            state: wire_state(view.state).into(),
            reason: view.reason,
            samples_done: view.samples_done,
            samples_total: view.samples_total,
            frames_done: view.frames_done,
            frames_total: view.frames_total,
            error: view.error,
            eta_seconds: view.eta.map(|eta| eta.as_secs_f64()),
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
            state,
            reason: text("reason", status.reason)?,
            samples_done: status.samples_done,
            samples_total: status.samples_total,
            frames_done: status.frames_done,
            frames_total: status.frames_total,
            error: status.error,
            eta: status.eta_seconds.map(|value| seconds("remaining time", value)).transpose()?,
        })
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
