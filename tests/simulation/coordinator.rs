//! A host with a coordinator on it: the real one, on a simulated disk, and someone who watches what it says.

use crate::network::accept;
use crate::picture::{JOB, PICTURE};
use crate::store::Disk;
use crate::world::Story;
use bytes::Bytes;
use farm_coordinator::driver;
use farm_coordinator::farm::Farm;
use farm_coordinator::serve::{RestoreError, restore, restore_all};
use farm_coordinator::service::serve_memory;
use farm_coordinator::store::{Clock, Patience, Store, StoreError, StoredJob, frame_path};
use farm_film::WorkUnit;
use farm_image::read_image;
use farm_job::{Digest, JobState};
use farm_scheduler::JobStatus;
use object_store::path::Path;
use object_store::{ObjectStoreExt, PutPayload};
use std::collections::BTreeMap;
use std::io::Write;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// How often the coordinator is asked how it goes.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// What was seen of the farm, over all lives of the coordinator.
#[derive(Debug, Default)]
pub struct Seen {
    /// Every frame is written.
    pub done: bool,
    /// A promise that was broken.
    pub broken: Option<String>,
    /// By which the coordinator's clock shall jump.
    pub clock_jump: Duration,
    /// The latest turn of each host to write to the store.
    pub turns: BTreeMap<usize, u64>,
    /// Coordinators that found out that the store is another one's; their processes end.
    pub fenced: Vec<usize>,
    /// What a liar delivered goes again, so that samples may become fewer.
    pub has_liar: bool,
    /// The turn that is heard of.
    turn: u64,
    lives: u64,
    /// Samples that are durable, as the coordinator last said.
    samples: u128,
    status: Option<JobStatus>,
    /// Units that were acknowledged to someone who took note.
    acknowledged: Vec<WorkUnit>,
    former: Story,
    tried_again: u64,
}

impl Seen {
    /// A unit was acknowledged; none is twice, nor any part of one.
    pub fn acknowledged(&mut self, unit: WorkUnit) {
        let overlaps = |other: &&WorkUnit| {
            (other.frame, other.tile) == (unit.frame, unit.tile)
                && (other.block.contains(unit.block) || unit.block.contains(other.block))
        };
        if let Some(other) = self.acknowledged.iter().find(overlaps) {
            self.broken.get_or_insert(format!("{unit} was acknowledged after {other}"));
        }
        self.acknowledged.push(unit);
    }

    pub fn story(&self) -> Story {
        let mut story = self.former;
        story += self.status.as_ref().map(counted).unwrap_or_default();
        story.tried_again = self.tried_again;
        story.restarts = self.lives.saturating_sub(1);
        story
    }
}

fn counted(status: &JobStatus) -> Story {
    Story {
        units: status.units_done,
        duplicates: status.duplicates,
        failures: status.failures,
        verified: status.verified,
        ..Story::default()
    }
}

