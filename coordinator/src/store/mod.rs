//! What must survive the coordinator: objects in a folder or a bucket, each put whole, durable when the put returns, and
//! never changed.
//!
//! ```text
//! session                              names this store's farm to its workers
//! epochs/..                            whose turn it is to write (see [`turn`])
//! scenes/<digest>                      which pieces a scene's snapshot is made of
//! pieces/<digest>                      pieces of snapshots, each kept once however many scenes share it
//! jobs/<id>/job.json                   what was asked, and by whom; null when the job was forgotten
//! jobs/<id>/state/<epoch>-<n>.json     what its owner decided since, and what became of it; the latest counts
//! jobs/<id>/partials/<frame>/*.exr     accepted results of frames that are not finished; under load several of them in
//! jobs/<id>/partials/<frame>/*.tar     one object, as a put costs the same whatever its size
//! jobs/<id>/frames/frame.####.exr      finished frames
//! jobs/<id>/origins/<frame>/*.json     where results are compared: who delivered which, or took part in a finished frame
//! workers/<epoch>-<n>.json             whose results were wrong, and who is in quarantine; the latest counts
//! ```
//!
//! Restart: list, read, continue. Every intermediate state opens in any EXR viewer, and `coordinator merge` takes the
//! partials as they are. Nothing that a coordinator leaves behind after its turn does harm: its partials hold the same bits
//! as anybody's, or, where results are compared, are of nobody known unless an origin has their digest, and compared like all
//! others; its states sort before those of the next turn.

mod batch;
mod clocks;
mod jobs;
mod location;
mod merging;
mod objects;
mod origins;
mod partials;
mod reputation;
mod scenes;
mod shelf;
mod turn;

pub use jobs::{Fate, StoredJob};
pub use location::{Clock, StoreLocation};
pub use merging::largest;
pub use partials::{Holding, OBJECT_BYTES_MAX, OBJECT_PARTIALS_MAX, StoredObject, StoredPartial};
pub use scenes::Unneeded;
pub use shelf::{Crowd, Shelf};
pub use turn::Patience;

use bytes::Bytes;
use farm_film::FrameIndex;
use farm_job::JobId;
use farm_scene::SceneId;
use location::Objects;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt};
use objects::{create, get, list, put, root_cause};
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use tokio::sync::watch;
use turn::Turn;

/// Objects that are read at the same time.
const READS: usize = 16;

/// A store that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Someone else writes there.
    #[error(
        "the store is in use by another coordinator ({0}): stop that one, give another store with --store, or wait for its end with --standby"
    )]
    InUse(String),
    /// This coordinator was given up for dead meanwhile.
    #[error("another coordinator has taken over the store ({0}): this one may not write there any more")]
    TurnOver(String),
    /// An object that cannot be read or written.
    #[error("the store's {path}: {error}")]
    Object {
        /// Which one.
        path: String,
        /// Why not.
        error: String,
    },
    /// A place that cannot be a store.
    #[error("{store} cannot be used as a store: {error}")]
    Unusable {
        /// Which one.
        store: String,
        /// Why not.
        error: String,
    },
    /// An object that does not hold what it should.
    #[error("the store's {path} is damaged: {fault}")]
    Damaged {
        /// Which one.
        path: String,
        /// What is wrong.
        fault: String,
    },
}

impl StoreError {
    fn object(path: &Path, error: &object_store::Error) -> Self {
        Self::Object { path: path.to_string(), error: root_cause(error) }
    }
}

/// A store that is ours as long as nobody takes it over.
pub struct Store {
    objects: Arc<Objects>,
    turn: Arc<Turn>,
    session: u64,
    /// Numbers what this coordinator puts.
    next: AtomicU64,
    /// The highest number that a job has or had.
    last_job: AtomicU64,
    /// Kept at hand, as all workers ask for the same one.
    latest_scene: Mutex<Option<(SceneId, Bytes)>>,
    beating: tokio::task::JoinHandle<()>,
}

impl Drop for Store {
    fn drop(&mut self) {
        self.beating.abort();
    }
}

impl Store {
    /// Takes a store when no other coordinator has it any more; makes it one if it is none yet.
    pub async fn open(location: &StoreLocation, patience: Patience) -> Result<Self, StoreError> {
        Self::take(Objects::open(location)?, patience).await
    }

    /// The same, over objects and a clock of the caller's. What is put there is durable when the put returns; the clock
    /// counts from any moment on, and while the machine sleeps.
    pub async fn over(
        objects: Arc<dyn ObjectStore>,
        clock: Clock,
        patience: Patience,
    ) -> Result<Self, StoreError> {
        Self::take(Objects::over(objects, clock), patience).await
    }

