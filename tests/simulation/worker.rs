//! A host with a worker on it: the real one, but its threads take simulated time, and it may have vices.

use crate::faults::Dice;
use crate::network::dialer;
use crate::picture::rendered;
use crate::witness::Sayings;
use farm_film::{FilmTile, Tile, WorkUnit};
use farm_image::encode_partial;
use farm_job::Digest;
use farm_proto::convert::UnitResult;
use farm_worker::driver::{Config, Left, Order, WorkerError, run};
use farm_worker::link::Target;
use farm_worker::render_pool::{Assignment, Ended, MakePool, Pool};
use farm_worker::scene_cache::SceneCache;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::Semaphore;
use tokio::sync::mpsc::{self, UnboundedSender};

/// A worker that is told to leave has this long.
const GRACE: Duration = Duration::from_secs(2);

/// What a worker is like.
#[derive(Clone, Debug)]
pub struct Character {
    pub name: String,
    pub slots: usize,
    /// Milliseconds for a thousand samples on one slot.
    pub pace_ms: u64,
    /// Percent of its results that are damaged, malformed or of something else.
    pub garbage: u64,
    /// Percent of units that it cannot render.
    pub fails: u64,
    /// Percent of units that take twenty times as long.
    pub dawdles: u64,
    /// Whether its results are well-formed and wrong.
    pub lies: bool,
}

/// The life of a worker, from start to crash. It starts again when it leaves, as a service would.
pub async fn live(
    character: Character,
    seed: u64,
    leave: Arc<Mutex<mpsc::Receiver<()>>>,
    sayings: Sayings,
) -> Result<(), WorkerError> {
    loop {
        let (orders, receiver) = mpsc::channel(1);
        let config = Config {
            name: character.name.clone(),
            threads: character.slots,
            pool: maker(character.clone(), seed, sayings.clone()),
            scenes: Arc::new(SceneCache::new(None, None)),
            target: Target::Memory(dialer()),
            retry_for: Duration::from_secs(3600),
        };
        let mut worker = std::pin::pin!(run(config, receiver));
        let left = loop {
            tokio::select! {
                biased;
                left = &mut worker => break left?,
                () = tokio::time::sleep(Duration::from_millis(500)) => {}
            }
            if leave.lock().expect("nothing panics in here").try_recv().is_ok() {
                // One order is enough.
                let _ = orders.try_send(Order::Drain(GRACE));
            }
        };
        match left {
            Left::Farewell(_) => return Ok(()),
            Left::Drained | Left::Late | Left::AtOnce => tokio::time::sleep(Duration::from_secs(1)).await,
        }
    }
}

fn maker(character: Character, seed: u64, sayings: Sayings) -> MakePool {
    Arc::new(move |slots, ended| {
        let dice = Arc::new(Mutex::new(Dice::new(seed)));
        let (character, slots) = (character.clone(), Arc::new(Semaphore::new(slots)));
        Ok(Box::new(TimedPool { character, dice, slots, ended, sayings: sayings.clone() }))
    })
}

/// Slots that take simulated time.
struct TimedPool {
    character: Character,
    dice: Arc<Mutex<Dice>>,
    slots: Arc<Semaphore>,
    ended: UnboundedSender<Ended>,
    sayings: Sayings,
}

impl Pool for TimedPool {
    fn push(&self, assignment: Assignment) {
        let (slots, ended) = (self.slots.clone(), self.ended.clone());
        let (character, dice, sayings) = (self.character.clone(), self.dice.clone(), self.sayings.clone());
        tokio::spawn(async move {
            let _slot = slots.acquire_owned().await;
            let mut roll = |chance: u64| dice.lock().expect("nothing panics in here").percent(chance);
            let lease = assignment.grant.lease;
            let time =
                duration(&character, &assignment.grant.unit) * if roll(character.dawdles) { 20 } else { 1 };
            if !slept(time, &assignment).await {
                let _ = ended.send(Ended::Stopped(lease));
            } else if roll(character.fails) {
                let _ = ended.send(Ended::Failed(lease, "the simulation says so".to_owned()));
            } else {
                let mut result = UnitResult { render: time, ..rendered(&assignment.grant) };
                if character.lies {
                    result = forged(&assignment, result.unit, result.unit, 7.0);
                } else if roll(character.garbage) {
                    result = garbage(&assignment, result, &mut roll);
                }
                sayings.lock().expect("nothing panics in here").push(result.clone());
                let _ = ended.send(Ended::Rendered(Box::new(result)));
            }
        });
    }
}

fn duration(character: &Character, unit: &WorkUnit) -> Duration {
    let samples = unit.tile.area() as u64 * unit.block.samples();
    Duration::from_micros(samples * character.pace_ms)
}

/// Whether the time passed without a word to stop.
async fn slept(time: Duration, assignment: &Assignment) -> bool {
    let step = Duration::from_millis(100);
    let mut left = time;
    while !left.is_zero() {
        let now = left.min(step);
        tokio::time::sleep(now).await;
        if assignment.stop.is_set() {
            return false;
        }
        left -= now;
    }
    true
}

/// A well-formed result that says whatever it is told to say.
fn forged(assignment: &Assignment, says: WorkUnit, holds: WorkUnit, value: f32) -> UnitResult {
    let tile = FilmTile::new(holds.tile, holds.block, vec![[value; 3]; holds.tile.area()]);
    let header = assignment.frame.header.clone();
    let partial_exr = bytes::Bytes::from(encode_partial(&tile, &header));
    UnitResult {
        lease: assignment.grant.lease,
        job: assignment.grant.job,
        unit: says,
        digest: Digest(*blake3::hash(&partial_exr).as_bytes()),
        partial_exr,
        render: Duration::from_millis(50),
        cpu: Duration::from_millis(50),
        counters: header.counters,
    }
}

/// Something that is no result, in one of several ways.
fn garbage(
    assignment: &Assignment,
    mut result: UnitResult,
    roll: &mut impl FnMut(u64) -> bool,
) -> UnitResult {
    let unit = result.unit;
    let elsewhere = WorkUnit { tile: Tile::new(0, 0, 4, 4).expect("a tile"), ..unit };
    if roll(20) {
        return forged(assignment, unit, unit, f32::NAN);
    }
    if roll(25) {
        return forged(assignment, unit, elsewhere, 1.0);
    }
    if roll(33) {
        return forged(assignment, elsewhere, elsewhere, 1.0);
    }
    let mut bytes = result.partial_exr.to_vec();
    if roll(50) {
        bytes.truncate(bytes.len() / 2);
        result.digest = Digest(*blake3::hash(&bytes).as_bytes());
    } else {
        let middle = bytes.len() / 2;
        bytes[middle] ^= 0x10;
    }
    result.partial_exr = bytes.into();
    result
}
