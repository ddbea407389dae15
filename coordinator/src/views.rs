//! The farm as people see it.

use crate::farm::{Ending, Farm, Overview};
use crate::store::StoredJob;
use farm_job::{JobId, JobState};
use farm_proto::convert::{JobView, WorkerView};
use farm_scheduler::{JobStatus, WorkerStatus};
use std::time::Duration;

/// One job, from what is kept of it and what the farm knows.
pub async fn job(farm: &Farm, record: &StoredJob, overview: &Overview) -> Result<JobView, Ending> {
    let jobs = overview.status.iter().flat_map(|status| &status.jobs);
    let known = jobs.into_iter().find(|status| status.job == record.job);
    let frames_done = overview.written.get(&record.job).copied().unwrap_or(0);
    let mut view = JobView {
        job: record.job,
        spec: record.spec.clone(),
        state: record.state,
        reason: record.reason.clone().unwrap_or_default(),
        samples_done: 0,
        samples_total: 0,
        frames_done,
        frames_total: record.spec.frames.count(),
        error: None,
        eta: None,
    };
    let Some(status) = known else { return Ok(view) };
    view.spec.priority = status.priority;
    view.state = match status.state {
        // Rendered, but not all of it is written.
        JobState::Done if frames_done < view.frames_total => JobState::Running,
        state => state,
    };
    view.reason = reason(status, overview);
    view.samples_done = clamped(status.samples_done);
    view.samples_total = clamped(status.samples);
    view.eta = eta(record.job, status, overview);
    if !view.state.is_final() {
        view.error = farm.estimate(record.job).await?.map(|error| error.rmse);
    }
    Ok(view)
}

fn clamped(samples: u128) -> u64 {
    u64::try_from(samples).unwrap_or(u64::MAX)
}

fn reason(status: &JobStatus, overview: &Overview) -> String {
    if let Some(fault) = &status.fault {
        return fault.clone();
    }
    match (&overview.trouble, &status.why_idle) {
        (Some(trouble), _) if !status.state.is_final() => format!("waits for the store: {trouble}"),
        (_, Some(why)) => why.to_string(),
        (_, None) => String::new(),
    }
}

/// At the speed since this coordinator began with the job.
fn eta(job: JobId, status: &JobStatus, overview: &Overview) -> Option<Duration> {
    let tally = overview.tallies.get(&job)?;
    let seconds = tally.running()?.as_secs_f64();
    let left = status.samples.saturating_sub(status.samples_done) as f64;
    let speed = tally.counters.samples as f64 / seconds;
    (status.state == JobState::Running && speed > 0.0)
        .then(|| Duration::try_from_secs_f64(left / speed).ok())
        .flatten()
}

/// Everybody who is connected.
pub fn workers(overview: &Overview) -> Vec<WorkerView> {
    let view = |status: &WorkerStatus| WorkerView {
        worker: status.worker,
        name: status.name.clone(),
        slots: status.slots,
        held: u32::try_from(status.in_flight).unwrap_or(u32::MAX),
        units_done: status.units_done,
        samples_per_s: status.samples_per_s,
        state: state(status),
    };
    overview.status.iter().flat_map(|status| &status.workers).map(view).collect()
}

fn state(status: &WorkerStatus) -> String {
    match (status.quarantined_for, status.draining, status.in_flight) {
        (Some(time), _, _) => format!("in quarantine for {} s", time.as_secs()),
        (None, true, _) => "draining".to_owned(),
        (None, false, 0) => "idle".to_owned(),
        (None, false, _) => "working".to_owned(),
    }
}
