//! A coordinator that serves many jobs, and goes on where it was when it starts again.

use crate::check::check_header;
use crate::cli::{Doors, announce};
use crate::driver;
use crate::farm::{Ending, Farm, JobOrder, Submission};
use crate::outputs::Outputs;
use crate::service::{ControlService, Listener, UploadLimits};
use crate::signals::Signals;
use crate::store::{Holding, Patience, Store, StoreError, StoreLocation, StoredJob, StoredPartial, largest};
use farm_film::{Counters, FilmTile, FrameIndex, Tile, WorkUnit};
use farm_job::{Digest, JobId, JobState};
use farm_scheduler::Origin;
use farm_worker::cli::Fault;
use farm_worker::frames::partial_header;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use tracing::{info, warn};

/// Serves until a signal comes, or until another coordinator takes the store over. Whatever was acknowledged is in the
/// store; workers wait for the next start.
pub async fn serve(
    doors: &Doors,
    location: &StoreLocation,
    patience: Patience,
    verify: f64,
    uploads: UploadLimits,
) -> Result<(), Fault> {
    let mut signals = Signals::listen()?;
    let store = tokio::select! {
        store = Store::open(location, patience) => Arc::new(store.map_err(Fault::failed)?),
        () = signals.next() => return Ok(()),
    };
    let mut lost = store.lost();
    let served = tokio::select! {
        served = serve_from(doors, store.clone(), verify, uploads, &mut signals) => served,
        Ok(by) = lost.wait_for(Option::is_some) => {
            let by = by.clone().unwrap_or_default();
            // Nothing more may be said to anyone: what is under way ends with the process.
            return Err(Fault::failed(StoreError::TurnOver(by)));
        }
    };
    store.leave().await;
    served
}

async fn serve_from(
    doors: &Doors,
    store: Arc<Store>,
    verify: f64,
    uploads: UploadLimits,
    signals: &mut Signals,
) -> Result<(), Fault> {
    let listener = Listener::bind(doors).await?;
    let farm = driver::start(Some(store.clone()), verify)
        .map_err(|err| Fault::failed(format!("cannot start: {err}")))?;
    let jobs = restore_all(&farm, &store).await.map_err(Fault::failed)?;
    eprintln!("listening on {}", listener.address());
    announce(&doors.security, listener.address())?;
    listener.serve(farm.clone(), Some(ControlService::new(farm, store, jobs, uploads)))?;
    signals.next().await;
    info!("stopping; everything acknowledged is kept");
    Ok(())
}

