//! Numbers the scheduler decides by, and why they are what they are.

use farm_film::LEAF_SAMPLES;
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

/// Towards the end of a job units shrink, so that each slot gets about this many more and all end together.
const UNITS_LEFT_PER_SLOT: f64 = 4.0;

/// They shrink to this part of the target, not further: shorter ones cost more in messages than an uneven end does.
const SHRINK_MAX: u32 = 16;

/// When all that is open takes the farm no longer than this many units of the target length, nothing waits at a worker any more:
/// by then those that were cut before they began to shrink have ended.
pub(crate) const ENDING_UNITS: u32 = 4;

/// Units of each slot that tell how fast the farm as a whole is.
pub(crate) const UNITS_REMEMBERED: f64 = 4.0;

/// Stands for the round trip until one was measured: a slow local network.
pub(crate) const ROUND_TRIP_GUESS: Duration = Duration::from_millis(10);

/// Time from a result's arrival to the next grant's departure, on a coordinator that is busy.
const HANDLING: Duration = Duration::from_millis(20);

/// Units that wait at a worker, per slot, at most: a millisecond unit still hides a 60 ms round trip, and no more than this
/// dies with the worker.
const PREFETCH_PER_SLOT_MAX: usize = 64;

/// Results per unit of a worker's window that may wait for the store before the worker is held back.
pub(crate) const STORING_PER_WINDOW: usize = 4;

/// Tiles of a job of which it is remembered what they cost; smaller parts of a picture matter little one by one.
pub(crate) const TILES_REMEMBERED: usize = 1 << 16;

/// No tile is believed to cost this many times the mean, or this small a part of it.
pub(crate) const COST_MAX: f64 = 1e4;

/// Weight of a new measurement: about the last five count.
const NEWEST: f64 = 0.3;

/// Render times below this are clock noise.
const SHORTEST_MEASURE: Duration = Duration::from_micros(10);

/// Render times above this are a worker's mistake: no unit is worth a week.
const LONGEST_MEASURE: Duration = Duration::from_secs(7 * 24 * 3600);

/// More than any machine renders at once; a worker that claims more must not empty the queue.
pub(crate) const SLOTS_MAX: u32 = 4096;

/// Open pieces looked at for one that a worker may have. More than this are passed over only when as many units have
/// failed on one worker, which is in quarantine long before.
pub(crate) const PIECES_LOOKED_AT: usize = 64;

/// Slowest units looked at for one that is worth a duplicate.
pub(crate) const SLOWEST_LOOKED_AT: usize = 16;

/// Idle workers for whom such a unit is looked for; if it is worth nothing to these, hardly to others.
pub(crate) const SPECULATORS_LOOKED_AT: usize = 4;

/// When nothing is worth a duplicate now, look again after this.
pub(crate) const SPECULATE_AGAIN: Duration = Duration::from_millis(250);

/// A unit that fails on this many different workers fails its job; or that fails as often when there are fewer.
pub(crate) const FAILURES_MAX: usize = 3;

/// A unit fails its job after this many failures even if some worker has not tried it yet.
pub(crate) const FAILURES_EVER: usize = 9;

/// A unit fails its job when this many workers vanished while they rendered it. Far above chance on machines that are
/// taken away at any time, and low enough that a scene too large for every machine ends.
pub(crate) const LOSSES_MAX: u32 = 12;

/// Failures in a row after which a worker is not trusted.
pub(crate) const STRIKES: usize = 3;

/// Successes in a row after which a worker's past quarantines no longer lengthen the next one.
pub(crate) const SUCCESSES_TO_FORGET: u32 = 32;

/// The first quarantine: a restart or a short outage of a disk is over by then.
const QUARANTINE_FIRST: Duration = Duration::from_secs(10);

/// The longest: a machine that was repaired is back within this.
const QUARANTINE_MAX: Duration = Duration::from_secs(640);

/// After a restart workers come back within this. Before that it is not known who is there to compare results.
pub(crate) const COME_BACK: Duration = Duration::from_secs(10);

/// When the scheduler was not told the time for this much longer than it asked for, the coordinator itself stood still. The
/// silence was its own, so that nobody's lease ends before everybody had the chance to be heard again.
pub(crate) const OVERSLEPT: Duration = Duration::from_secs(1);

/// What differs between farms. The default suits a farm of any size; tests and restarts change parts of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Time a unit should take on the slot that gets it.
    pub target_unit: Duration,
    /// Time without renewal after which a lease ends, and of silence after which a worker is disconnected.
    pub lease_ttl: Duration,
    /// Whether idle workers render the slowest units a second time.
    pub speculate: bool,
    /// Part of the accepted units that is rendered once more by another worker, to compare: 0 for none, 1 for all.
    pub verify: f64,
    /// Decides which units these are; nobody outside may know.
    pub verify_seed: u64,
    /// First lease given out; later ones count upwards. A restarted coordinator starts beyond those of its former life.
    pub first_lease: LeaseId,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            target_unit: TARGET_UNIT,
            lease_ttl: LEASE_TTL,
            speculate: true,
            verify: 0.0,
            verify_seed: 0,
            first_lease: LeaseId(1),
        }
    }
}

