//! Numbers the scheduler decides by, and why they are what they are.

use farm_job::LeaseId;
use std::time::Duration;

/// How often a worker should send a heartbeat: three of them may be lost before a lease ends.
pub const HEARTBEAT: Duration = Duration::from_secs(1);

/// A lease that no heartbeat has renewed for this long is open again, and a worker silent for this long is
/// disconnected: a dead worker costs a frame at most this.
pub const LEASE_TTL: Duration = Duration::from_secs(4);

/// Time a unit should take: long enough that messages and the store cost nothing beside it, short enough that the last
/// ones of a frame, and what dies with a worker, are soon done again.
pub const TARGET_UNIT: Duration = Duration::from_millis(1500);

/// What differs between farms. The default suits a farm of any size; tests and restarts change parts of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Time a unit should take on the slot that gets it.
    pub target_unit: Duration,
    /// Time without renewal after which a lease ends, and of silence after which a worker is disconnected.
    pub lease_ttl: Duration,
    /// Whether idle workers render the slowest units a second time.
    pub speculate: bool,
    /// First lease given out; later ones count upwards. A restarted coordinator starts beyond those of its former life.
    pub first_lease: LeaseId,
}

impl Default for Config {
    fn default() -> Self {
        Self { target_unit: TARGET_UNIT, lease_ttl: LEASE_TTL, speculate: true, first_lease: LeaseId(1) }
    }
}
