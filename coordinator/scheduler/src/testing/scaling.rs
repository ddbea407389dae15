//! How well a farm uses workers of different speeds, in virtual time: every message takes a moment on the wire, a result another
//! on its way to the store, and rendering takes what the tile costs on that worker, a tenth more or less.

use super::{honest, spec};
use crate::{Action, Config, Delivery, Event, Scheduler, Timestamp, Verdict};
use farm_film::{Tile, WorkUnit};
use farm_job::{JobId, LeaseId, WorkerId};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// A message from one side to the other.
const WIRE: Duration = Duration::from_millis(1);

/// From a result's arrival until it is durable.
const STORE: Duration = Duration::from_millis(20);

/// Time of the frame if everybody were busy with something useful all the time.
const FRAME: f64 = 60.0;

const SIDE: u32 = 32;

/// What tiles cost, one is the mean.
const COSTS: [f64; 6] = [0.5, 1.0, 2.0, 0.75, 1.25, 0.5];

#[derive(Clone, Copy)]
struct Held {
    lease: LeaseId,
    unit: WorkUnit,
}

/// What happens when its time comes.
enum Happening {
    Granted(WorkerId, Held),
    Revoked(WorkerId, LeaseId),
    /// Void if the worker was told to stop before.
    Rendered(WorkerId, LeaseId),
    Delivered(Delivery, Duration),
    Stored(Delivery, Duration),
    Heartbeat(WorkerId),
}

#[derive(Default)]
struct SimWorker {
    speed: f64,
    /// The first is being rendered.
    held: VecDeque<Held>,
    begun: Timestamp,
    /// When it last stopped doing something.
    busy_until: Timestamp,
}

/// What came of it.
struct Outcome {
    /// Part of the time in which the farm did something useful.
    efficiency: f64,
    /// From the first worker without work to the end, as a part of the frame.
    tail: f64,
}

struct World {
    now: Timestamp,
    scheduler: Scheduler,
    /// By when, in the order in which they were caused.
    ahead: BTreeMap<(Timestamp, u64), Happening>,
    caused: u64,
    workers: BTreeMap<WorkerId, SimWorker>,
    /// Seconds per pixel sample of cost one on a worker of speed one.
    pace: f64,
    done: bool,
    /// Units by when they were first there, and what they took of a worker of speed one.
    rendered: BTreeMap<WorkUnit, (Timestamp, f64)>,
}

fn cost(tile: Tile) -> f64 {
    COSTS[(tile.x0() / SIDE * 5 + tile.y0() / SIDE * 3) as usize % COSTS.len()]
}

/// 0.9 to 1.1: what samples of a unit cost beside others of its tile.
fn chance(unit: &WorkUnit) -> f64 {
    let name = honest(unit).0.into_iter().fold(0u8, |name, byte| name.wrapping_mul(31).wrapping_add(byte));
    0.9 + 0.2 * f64::from(name) / 255.0
}

fn render(speeds: &[f64], width: u32, height: u32, spp: u64) -> Outcome {
    let job = spec(width, height, SIDE, spp, "0");
    let capacity: f64 = speeds.iter().sum();
    let tiles = job.resolution().expect("a good job").tiles(SIDE);
    let work: f64 = tiles.map(|tile| cost(tile) * tile.area() as f64).sum::<f64>() * spp as f64;
    let mut world = World {
        now: Timestamp::START,
        scheduler: Scheduler::new(Config::default()),
        ahead: BTreeMap::new(),
        caused: 0,
        workers: BTreeMap::new(),
        pace: FRAME * capacity / work,
        done: false,
        rendered: BTreeMap::new(),
    };
    let (finished, durable) = Default::default();
    world.tell(Event::JobSubmitted {
        job: JobId(0),
        spec: Box::new(job),
        finished,
        durable,
        origins: Vec::new(),
    });
    for (id, &speed) in (1..).map(WorkerId).zip(speeds) {
        world.workers.insert(id, SimWorker { speed, ..SimWorker::default() });
        world.tell(Event::WorkerJoined { worker: id, name: id.to_string(), slots: 1 });
        world.cause(Duration::from_millis(10 * id.0), Happening::Heartbeat(id));
    }
    world.run();
    let end = world.rendered.values().map(|(when, _)| *when).max().expect("something was rendered");
    let busy_until = |worker: &SimWorker| if worker.held.is_empty() { worker.busy_until } else { end };
    let first_idle = world.workers.values().map(busy_until).min().expect("there are workers");
    let useful: f64 = world.rendered.values().map(|(_, work)| work).sum();
    let (end_s, tail_s) = (end.0.as_secs_f64(), end.since(first_idle).as_secs_f64());
    Outcome { efficiency: useful / capacity / end_s, tail: tail_s / end_s }
}

