//! Where a store lies: a local folder, or a bucket.

use super::StoreError;
use object_store::aws::AmazonS3Builder;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::prefix::PrefixStore;
use object_store::{BackoffConfig, ObjectStore, RetryConfig};
use rustix::time::{ClockId, clock_gettime};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// A bucket that does not answer is tried again for this long before its failure is shown to people; waiting goes on after.
const RETRY_TIMEOUT: Duration = Duration::from_secs(10);

/// Puts at a time: a disk gains nothing from more than one being written and one being synced; a bucket answers slowly, but
/// many at once.
const PUTS_LOCAL: usize = 2;
const PUTS_BUCKET: usize = 16;

/// Where a store lies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StoreLocation {
    /// A folder of this machine.
    Folder(PathBuf),
    /// `s3://BUCKET/PREFIX`; endpoint, region and keys come from the environment (`AWS_ENDPOINT_URL`, `AWS_REGION`, ..).
    S3(String),
}

impl std::fmt::Display for StoreLocation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Folder(folder) => folder.display().fmt(f),
            Self::S3(url) => f.write_str(url),
        }
    }
}

impl std::str::FromStr for StoreLocation {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once("://") {
            None if text.is_empty() => Err("a store needs a name: DIR or s3://BUCKET/PREFIX".to_owned()),
            None => Ok(Self::Folder(text.into())),
            Some(("s3", rest)) if !rest.trim_matches('/').is_empty() => Ok(Self::S3(text.to_owned())),
            Some(("s3", _)) => Err(format!("{text} names no bucket: write s3://BUCKET/PREFIX")),
            Some((scheme, _)) => {
                Err(format!("{scheme}:// is no place for a store: use DIR or s3://BUCKET/PREFIX"))
            }
        }
    }
}

/// Tells the time that has passed since some moment.
pub type Clock = Arc<dyn Fn() -> Duration + Send + Sync>;

/// Time since the machine started, sleep included.
fn since_start() -> Duration {
    let time = clock_gettime(ClockId::Boottime);
    Duration::new(u64::try_from(time.tv_sec).unwrap_or(0), u32::try_from(time.tv_nsec).unwrap_or(0))
}

/// A store's objects, with all names below its root.
pub(super) struct Objects {
    /// What is put is durable when the put returns.
    pub durable: Arc<dyn ObjectStore>,
    /// The same objects, for what may be lost.
    pub quick: Arc<dyn ObjectStore>,
    /// The folder itself, where there is one.
    pub folder: Option<PathBuf>,
    /// Puts that are worth having under way at the same time.
    pub puts: usize,
    /// Counts while the machine sleeps.
    pub clock: Clock,
}

impl Objects {
    pub fn over(objects: Arc<dyn ObjectStore>, clock: Clock) -> Self {
        Self { durable: objects.clone(), quick: objects, folder: None, puts: PUTS_LOCAL, clock }
    }

    pub fn open(location: &StoreLocation) -> Result<Self, StoreError> {
        let clock: Clock = Arc::new(since_start);
        let unusable = |error: String| StoreError::Unusable { store: location.to_string(), error };
        match location {
            StoreLocation::Folder(folder) => {
                std::fs::create_dir_all(folder).map_err(|err| unusable(err.to_string()))?;
                let local =
                    || LocalFileSystem::new_with_prefix(folder).map_err(|err| unusable(err.to_string()));
                // Without fsync a put may be gone after a power cut, although its file was there.
                let durable = local()?.with_fsync(true).with_automatic_cleanup(true);
                let folder = Some(folder.clone());
                Ok(Self {
                    durable: Arc::new(durable),
                    quick: Arc::new(local()?),
                    folder,
                    puts: PUTS_LOCAL,
                    clock,
                })
            }
            StoreLocation::S3(url) => {
                let bucket = bucket(url).map_err(|err| unusable(err.to_string()))?;
                Ok(Self { durable: bucket.clone(), quick: bucket, folder: None, puts: PUTS_BUCKET, clock })
            }
        }
    }
}

impl Objects {
    /// Removes what former coordinators were writing when they died: a file gets its name when it is whole.
    pub fn sweep(&self) {
        if let Some(folder) = &self.folder {
            sweep(folder);
        }
    }
}

/// Unfinished files are called after the finished one, with `#` and a number behind.
fn sweep(folder: &std::path::Path) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        let name = entry.file_name();
        let suffix = name.to_str().and_then(|name| name.rsplit_once('#')).map(|(_, suffix)| suffix);
        if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            sweep(&path);
        } else if suffix.is_some_and(|suffix| suffix.parse::<u32>().is_ok()) {
            // What cannot be removed is only in the way of the disk.
            let _ = std::fs::remove_file(path);
        }
    }
}

fn bucket(url: &str) -> object_store::Result<Arc<dyn ObjectStore>> {
    // Another part of the program may have chosen one already.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let retry =
        RetryConfig { backoff: BackoffConfig::default(), max_retries: 5, retry_timeout: RETRY_TIMEOUT };
    let bucket = AmazonS3Builder::from_env().with_url(url).with_retry(retry).build()?;
    let rest = url.split_once("://").map_or("", |(_, rest)| rest);
    let prefix = rest.split_once('/').map_or("", |(_, prefix)| prefix);
    Ok(Arc::new(PrefixStore::new(bucket, Path::from(prefix))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_that_are_none_get_a_sentence() {
        let parse = |text: &str| text.parse::<StoreLocation>();
        assert_eq!(parse("/srv/tessera"), Ok(StoreLocation::Folder("/srv/tessera".into())));
        assert_eq!(parse("s3://farm/a/b"), Ok(StoreLocation::S3("s3://farm/a/b".into())));
        for (text, sentence) in
            [("", "needs a name"), ("s3://", "no bucket"), ("ftp://farm", "no place for a store")]
        {
            assert!(parse(text).unwrap_err().contains(sentence), "{text}");
        }
    }
}
