//! Single objects.

use super::StoreError;
use bytes::Bytes;
use futures::TryStreamExt;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt, PutMode};

/// Puts an object in place of any of the same name.
pub(super) async fn put(store: &dyn ObjectStore, path: &Path, bytes: Bytes) -> Result<(), StoreError> {
    store.put(path, bytes.into()).await.map_err(|error| StoreError::object(path, &error))?;
    Ok(())
}

/// Puts an object if there is none of its name; whether there was none.
pub(super) async fn create(store: &dyn ObjectStore, path: &Path, bytes: Vec<u8>) -> Result<bool, StoreError> {
    match store.put_opts(path, bytes.into(), PutMode::Create.into()).await {
        Ok(_) => Ok(true),
        Err(object_store::Error::AlreadyExists { .. } | object_store::Error::Precondition { .. }) => {
            Ok(false)
        }
        Err(error) => Err(StoreError::object(path, &error)),
    }
}

/// An object's bytes; none when there is no such object.
pub(super) async fn get(store: &dyn ObjectStore, path: &Path) -> Result<Option<Bytes>, StoreError> {
    let read = async { store.get(path).await?.bytes().await };
    match read.await {
        Ok(bytes) => Ok(Some(bytes)),
        Err(object_store::Error::NotFound { .. }) => Ok(None),
        Err(error) => Err(StoreError::object(path, &error)),
    }
}

/// Names of all objects in a folder and below, sorted, so that nothing depends on the store's order.
pub(super) async fn list(store: &dyn ObjectStore, folder: &Path) -> Result<Vec<Path>, StoreError> {
    let found = store.list(Some(folder)).map_ok(|object| object.location).try_collect::<Vec<_>>().await;
    let mut paths = match found {
        Ok(paths) => paths,
        Err(object_store::Error::NotFound { .. }) => Vec::new(),
        Err(error) => return Err(StoreError::object(folder, &error)),
    };
    paths.sort();
    Ok(paths)
}

/// The innermost error: "no space left on device" rather than what was being tried.
pub(super) fn root_cause(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(source) = cause.source() {
        cause = source;
    }
    cause.to_string()
}
