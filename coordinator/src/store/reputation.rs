//! What is known of workers, in the store.

use super::objects::list;
use super::{Store, StoreError};
use farm_scheduler::{Quarantined, Reputation};
use object_store::path::Path;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// `workers/<epoch>-<n>.json`; the latest counts.
#[derive(Serialize, Deserialize)]
struct StoredReputation {
    distrusted: BTreeSet<String>,
    quarantined: Vec<StoredQuarantine>,
}

#[derive(Serialize, Deserialize)]
struct StoredQuarantine {
    name: String,
    times: u32,
    /// Milliseconds since 1970-01-01, UTC.
    until: u64,
}

fn now() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}

impl Store {
    /// Keeps what is known of workers, in place of what was.
    pub async fn put_reputation(&self, reputation: &Reputation) -> Result<(), StoreError> {
        let folder = Path::from("workers");
        let former = list(&*self.objects.durable, &folder).await?;
        let quarantined = reputation.quarantined.iter().map(|Quarantined { name, times, left }| {
            let until = now().saturating_add(*left).as_millis();
            StoredQuarantine {
                name: name.clone(),
                times: *times,
                until: u64::try_from(until).unwrap_or(u64::MAX),
            }
        });
        let stored = StoredReputation {
            distrusted: reputation.distrusted.clone(),
            quarantined: quarantined.collect(),
        };
        let json = serde_json::to_vec_pretty(&stored).expect("plain data serialises");
        self.keep(&folder.join(self.fresh_name("json")), json).await?;
        self.remove(former).await;
        Ok(())
    }

    /// What is known of workers.
    pub async fn reputation(&self) -> Result<Reputation, StoreError> {
        let paths = list(&*self.objects.durable, &Path::from("workers")).await?;
        let Some(latest) = paths.last() else { return Ok(Reputation::default()) };
        let Some(StoredReputation { distrusted, quarantined }) = self.read_json(latest).await? else {
            return Ok(Reputation::default());
        };
        let quarantined = quarantined.into_iter().map(|StoredQuarantine { name, times, until }| {
            Quarantined { name, times, left: Duration::from_millis(until).saturating_sub(now()) }
        });
        Ok(Reputation { distrusted, quarantined: quarantined.collect() })
    }
}
