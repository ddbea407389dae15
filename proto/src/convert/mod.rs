//! Wire types to the farm's own types and back. Everything that comes in is checked here, once.

mod control;
mod job;
mod unit;
mod worker;

pub use control::{JobCounts, JobView, LogView, WatchView, WorkerView};
pub use worker::{FromWorker, Grant, Heartbeat, Hello, ToWorker, UnitResult};

/// A message that says something impossible.
#[derive(Debug, thiserror::Error)]
pub enum ConvertError {
    /// A part that must be there is not.
    #[error("message has no {0}")]
    Missing(&'static str),
    /// A digest of another length than 32 bytes.
    #[error("digest has {0} bytes instead of 32")]
    DigestLength(usize),
    /// A number that stands for no member of a closed family.
    #[error("{value} is no known {family}")]
    Unknown {
        /// Which family.
        family: &'static str,
        /// The number.
        value: i32,
    },
    /// A text too long to be honest.
    #[error("{what} has {len} bytes, more than {max}")]
    TooLong {
        /// Which text.
        what: &'static str,
        /// Its length.
        len: usize,
        /// The limit.
        max: usize,
    },
    /// A number out of its range.
    #[error("{what} is {value}")]
    Number {
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// An impossible rectangle.
    #[error(transparent)]
    Tile(#[from] farm_film::TileError),
    /// An impossible range of samples.
    #[error(transparent)]
    Samples(#[from] farm_film::SampleBlockError),
    /// An impossible job.
    #[error(transparent)]
    Job(#[from] farm_job::JobSpecError),
}

impl From<ConvertError> for tonic::Status {
    fn from(err: ConvertError) -> Self {
        Self::invalid_argument(err.to_string())
    }
}

/// Longest text that is shown to people: names and reasons.
const TEXT_BYTES_MAX: usize = 4096;

fn text(what: &'static str, text: String) -> Result<String, ConvertError> {
    match text.len() {
        len if len > TEXT_BYTES_MAX => Err(ConvertError::TooLong { what, len, max: TEXT_BYTES_MAX }),
        _ => Ok(text),
    }
}

fn seconds(what: &'static str, value: f64) -> Result<std::time::Duration, ConvertError> {
    std::time::Duration::try_from_secs_f64(value).map_err(|_| ConvertError::Number { what, value })
}
