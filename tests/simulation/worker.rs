//! A host with a worker on it: the real one, but its threads take simulated time, and it may have vices.

use crate::faults::Dice;
use crate::network::{Cable, dialer};
use crate::picture::rendered;
use crate::witness::Sayings;
use farm_film::{FilmTile, LEAF_SAMPLES, SampleBlock, Tile, WorkUnit};
use farm_image::encode_partial;
use farm_job::Digest;
use farm_proto::convert::{Grant, UnitResult};
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

/// A unit over which a worker dawdles takes so many times as long.
const DAWDLING: u32 = 20;

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
    /// Percent of units that it dawdles over.
    pub dawdles: u64,
    /// Whether its results are well-formed and wrong.
    pub lies: bool,
}

impl Character {
    /// What it gets done, on average, while nothing disturbs it.
    pub fn samples_per_second(&self) -> f64 {
        let useful = 1.0 - (self.garbage + self.fails) as f64 / 100.0;
        let dawdling = 1.0 + (DAWDLING - 1) as f64 * self.dawdles as f64 / 100.0;
        self.slots as f64 * useful / (self.pace_ms as f64 / 1000.0 * dawdling) * 1000.0
    }
}

/// The life of a worker, from start to crash. It starts again when it leaves, as a service would.
pub async fn live(
    character: Character,
    seed: u64,
    leave: Arc<Mutex<mpsc::Receiver<()>>>,
    cable: Arc<Cable>,
    sayings: Sayings,
) -> Result<(), WorkerError> {
    loop {
        let (orders, receiver) = mpsc::channel(1);
        let config = Config {
            name: character.name.clone(),
            threads: character.slots,
            pool: maker(character.clone(), seed, sayings.clone()),
            scenes: Arc::new(SceneCache::new(None, None)),
            target: Target::Memory(dialer(cable.clone())),
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
            let time = duration(&character, &assignment.grant.unit)
                * if roll(character.dawdles) { DAWDLING } else { 1 };
            let worked = work(time, &assignment).await;
            if worked < time {
                let finished = part(&assignment.grant, worked.div_duration_f64(time));
                let finished = finished.filter(|_| assignment.stop.is_hand_back() && !character.lies);
                let _ = ended.send(match finished {
                    Some(grant) => Ended::Rendered(Box::new(rendered(&grant))),
                    None => Ended::Stopped(lease),
                });
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

/// Takes time until it is told to stop; how much it was.
async fn work(time: Duration, assignment: &Assignment) -> Duration {
    let step = Duration::from_millis(100);
    let mut worked = Duration::ZERO;
    while worked < time {
        let now = step.min(time - worked);
        tokio::time::sleep(now).await;
        if assignment.stop.is_set() {
            break;
        }
        worked += now;
    }
    worked
}

/// The largest node from the first sample on of which all leaves are finished.
fn part(grant: &Grant, share: f64) -> Option<Grant> {
    let block = grant.unit.block;
    let leaves = block.samples() / LEAF_SAMPLES;
    let finished = (leaves as f64 * share) as u64;
    let samples = LEAF_SAMPLES << finished.checked_ilog2()?;
    let block = SampleBlock::new(block.start()..block.start() + samples).ok()?;
    Some(Grant { unit: WorkUnit { block, ..grant.unit }, ..*grant })
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
        // The last bytes are of pixels, where nothing but the digest tells; a header may say by itself that it is damaged.
        let place = bytes.len() - 30;
        bytes[place] ^= 0x10;
    }
    result.partial_exr = bytes.into();
    result
}
