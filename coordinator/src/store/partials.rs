//! Accepted results in the store: one object each, or several in one, until their frame is finished.

use super::batch::{self, partial_name};
use super::objects::{get, list};
use super::{READS, Store, StoreError, job_path};
use bytes::Bytes;
use farm_film::{FilmTile, FrameIndex, SampleBlock, Tile, WorkUnit};
use farm_image::{PartialHeader, PartialLimits, decode_partial};
use farm_job::{Digest, JobId};
use farm_worker::blocking;
use futures::{StreamExt, TryStreamExt};
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt};
use std::collections::BTreeSet;
use tracing::warn;

/// Partials in one object at most, and their bytes: what is lost when one object is damaged, and has to be held in memory
/// twice while it is packed.
pub const OBJECT_PARTIALS_MAX: usize = 1024;
/// See [`OBJECT_PARTIALS_MAX`].
pub const OBJECT_BYTES_MAX: usize = 32 << 20;

/// An object of partials, and which they are.
#[derive(Clone, Debug, PartialEq)]
pub struct Holding {
    pub(super) path: Path,
    pub(super) bytes: usize,
    pub(super) parts: Vec<(Tile, SampleBlock)>,
}

/// An object of partials that was read.
pub struct StoredObject {
    path: Path,
    bytes: usize,
    /// Nothing in it is damaged.
    pub is_whole: bool,
    /// What can be read of it.
    pub partials: Vec<StoredPartial>,
}

/// A partial that was read.
pub struct StoredPartial {
    /// Its sums.
    pub tile: FilmTile,
    /// What it says of itself.
    pub header: PartialHeader,
    /// Of the whole file.
    pub digest: Digest,
}

impl StoredObject {
    /// What it holds.
    pub fn holding(&self) -> Holding {
        let parts = self.partials.iter().map(|partial| (partial.tile.tile(), partial.tile.block())).collect();
        Holding { path: self.path.clone(), bytes: self.bytes, parts }
    }
}

impl Store {
    /// Keeps accepted results of one frame. Durable, and ours, when this returns.
    pub async fn put_partials(
        &self,
        job: JobId,
        frame: FrameIndex,
        partials: &[(&WorkUnit, Bytes)],
    ) -> Result<Holding, StoreError> {
        let folder = partials_path(job, frame);
        let (path, object) = match partials {
            [(unit, bytes)] => (folder.join(partial_name(unit)), bytes.clone()),
            several => {
                let files = several.iter().map(|(unit, bytes)| (partial_name(unit), bytes));
                (folder.join(self.fresh_name("tar")), batch::pack(files).into())
            }
        };
        let parts = partials.iter().map(|(unit, _)| (unit.tile, unit.block)).collect();
        let holding = Holding { path, bytes: object.len(), parts };
        self.keep(&holding.path, object).await?;
        Ok(holding)
    }

    /// Frames of a job of which partials are there.
    pub async fn begun_frames(&self, job: JobId) -> Result<BTreeSet<FrameIndex>, StoreError> {
        let folder = job_path(job).join("partials");
        let found = self.objects.durable.list_with_delimiter(Some(&folder)).await;
        let found = found.map_err(|error| StoreError::object(&folder, &error))?;
        let frame = |path: &Path| path.filename()?.parse().ok().map(FrameIndex);
        Ok(found.common_prefixes.iter().filter_map(frame).collect())
    }

    /// What is there of a frame. A file that is damaged is as good as none: its unit is rendered again. Some may be parts of
    /// others: see [`super::largest`].
    pub async fn partials(&self, job: JobId, frame: FrameIndex) -> Result<Vec<StoredObject>, StoreError> {
        loop {
            let paths = list(&*self.objects.durable, &partials_path(job, frame)).await?;
            let read = futures::stream::iter(paths).map(|path| self.read_partials(path)).buffered(READS);
            let objects: Vec<Option<StoredObject>> = read.try_collect().await?;
            // What went meanwhile was merged into something that was not there yet.
            if let Some(objects) = objects.into_iter().collect() {
                return Ok(objects);
            }
        }
    }

    /// None when there is no such object.
    pub(super) async fn read_partials(&self, path: Path) -> Result<Option<StoredObject>, StoreError> {
        let Some(object) = get(&*self.objects.durable, &path).await? else { return Ok(None) };
        let read = blocking(move || {
            let (files, fault) = match path.extension() {
                Some("tar") => batch::unpack(&object),
                _ => (vec![(String::new(), object.to_vec())], None),
            };
            if let Some(error) = &fault {
                warn!(%path, error, "partials are damaged; rendering them again");
            }
            let partials: Vec<_> =
                files.iter().filter_map(|(name, file)| decode(&path, name, file)).collect();
            let is_whole = fault.is_none() && partials.len() == files.len();
            StoredObject { path, bytes: object.len(), is_whole, partials }
        });
        Ok(Some(read.await))
    }

    /// Forgets the partials of some tiles, which are rendered again. Those of others stay durable at every moment.
    pub async fn remove_tiles(
        &self,
        job: JobId,
        frame: FrameIndex,
        tiles: &[Tile],
    ) -> Result<(), StoreError> {
        let objects = &*self.objects.durable;
        for path in list(objects, &partials_path(job, frame)).await? {
            let is_concerned = |name: &str| tiles.iter().any(|tile| batch::is_of_tile(name, *tile));
            if path.extension() == Some("tar") {
                let (files, _) = batch::unpack(&get(objects, &path).await?.unwrap_or_default());
                let total = files.len();
                let rest: Vec<_> = files.into_iter().filter(|(name, _)| !is_concerned(name)).collect();
                if rest.len() == total {
                    continue;
                }
                if !rest.is_empty() {
                    let rest = batch::pack(rest.into_iter());
                    self.keep(&partials_path(job, frame).join(self.fresh_name("tar")), rest).await?;
                }
            } else if !path.filename().is_some_and(is_concerned) {
                continue;
            }
            self.turn.check(&self.objects).await?;
            objects.delete(&path).await.map_err(|error| StoreError::object(&path, &error))?;
        }
        Ok(())
    }

    /// Forgets all partials of a job that was given up. What is left behind is only in the way of the disk.
    pub async fn remove_all_partials(&self, job: JobId) {
        if self.turn.check(&self.objects).await.is_ok() {
            let folder = job_path(job).join("partials");
            self.remove(list(&*self.objects.durable, &folder).await.unwrap_or_default()).await;
        }
    }

    /// Forgets the partials of a frame that is finished. What is left behind is only in the way of the disk.
    pub async fn remove_partials(&self, job: JobId, frame: FrameIndex) {
        if self.turn.check(&self.objects).await.is_ok() {
            self.remove(list(&*self.objects.durable, &partials_path(job, frame)).await.unwrap_or_default())
                .await;
        }
    }

    /// Removes objects that hold nothing but parts of what is in others.
    pub async fn remove_superfluous(&self, objects: Vec<Path>) {
        if self.turn.check(&self.objects).await.is_ok() {
            self.remove(objects).await;
        }
    }
}

pub(super) fn partials_path(job: JobId, frame: FrameIndex) -> Path {
    job_path(job).join("partials").join(frame.to_string())
}

fn decode(path: &Path, name: &str, bytes: &[u8]) -> Option<StoredPartial> {
    let (tile, header) = decode_partial(bytes, PartialLimits::default())
        .inspect_err(|error| warn!(%path, name, %error, "partial is damaged; rendering it again"))
        .ok()?;
    Some(StoredPartial { tile, header, digest: Digest(*blake3::hash(bytes).as_bytes()) })
}
