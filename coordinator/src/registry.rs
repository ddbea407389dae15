//! Jobs and scenes by name, for everyone who answers workers.

use bytes::Bytes;
use farm_job::{JobId, JobSpec};
use farm_proto::SCENE_CHUNK_BYTES;
use farm_scene::SceneId;
use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock};

/// What workers may ask for.
#[derive(Default)]
pub struct Registry {
    jobs: RwLock<BTreeMap<JobId, Arc<JobSpec>>>,
    scenes: RwLock<BTreeMap<SceneId, Bytes>>,
}

impl Registry {
    /// Makes a job known.
    pub fn put_job(&self, job: JobId, spec: JobSpec) {
        self.jobs.write().unwrap_or_else(PoisonError::into_inner).insert(job, Arc::new(spec));
    }

    /// What a job asks.
    pub fn job(&self, job: JobId) -> Option<Arc<JobSpec>> {
        self.jobs.read().unwrap_or_else(PoisonError::into_inner).get(&job).cloned()
    }

    /// Makes a job unknown.
    pub fn remove_job(&self, job: JobId) {
        self.jobs.write().unwrap_or_else(PoisonError::into_inner).remove(&job);
    }

    /// Makes a scene known by its snapshot.
    pub fn put_scene(&self, scene: SceneId, snapshot: impl Into<Bytes>) {
        self.scenes.write().unwrap_or_else(PoisonError::into_inner).insert(scene, snapshot.into());
    }

    /// A scene's snapshot.
    pub fn scene(&self, scene: SceneId) -> Option<Bytes> {
        self.scenes.read().unwrap_or_else(PoisonError::into_inner).get(&scene).cloned()
    }
}

/// A snapshot from `offset` on in pieces, each with its place. Nothing is copied.
pub fn chunks(snapshot: Bytes, offset: usize) -> impl Iterator<Item = (usize, Bytes)> + Send {
    let total = snapshot.len();
    (offset..total)
        .step_by(SCENE_CHUNK_BYTES)
        .map(move |start| (start, snapshot.slice(start..total.min(start + SCENE_CHUNK_BYTES))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_go_on_from_anywhere() {
        let snapshot: Bytes = (0..SCENE_CHUNK_BYTES * 2 + 5).map(|byte| byte as u8).collect();
        for offset in [0, 1, SCENE_CHUNK_BYTES, snapshot.len() - 1, snapshot.len()] {
            let mut joined = snapshot[..offset].to_vec();
            for (start, chunk) in chunks(snapshot.clone(), offset) {
                assert_eq!(start, joined.len());
                assert!(!chunk.is_empty() && chunk.len() <= SCENE_CHUNK_BYTES);
                joined.extend_from_slice(&chunk);
            }
            assert_eq!(joined, snapshot);
        }
    }
}
