//! Whose turn it is: of all coordinators that know a store, one writes.
//!
//! ```text
//! epochs/<n>.json    created, never replaced, by the coordinator whose turn is the n-th; ends the turn before
//! epochs/<n>.beat    replaced by it every now and then, as a sign of life
//! epochs/<n>.ended   put by it when it leaves of its own accord
//! epochs/<n>.lock    held by it as long as its process lives, where the store is a folder
//! ```
//!
//! A turn is taken by *creating* the next epoch, which one of several can: a conditional put. Clocks decide only when to try.
//! A coordinator whose turn has ended finds the next epoch there: it looks after each put and before it acknowledges
//! anything, and before each put when the last look is not fresh, so that one that slept through its end writes nothing.

use super::StoreError;
use super::location::Objects;
use object_store::path::Path;
use object_store::{ObjectStoreExt, PutPayload};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::watch;
use tracing::{info, warn};

/// How often a coordinator shows that it lives.
const BEAT_EVERY: Duration = Duration::from_secs(1);

/// Without a sign of life for this long a coordinator is taken for dead. Several beats may be late or lost.
const SILENT_AFTER: Duration = Duration::from_secs(8);

/// How often whoever waits for a turn looks: a folder costs nothing, a bucket is paid by request.
const LOOK_EVERY_FOLDER: Duration = Duration::from_millis(100);
const LOOK_EVERY_BUCKET: Duration = Duration::from_secs(1);

/// A turn that was seen to last this long ago need not be looked at before a put.
const FRESH: Duration = Duration::from_secs(1);

/// What to do about another coordinator that lives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Patience {
    /// Give up.
    Leave,
    /// Wait until it is gone.
    StandBy,
}

/// Who has a turn.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Holder {
    host: String,
    process: u32,
}

impl std::fmt::Display for Holder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "process {} on {}", self.process, self.host)
    }
}

/// A coordinator's turn.
pub(super) struct Turn {
    epoch: u64,
    /// When the turn was last seen to last, in nanoseconds of a clock that counts while the machine sleeps.
    seen: AtomicU64,
    /// Who has ended it.
    lost: watch::Sender<Option<String>>,
    _lock: Option<File>,
}

fn name(epoch: u64, what: &str) -> Path {
    // Zeros in front, so that names sort as numbers do.
    Path::from(format!("epochs/{epoch:010}.{what}"))
}

impl Turn {
    /// Takes the next turn, once the coordinator before is gone. Whoever stands by waits for the store, too.
    pub async fn take(objects: &Objects, patience: Patience) -> Result<Self, StoreError> {
        let mut told = None;
        loop {
            let outcome = Self::try_to_take(objects).await;
            let obstacle = match outcome {
                Ok(Some(turn)) => return Ok(turn),
                // Another one was quicker.
                Ok(None) => continue,
                Err(obstacle) => obstacle,
            };
            let may_pass = matches!(obstacle, StoreError::InUse(_) | StoreError::Object { .. });
            if patience == Patience::Leave || !may_pass {
                return Err(obstacle);
            }
            let obstacle = obstacle.to_string();
            if told.as_ref() != Some(&obstacle) {
                info!(%obstacle, "standing by");
                told = Some(obstacle);
            }
            tokio::time::sleep(look_every(objects)).await;
        }
    }

    async fn try_to_take(objects: &Objects) -> Result<Option<Self>, StoreError> {
        let before = latest(objects).await?;
        if let Some(epoch) = before {
            let holder = holder(objects, epoch).await;
            match is_gone(objects, epoch).await? {
                Gone::Yes(why) => info!(epoch, %holder, why, "the coordinator before is gone"),
                Gone::No => return Err(StoreError::InUse(holder)),
            }
        }
        Self::create(objects, before.map_or(1, |before| before + 1)).await
    }

    async fn create(objects: &Objects, epoch: u64) -> Result<Option<Self>, StoreError> {
        let lock = match &objects.folder {
            Some(folder) => match lock(folder, epoch)? {
                Some(lock) => Some(lock),
                None => return Ok(None),
            },
            None => None,
        };
        let host = rustix::system::uname().nodename().to_string_lossy().into_owned();
        let holder = Holder { host, process: std::process::id() };
        let bytes = serde_json::to_vec(&holder).expect("plain data serialises");
        if !super::create(&*objects.durable, &name(epoch, "json"), bytes.clone()).await? {
            return Ok(None);
        }
        // A server that takes no notice of the condition would let everybody in.
        if super::create(&*objects.durable, &name(epoch, "json"), bytes).await? {
            let error = "it does not honour If-None-Match, so that two coordinators could not be kept apart";
            return Err(StoreError::Unusable { store: objects.durable.to_string(), error: error.to_owned() });
        }
        info!(epoch, "the store is ours");
        let (lost, _) = watch::channel(None);
        Ok(Some(Self { epoch, seen: AtomicU64::new(0), lost, _lock: lock }))
    }

    /// The number of the turn.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Says who has ended the turn.
    pub fn lost(&self) -> watch::Receiver<Option<String>> {
        self.lost.subscribe()
    }

