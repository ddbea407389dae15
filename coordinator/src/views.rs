//! The farm as people see it.

use crate::farm::{Ending, Farm, Overview};
use crate::forecast::Left;
use crate::open_frame::Outlook;
use crate::store::StoredJob;
use farm_job::JobState;
use farm_proto::convert::{JobCounts, JobView, WorkerView};
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
        owner: record.owner.map(|owner| owner.to_string()).unwrap_or_default(),
        state: record.state,
        reason: record.reason.clone().unwrap_or_default(),
        samples_done: 0,
        samples_total: 0,
        frames_done,
        frames_total: record.spec.frames.count(),
        error: None,
        rel_mse: None,
        slope: None,
        spp: 0,
        eta: None,
        eta_low: None,
        eta_high: None,
        counts: JobCounts::default(),
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
    view.counts = counts(status);
    if view.state == JobState::Running
        && let Some(outlook) = farm.outlook(record.job).await?
    {
        look_ahead(&mut view, frames_done, &outlook);
    }
    Ok(view)
}

/// How wrong the frame at hand is, and when the job will be done.
fn look_ahead(view: &mut JobView, frames_done: u64, outlook: &Outlook) {
    view.spp = outlook.spp;
    view.error = outlook.error.map(|error| error.rmse);
    view.rel_mse = outlook.error.map(|error| error.rel_mse);
    view.slope = outlook.slope;
    let Some(left) = Left::of_job(&view.spec, frames_done, outlook) else { return };
    let time = |seconds: f64| Duration::try_from_secs_f64(seconds).ok();
    view.eta = time(left.seconds);
    view.eta_low = time(left.seconds_low);
    view.eta_high = time(left.seconds_high);
    if !view.spec.stop.is_never() {
        view.samples_total = left.samples as u64;
    }
}

fn counts(status: &JobStatus) -> JobCounts {
    let &JobStatus { duplicates, failures, expired, verified, unverified, .. } = status;
    JobCounts { duplicates, failures, expired, verified, unverified }
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
    if status.distrusted {
        return "distrusted: it delivered wrong results".to_owned();
    }
    match (status.quarantined_for, status.draining, status.in_flight) {
        (Some(time), _, _) => format!("in quarantine for {} s", time.as_secs()),
        (None, true, _) => "draining".to_owned(),
        (None, false, 0) => "idle".to_owned(),
        (None, false, _) => "working".to_owned(),
    }
}
