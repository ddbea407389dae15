//! Scenes by digest: in memory, on disk where the worker was given a place, else from the coordinator.

use crate::client::{Client, FetchError};
use farm_scene::{Scene, SceneId, decode};
use std::collections::VecDeque;
use std::io::Write;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use tracing::warn;

/// Scenes kept in memory: the one being rendered and the next one.
const SCENES_MAX: usize = 2;

/// Scenes that were here once.
pub struct SceneCache {
    directory: Option<PathBuf>,
    /// Most recently used last.
    scenes: Mutex<VecDeque<(SceneId, Arc<Scene>)>>,
}

impl SceneCache {
    /// Keeps scenes in memory, and under `directory` if there is one.
    pub fn new(directory: Option<PathBuf>) -> Self {
        Self { directory, scenes: Mutex::default() }
    }

    /// Puts a scene in that is at hand already.
    pub fn put(&self, id: SceneId, scene: Arc<Scene>) {
        let mut scenes = self.scenes.lock().unwrap_or_else(PoisonError::into_inner);
        scenes.retain(|(held, _)| *held != id);
        scenes.push_back((id, scene));
        while scenes.len() > SCENES_MAX {
            scenes.pop_front();
        }
    }

    /// The scene, wherever it is.
    pub async fn get(self: &Arc<Self>, id: SceneId, client: &Client) -> Result<Arc<Scene>, FetchError> {
        if let Some(scene) = self.in_memory(id) {
            return Ok(scene);
        }
        let cache = self.clone();
        let on_disk = blocking(move || cache.on_disk(id)).await;
        let scene = match on_disk {
            Some(scene) => scene,
            None => {
                let bytes = client.scene(id).await?;
                let cache = self.clone();
                blocking(move || {
                    let scene = decode(&bytes)
                        .map_err(|err| FetchError::Snapshot { scene: id, fault: err.to_string() })?;
                    cache.keep_on_disk(id, &bytes);
                    Ok::<_, FetchError>(Arc::new(scene))
                })
                .await?
            }
        };
        self.put(id, scene.clone());
        Ok(scene)
    }

    fn in_memory(&self, id: SceneId) -> Option<Arc<Scene>> {
        let mut scenes = self.scenes.lock().unwrap_or_else(PoisonError::into_inner);
        let place = scenes.iter().position(|(held, _)| *held == id)?;
        let found = scenes.remove(place)?;
        scenes.push_back(found.clone());
        Some(found.1)
    }

    /// A file whose bytes do not have its name's digest is as good as none.
    fn on_disk(&self, id: SceneId) -> Option<Arc<Scene>> {
        let path = self.directory.as_ref()?.join(id.to_string());
        let bytes = std::fs::read(&path).ok()?;
        if SceneId::of(&bytes) != id {
            warn!(path = %path.display(), "cached scene is damaged; fetching it again");
            return None;
        }
        decode(&bytes).ok().map(Arc::new)
    }

    /// A cache that cannot be written is no reason to stop.
    fn keep_on_disk(&self, id: SceneId, bytes: &[u8]) {
        let Some(directory) = &self.directory else { return };
        let written = || -> std::io::Result<()> {
            std::fs::create_dir_all(directory)?;
            let mut file = tempfile::NamedTempFile::new_in(directory)?;
            file.write_all(bytes)?;
            file.persist(directory.join(id.to_string()))?;
            Ok(())
        };
        if let Err(error) = written() {
            warn!(directory = %directory.display(), %error, "scene cannot be cached");
        }
    }
}

/// Runs what would hold up other tasks on a thread of its own.
pub(crate) async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> T {
    match tokio::task::spawn_blocking(work).await {
        Ok(value) => value,
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(_) => {
                unreachable!("blocking work is not cancelled once it runs, and the runtime outlives it")
            }
        },
    }
}
