//! Who delivered what, in the store, where results are compared: all that came from a worker whose results turn out to be wrong
//! is rendered again, also what it delivered before the coordinator started.

use super::objects::{get, list};
use super::{Store, StoreError, job_path};
use farm_film::{FrameIndex, Tile};
use farm_job::JobId;
use farm_scheduler::Origin;
use object_store::ObjectStoreExt;
use object_store::path::Path;
use serde::{Deserialize, Serialize};

/// One entry of `jobs/<id>/origins/<frame>/<epoch>-<n>.json`.
#[derive(Clone, Serialize, Deserialize)]
struct StoredOrigin {
    /// `x0, y0, x1, y1`.
    tile: [u32; 4],
    name: String,
}

fn corners(tile: Tile) -> [u32; 4] {
    [tile.x0(), tile.y0(), tile.x1(), tile.y1()]
}

fn origins_path(job: JobId, frame: FrameIndex) -> Path {
    job_path(job).join("origins").join(frame.to_string())
}

impl Store {
    /// Keeps who delivered what of one frame.
    pub async fn put_origins(
        &self,
        job: JobId,
        frame: FrameIndex,
        origins: &[(Tile, String)],
    ) -> Result<(), StoreError> {
        let stored =
            origins.iter().map(|(tile, name)| StoredOrigin { tile: corners(*tile), name: name.clone() });
        self.put_stored(job, frame, &stored.collect::<Vec<_>>()).await
    }

    async fn put_stored(
        &self,
        job: JobId,
        frame: FrameIndex,
        origins: &[StoredOrigin],
    ) -> Result<(), StoreError> {
        let json = serde_json::to_vec(origins).expect("plain data serialises");
        self.keep(&origins_path(job, frame).join(self.fresh_name("json")), json).await
    }

    /// Who delivered what of a job, as far as that was kept.
    pub async fn origins(&self, job: JobId) -> Result<Vec<Origin>, StoreError> {
        let mut origins = Vec::new();
        for path in list(&*self.objects.durable, &job_path(job).join("origins")).await? {
            let frame = path.as_ref().rsplit('/').nth(1).and_then(|part| part.parse().ok());
            let Some(frame) = frame.map(FrameIndex) else { continue };
            let stored: Vec<StoredOrigin> = self.read_json(&path).await?.unwrap_or_default();
            for StoredOrigin { tile: [x0, y0, x1, y1], name } in stored {
                let tile = Tile::new(x0, y0, x1, y1);
                let damaged = |fault: farm_film::TileError| StoreError::Damaged {
                    path: path.to_string(),
                    fault: fault.to_string(),
                };
                origins.push(Origin { frame, tile: tile.map_err(damaged)?, name });
            }
        }
        Ok(origins)
    }

    /// Forgets who delivered what of some tiles, or of all, whose samples are gone.
    pub async fn remove_origins(
        &self,
        job: JobId,
        frame: FrameIndex,
        tiles: Option<&[Tile]>,
    ) -> Result<(), StoreError> {
        let objects = &*self.objects.durable;
        for path in list(objects, &origins_path(job, frame)).await? {
            if let Some(tiles) = tiles {
                let bytes = get(objects, &path).await?.unwrap_or_default();
                let stored: Vec<StoredOrigin> = serde_json::from_slice(&bytes).unwrap_or_default();
                let is_concerned =
                    |origin: &StoredOrigin| tiles.iter().any(|tile| corners(*tile) == origin.tile);
                let rest: Vec<_> = stored.iter().filter(|origin| !is_concerned(origin)).cloned().collect();
                if rest.len() == stored.len() {
                    continue;
                }
                if !rest.is_empty() {
                    self.put_stored(job, frame, &rest).await?;
                }
            }
            self.turn.check(&self.objects).await?;
            objects.delete(&path).await.map_err(|error| StoreError::object(&path, &error))?;
        }
        Ok(())
    }
}
