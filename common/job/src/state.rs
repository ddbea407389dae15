//! How far a job is.

use serde::{Deserialize, Serialize};

/// Where a job is in its life.
///
/// ```text
/// Running <-> Paused
///    |-> Done          every frame is complete
///    |-> Failed        a unit cannot be rendered; requeue returns it to Running
///    `-> Cancelled     by its owner
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// Its units are given to workers, or wait for one.
    Running,
    /// Nothing more is given out; what is out is still accepted.
    Paused,
    /// Every frame is complete.
    Done,
    /// Given up, with a reason.
    Failed,
    /// Given up because its owner said so.
    Cancelled,
}

impl JobState {
    /// Whether nothing more will happen to the job by itself.
    pub fn is_final(self) -> bool {
        match self {
            Self::Running | Self::Paused => false,
            Self::Done | Self::Failed | Self::Cancelled => true,
        }
    }
}

impl std::fmt::Display for JobState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Running => "running",
            Self::Paused => "paused",
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        })
    }
}
