//! Time as the scheduler is told it.

use std::time::Duration;

/// Time since the coordinator started. The scheduler reads no clock; whoever calls it does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Timestamp(pub Duration);

impl Timestamp {
    /// The moment the coordinator started.
    pub const START: Self = Self(Duration::ZERO);

    /// This moment and `later`, without overflow.
    pub fn after(self, later: Duration) -> Self {
        Self(self.0.saturating_add(later))
    }

    /// Time from `earlier` to this moment; zero when `earlier` is later.
    pub fn since(self, earlier: Self) -> Duration {
        self.0.saturating_sub(earlier.0)
    }
}