    async fn take(objects: Objects, patience: Patience) -> Result<Self, StoreError> {
        let objects = Arc::new(objects);
        let turn = Arc::new(Turn::take(&objects, patience).await?);
        objects.sweep();
        turn.tidy(&objects).await;
        let session = session(&objects).await?;
        let beating = tokio::spawn({
            let (turn, objects) = (turn.clone(), objects.clone());
            async move { turn.beat(&objects).await }
        });
        let (next, last_job) = (AtomicU64::new(0), AtomicU64::new(0));
        Ok(Self { objects, turn, session, next, last_job, latest_scene: Mutex::default(), beating })
    }

    /// Names this store's farm to its workers: what they hold stays good across restarts.
    pub fn session(&self) -> u64 {
        self.session
    }

    /// The number of this coordinator's turn to write.
    pub fn epoch(&self) -> u64 {
        self.turn.epoch()
    }

    /// Says who has taken the store over.
    pub fn lost(&self) -> watch::Receiver<Option<String>> {
        self.turn.lost()
    }

    /// Puts that are worth having under way at the same time.
    pub fn puts(&self) -> usize {
        self.objects.puts
    }

    /// Leaves the store to whoever comes next.
    pub async fn leave(&self) {
        self.turn.end(&self.objects).await;
    }

    /// Makes an object durable, if it is still ours to do so, and says so only if it still is.
    async fn keep(&self, path: &Path, bytes: impl Into<Bytes>) -> Result<(), StoreError> {
        self.turn.check(&self.objects).await?;
        put(&*self.objects.durable, path, bytes.into()).await?;
        self.turn.confirm(&self.objects).await
    }

    /// A name that no other object of any coordinator has, and that sorts after those before.
    fn fresh_name(&self, extension: &str) -> String {
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        format!("{:010}-{number:010}.{extension}", self.turn.epoch())
    }

    async fn read_json<T: serde::de::DeserializeOwned>(&self, path: &Path) -> Result<Option<T>, StoreError> {
        let Some(bytes) = get(&*self.objects.durable, path).await? else { return Ok(None) };
        let damaged =
            |err: serde_json::Error| StoreError::Damaged { path: path.to_string(), fault: err.to_string() };
        serde_json::from_slice(&bytes).map(Some).map_err(damaged)
    }

    /// Takes a finished frame away, which is rendered again.
    pub async fn remove_frame(&self, job: JobId, frame: FrameIndex) -> Result<(), StoreError> {
        self.turn.check(&self.objects).await?;
        let path = frame_path(job, frame);
        match self.objects.durable.delete(&path).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(StoreError::object(&path, &error)),
        }
    }

    async fn remove(&self, paths: Vec<Path>) {
        use futures::StreamExt;
        let paths = futures::stream::iter(paths.into_iter().map(Ok)).boxed();
        self.objects.durable.delete_stream(paths).for_each(|_| async {}).await;
    }

    /// Keeps a finished frame.
    pub async fn put_frame(&self, job: JobId, frame: FrameIndex, exr: Bytes) -> Result<(), StoreError> {
        self.keep(&frame_path(job, frame), exr).await
    }

    /// A finished frame's file.
    pub async fn frame(&self, job: JobId, frame: FrameIndex) -> Result<Option<Bytes>, StoreError> {
        get(&*self.objects.durable, &frame_path(job, frame)).await
    }

    /// Frames of a job that are finished.
    pub async fn finished_frames(&self, job: JobId) -> Result<BTreeSet<FrameIndex>, StoreError> {
        let paths = list(&*self.objects.durable, &job_path(job).join("frames")).await?;
        let frame = |path: &Path| {
            let number = path.filename()?.strip_prefix("frame.")?.strip_suffix(".exr")?;
            number.parse().ok().map(FrameIndex)
        };
        Ok(paths.iter().filter_map(frame).collect())
    }
}

fn job_path(job: JobId) -> Path {
    Path::from("jobs").join(job.to_string())
}

/// Where a finished frame is, from the store's root.
pub fn frame_path(job: JobId, frame: FrameIndex) -> Path {
    job_path(job).join("frames").join(format!("frame.{:04}.exr", frame.0))
}

/// The store's name, made up once.
async fn session(objects: &Objects) -> Result<u64, StoreError> {
    let path = Path::from("session");
    create(&*objects.durable, &path, fastrand::u64(..).to_string().into_bytes()).await?;
    let text = get(&*objects.durable, &path).await?.unwrap_or_default();
    let number = std::str::from_utf8(&text).ok().and_then(|text| text.trim().parse().ok());
    number.ok_or_else(|| StoreError::Damaged { path: path.to_string(), fault: "it is no number".to_owned() })
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
