//! What can be wrong with a picture or with the place it should go to.

use std::path::{Path, PathBuf};

/// A picture that cannot be read, written or compared.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// Bytes that are no EXR, or one that is damaged or of an unsupported kind.
    #[error("not a readable EXR: {0}")]
    Exr(String),
    /// An EXR, but not the result of a work unit.
    #[error("not a partial EXR: {0}")]
    Partial(String),
    /// More pixels than the caller allows.
    #[error("{pixels} pixels are more than the {allowed} that are allowed here")]
    TooLarge {
        /// Pixels announced by the picture's header.
        pixels: u64,
        /// The caller's limit.
        allowed: u64,
    },
    /// A file that cannot be read, or whose content is at fault.
    #[error("cannot read {}: {fault}", path.display())]
    Read {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        fault: String,
    },
    /// A file that cannot be written; nothing was left under its name.
    #[error("cannot write {}: {fault}", path.display())]
    Write {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        fault: String,
    },
    /// Two pictures that cannot be compared pixel by pixel.
    #[error("a picture of {picture} pixels cannot be compared with a reference of {reference}")]
    Resolutions {
        /// Of the picture.
        picture: farm_film::Resolution,
        /// Of the reference.
        reference: farm_film::Resolution,
    },
    /// A picture with values that make every mean meaningless.
    #[error("the {which} has {count} pixels that are not finite, the first at ({x}, {y})")]
    NotFinite {
        /// `picture` or `reference`.
        which: &'static str,
        /// How many pixels.
        count: usize,
        /// Column of the first.
        x: usize,
        /// Row of the first.
        y: usize,
    },
}

impl ImageError {
    pub(crate) fn write(path: &Path, fault: impl ToString) -> Self {
        Self::Write { path: path.to_owned(), fault: fault.to_string() }
    }
}

impl From<exr::error::Error> for ImageError {
    fn from(err: exr::error::Error) -> Self {
        Self::Exr(err.to_string())
    }
}

/// Runs a decoder on bytes of unknown origin. The EXR library computes sizes from header fields before it has checked all of
/// them; should it ever panic over that, the fault stays here and becomes an error like any other.
pub(crate) fn guarded<T>(decode: impl FnOnce() -> Result<T, ImageError>) -> Result<T, ImageError> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(decode))
        .unwrap_or_else(|_| Err(ImageError::Exr("its header contradicts itself".to_owned())))
}
