//! Scenes by digest: in memory, on disk where the worker was given a place, else from the coordinator.

use crate::blocking::blocking;
use crate::client::{Client, FetchError, fits};
use crate::disk_cache::DiskCache;
use farm_scene::{Scene, SceneId, decode};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

/// Scenes kept in memory: the one being rendered and the next one.
const SCENES_MAX: usize = 2;

/// Scenes that were here once.
pub struct SceneCache {
    disk: Option<DiskCache>,
    /// Bytes that the worker may use in all.
    memory: u64,
    /// Most recently used last.
    scenes: Mutex<VecDeque<Held>>,
}

/// A scene, and about what it takes.
#[derive(Clone)]
pub struct Held {
    id: SceneId,
    /// Plain data.
    pub scene: Arc<Scene>,
    /// Of its snapshot; in memory it takes about as much.
    pub bytes: u64,
}

impl SceneCache {
    /// Keeps scenes in memory, and on disk if there is a place. Scenes that take more than `memory` bytes are not read.
    pub fn new(disk: Option<DiskCache>, memory: Option<u64>) -> Self {
        Self { disk, memory: memory.unwrap_or(u64::MAX), scenes: Mutex::default() }
    }

    /// Bytes that the worker may use in all.
    pub fn memory(&self) -> u64 {
        self.memory
    }

    /// Puts a scene in that is at hand already, and costs nothing more.
    pub fn put(&self, id: SceneId, scene: Arc<Scene>) {
        self.keep(Held { id, scene, bytes: 0 });
    }

    fn keep(&self, new: Held) {
        let mut scenes = self.scenes.lock().unwrap_or_else(PoisonError::into_inner);
        scenes.retain(|held| held.id != new.id);
        scenes.push_back(new);
        let crowded = |scenes: &VecDeque<Held>| {
            scenes.len() > SCENES_MAX || scenes.iter().map(|held| held.bytes).sum::<u64>() > self.memory / 2
        };
        while scenes.len() > 1 && crowded(&scenes) {
            scenes.pop_front();
        }
    }

    /// The scene, wherever it is.
    pub async fn get(self: &Arc<Self>, id: SceneId, client: &Client) -> Result<Held, FetchError> {
        if let Some(held) = self.in_memory(id) {
            return Ok(held);
        }
        let cache = self.clone();
        let on_disk = blocking(move || cache.on_disk(id)).await?;
        let held = match on_disk {
            Some(held) => held,
            None => {
                let bytes = client.scene(id, self.memory).await?;
                let cache = self.clone();
                blocking(move || {
                    let held = read(id, &bytes)?;
                    if let Some(disk) = &cache.disk {
                        disk.put(id, &bytes);
                    }
                    Ok::<_, FetchError>(held)
                })
                .await?
            }
        };
        self.keep(held.clone());
        Ok(held)
    }

    fn in_memory(&self, id: SceneId) -> Option<Held> {
        let mut scenes = self.scenes.lock().unwrap_or_else(PoisonError::into_inner);
        let place = scenes.iter().position(|held| held.id == id)?;
        let found = scenes.remove(place)?;
        scenes.push_back(found.clone());
        Some(found)
    }

    /// A file that is no scene of this version is fetched again.
    fn on_disk(&self, id: SceneId) -> Result<Option<Held>, FetchError> {
        let Some(bytes) = self.disk.as_ref().and_then(|disk| disk.get(id)) else { return Ok(None) };
        fits(id, bytes.len() as u64, self.memory)?;
        Ok(read(id, &bytes).ok())
    }
}

fn read(id: SceneId, bytes: &[u8]) -> Result<Held, FetchError> {
    let scene = decode(bytes).map_err(|err| FetchError::Snapshot { scene: id, fault: err.to_string() })?;
    Ok(Held { id, scene: Arc::new(scene), bytes: bytes.len() as u64 })
}
