//! Who delivered what, in the store, where results are compared: all that came from a worker whose results turn out to be wrong
//! is rendered again, also what it delivered before the coordinator started.

use super::objects::{get, list};
use super::{Store, StoreError, job_path};
use farm_film::{FrameIndex, SampleBlock, Tile, WorkUnit};
use farm_job::{Digest, JobId};
use farm_scheduler::Origin;
use object_store::ObjectStoreExt;
use object_store::path::Path;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// One entry of `jobs/<id>/origins/<frame>/<epoch>-<n>.json`.
#[derive(Clone, Serialize, Deserialize)]
struct StoredOrigin {
    name: String,
    /// Of frames that are not finished: what.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    part: Option<StoredPart>,
}

#[derive(Clone, Serialize, Deserialize)]
struct StoredPart {
    /// `x0, y0, x1, y1`.
    tile: [u32; 4],
    /// First, and the one after the last.
    samples: [u64; 2],
    /// Of the partial, in hexadecimal digits.
    digest: String,
}

impl StoredOrigin {
    fn new(origin: &Origin) -> Self {
        let part = origin.part.map(|(unit, digest)| StoredPart {
            tile: corners(unit.tile),
            samples: [unit.block.start(), unit.block.end()],
            digest: digest.to_string(),
        });
        Self { name: origin.name.clone(), part }
    }

    fn read(self, frame: FrameIndex) -> Result<Origin, String> {
        let part = self.part.map(|part| part.read(frame)).transpose()?;
        Ok(Origin { frame, name: self.name, part })
    }

    fn is_of(&self, tiles: &[Tile]) -> bool {
        self.part.as_ref().is_none_or(|part| tiles.iter().any(|tile| corners(*tile) == part.tile))
    }
}

impl StoredPart {
    fn read(self, frame: FrameIndex) -> Result<(WorkUnit, Digest), String> {
        let ([x0, y0, x1, y1], [start, end]) = (self.tile, self.samples);
        let tile = Tile::new(x0, y0, x1, y1).map_err(|error| error.to_string())?;
        let block = SampleBlock::new(start..end).map_err(|error| error.to_string())?;
        let digest = self.digest.parse().map_err(|error: farm_job::DigestError| error.to_string())?;
        Ok((WorkUnit { frame, tile, block }, digest))
    }
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
        origins: &[Origin],
    ) -> Result<(), StoreError> {
        self.put_stored(job, frame, &origins.iter().map(StoredOrigin::new).collect::<Vec<_>>()).await
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
            for origin in stored {
                let damaged = |fault| StoreError::Damaged { path: path.to_string(), fault };
                origins.push(origin.read(frame).map_err(damaged)?);
            }
        }
        // Beside these, what comes late from a coordinator whose turn is over says nothing of a finished frame.
        let settled: BTreeSet<FrameIndex> =
            origins.iter().filter(|origin| origin.part.is_none()).map(|origin| origin.frame).collect();
        origins.retain(|origin| origin.part.is_none() || !settled.contains(&origin.frame));
        Ok(origins)
    }

    /// Keeps of a finished frame only who took part in it.
    pub async fn settle_origins(&self, job: JobId, frame: FrameIndex) -> Result<(), StoreError> {
        let objects = &*self.objects.durable;
        let (paths, mut names) = (list(objects, &origins_path(job, frame)).await?, BTreeSet::new());
        for path in &paths {
            let stored: Vec<StoredOrigin> = self.read_json(path).await?.unwrap_or_default();
            names.extend(stored.into_iter().map(|origin| origin.name));
        }
        // What came from these was rendered again before the frame was finished.
        let liars = self.reputation().await?.distrusted;
        names.retain(|name| !liars.contains(name));
        if names.is_empty() {
            return Ok(());
        }
        let origins: Vec<_> = names.into_iter().map(|name| StoredOrigin { name, part: None }).collect();
        self.put_stored(job, frame, &origins).await?;
        for path in paths {
            objects.delete(&path).await.map_err(|error| StoreError::object(&path, &error))?;
        }
        Ok(())
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
                let rest: Vec<_> = stored.iter().filter(|origin| !origin.is_of(tiles)).cloned().collect();
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
