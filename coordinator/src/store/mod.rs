//! What must survive the coordinator: a folder of ordinary files, each written whole, made durable and never changed.
//!
//! ```text
//! session                              names this store's farm to its workers
//! lock                                 held by the coordinator that writes here
//! scenes/<digest>                      snapshots
//! jobs/<id>/job.json                   what was asked, and what its owner decided since
//! jobs/<id>/partials/<frame>/*.exr     accepted results of frames that are not finished
//! jobs/<id>/frames/frame.####.exr      finished frames
//! ```
//!
//! Restart: list, read, continue. Every intermediate state opens in any EXR viewer, and `coordinator merge` takes the
//! partials as they are.

use farm_film::{FilmTile, FrameIndex, Tile, WorkUnit};
use farm_image::{ImageError, PartialLimits, decode_partial, write_file};
use farm_job::{JobId, JobSpec, JobState};
use farm_scene::SceneId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use tracing::warn;

/// A store that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Someone else writes there.
    #[error("the store {} is in use by another coordinator: stop it, or give another folder with --store", .0.display())]
    InUse(PathBuf),
    /// A file that cannot be read or written.
    #[error("the store's {}: {error}", path.display())]
    File {
        /// Which one.
        path: PathBuf,
        /// Why not.
        error: std::io::Error,
    },
    /// A file that could not be written whole.
    #[error(transparent)]
    Write(#[from] ImageError),
    /// A file that does not hold what it should.
    #[error("the store's {} is damaged: {fault}", path.display())]
    Damaged {
        /// Which one.
        path: PathBuf,
        /// What is wrong.
        fault: String,
    },
}

/// A job as it is kept.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredJob {
    /// Its name.
    pub job: JobId,
    /// What was asked; its priority is the present one.
    pub spec: JobSpec,
    /// Where it is in its life.
    pub state: JobState,
    /// Why it failed.
    pub reason: Option<String>,
}

/// A folder that is ours as long as this lives.
pub struct Store {
    root: PathBuf,
    session: u64,
    _lock: File,
}

impl Store {
    /// Takes a folder, and makes it a store if it is none yet.
    pub fn open(root: &Path) -> Result<Self, StoreError> {
        for folder in ["scenes", "jobs"] {
            let path = root.join(folder);
            std::fs::create_dir_all(&path).map_err(|error| StoreError::File { path, error })?;
        }
        let path = root.join("lock");
        let lock = File::create(&path).map_err(|error| StoreError::File { path: path.clone(), error })?;
        lock.try_lock().map_err(|err| match err {
            TryLockError::WouldBlock => StoreError::InUse(root.to_owned()),
            TryLockError::Error(error) => StoreError::File { path, error },
        })?;
        let session = session(root)?;
        Ok(Self { root: root.to_owned(), session, _lock: lock })
    }

    /// Names this store's farm to its workers: what they hold stays good across restarts.
    pub fn session(&self) -> u64 {
        self.session
    }

    /// Keeps a scene's snapshot.
    pub fn put_scene(&self, scene: SceneId, snapshot: &[u8]) -> Result<(), StoreError> {
        Ok(write_file(&self.scene_path(scene), snapshot)?)
    }

    /// A scene's snapshot, verified.
    pub fn scene(&self, scene: SceneId) -> Option<Vec<u8>> {
        let snapshot = std::fs::read(self.scene_path(scene)).ok()?;
        (SceneId::of(&snapshot) == scene).then_some(snapshot)
    }

    fn scene_path(&self, scene: SceneId) -> PathBuf {
        self.root.join("scenes").join(scene.to_string())
    }

    fn job_folder(&self, job: JobId) -> PathBuf {
        self.root.join("jobs").join(job.to_string())
    }

    fn partials_folder(&self, job: JobId, frame: FrameIndex) -> PathBuf {
        self.job_folder(job).join("partials").join(frame.to_string())
    }

    /// Folder of a job's finished frames.
    pub fn frames_folder(&self, job: JobId) -> PathBuf {
        self.job_folder(job).join("frames")
    }

    /// Keeps a job, or what has become of it.
    pub fn put_job(&self, job: &StoredJob) -> Result<(), StoreError> {
        let folder = self.frames_folder(job.job);
        std::fs::create_dir_all(&folder).map_err(|error| StoreError::File { path: folder, error })?;
        let json = serde_json::to_vec_pretty(job).expect("plain data serialises");
        Ok(write_file(&self.job_folder(job.job).join("job.json"), &json)?)
    }

