//! Files that are nobody else's business.

use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// No file of ours is larger.
const FILE_BYTES_MAX: u64 = 1 << 20;

/// What cannot be trusted, and why.
#[derive(Debug, thiserror::Error)]
pub enum TrustError {
    /// A file that cannot be read or written.
    #[error("{}: {error}", path.display())]
    File {
        /// Which one.
        path: PathBuf,
        /// Why not.
        error: std::io::Error,
    },
    /// A secret that others can read.
    #[error("{} can be read by other users of this host: chmod 600 it, and make new ones of what it held", .0.display())]
    Open(PathBuf),
    /// A file that does not hold what it should.
    #[error("{} is damaged: {fault}", path.display())]
    Damaged {
        /// Which one.
        path: PathBuf,
        /// What is wrong.
        fault: String,
    },
    /// A certificate that cannot be made.
    #[error("no certificate can be made: {0}")]
    Certificate(String),
}

impl TrustError {
    pub(crate) fn file(path: &Path, error: std::io::Error) -> Self {
        Self::File { path: path.to_owned(), error }
    }

    pub(crate) fn damaged(path: &Path, fault: impl ToString) -> Self {
        Self::Damaged { path: path.to_owned(), fault: fault.to_string() }
    }

    pub(crate) fn certificate(fault: impl ToString) -> Self {
        Self::Certificate(fault.to_string())
    }
}

/// Makes a folder that only its owner may enter.
pub(crate) fn make_folder(path: &Path) -> Result<(), TrustError> {
    let made = std::fs::DirBuilder::new().recursive(true).mode(0o700).create(path);
    made.map_err(|error| TrustError::file(path, error))
}

/// Writes a file, whole and durable, that only its owner may read.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<(), TrustError> {
    let written = || -> std::io::Result<()> {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        // Temporary files are made with mode 0600.
        let mut file = tempfile::NamedTempFile::new_in(folder)?;
        file.write_all(bytes)?;
        file.as_file().sync_all()?;
        file.persist(path)?;
        File::open(folder)?.sync_all()
    };
    written().map_err(|error| TrustError::file(path, error))
}

/// Reads a file that may be anybody's; none when it is not there.
pub(crate) fn read(path: &Path) -> Result<Option<Vec<u8>>, TrustError> {
    let read = || -> std::io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        File::open(path)?.take(FILE_BYTES_MAX).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    match read() {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(TrustError::file(path, error)),
    }
}

/// Reads a secret; none when it is not there. Refuses one that others could have read.
pub(crate) fn read_secret(path: &Path) -> Result<Option<Vec<u8>>, TrustError> {
    let Ok(meta) = std::fs::metadata(path) else { return read(path) };
    if meta.is_file() && meta.permissions().mode() & 0o077 != 0 {
        return Err(TrustError::Open(path.to_owned()));
    }
    read(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_are_only_their_owners() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("a/b");
        make_folder(&inner).unwrap();
        assert_eq!(std::fs::metadata(&inner).unwrap().permissions().mode() & 0o777, 0o700);
        let path = inner.join("key");
        assert!(read_secret(&path).unwrap().is_none());
        write(&path, b"secret").unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(read_secret(&path).unwrap().unwrap(), b"secret");
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o640)).unwrap();
        assert!(read_secret(&path).unwrap_err().to_string().contains("chmod 600"));
    }
}
