//! A tile's partials become fewer: siblings are merged, the parents made durable, and then the children removed. Killed in
//! between, both are there, and whoever reads them takes the parents.

use super::batch::{self, partial_name};
use super::partials::{Holding, OBJECT_BYTES_MAX, OBJECT_PARTIALS_MAX, partials_path};
use super::shelf::{Crowd, parent_within};
use super::{READS, Store, StoreError};
use bytes::Bytes;
use farm_film::{FilmTile, FrameIndex, SampleBlock, Tile, WorkUnit};
use farm_image::{PartialHeader, encode_partial};
use farm_job::JobId;
use farm_worker::blocking;
use futures::{StreamExt, TryStreamExt};
use std::cmp::Reverse;
use std::sync::Arc;

type Partial = (FilmTile, PartialHeader);

/// Partials of one picture, sorted by tile and first sample, without those that are part of another.
pub fn largest<T>(mut partials: Vec<(FilmTile, T)>) -> Vec<(FilmTile, T)> {
    partials.sort_by_key(|(tile, _)| (tile.tile(), tile.block().start(), Reverse(tile.block().samples())));
    let mut before: Option<(Tile, SampleBlock)> = None;
    partials.retain(|(partial, _)| {
        // Blocks are nested or apart: the larger ones come first.
        let is_part =
            before.is_some_and(|(tile, block)| tile == partial.tile() && block.contains(partial.block()));
        if !is_part {
            before = Some((partial.tile(), partial.block()));
        }
        !is_part
    });
    partials
}

/// Merges siblings within `rounds`. None when that gives a value that no file could hold.
fn merged(partials: Vec<Partial>, rounds: &[SampleBlock]) -> Option<Vec<Partial>> {
    let mut merged: Vec<Partial> = Vec::new();
    for (mut tile, mut header) in largest(partials) {
        while let Some((left, of_left)) = merged.pop_if(|(left, _)| {
            left.tile() == tile.tile() && parent_within(rounds, left.block(), tile.block()).is_some()
        }) {
            tile = left.merge(tile);
            header.counters = header.counters.plus(of_left.counters);
            if !tile.is_finite() {
                return None;
            }
        }
        merged.push((tile, header));
    }
    Some(merged)
}

/// Several partials in one object, and what they are.
struct Packed {
    parts: Vec<(Tile, SampleBlock)>,
    tar: Bytes,
}

fn packed(partials: &[Partial], frame: FrameIndex) -> Vec<Packed> {
    let (mut objects, mut files, mut parts, mut bytes) = (Vec::new(), Vec::new(), Vec::new(), 0);
    for (index, (tile, header)) in partials.iter().enumerate() {
        let unit = WorkUnit { frame, tile: tile.tile(), block: tile.block() };
        let file = encode_partial(tile, header);
        bytes += file.len();
        files.push((partial_name(&unit), file));
        parts.push((unit.tile, unit.block));
        if files.len() == OBJECT_PARTIALS_MAX || bytes >= OBJECT_BYTES_MAX || index + 1 == partials.len() {
            let tar = batch::pack(files.drain(..));
            objects.push(Packed { parts: std::mem::take(&mut parts), tar: tar.into() });
            bytes = 0;
        }
    }
    objects
}

impl Store {
    /// Puts fewer partials in place of a crowd that [`super::Shelf::crowd`] told, and says which. None, and nothing is changed,
    /// when they cannot be merged.
    pub async fn merge(
        &self,
        job: JobId,
        frame: FrameIndex,
        rounds: Arc<[SampleBlock]>,
        crowd: &Crowd,
    ) -> Result<Option<Vec<Holding>>, StoreError> {
        let read = futures::stream::iter(crowd.0.clone()).map(|path| async move {
            let object = self.read_partials(path.clone()).await?;
            let whole = object.filter(|object| object.is_whole);
            whole.ok_or_else(|| StoreError::Damaged {
                path: path.to_string(),
                fault: "it holds no longer what was put there".to_owned(),
            })
        });
        let objects: Vec<_> = read.buffered(READS).try_collect().await?;
        let work = blocking(move || {
            let partials = objects.into_iter().flat_map(|object| object.partials);
            let partials: Vec<Partial> = partials.map(|partial| (partial.tile, partial.header)).collect();
            let before = partials.len();
            let merged = merged(partials, &rounds).filter(|merged| merged.len() < before)?;
            // Whatever merges no more goes apart, so that it is written no more.
            let (whole, rest): (Vec<_>, Vec<_>) =
                merged.into_iter().partition(|(tile, _)| rounds.contains(&tile.block()));
            Some([packed(&whole, frame), packed(&rest, frame)])
        });
        let Some(parents) = work.await else { return Ok(None) };
        let mut put = Vec::new();
        for Packed { parts, tar } in parents.into_iter().flatten() {
            let (path, bytes) = (partials_path(job, frame).join(self.fresh_name("tar")), tar.len());
            // What is there of the parents when this fails does no harm: a successor may rely on it already.
            self.keep(&path, tar).await?;
            put.push(Holding { path, bytes, parts });
        }
        self.remove(crowd.0.clone()).await;
        Ok(Some(put))
    }
}

#[cfg(test)]
#[path = "merging_tests.rs"]
mod tests;
