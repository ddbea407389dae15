//! Looks after the partials of open frames in the store: where many of them have siblings, these are merged in the background.

use super::Key;
use crate::store::{Crowd, Holding, Shelf, Store, StoreError};
use farm_film::SampleBlock;
use farm_job::JobId;
use object_store::path::Path;
use std::collections::BTreeMap;
use std::sync::Arc;
use tokio::task::JoinHandle;
use tracing::{debug, warn};

/// What there is to merge, and what is being merged: one crowd at a time.
#[derive(Default)]
pub(super) struct Merging {
    rounds: BTreeMap<JobId, Arc<[SampleBlock]>>,
    shelves: BTreeMap<Key, Shelf>,
    under_way: Option<UnderWay>,
}

struct UnderWay {
    key: Key,
    crowd: Arc<Crowd>,
    outcome: JoinHandle<Result<Option<Vec<Holding>>, StoreError>>,
}

/// A frame that needs no partials any more, while some were being put.
pub(super) struct LeftBehind(pub Key);

impl Merging {
    /// Results of a job will come; siblings among them merge within its rounds.
    pub fn open(&mut self, job: JobId, rounds: Vec<SampleBlock>) {
        self.rounds.insert(job, rounds.into());
    }

    /// All that is durable of a frame of an open job; tells what of it is superfluous.
    pub fn recall(&mut self, key: Key, holdings: Vec<Holding>) -> Vec<Path> {
        self.shelves.remove(&key);
        holdings.into_iter().for_each(|holding| self.put(key, holding));
        self.shelves.get_mut(&key).map(Shelf::take_superfluous).unwrap_or_default()
    }

    /// Something more is durable of a frame of an open job.
    pub fn put(&mut self, key: Key, holding: Holding) {
        if let Some(rounds) = self.rounds.get(&key.0) {
            self.shelves.entry(key).or_insert_with(|| Shelf::new(rounds.to_vec())).add(holding);
        }
    }

    /// A frame needs no partials any more, or some of them go: what is left is not merged with what comes.
    pub fn forget(&mut self, key: Key) {
        self.shelves.remove(&key);
    }

    /// A job needs no partials any more.
    pub fn close(&mut self, job: JobId) {
        self.rounds.remove(&job);
        self.shelves.retain(|key, _| key.0 != job);
    }

    /// Whether partials of a frame are being merged.
    pub fn is_at(&self, key: Key) -> bool {
        self.under_way.as_ref().is_some_and(|under_way| under_way.key == key)
    }

    /// Begins, if there is anything to merge and nothing is being merged. `is_busy`: the store has something else to do.
    pub fn begin(&mut self, store: &Arc<Store>, is_busy: bool) {
        if self.under_way.is_some() {
            return;
        }
        let crowded = self.shelves.iter().find_map(|(key, shelf)| Some((*key, shelf.crowd(is_busy)?)));
        let Some((key @ (job, frame), crowd)) = crowded else { return };
        let (store, rounds, crowd) = (store.clone(), self.rounds[&job].clone(), Arc::new(crowd));
        let outcome = tokio::spawn({
            let crowd = crowd.clone();
            async move { store.merge(job, frame, rounds, &crowd).await }
        });
        self.under_way = Some(UnderWay { key, crowd, outcome });
    }

    /// Ends when what is being merged is; never while nothing is. May be given up and called again.
    pub async fn step(&mut self) -> Option<LeftBehind> {
        let Some(UnderWay { outcome, .. }) = &mut self.under_way else { return std::future::pending().await };
        let outcome = outcome.await;
        let UnderWay { key: key @ (job, frame), crowd, .. } = self.under_way.take()?;
        let Some(shelf) = self.shelves.get_mut(&key) else { return Some(LeftBehind(key)) };
        match outcome {
            Ok(Ok(Some(parents))) => {
                debug!(%job, %frame, objects = crowd.len(), into = parents.len(), "partials merged in the store");
                shelf.replaced(&crowd, parents);
            }
            Ok(Ok(None)) => shelf.in_vain(),
            Ok(Err(error)) => {
                // Nothing is lost; whatever else is put waits for the store.
                warn!(%job, %frame, %error, "partials cannot be merged in the store at present");
                shelf.in_vain();
            }
            Err(error) => {
                if let Ok(panic) = error.try_into_panic() {
                    std::panic::resume_unwind(panic);
                }
            }
        }
        None
    }

    /// The same, and ends at once while nothing is being merged.
    pub async fn finish(&mut self) -> Option<LeftBehind> {
        if self.under_way.is_some() { self.step().await } else { None }
    }
}
