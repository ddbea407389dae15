//! When frames that end at a time were begun, in the store: a restart does not begin their time anew.

use super::objects::list;
use super::{Store, StoreError, job_path};
use farm_film::FrameIndex;
use farm_job::JobId;
use object_store::path::Path;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// `jobs/<id>/begun/<frame>.json`.
#[derive(Serialize, Deserialize)]
struct StoredBegin {
    /// Milliseconds since 1970-01-01, UTC.
    begun: u64,
}

fn folder(job: JobId) -> Path {
    job_path(job).join("begun")
}

impl Store {
    /// Keeps when a frame was begun, in place of what was known of it.
    pub async fn put_begun(
        &self,
        job: JobId,
        frame: FrameIndex,
        begun: SystemTime,
    ) -> Result<(), StoreError> {
        let since = begun.duration_since(UNIX_EPOCH).unwrap_or_default().as_millis();
        let stored = StoredBegin { begun: u64::try_from(since).unwrap_or(u64::MAX) };
        let json = serde_json::to_vec(&stored).expect("plain data serialises");
        self.keep(&folder(job).join(format!("{frame}.json")), json).await
    }

    /// When frames of a job were begun, as far as that was kept.
    pub async fn begun(&self, job: JobId) -> Result<BTreeMap<FrameIndex, SystemTime>, StoreError> {
        let mut found = BTreeMap::new();
        for path in list(&*self.objects.durable, &folder(job)).await? {
            let frame = path.filename().and_then(|name| name.strip_suffix(".json")?.parse().ok());
            let Some(frame) = frame.map(FrameIndex) else { continue };
            let stored: Option<StoredBegin> = self.read_json(&path).await?;
            let begun = stored.and_then(|stored| UNIX_EPOCH.checked_add(Duration::from_millis(stored.begun)));
            found.extend(begun.map(|begun| (frame, begun)));
        }
        Ok(found)
    }
}