/// The life of a coordinator, from start to crash. One that cannot start is started again, as a service would be.
pub async fn live(disk: Disk, seen: Arc<Mutex<Seen>>, verify: f64, host: usize) -> turmoil::Result {
    loop {
        match start(&disk, verify).await {
            Ok((farm, store)) => {
                seen.lock().expect("nothing panics in here").turns.insert(host, store.epoch());
                let mut lost = store.lost();
                tokio::spawn(watch(farm.clone(), store, seen.clone()));
                tokio::select! {
                    accepted = accept(serve_memory(farm)) => accepted?,
                    _ = lost.wait_for(Option::is_some) => {
                        seen.lock().expect("nothing panics in here").fenced.push(host);
                        return std::future::pending().await;
                    }
                }
            }
            Err(error) => tracing::info!(%error, "the coordinator cannot start"),
        }
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
}

async fn start(disk: &Disk, verify: f64) -> Result<(Farm, Arc<Store>), RestoreError> {
    let store = Arc::new(Store::over(Arc::new(disk.clone()), clock(), Patience::StandBy).await?);
    let farm = driver::start(Some(store.clone()), verify).expect("a simulated coordinator needs no threads");
    if store.jobs().await?.is_empty() {
        let snapshot = Bytes::from(PICTURE.snapshot.clone());
        store.put_piece(snapshot.clone()).await?;
        store.put_scene(PICTURE.scene, &[Digest(*blake3::hash(&snapshot).as_bytes())]).await?;
        assert_eq!(store.create_job(&PICTURE.spec, None).await?, JOB, "it is the first");
    }
    restore_all(&farm, &store).await?;
    Ok((farm, store))
}

/// The clock of the host on which this runs, which has been up for an hour.
fn clock() -> Clock {
    let start = tokio::time::Instant::now();
    Arc::new(move || Duration::from_secs(3600) + start.elapsed())
}

/// What `resume` does for a failed job.
async fn try_again(farm: &Farm, store: &Store) -> Result<(), RestoreError> {
    let (spec, state) = (PICTURE.spec.clone(), JobState::Running);
    let record = StoredJob { job: JOB, spec, owner: None, state, reason: None };
    store.put_fate(JOB, &record.fate()).await?;
    restore(farm, store, &record).await
}

async fn watch(farm: Farm, store: Arc<Store>, seen: Arc<Mutex<Seen>>) {
    let turn = store.epoch();
    loop {
        let Ok(overview) = farm.overview().await else { return };
        let mut jobs = overview.status.iter().flat_map(|status| &status.jobs);
        let status = jobs.find(|job| job.job == JOB).cloned();
        let written = overview.written.get(&JOB).copied().unwrap_or(0);
        if status.as_ref().is_some_and(|status| status.state == JobState::Failed) {
            // A unit failed on three workers; or nothing can be stored, then it is tried once more.
            let _ = try_again(&farm, &store).await;
            seen.lock().expect("nothing panics in here").tried_again += 1;
        }
        let jump = match status {
            Some(status) => look(&mut seen.lock().expect("nothing panics in here"), status, written, turn),
            None => Duration::ZERO,
        };
        if !jump.is_zero() {
            tokio::time::advance(jump).await;
        }
        tokio::time::sleep(LOOK_EVERY).await;
    }
}

/// Compares what the coordinator of a turn says with what was said before; by how much its clock is to jump.
fn look(seen: &mut Seen, status: JobStatus, written: u64, turn: u64) -> Duration {
    if turn < seen.turn {
        // It does not know yet that its turn is over.
        return Duration::ZERO;
    }
    if turn > seen.turn {
        seen.turn = turn;
        if status.samples_done < seen.samples && !seen.has_liar {
            let (now, before) = (status.samples_done, seen.samples);
            seen.broken =
                Some(format!("{now} samples after a restart and {before} before: something was lost"));
        }
        seen.lives += 1;
        let before = seen.status.take();
        seen.former += before.as_ref().map(counted).unwrap_or_default();
    }
    seen.done = status.state == JobState::Done && written == PICTURE.spec.frames.count();
    seen.samples = status.samples_done;
    seen.status = Some(status);
    std::mem::take(&mut seen.clock_jump)
}

/// What a lock on a disk tells: whoever had a turn is gone.
pub fn process_is_dead(disk: &Disk, turn: u64) {
    let path = Path::from(format!("epochs/{turn:010}.ended"));
    let _ = block_on(disk.objects.put(&path, PutPayload::new()));
}

fn block_on<T>(work: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .start_paused(true)
        .build()
        .expect("a runtime")
        .block_on(work)
}

/// Every frame has the bits of a single process, and each sample once.
pub fn check_pictures(disk: &Disk) -> Result<(), String> {
    block_on(async {
        for (frame, expected) in &PICTURE.expected {
            let object =
                disk.objects.get(&frame_path(JOB, *frame)).await.map_err(|error| error.to_string())?;
            let bytes = object.bytes().await.map_err(|error| error.to_string())?;
            let mut file = tempfile::Builder::new().suffix(".exr").tempfile().expect("a file");
            file.write_all(&bytes).expect("a file can be written");
            let image = read_image(file.path()).map_err(|error| error.to_string())?;
            let bits = |pixels: &[[f32; 3]]| pixels.iter().flatten().map(|v| v.to_bits()).collect::<Vec<_>>();
            if bits(&image.pixels) != bits(expected) {
                return Err(format!("frame {frame} has other bits than a single process gives it"));
            }
            let samples = image.metadata.map(|metadata| metadata.counters.samples);
            if samples != Some(PICTURE.samples()) {
                return Err(format!("frame {frame} has {samples:?} samples of {}", PICTURE.samples()));
            }
        }
        Ok(())
    })
}

/// What a coordinator finds that starts now: the job's state, its durable samples and its written frames.
type Found = (JobState, u128, u64);

fn reloaded(disk: &Disk, seen: &Seen) -> Result<Found, String> {
    let fork = Disk::holding(disk.objects.fork());
    if let Some(turn) = seen.turns.values().max() {
        process_is_dead(&fork, *turn);
    }
    block_on(async {
        let (farm, store) = start(&fork, 0.0).await.map_err(|error| error.to_string())?;
        if let Some(unit) = missing(&store, &seen.acknowledged).await.map_err(|error| error.to_string())? {
            return Err(format!("{unit} was acknowledged and is not in the store"));
        }
        let overview = farm.overview().await.map_err(|error| error.to_string())?;
        let mut jobs = overview.status.iter().flat_map(|status| &status.jobs);
        if let Some(job) = jobs.find(|job| job.job == JOB) {
            return Ok((job.state, job.samples_done, overview.written.get(&JOB).copied().unwrap_or(0)));
        }
        // One that has failed waits for its owner.
        let records = store.jobs().await.map_err(|error| error.to_string())?;
        let failed = records.iter().any(|record| record.job == JOB && record.state == JobState::Failed);
        if failed { Ok((JobState::Failed, 0, 0)) } else { Err("the job is gone".to_owned()) }
    })
}

/// The first unit that the store does not hold.
async fn missing(store: &Store, units: &[WorkUnit]) -> Result<Option<WorkUnit>, StoreError> {
    let finished = store.finished_frames(JOB).await?;
    for frame in PICTURE.spec.frames.iter().filter(|frame| !finished.contains(frame)) {
        let objects = store.partials(JOB, frame).await?;
        let is_there = |unit: &WorkUnit| {
            let mut partials = objects.iter().flat_map(|object| &object.partials);
            partials
                .any(|partial| partial.tile.tile() == unit.tile && partial.tile.block().contains(unit.block))
        };
        if let Some(unit) = units.iter().find(|unit| unit.frame == frame && !is_there(unit)) {
            return Ok(Some(*unit));
        }
    }
    Ok(None)
}

/// Whatever was acknowledged is in the store.
pub fn audit(disk: &Disk, seen: &Seen) -> Result<(), String> {
    // Until there is a job nothing is acknowledged.
    if seen.status.is_none() || seen.has_liar {
        return Ok(());
    }
    let (state, found, _) = reloaded(disk, seen)?;
    if state != JobState::Failed && found < seen.samples {
        return Err(format!("{found} samples are in the store, and {} were acknowledged", seen.samples));
    }
    Ok(())
}

/// A coordinator that starts when all is done finds what the one before it knew.
pub fn check_state(disk: &Disk, seen: &Seen) -> Result<(), String> {
    let live = (JobState::Done, seen.samples, PICTURE.spec.frames.count());
    let found = reloaded(disk, seen)?;
    if found != live {
        return Err(format!("a coordinator that starts at the end finds {found:?} instead of {live:?}"));
    }
    Ok(())
}