    /// Every job, by number.
    pub fn jobs(&self) -> Result<Vec<StoredJob>, StoreError> {
        let mut jobs = Vec::new();
        for name in names(&self.root.join("jobs"))? {
            let path = self.root.join("jobs").join(name).join("job.json");
            // A folder without it is a job that was never acknowledged.
            let Ok(bytes) = std::fs::read(&path) else { continue };
            let job: StoredJob = serde_json::from_slice(&bytes)
                .map_err(|err| StoreError::Damaged { path, fault: err.to_string() })?;
            jobs.push(job);
        }
        jobs.sort_by_key(|job| job.job);
        Ok(jobs)
    }

    /// Keeps an accepted result. Durable when this returns.
    pub fn put_partial(&self, job: JobId, unit: &WorkUnit, partial_exr: &[u8]) -> Result<(), StoreError> {
        let folder = self.partials_folder(job, unit.frame);
        std::fs::create_dir_all(&folder).map_err(|error| StoreError::File { path: folder.clone(), error })?;
        let (tile, block) = (unit.tile, unit.block);
        let name = format!("{}-{}-{}-{}.exr", tile.x0(), tile.y0(), block.start(), block.end());
        Ok(write_file(&folder.join(name), partial_exr)?)
    }

    /// What is there of a frame. A file that cannot be read is as good as none: its unit is rendered again.
    pub fn partials(&self, job: JobId, frame: FrameIndex) -> Vec<(FilmTile, farm_image::PartialHeader)> {
        let folder = self.partials_folder(job, frame);
        let mut partials = Vec::new();
        for name in names(&folder).unwrap_or_default() {
            let path = folder.join(name);
            let read = std::fs::read(&path).map_err(|err| err.to_string()).and_then(|bytes| {
                decode_partial(&bytes, PartialLimits::default()).map_err(|err| err.to_string())
            });
            match read {
                Ok(partial) => partials.push(partial),
                Err(error) => warn!(path = %path.display(), %error, "partial is damaged; rendering it again"),
            }
        }
        partials
    }

    /// Forgets the partials of some tiles, which are rendered again.
    pub fn remove_tiles(&self, job: JobId, frame: FrameIndex, tiles: &[Tile]) -> Result<(), StoreError> {
        let folder = self.partials_folder(job, frame);
        if !folder.is_dir() {
            return Ok(());
        }
        let corners: BTreeSet<String> =
            tiles.iter().map(|tile| format!("{}-{}-", tile.x0(), tile.y0())).collect();
        for name in names(&folder)? {
            let name = name.to_string_lossy().into_owned();
            if corners.iter().any(|corner| name.starts_with(corner)) {
                let path = folder.join(name);
                std::fs::remove_file(&path).map_err(|error| StoreError::File { path, error })?;
            }
        }
        Ok(())
    }

    /// Forgets the partials of a frame that is finished.
    pub fn remove_partials(&self, job: JobId, frame: FrameIndex) {
        // What is left behind is only in the way of the disk.
        let _ = std::fs::remove_dir_all(self.partials_folder(job, frame));
    }

    /// Whether files can be written at present.
    pub fn probe(&self) -> Result<(), StoreError> {
        Ok(write_file(&self.root.join("probe"), &[0; 1 << 16])?)
    }
}

/// The store's name, made up once.
fn session(root: &Path) -> Result<u64, StoreError> {
    let path = root.join("session");
    match std::fs::read_to_string(&path) {
        Ok(text) => {
            text.trim().parse().map_err(|_| StoreError::Damaged { path, fault: "it is no number".into() })
        }
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            let session = fastrand::u64(..);
            write_file(&path, session.to_string().as_bytes())?;
            Ok(session)
        }
        Err(error) => Err(StoreError::File { path, error }),
    }
}

/// Names in a folder, sorted, so that nothing depends on the file system's order.
fn names(folder: &Path) -> Result<Vec<std::ffi::OsString>, StoreError> {
    let read = || -> std::io::Result<Vec<_>> {
        std::fs::read_dir(folder)?.map(|entry| Ok(entry?.file_name())).collect()
    };
    let mut names = read().map_err(|error| StoreError::File { path: folder.to_owned(), error })?;
    names.sort();
    Ok(names)
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
