//! Scenes in the store, in pieces that scenes share, and what of them nobody needs any more.

use super::objects::{get, list};
use super::{READS, Store, StoreError};
use crate::pieces;
use bytes::{Bytes, BytesMut};
use farm_job::Digest;
use farm_scene::SceneId;
use farm_worker::blocking;
use futures::{StreamExt, TryStreamExt};
use object_store::ObjectStoreExt;
use object_store::path::Path;
use std::collections::BTreeSet;
use std::sync::PoisonError;

impl Store {
    /// Keeps a piece of a scene.
    pub async fn put_piece(&self, piece: Bytes) -> Result<(), StoreError> {
        self.keep(&piece_path(pieces::digest(&piece)), piece).await
    }

    /// Whether a piece is there.
    pub async fn has_piece(&self, piece: Digest) -> Result<bool, StoreError> {
        self.has(&piece_path(piece)).await
    }

    /// Whether a scene is there.
    pub async fn has_scene(&self, scene: SceneId) -> Result<bool, StoreError> {
        self.has(&scene_path(scene)).await
    }

    async fn has(&self, path: &Path) -> Result<bool, StoreError> {
        match self.objects.durable.head(path).await {
            Ok(_) => Ok(true),
            Err(object_store::Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(StoreError::object(path, &error)),
        }
    }

    /// The pieces in a row, as far as they are there.
    pub async fn join(&self, digests: &[Digest], bytes_max: usize) -> Result<Option<Bytes>, StoreError> {
        let paths: Vec<Path> = digests.iter().map(|digest| piece_path(*digest)).collect();
        let objects = self.objects.clone();
        let pieces = futures::stream::iter(paths).map(move |path| {
            let objects = objects.clone();
            async move { get(&*objects.durable, &path).await }
        });
        let mut pieces = pieces.buffered(READS);
        let mut joined = BytesMut::new();
        while let Some(piece) = pieces.next().await {
            let Some(piece) = piece? else { return Ok(None) };
            if joined.len() + piece.len() > bytes_max {
                return Ok(None);
            }
            joined.extend_from_slice(&piece);
        }
        Ok(Some(joined.freeze()))
    }

    /// Keeps which pieces, all of which are there, make up a scene's snapshot.
    pub async fn put_scene(&self, scene: SceneId, digests: &[Digest]) -> Result<(), StoreError> {
        let names: Vec<String> = digests.iter().map(Digest::to_string).collect();
        let json = serde_json::to_vec_pretty(&names).expect("plain data serialises");
        self.keep(&scene_path(scene), json).await
    }

    /// A scene's snapshot, verified.
    pub async fn scene(&self, scene: SceneId) -> Option<Bytes> {
        if let Some((latest, snapshot)) = &*self.latest_scene.lock().unwrap_or_else(PoisonError::into_inner)
            && *latest == scene
        {
            return Some(snapshot.clone());
        }
        let digests = self.pieces_of(scene).await.ok()??;
        let snapshot = self.join(&digests, usize::MAX).await.ok()??;
        let verified = blocking(move || (SceneId::of(&snapshot) == scene).then_some(snapshot));
        let snapshot = verified.await?;
        *self.latest_scene.lock().unwrap_or_else(PoisonError::into_inner) = Some((scene, snapshot.clone()));
        Some(snapshot)
    }

    /// Which pieces a scene is made of; none when it is not there.
    async fn pieces_of(&self, scene: SceneId) -> Result<Option<Vec<Digest>>, StoreError> {
        let path = scene_path(scene);
        let Some(names) = self.read_json::<Vec<String>>(&path).await? else { return Ok(None) };
        let digests: Result<Vec<Digest>, _> = names.iter().map(|name| name.parse()).collect();
        let damaged = |fault: farm_job::DigestError| StoreError::Damaged {
            path: path.to_string(),
            fault: fault.to_string(),
        };
        digests.map(Some).map_err(damaged)
    }

    /// Scenes that are none of `needed`, and pieces that none of those is made of. What is brought meanwhile may be among them.
    pub async fn unneeded(&self, needed: &BTreeSet<SceneId>) -> Result<Unneeded, StoreError> {
        let mut unneeded = Unneeded::default();
        let pieces = list(&*self.objects.durable, &Path::from("pieces")).await?;
        let mut pieces: BTreeSet<Digest> = pieces.iter().filter_map(named).collect();
        let scenes = list(&*self.objects.durable, &Path::from("scenes")).await?;
        let scenes: BTreeSet<SceneId> =
            scenes.iter().filter_map(named).map(|digest| SceneId(digest.0)).collect();
        let (kept, gone) = scenes.into_iter().partition::<BTreeSet<_>, _>(|scene| needed.contains(scene));
        unneeded.scenes = gone;
        let lists = futures::stream::iter(kept).map(|scene| self.pieces_of(scene)).buffered(READS);
        for used in lists.try_collect::<Vec<_>>().await? {
            let used: BTreeSet<Digest> = used.into_iter().flatten().collect();
            pieces.retain(|piece| !used.contains(piece));
        }
        unneeded.pieces = pieces;
        Ok(unneeded)
    }

    /// Forgets scenes and pieces, a scene before what it is made of.
    pub async fn remove_unneeded(&self, unneeded: &Unneeded) -> Result<(), StoreError> {
        self.turn.check(&self.objects).await?;
        self.latest_scene
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take_if(|(scene, _)| unneeded.scenes.contains(scene));
        self.remove(unneeded.scenes.iter().copied().map(scene_path).collect()).await;
        self.remove(unneeded.pieces.iter().copied().map(piece_path).collect()).await;
        Ok(())
    }
}

/// What nobody needs any more.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Unneeded {
    /// Scenes.
    pub scenes: BTreeSet<SceneId>,
    /// Pieces of them, and of what never became a scene.
    pub pieces: BTreeSet<Digest>,
}

impl Unneeded {
    /// Whether there is nothing to forget.
    pub fn is_empty(&self) -> bool {
        self.scenes.is_empty() && self.pieces.is_empty()
    }
}

/// Of whatever is called by its digest.
fn named(path: &Path) -> Option<Digest> {
    path.filename()?.parse().ok()
}

fn scene_path(scene: SceneId) -> Path {
    Path::from("scenes").join(scene.to_string())
}

fn piece_path(piece: Digest) -> Path {
    Path::from("pieces").join(piece.to_string())
}
