//! A disk that outlives its host, and that fills up, slows down and lies about what it did.

use futures::stream::BoxStream;
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
}

/// Objects in memory, with a mood.
#[derive(Clone, Debug)]
pub struct Disk {
    pub objects: Arc<InMemory>,
    pub mood: Arc<Mood>,
}

impl Disk {
    pub fn new() -> Self {
        Self::holding(InMemory::new())
    }

    /// A disk in a good mood.
    pub fn holding(objects: InMemory) -> Self {
        Self { objects: Arc::new(objects), mood: Arc::default() }
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
        let put = self.objects.put_opts(location, payload, opts).await?;
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
        self.objects.get_opts(location, options).await
    }

    fn delete_stream(&self, locations: BoxStream<'static, Result<Path>>) -> BoxStream<'static, Result<Path>> {
        self.objects.delete_stream(locations)
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        self.objects.list(prefix)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.objects.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.objects.copy_opts(from, to, options).await
    }
}