impl World {
    fn cause(&mut self, after: Duration, what: Happening) {
        self.caused += 1;
        self.ahead.insert((self.now.after(after), self.caused), what);
    }

    fn run(&mut self) {
        while !self.done {
            let next = self.ahead.first_key_value().map(|((when, _), _)| *when);
            match self.scheduler.next_deadline() {
                Some(due) if next.is_none_or(|next| due < next) => {
                    self.now = self.now.max(due);
                    self.tell(Event::Tick);
                }
                _ => {
                    let ((when, _), what) = self.ahead.pop_first().expect("something happens");
                    self.now = when;
                    self.happen(what);
                }
            }
        }
    }

    fn tell(&mut self, event: Event) {
        self.scheduler.handle(self.now, event);
        self.perform();
    }

    fn perform(&mut self) {
        while let Some(action) = self.scheduler.poll_action() {
            match action {
                Action::Grant { worker, lease, unit, .. } => {
                    self.cause(WIRE, Happening::Granted(worker, Held { lease, unit }));
                }
                Action::Revoke { worker, lease } => self.cause(WIRE, Happening::Revoked(worker, lease)),
                Action::JobDone { .. } => self.done = true,
                Action::RoundComplete { .. } | Action::FrameComplete { .. } => {}
                unexpected => panic!("nothing goes wrong here: {unexpected:?}"),
            }
        }
    }

    fn happen(&mut self, what: Happening) {
        match what {
            Happening::Granted(id, held) => {
                let worker = self.workers.get_mut(&id).expect("nobody leaves");
                worker.held.push_back(held);
                if worker.held.len() == 1 {
                    self.begin(id);
                }
            }
            Happening::Revoked(id, lease) => {
                let worker = self.workers.get_mut(&id).expect("nobody leaves");
                let was_first = worker.held.front().is_some_and(|held| held.lease == lease);
                worker.held.retain(|held| held.lease != lease);
                if was_first {
                    worker.busy_until = self.now;
                    self.begin(id);
                }
            }
            Happening::Rendered(id, lease) => self.rendered(id, lease),
            Happening::Delivered(delivery, render) => {
                let verdict = self.scheduler.claim(self.now, &delivery);
                self.perform();
                if verdict == Verdict::Wanted {
                    self.cause(STORE, Happening::Stored(delivery, render));
                }
            }
            Happening::Stored(delivery, render) => self.tell(Event::UnitAccepted { delivery, render }),
            Happening::Heartbeat(id) => {
                let leases = self.workers[&id].held.iter().map(|held| held.lease).collect();
                self.tell(Event::Heartbeat { worker: id, leases, round_trip: Some(WIRE * 2) });
                self.cause(Duration::from_secs(1), Happening::Heartbeat(id));
            }
        }
    }

    /// Begins with the first unit that a worker holds, if there is one.
    fn begin(&mut self, id: WorkerId) {
        let worker = self.workers.get_mut(&id).expect("nobody leaves");
        worker.begun = self.now;
        if let Some(held) = worker.held.front() {
            let samples = held.unit.tile.area() as f64 * held.unit.block.samples() as f64;
            let time = samples * cost(held.unit.tile) * self.pace / worker.speed * chance(&held.unit);
            let lease = held.lease;
            self.cause(Duration::from_secs_f64(time), Happening::Rendered(id, lease));
        }
    }

    fn rendered(&mut self, id: WorkerId, lease: LeaseId) {
        let worker = self.workers.get_mut(&id).expect("nobody leaves");
        let Some(held) = worker.held.pop_front_if(|held| held.lease == lease) else { return };
        worker.busy_until = self.now;
        let render = self.now.since(worker.begun);
        self.rendered.entry(held.unit).or_insert((self.now, render.as_secs_f64() * worker.speed));
        let digest = honest(&held.unit);
        let delivery = Delivery { worker: id, lease, job: JobId(0), unit: held.unit, digest };
        self.cause(WIRE, Happening::Delivered(delivery, render));
        self.begin(id);
    }
}

/// Speeds of unequal workers, over and over: a laptop beside a workstation.
const UNEQUAL: [f64; 4] = [1.0, 4.0, 2.0, 0.5];

#[test]
fn workers_that_differ_are_busy_and_end_together() {
    for count in [2, 4, 8, 16] {
        for (width, height, spp) in [(320, 192, 1024), (320, 160, 1000), (640, 192, 4096), (640, 352, 512)] {
            for first in 0..4 {
                let speeds: Vec<f64> = UNEQUAL.into_iter().cycle().skip(first).take(count).collect();
                let Outcome { efficiency, tail } = render(&speeds, width, height, spp);
                let farm = format!("{width}x{height} {spp} spp on {speeds:?}");
                assert!(efficiency >= 0.985, "{farm}: efficiency {efficiency}");
                assert!(tail <= 0.015, "{farm}: tail {tail}");
            }
        }
    }
}
