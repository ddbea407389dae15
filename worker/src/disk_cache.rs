//! Scenes on disk, by digest, within a bound: what was not needed for longest goes first. Several workers of one host may share
//! a folder.

use farm_scene::SceneId;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::SystemTime;
use tracing::{info, warn};

/// Scenes in a folder.
#[derive(Clone, Debug)]
pub struct DiskCache {
    folder: PathBuf,
    bytes_max: u64,
}

/// One file of the cache.
struct Kept {
    path: PathBuf,
    bytes: u64,
    used: SystemTime,
}

impl DiskCache {
    /// Keeps at most `bytes_max` bytes of scenes in `folder`.
    pub fn new(folder: PathBuf, bytes_max: u64) -> Self {
        Self { folder, bytes_max }
    }

    /// A scene's snapshot, verified. A file whose bytes do not have its name's digest is as good as none, and goes.
    pub fn get(&self, id: SceneId) -> Option<Vec<u8>> {
        let path = self.folder.join(id.to_string());
        let bytes = std::fs::read(&path).ok()?;
        if SceneId::of(&bytes) != id {
            warn!(path = %path.display(), "cached scene is damaged; fetching it again");
            let _ = std::fs::remove_file(&path);
            return None;
        }
        // Its place in the order; without it the scene only goes too early.
        let _ =
            File::options().append(true).open(&path).and_then(|file| file.set_modified(SystemTime::now()));
        Some(bytes)
    }

    /// Keeps a snapshot, and lets others go to make room. A cache that cannot be written is no reason to stop.
    pub fn put(&self, id: SceneId, snapshot: &[u8]) {
        if snapshot.len() as u64 > self.bytes_max {
            info!(scene = %id, bytes = snapshot.len(), allowed = self.bytes_max, "scene is larger than the cache");
            return;
        }
        if let Err(error) = self.write(id, snapshot) {
            warn!(folder = %self.folder.display(), %error, "scene cannot be cached");
        }
    }

    fn write(&self, id: SceneId, snapshot: &[u8]) -> std::io::Result<()> {
        std::fs::create_dir_all(&self.folder)?;
        self.make_room(snapshot.len() as u64)?;
        let mut file = tempfile::NamedTempFile::new_in(&self.folder)?;
        file.write_all(snapshot)?;
        file.persist(self.folder.join(id.to_string()))?;
        Ok(())
    }

    fn make_room(&self, bytes: u64) -> std::io::Result<()> {
        let mut kept = scenes(&self.folder)?;
        kept.sort_by_key(|scene| std::cmp::Reverse(scene.used));
        let mut left = kept.iter().map(|scene| scene.bytes).sum::<u64>();
        while left + bytes > self.bytes_max {
            let Some(oldest) = kept.pop() else { break };
            left -= oldest.bytes;
            match std::fs::remove_file(&oldest.path) {
                // Another worker was faster.
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
                _ => info!(path = %oldest.path.display(), "scene leaves the cache"),
            }
        }
        Ok(())
    }
}

/// Files that are named like scenes; nothing else in the folder is ours.
fn scenes(folder: &Path) -> std::io::Result<Vec<Kept>> {
    let mut kept = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.len() != 64 || !name.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            continue;
        }
        // It may have gone since.
        let Ok(facts) = entry.metadata() else { continue };
        let used = facts.modified().unwrap_or(SystemTime::UNIX_EPOCH);
        kept.push(Kept { path: entry.path(), bytes: facts.len(), used });
    }
    Ok(kept)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn scene(fill: u8) -> (SceneId, Vec<u8>) {
        let bytes = vec![fill; 1000];
        (SceneId::of(&bytes), bytes)
    }

    fn last_used(folder: &Path, id: SceneId, seconds_ago: u64) {
        let file = File::options().append(true).open(folder.join(id.to_string())).unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(seconds_ago)).unwrap();
    }

    #[test]
    fn what_was_not_needed_for_longest_goes_first() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("notes.txt"), "not a scene").unwrap();
        let cache = DiskCache::new(folder.path().to_owned(), 3500);
        let scenes = [1, 2, 3].map(scene);
        for (age, (id, bytes)) in (1..).zip(&scenes) {
            cache.put(*id, bytes);
            last_used(folder.path(), *id, 100 - age);
        }
        assert_eq!(cache.get(scenes[0].0).as_ref(), Some(&scenes[0].1), "it is needed again");
        let (id, bytes) = scene(4);
        cache.put(id, &bytes);
        let there = [scenes[0].0, scenes[1].0, scenes[2].0, id].map(|id| cache.get(id).is_some());
        assert_eq!(there, [true, false, true, true]);
        assert!(folder.path().join("notes.txt").exists());
    }

    #[test]
    fn what_is_larger_than_the_cache_pushes_nothing_out() {
        let folder = tempfile::tempdir().unwrap();
        let cache = DiskCache::new(folder.path().to_owned(), 1500);
        let (small, bytes) = scene(1);
        cache.put(small, &bytes);
        let large = vec![7; 2000];
        cache.put(SceneId::of(&large), &large);
        assert!(cache.get(small).is_some() && cache.get(SceneId::of(&large)).is_none());
    }

    #[test]
    fn damage_is_noticed_and_goes() {
        let folder = tempfile::tempdir().unwrap();
        let cache = DiskCache::new(folder.path().to_owned(), 1500);
        let (id, bytes) = scene(1);
        cache.put(id, &bytes);
        let path = folder.path().join(id.to_string());
        std::fs::write(&path, b"other").unwrap();
        assert_eq!(cache.get(id), None);
        assert!(!path.exists());
    }
}
