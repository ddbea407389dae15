//! What goes wrong, and when: made up from a seed.

use crate::worker::Character;
use std::time::Duration;

/// Chance from a seed: SplitMix64.
#[derive(Debug)]
pub struct Dice(u64);

impl Dice {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub fn roll(&mut self, sides: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) % sides
    }

    pub fn percent(&mut self, chance: u64) -> bool {
        self.roll(100) < chance
    }

    fn millis(&mut self, up_to: u64) -> Duration {
        Duration::from_millis(self.roll(up_to))
    }
}

/// What goes wrong. Workers are numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// A worker's host dies, and comes back after a while.
    WorkerDies(usize, Duration),
    /// A worker is told to leave, and starts again.
    WorkerLeaves(usize),
    /// A coordinator's host dies, and comes back.
    CoordinatorDies(usize, Duration),
    /// A coordinator's disk does not answer, so that it may be given up for dead, and goes on where it was.
    CoordinatorHangs(usize, Duration),
    /// Nothing passes between a worker and the coordinator.
    Partition(usize, Duration),
    /// Nothing passes from a worker to the coordinator.
    Deaf(usize, Duration),
    /// Nothing passes from the coordinator to a worker.
    Mute(usize, Duration),
    /// Everything between a worker and the coordinator is held back, and comes all at once.
    Hold(usize, Duration),
    /// Connections of a worker break in the middle of messages.
    LooseCable(usize, Duration),
    /// A line becomes slow.
    Slow(usize, Duration),
    /// Nothing can be stored.
    StoreFull(Duration),
    /// What is stored takes its time.
    StoreSlow(Duration),
    /// What is stored is reported as failed nevertheless.
    StoreDenies(Duration),
    /// The coordinator's clock jumps ahead, as after a sleep.
    ClockJumps(Duration),
    /// Nothing is wrong, but somebody looks whether the store holds all that was acknowledged.
    Audit,
}

/// One farm's fate.
#[derive(Debug)]
pub struct Plan {
    pub workers: Vec<Character>,
    pub verify: f64,
    /// Whether there is somebody who notes what is acknowledged, and repeats what the workers say.
    pub witness: bool,
    /// Whether the store is a bucket, where a coordinator that died is missed only after a while.
    pub bucket: bool,
    /// Coordinators that know the store; all but one stand by.
    pub coordinators: usize,
    /// By the moment at which they begin.
    pub faults: Vec<(Duration, Fault)>,
    /// Longest time of a message on its way.
    pub latency_max: Duration,
}

/// Longest waits of a farm in which nothing goes wrong any more.
const QUARANTINES: Duration = Duration::from_secs(400);

/// Faults begin within this time.
pub const TROUBLE: Duration = Duration::from_secs(20);

impl Plan {
    pub fn new(dice: &mut Dice) -> Self {
        let count = 2 + dice.roll(4) as usize;
        // One who lies can only be told from two others.
        let liar = (count >= 4 && dice.percent(40)).then(|| dice.roll(count as u64) as usize);
        let workers = (0..count).map(|index| character(dice, index, liar == Some(index))).collect();
        let verify = match liar {
            Some(_) => 1.0,
            None if dice.percent(30) => 0.3,
            None => 0.0,
        };
        // What a liar says must not come from two.
        let witness = liar.is_none() && dice.percent(60);
        let bucket = dice.percent(30);
        let coordinators = if dice.percent(40) { 2 } else { 1 };
        let hosts = Hosts { workers: count as u64, coordinators: coordinators as u64 };
        let mut faults: Vec<_> = (0..dice.roll(12))
            .map(|_| (dice.millis(TROUBLE.as_millis() as u64), fault(dice, hosts)))
            .collect();
        faults.sort_by_key(|(at, _)| *at);
        Self {
            workers,
            verify,
            witness,
            bucket,
            coordinators,
            faults,
            latency_max: Duration::from_millis(2 + dice.roll(100)),
        }
    }

    /// Once nothing goes wrong any more everything is done within this: the longest waits, which are quarantines that were
    /// doubled, and twice what the honest workers need for all of it.
    pub fn bound(&self, samples: u64) -> Duration {
        let honest = self.workers.iter().filter(|worker| !worker.lies);
        let speed: f64 = honest.map(Character::samples_per_second).sum();
        QUARANTINES + Duration::from_secs_f64(2.0 * samples as f64 * (1.0 + self.verify) / speed)
    }
}

fn character(dice: &mut Dice, index: usize, lies: bool) -> Character {
    let (garbage, fails, dawdles) = (vice(dice, 25, 30), vice(dice, 25, 20), vice(dice, 30, 30));
    Character {
        name: format!("worker-{index}"),
        slots: 1 + dice.roll(3) as usize,
        pace_ms: 300 + dice.roll(2500),
        garbage,
        fails,
        dawdles,
        lies,
    }
}

fn vice(dice: &mut Dice, chance: u64, most: u64) -> u64 {
    if dice.percent(chance) { dice.roll(most) } else { 0 }
}

#[derive(Clone, Copy)]
struct Hosts {
    workers: u64,
    coordinators: u64,
}

fn fault(dice: &mut Dice, hosts: Hosts) -> Fault {
    let (worker, coordinator) = (dice.roll(hosts.workers) as usize, dice.roll(hosts.coordinators) as usize);
    let (short, long) = (dice.millis(4_000), dice.millis(15_000));
    match dice.roll(18) {
        0 | 1 => Fault::WorkerDies(worker, short),
        2 => Fault::WorkerLeaves(worker),
        3 | 4 => Fault::CoordinatorDies(coordinator, short),
        15 => Fault::CoordinatorHangs(coordinator, long),
        16 => Fault::LooseCable(worker, long),
        5 => Fault::Partition(worker, long),
        6 => Fault::Deaf(worker, long),
        7 => Fault::Mute(worker, long),
        8 => Fault::Hold(worker, short),
        9 => Fault::Slow(worker, long),
        10 => Fault::StoreFull(short),
        11 => Fault::StoreSlow(long),
        12 => Fault::StoreDenies(short),
        13 | 14 => Fault::Audit,
        _ => Fault::ClockJumps(Duration::from_secs(2) + long),
    }
}
