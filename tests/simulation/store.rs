//! A disk that outlives its host, and that fills up, slows down and lies about what it did.

use futures::stream::BoxStream;
use futures::{FutureExt, StreamExt};
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// How a disk behaves at present.
#[derive(Debug, Default)]
pub struct Mood {
    /// Nothing can be put.
    pub full: AtomicBool,
    /// What is put is there, and reported as failed.
    pub denies: AtomicBool,
    /// Milliseconds that a put takes.
    pub delay_ms: AtomicU64,
    /// Something was removed since somebody looked.
    pub removed: AtomicBool,
}

/// Objects in memory, with a mood, as one host sees them.
#[derive(Clone, Debug)]
pub struct Disk {
    pub objects: Arc<InMemory>,
    pub mood: Arc<Mood>,
    /// Whatever this host asks for, and every answer to it, waits.
    pub hangs: Arc<AtomicBool>,
}

impl Disk {
    pub fn new() -> Self {
        Self::holding(InMemory::new())
    }

    /// A disk in a good mood.
    pub fn holding(objects: InMemory) -> Self {
        Self { objects: Arc::new(objects), mood: Arc::default(), hangs: Arc::default() }
    }

    /// The same disk, as another host sees it.
    pub fn elsewhere(&self) -> Self {
        Self { hangs: Arc::default(), ..self.clone() }
    }

    async fn wait(&self) {
        while self.hangs.load(Ordering::Relaxed) {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }
}

impl std::fmt::Display for Disk {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a disk of the simulation")
    }
}

fn failure(what: &str) -> Error {
    Error::Generic { store: "simulation", source: what.to_owned().into() }
}

#[async_trait::async_trait]
impl ObjectStore for Disk {
    async fn put_opts(&self, location: &Path, payload: PutPayload, opts: PutOptions) -> Result<PutResult> {
        tokio::time::sleep(Duration::from_millis(self.mood.delay_ms.load(Ordering::Relaxed))).await;
        if self.mood.full.load(Ordering::Relaxed) {
            return Err(failure("no space left on device"));
        }
        self.wait().await;
        let put = self.objects.put_opts(location, payload, opts).await?;
        self.wait().await;
        if self.mood.denies.load(Ordering::Relaxed) {
            return Err(failure("the reply was lost"));
        }
        Ok(put)
    }

    async fn put_multipart_opts(
        &self,
        location: &Path,
        opts: PutMultipartOptions,
    ) -> Result<Box<dyn MultipartUpload>> {
        self.objects.put_multipart_opts(location, opts).await
    }

    async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
        self.wait().await;
        let got = self.objects.get_opts(location, options).await;
        self.wait().await;
        got
    }

    fn delete_stream(&self, locations: BoxStream<'static, Result<Path>>) -> BoxStream<'static, Result<Path>> {
        let disk = self.clone();
        let begun = async move {
            disk.wait().await;
            disk.mood.removed.store(true, Ordering::Relaxed);
            disk.objects.delete_stream(locations)
        };
        begun.into_stream().flatten().boxed()
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        let (disk, prefix) = (self.clone(), prefix.cloned());
        let begun = async move {
            disk.wait().await;
            disk.objects.list(prefix.as_ref())
        };
        begun.into_stream().flatten().boxed()
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.objects.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.objects.copy_opts(from, to, options).await
    }
}