    /// Whether the turn lasts, as of a moment ago.
    pub async fn check(&self, objects: &Objects) -> Result<(), StoreError> {
        let seen = Duration::from_nanos(self.seen.load(Ordering::Relaxed));
        if (objects.clock)().saturating_sub(seen) < FRESH && self.lost.borrow().is_none() {
            return Ok(());
        }
        self.confirm(objects).await
    }

    /// Whether the turn lasts still.
    pub async fn confirm(&self, objects: &Objects) -> Result<(), StoreError> {
        let (looked, next) = ((objects.clock)(), self.epoch + 1);
        let path = name(next, "json");
        match objects.durable.head(&path).await {
            Err(object_store::Error::NotFound { .. }) => {
                self.seen.fetch_max(looked.as_nanos() as u64, Ordering::Relaxed);
                Ok(())
            }
            Ok(_) => {
                let by = holder(objects, next).await;
                self.lost.send_if_modified(|lost| lost.replace(by.clone()).is_none());
                Err(StoreError::TurnOver(by))
            }
            Err(error) => Err(StoreError::object(&path, &error)),
        }
    }

    /// Shows that this coordinator lives, and looks whether it is still wanted. Never ends of itself.
    pub async fn beat(&self, objects: &Objects) {
        let mut beats = tokio::time::interval(BEAT_EVERY);
        beats.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        for beat in 0u64.. {
            beats.tick().await;
            // What a put would find out is found out here while there are none.
            let _ = self.confirm(objects).await;
            let payload = PutPayload::from(beat.to_string());
            if let Err(error) = objects.quick.put(&name(self.epoch, "beat"), payload).await {
                warn!(error = super::root_cause(&error), "no sign of life can be given");
            }
        }
    }

    /// Leaves the store to whoever comes next.
    pub async fn end(&self, objects: &Objects) {
        let _ = objects.durable.put(&name(self.epoch, "ended"), PutPayload::new()).await;
    }

    /// Removes what former turns left behind, except that they were.
    pub async fn tidy(&self, objects: &Objects) {
        for path in super::list(&*objects.durable, &Path::from("epochs")).await.unwrap_or_default() {
            let former = epoch_of(&path).is_some_and(|epoch| epoch < self.epoch);
            if former && path.extension() != Some("json") {
                let _ = objects.quick.delete(&path).await;
            }
        }
    }
}

fn look_every(objects: &Objects) -> Duration {
    if objects.folder.is_some() { LOOK_EVERY_FOLDER } else { LOOK_EVERY_BUCKET }
}

enum Gone {
    Yes(&'static str),
    No,
}

/// Whether the coordinator of a turn is gone, as soon as it can be told.
async fn is_gone(objects: &Objects, epoch: u64) -> Result<Gone, StoreError> {
    let (shown, since) = (beat_of(objects, epoch).await?, (objects.clock)());
    loop {
        let ended = objects.durable.head(&name(epoch, "ended")).await;
        if ended.is_ok() {
            return Ok(Gone::Yes("it has ended"));
        }
        if let Some(folder) = &objects.folder
            && lock(folder, epoch)?.is_some()
        {
            return Ok(Gone::Yes("its process is dead"));
        }
        if latest(objects).await? != Some(epoch) {
            return Ok(Gone::No);
        }
        tokio::time::sleep(look_every(objects)).await;
        if beat_of(objects, epoch).await? != shown {
            return Ok(Gone::No);
        }
        if (objects.clock)().saturating_sub(since) > SILENT_AFTER {
            return Ok(Gone::Yes("it gives no sign of life"));
        }
    }
}

/// Takes the lock of a turn; none when a process has it.
fn lock(folder: &std::path::Path, epoch: u64) -> Result<Option<File>, StoreError> {
    let path = folder.join(name(epoch, "lock").as_ref());
    let unusable = |error: std::io::Error| StoreError::Object {
        path: path.display().to_string(),
        error: error.to_string(),
    };
    std::fs::create_dir_all(folder.join("epochs")).map_err(unusable)?;
    let file = File::create(&path).map_err(unusable)?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(std::fs::TryLockError::WouldBlock) => Ok(None),
        Err(std::fs::TryLockError::Error(error)) => Err(unusable(error)),
    }
}

fn epoch_of(path: &Path) -> Option<u64> {
    path.filename()?.split_once('.')?.0.parse().ok()
}

/// The latest turn that was taken.
async fn latest(objects: &Objects) -> Result<Option<u64>, StoreError> {
    let paths = super::list(&*objects.durable, &Path::from("epochs")).await?;
    Ok(paths.iter().filter(|path| path.extension() == Some("json")).filter_map(epoch_of).max())
}

async fn beat_of(objects: &Objects, epoch: u64) -> Result<Option<Vec<u8>>, StoreError> {
    super::get(&*objects.durable, &name(epoch, "beat")).await.map(|beat| beat.map(|beat| beat.to_vec()))
}

/// For people: whoever it is.
async fn holder(objects: &Objects, epoch: u64) -> String {
    let bytes = super::get(&*objects.durable, &name(epoch, "json")).await.ok().flatten();
    let holder = bytes.and_then(|bytes| serde_json::from_slice::<Holder>(&bytes).ok());
    holder.map_or_else(|| "someone unknown".to_owned(), |holder| holder.to_string())
}
