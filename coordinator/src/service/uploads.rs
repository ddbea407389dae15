//! What submitters bring: how much of it there may be, and what becomes of it when no job ever refers to it.

use super::policy::Peer;
use super::quota::{Quota, QuotaExceeded};
use crate::pieces;
use crate::store::{Store, StoreError, Unneeded};
use bytes::Bytes;
use farm_job::Digest;
use farm_scene::SceneId;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{RwLock, Semaphore};
use tracing::{info, warn};

/// Scenes that are held in memory to be checked, at the same time.
const CHECKS_AT_ONCE: usize = 2;

/// How often it is looked whether anything is to be forgotten, at most and at least.
const SWEEP_EVERY_MIN: Duration = Duration::from_millis(250);
const SWEEP_EVERY_MAX: Duration = Duration::from_secs(600);

/// How uploads are bounded.
#[derive(Clone, Copy, Debug)]
pub struct UploadLimits {
    /// Bytes that a submitter may bring within an hour; admins may bring as many as they like.
    pub quota: u64,
    /// What was brought, and what no job refers to any more, is forgotten when nobody has asked for it for so long.
    pub keep: Duration,
}

/// Scenes on their way into the store, and out of it.
pub struct Uploads {
    store: Arc<Store>,
    quota: Quota,
    keep: Duration,
    /// When somebody last brought, or counted on, a scene or a piece.
    touched: Mutex<BTreeMap<Digest, Instant>>,
    /// Held from the look whether something is there to the note that somebody counts on it.
    gate: RwLock<()>,
    /// Room for scenes that are being checked.
    pub checks: Semaphore,
}

/// Something cannot be brought.
#[derive(Debug, thiserror::Error)]
pub enum UploadError {
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Quota(#[from] QuotaExceeded),
}

impl Uploads {
    pub fn new(store: Arc<Store>, limits: UploadLimits) -> Self {
        Self {
            store,
            quota: Quota::new(limits.quota),
            keep: limits.keep,
            touched: Mutex::default(),
            gate: RwLock::default(),
            checks: Semaphore::new(CHECKS_AT_ONCE),
        }
    }

    /// Whether a scene is there; from now on somebody counts on that.
    pub async fn has_scene(&self, scene: SceneId) -> Result<bool, StoreError> {
        let _hold = self.gate.read().await;
        let has = self.store.has_scene(scene).await?;
        self.note(has.then_some(Digest(scene.0)));
        Ok(has)
    }

    /// Whether a piece is there; from now on somebody counts on that.
    pub async fn has_piece(&self, piece: Digest) -> Result<bool, StoreError> {
        let _hold = self.gate.read().await;
        let has = self.store.has_piece(piece).await?;
        self.note(has.then_some(piece));
        Ok(has)
    }

    /// Keeps a piece that somebody brings. What is there already is not counted.
    pub async fn bring(&self, peer: &Peer, piece: Bytes) -> Result<(), UploadError> {
        let digest = pieces::digest(&piece);
        if self.has_piece(digest).await? {
            return Ok(());
        }
        if !peer.standing.is_admin() {
            let taken = self.quota.take(peer.standing.owner(), piece.len(), Instant::now());
            taken
                .inspect_err(|exceeded| warn!(peer = %peer.address, reason = %exceeded, "upload refused"))?;
        }
        self.touch([digest]).await;
        Ok(self.store.put_piece(piece).await?)
    }

    /// Notes that somebody counts on these.
    pub async fn touch(&self, digests: impl IntoIterator<Item = Digest>) {
        let _hold = self.gate.read().await;
        self.note(digests);
    }

    fn note(&self, digests: impl IntoIterator<Item = Digest>) {
        let now = Instant::now();
        let mut touched = self.touched.lock().unwrap_or_else(PoisonError::into_inner);
        touched.extend(digests.into_iter().map(|digest| (digest, now)));
    }

    /// What was touched of late; the rest is dropped.
    fn recent(&self) -> BTreeSet<Digest> {
        let mut touched = self.touched.lock().unwrap_or_else(PoisonError::into_inner);
        touched.retain(|_, at| at.elapsed() < self.keep);
        touched.keys().copied().collect()
    }