/// A job that cannot be gone on with.
#[derive(Debug, thiserror::Error)]
pub enum RestoreError {
    /// What there is of it cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// There is nobody to go on with it.
    #[error(transparent)]
    Ending(#[from] Ending),
}

/// Goes on with every job that the store holds, and with what is known of workers; all jobs, also those that have ended.
pub async fn restore_all(farm: &Farm, store: &Store) -> Result<Vec<StoredJob>, RestoreError> {
    farm.recall(store.reputation().await?).await?;
    let jobs = store.jobs().await?;
    for job in &jobs {
        restore(farm, store, job).await?;
    }
    Ok(jobs)
}

/// Goes on with a job from what the store holds of it.
pub async fn restore(farm: &Farm, store: &Store, record: &StoredJob) -> Result<(), RestoreError> {
    match record.state {
        JobState::Running | JobState::Paused | JobState::Done => {}
        JobState::Failed => return Ok(()),
        JobState::Cancelled => {
            // Whatever the end of the former life left behind.
            store.remove_all_partials(record.job).await;
            return Ok(());
        }
    }
    let submission = submission(store, record).await?;
    let partials: usize = submission.durable.iter().map(|(_, partials)| partials.len()).sum();
    info!(job = %record.job, frames = submission.finished.len(), partials, "going on with a job");
    farm.submit(submission).await?;
    if record.state == JobState::Paused {
        farm.order(record.job, JobOrder::Pause).await?;
    }
    Ok(())
}

/// Who delivered what nobody vouches for.
const UNKNOWN: &str = "someone unknown";

/// A partial that is kept, and its file's digest.
type Kept = (FilmTile, (Counters, Digest));

/// What is there of a job.
async fn submission(store: &Store, record: &StoredJob) -> Result<Submission, StoreError> {
    let (job, spec) = (record.job, record.spec.clone());
    let origins = honest_origins(store, job).await?;
    let finished = store.finished_frames(job).await?;
    let (mut origins, of_open): (Vec<_>, Vec<_>) =
        origins.into_iter().partition(|origin| finished.contains(&origin.frame));
    let known: BTreeMap<_, String> =
        of_open.into_iter().filter_map(|origin| Some((origin.part?, origin.name))).collect();
    let (mut durable, mut stored) = (Vec::new(), Vec::new());
    for frame in store.begun_frames(job).await? {
        if finished.contains(&frame) {
            // Whatever the end of the former life left behind.
            store.remove_partials(job, frame).await;
            continue;
        }
        let (partials, holdings) = partials(store, record, frame).await?;
        stored.push((frame, holdings));
        if partials.is_empty() {
            continue;
        }
        origins.extend(partials.iter().map(|(tile, (_, digest))| {
            let part = (WorkUnit { frame, tile: tile.tile(), block: tile.block() }, *digest);
            // Nothing is known of what was merged, or was still put by a coordinator whose turn was over.
            let name = known.get(&part).map_or(UNKNOWN, String::as_str).to_owned();
            Origin { frame, name, part: Some(part) }
        }));
        let partials = partials.into_iter().map(|(tile, (counters, _))| (tile, counters));
        durable.push((frame, partials.collect()));
    }
    let outputs = Outputs::Store { scene_name: spec.name.clone() };
    let mut begun = store.begun(job).await?;
    begun.retain(|frame, _| !finished.contains(frame));
    let finished = finished.into_iter().collect();
    Ok(Submission { job, spec, outputs, listener: None, finished, durable, stored, origins, begun })
}

/// Who delivered what of a job. What is still there from workers whose results were wrong goes first: the former life ended in
/// between.
async fn honest_origins(store: &Store, job: JobId) -> Result<Vec<Origin>, StoreError> {
    let mut origins = store.origins(job).await?;
    let liars = if origins.is_empty() { BTreeSet::new() } else { store.reputation().await?.distrusted };
    let tile = |origin: &Origin| origin.part.map(|(unit, _)| unit.tile);
    let mut tainted: BTreeMap<FrameIndex, Vec<Tile>> = BTreeMap::new();
    for origin in origins.iter().filter(|origin| liars.contains(&origin.name)) {
        tainted.entry(origin.frame).or_default().extend(tile(origin));
    }
    let finished = if tainted.is_empty() { BTreeSet::new() } else { store.finished_frames(job).await? };
    for (frame, tiles) in tainted {
        let whole = finished.contains(&frame);
        warn!(%job, %frame, tiles = tiles.len(), "a worker that delivers wrong results had a hand in this; rendering it again");
        if whole {
            store.remove_partials(job, frame).await;
            store.remove_frame(job, frame).await?;
        } else {
            store.remove_tiles(job, frame, &tiles).await?;
        }
        store.remove_origins(job, frame, (!whole).then_some(&tiles)).await?;
        let concerned = |origin: &Origin| tile(origin).is_none_or(|tile| tiles.contains(&tile));
        origins.retain(|origin| origin.frame != frame || !(whole || concerned(origin)));
    }
    Ok(origins)
}

/// Partials of a frame that belong to it, and the objects in which there is nothing else; others, as of an older renderer, are
/// rendered again.
async fn partials(
    store: &Store,
    record: &StoredJob,
    frame: FrameIndex,
) -> Result<(Vec<Kept>, Vec<Holding>), StoreError> {
    let (job, spec) = (record.job, &record.spec);
    let damaged = |fault: String| StoreError::Damaged { path: format!("jobs/{job}/job.json"), fault };
    let resolution = spec.resolution().map_err(|err| damaged(err.to_string()))?;
    let expected = partial_header(resolution, spec.scene, &spec.settings, frame);
    let (mut sound, mut holdings) = (Vec::new(), Vec::new());
    for object in store.partials(job, frame).await? {
        let (holding, mut is_sound) = (object.holding(), object.is_whole);
        for StoredPartial { tile, header, digest } in object.partials {
            match check_header(&header, &expected) {
                Ok(()) if tile.is_finite() => {
                    sound.push((tile, (header.counters, digest)));
                    continue;
                }
                Ok(()) => warn!(%job, tile = %tile.tile(), "kept partial is not finite; rendering it again"),
                Err(error) => warn!(%job, %error, "kept partial does not fit; rendering it again"),
            }
            is_sound = false;
        }
        holdings.extend(is_sound.then_some(holding));
    }
    Ok((largest(sound), holdings))
}

#[cfg(test)]
#[path = "serve_tests.rs"]
mod tests;