/// A measured value smoothed with the one before.
pub(crate) fn smooth(before: Option<f64>, measured: f64) -> f64 {
    before.map_or(measured, |before| before + NEWEST * (measured - before))
}

/// A render time as a worker tells it, within what can be true.
pub(crate) fn plausible(render: Duration) -> Duration {
    render.clamp(SHORTEST_MEASURE, LONGEST_MEASURE)
}

/// Length of the quarantine after `earlier` ones.
pub(crate) fn quarantine(earlier: u32) -> Duration {
    QUARANTINE_FIRST.saturating_mul(1 << earlier.min(16)).min(QUARANTINE_MAX)
}

/// Units a worker may hold, so that a slot that ends one finds the next one waiting: what all slots finish while
/// a message goes there and back. As slots that began together end together, that is at least one per slot; but only one
/// in all when units are long, for then it is better to leave them to others.
pub(crate) fn window(
    slots: u32,
    unit: Option<Duration>,
    round_trip: Option<Duration>,
    target: Duration,
) -> usize {
    let Some(unit) = unit else { return slots as usize * 2 };
    let least = if unit > target * 2 { 1 } else { slots as usize };
    slots as usize + prefetch(slots, unit, round_trip).ceil().max(least as f64) as usize
}

/// The same when so little is left to do that what waits at one worker may be missing at another: only what is begun within a
/// round trip.
pub(crate) fn last_window(slots: u32, unit: Option<Duration>, round_trip: Option<Duration>) -> usize {
    slots as usize + unit.map_or(0.0, |unit| prefetch(slots, unit, round_trip)).round() as usize
}

/// Units that all slots finish while a message goes there and back.
fn prefetch(slots: u32, unit: Duration, round_trip: Option<Duration>) -> f64 {
    let hidden = round_trip.unwrap_or(ROUND_TRIP_GUESS).saturating_add(HANDLING);
    let per_slot = hidden.as_secs_f64() / unit.as_secs_f64().max(1e-6);
    f64::from(slots) * per_slot.min(PREFETCH_PER_SLOT_MAX as f64)
}

/// Samples per pixel of a tile that costs as much as `area` pixels of cost 1, for a slot that renders `speed` pixel samples of
/// cost 1 per second, when the whole farm will be done in `left` seconds. Nothing is known of the speed at first; then a unit is as small as can be.
pub(crate) fn unit_samples(target: Duration, speed: Option<f64>, area: f64, left: Option<f64>) -> u64 {
    let Some(speed) = speed else { return LEAF_SAMPLES };
    let shortest = target / SHRINK_MAX;
    let seconds = left.unwrap_or(f64::INFINITY) / UNITS_LEFT_PER_SLOT;
    let seconds = seconds.clamp(shortest.as_secs_f64(), target.as_secs_f64());
    (speed * seconds / area) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);
    const MILLISECOND: Duration = Duration::from_millis(1);

    #[test]
    fn a_window_hides_the_round_trip() {
        let window = |slots, unit, round_trip| window(slots, Some(unit), Some(round_trip), TARGET_UNIT);
        assert_eq!(window(4, SECOND, MILLISECOND), 8, "one waits for each slot");
        assert_eq!(window(4, SECOND * 10, MILLISECOND), 5, "long units are left to others");
        assert_eq!(window(1, MILLISECOND * 10, MILLISECOND * 80), 11, "ten end in a round trip");
        assert_eq!(window(2, MILLISECOND / 100, SECOND), 2 + 2 * PREFETCH_PER_SLOT_MAX, "bounded");
        let last = |unit, round_trip| last_window(4, Some(unit), Some(round_trip));
        assert_eq!(last(SECOND, MILLISECOND), 4, "in the end nothing waits");
        assert_eq!(last(MILLISECOND * 10, MILLISECOND * 80), 44, "but for what hides the round trip");
    }

    #[test]
    fn a_unit_takes_the_target_time_until_little_is_left() {
        let samples = |speed, left| unit_samples(SECOND, speed, 100.0, left);
        assert_eq!(samples(Some(1e6), None), 10_000);
        assert_eq!(samples(Some(1e6), Some(60.0)), 10_000);
        assert_eq!(samples(Some(1e6), Some(2.0)), 5_000, "two seconds, in four units");
        assert_eq!(samples(Some(1e5), Some(2.0)), 500, "as short a time for a slow worker");
        assert_eq!(samples(Some(1e6), Some(0.0)), 625);
        assert_eq!(samples(None, Some(60.0)), LEAF_SAMPLES);
    }

    #[test]
    fn quarantines_double_up_to_a_limit() {
        assert_eq!([0, 1, 2, 40].map(|earlier| quarantine(earlier).as_secs()), [10, 20, 40, 640]);
    }
}
