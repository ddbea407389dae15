//! A coordinator that serves many jobs, and goes on where it was when it starts again.

use crate::check::check_header;
use crate::driver;
use crate::farm::{Farm, JobOrder, Submission};
use crate::service::{ControlService, Listener, plan};
use crate::signals::Signals;
use crate::store::{Store, StoredJob};
use farm_film::{Counters, FilmTile, FrameIndex};
use farm_job::JobState;
use farm_worker::cli::Fault;
use farm_worker::frames::partial_header;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use tracing::{info, warn};

/// Serves until a signal comes. Whatever was acknowledged is in the store; workers wait for the next start.
pub async fn serve(address: SocketAddr, folder: &Path, verify: f64) -> Result<(), Fault> {
    let mut signals = Signals::listen()?;
    let store = Arc::new(Store::open(folder).map_err(Fault::failed)?);
    let listener = Listener::bind_or_fault(address).await?;
    let farm = driver::start(Some(store.clone()), verify)
        .map_err(|err| Fault::failed(format!("cannot start: {err}")))?;
    let jobs = store.jobs().map_err(Fault::failed)?;
    for job in &jobs {
        restore(&farm, &store, job).await?;
    }
    eprintln!("listening on {}", listener.address());
    listener.serve(farm.clone(), Some(ControlService::new(farm, store, jobs)));
    signals.next().await;
    info!("stopping; everything acknowledged is kept");
    Ok(())
}

/// Goes on with a job from before a restart.
async fn restore(farm: &Farm, store: &Arc<Store>, record: &StoredJob) -> Result<(), Fault> {
    match record.state {
        JobState::Running | JobState::Paused | JobState::Done => {}
        JobState::Failed | JobState::Cancelled => return Ok(()),
    }
    let (kept, job) = (store.clone(), record.clone());
    let submission = tokio::task::spawn_blocking(move || submission(&kept, &job))
        .await
        .map_err(Fault::failed)?
        .map_err(Fault::failed)?;
    let partials: usize = submission.durable.iter().map(|(_, partials)| partials.len()).sum();
    info!(job = %record.job, frames = submission.finished.len(), partials, "going on with a job");
    farm.submit(submission).await.map_err(Fault::failed)?;
    if record.state == JobState::Paused {
        farm.order(record.job, JobOrder::Pause).await.map_err(Fault::failed)?;
    }
    Ok(())
}

/// What is there of a job.
fn submission(store: &Store, record: &StoredJob) -> Result<Submission, String> {
    let (job, spec) = (record.job, record.spec.clone());
    let plan = plan(store, job, &spec.name)?;
    let (mut finished, mut durable) = (Vec::new(), Vec::new());
    for frame in spec.frames.iter() {
        if plan.names.path(frame).is_file() {
            finished.push(frame);
            // Whatever the end of the former life left behind.
            store.remove_partials(job, frame);
            continue;
        }
        let partials = partials(store, record, frame)?;
        if !partials.is_empty() {
            durable.push((frame, partials));
        }
    }
    Ok(Submission { job, spec, plan, listener: None, finished, durable })
}

/// Partials of a frame that belong to it; others, as of an older renderer, are rendered again.
fn partials(
    store: &Store,
    record: &StoredJob,
    frame: FrameIndex,
) -> Result<Vec<(FilmTile, Counters)>, String> {
    let spec = &record.spec;
    let resolution = spec.resolution().map_err(|err| err.to_string())?;
    let expected = partial_header(resolution, spec.scene, &spec.settings, frame);
    let mut partials = Vec::new();
    for (tile, header) in store.partials(record.job, frame) {
        match check_header(&header, &expected) {
            Ok(()) if tile.is_finite() => partials.push((tile, header.counters)),
            Ok(()) => {
                warn!(job = %record.job, tile = %tile.tile(), "kept partial is not finite; rendering it again")
            }
            Err(error) => warn!(job = %record.job, %error, "kept partial does not fit; rendering it again"),
        }
    }
    Ok(partials)
}