    /// Forgets what no job refers to, again and again. `in_jobs` gives the scenes of all jobs. As this coordinator does not know
    /// what was touched before it started, it waits as long first.
    pub async fn sweep_for_ever(self: Arc<Self>, in_jobs: impl Fn() -> BTreeSet<SceneId>) {
        tokio::time::sleep(self.keep).await;
        loop {
            match self.sweep(&in_jobs).await {
                Ok(gone) if gone.is_empty() => {}
                Ok(gone) => {
                    let (scenes, pieces) = (gone.scenes.len(), gone.pieces.len());
                    info!(scenes, pieces, "forgotten: no job refers to them");
                }
                Err(StoreError::TurnOver(_)) => return,
                Err(error) => warn!(%error, "what no job refers to cannot be looked for at present"),
            }
            tokio::time::sleep((self.keep / 4).clamp(SWEEP_EVERY_MIN, SWEEP_EVERY_MAX)).await;
        }
    }

    async fn sweep(&self, in_jobs: impl Fn() -> BTreeSet<SceneId>) -> Result<Unneeded, StoreError> {
        let mut needed = in_jobs();
        needed.extend(self.recent().into_iter().map(|digest| SceneId(digest.0)));
        let mut unneeded = self.store.unneeded(&needed).await?;
        if unneeded.is_empty() {
            return Ok(unneeded);
        }
        // Whoever counts on something has said so before.
        let _nobody = self.gate.write().await;
        let recent = self.recent();
        if unneeded.scenes.iter().any(|scene| recent.contains(&Digest(scene.0))) {
            // Its pieces are needed as well: next time.
            return Ok(Unneeded::default());
        }
        unneeded.pieces.retain(|piece| !recent.contains(piece));
        self.store.remove_unneeded(&unneeded).await?;
        Ok(unneeded)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::{Patience, StoreLocation};

    const SCENES: [&[&str]; 3] = [&["shared", "fox"], &["shared", "owl"], &["cat"]];

    fn id(scene: usize) -> SceneId {
        SceneId::of(SCENES[scene].concat().as_bytes())
    }

    fn parts(scene: usize) -> Vec<Digest> {
        SCENES[scene].iter().map(|part| pieces::digest(part.as_bytes())).collect()
    }

    #[tokio::test]
    async fn what_no_job_refers_to_is_forgotten_and_nothing_else() {
        let place = tempfile::tempdir().unwrap();
        let location = StoreLocation::Folder(place.path().to_owned());
        let store = Arc::new(Store::open(&location, Patience::Leave).await.unwrap());
        for (scene, texts) in SCENES.iter().enumerate() {
            for text in *texts {
                store.put_piece(Bytes::from_static(text.as_bytes())).await.unwrap();
            }
            store.put_scene(id(scene), &parts(scene)).await.unwrap();
        }
        store.put_piece(Bytes::from("never finished")).await.unwrap();
        let half = pieces::digest(b"never finished");
        let limits = UploadLimits { quota: 0, keep: Duration::from_millis(300) };
        let uploads = Uploads::new(store.clone(), limits);
        // A job has the owl; somebody looks at the cat, and brings something.
        uploads.touch([Digest(id(2).0), half]).await;
        let gone = uploads.sweep(|| BTreeSet::from([id(1)])).await.unwrap();
        assert_eq!(gone.scenes, BTreeSet::from([id(0)]));
        assert_eq!(gone.pieces, BTreeSet::from([parts(0)[1]]));
        assert!(store.scene(id(1)).await.is_some() && store.scene(id(2)).await.is_some());
        assert!(!store.has_scene(id(0)).await.unwrap() && store.has_piece(half).await.unwrap());
        tokio::time::sleep(limits.keep).await;
        let gone = uploads.sweep(|| BTreeSet::from([id(1)])).await.unwrap();
        assert_eq!(
            (gone.scenes, gone.pieces),
            (BTreeSet::from([id(2)]), BTreeSet::from([parts(2)[0], half]))
        );
        assert!(uploads.sweep(|| BTreeSet::from([id(1)])).await.unwrap().is_empty());
        assert!(store.scene(id(1)).await.is_some());
    }
}
