//! What the scheduler costs on a large farm: a job of a million units, a thousand workers.
//!
//! `cargo bench -p farm-scheduler` prints one line per figure.

use farm_film::{FrameIndex, SampleBlock, WorkUnit};
use farm_job::{Digest, JobId, JobSpec, LeaseId, Stop, WorkerId};
use farm_scene::{Filter, Integrator, SceneId, Settings};
use farm_scheduler::{Action, Config, Delivery, Event, Scheduler, Timestamp, Verdict};
use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

const JOB: JobId = JobId(1);
const WORKERS: u64 = 1000;
const SLOTS: u32 = 4;

/// A frame of a thousand by a thousand tiles.
fn million_units() -> JobSpec {
    let settings = Settings {
        camera: 0,
        width: 8000,
        height: 8000,
        integrator: Integrator::Path,
        filter: Filter::Box,
        max_depth: 8,
        seed: 0,
        fps: 24.0,
        clamp: None,
    };
    let frames = "0".parse().expect("a frame");
    let scene = SceneId([0; 32]);
    JobSpec {
        name: "large".to_owned(),
        scene,
        settings,
        frames,
        spp: 16,
        stop: Stop::default(),
        variance: false,
        tile_side: 8,
        priority: 0,
    }
}

fn main() {
    plan();
    restart();
    work();
}

fn submitted(durable: Vec<WorkUnit>) -> Event {
    let (spec, finished, origins) = (Box::new(million_units()), Vec::new(), Vec::new());
    Event::JobSubmitted { job: JOB, spec, finished, durable, origins }
}

fn joined(scheduler: &mut Scheduler) {
    for id in 0..WORKERS {
        let event = Event::WorkerJoined { worker: WorkerId(id), name: format!("worker {id}"), slots: SLOTS };
        scheduler.handle(Timestamp::START, event);
    }
}

fn plan() {
    let mut scheduler = Scheduler::new(Config::default());
    joined(&mut scheduler);
    let event = submitted(Vec::new());
    let start = Instant::now();
    scheduler.handle(Timestamp::START, event);
    let granted = std::iter::from_fn(|| scheduler.poll_action()).count();
    println!("plan a job of 10^6 units and grant the first {granted}: {:.1?}", start.elapsed());
}

fn restart() {
    let spec = million_units();
    let block = SampleBlock::new(0..16).expect("a leaf");
    let tiles = spec.resolution().expect("a resolution").tiles(spec.tile_side).skip(1);
    let durable = tiles.map(|tile| WorkUnit { frame: FrameIndex(0), block, tile }).collect();
    let event = submitted(durable);
    let mut scheduler = Scheduler::new(Config::default());
    let start = Instant::now();
    scheduler.handle(Timestamp::START, event);
    println!("take up a job of 10^6 units of which all but one are durable: {:.1?}", start.elapsed());
}

fn work() {
    let before = resident_kilobytes();
    let mut farm = Load::new();
    let start = Instant::now();
    let mut heartbeat_time = Duration::ZERO;
    let mut heartbeats = 0u32;
    let mut largest = 0;
    while let Some(delivery) = farm.queue.pop_front() {
        if farm.units.is_multiple_of(5_000) {
            let beat = Instant::now();
            heartbeats += farm.heartbeats();
            heartbeat_time += beat.elapsed();
            largest = largest.max(resident_kilobytes());
        }
        farm.deliver(delivery);
    }
    let (work, units) = (start.elapsed() - heartbeat_time, farm.units as u32);
    println!(
        "{units} units on {WORKERS} workers of {SLOTS} slots: {work:.1?}, {:.0?} per unit",
        work / units
    );
    println!(
        "{heartbeats} heartbeats, each for all leases of a worker: {:.0?} each",
        heartbeat_time / heartbeats
    );
    println!("memory: {} kB more than before", largest.saturating_sub(before));
}

struct Load {
    scheduler: Scheduler,
    now: Timestamp,
    queue: VecDeque<Delivery>,
    held: BTreeMap<WorkerId, Vec<LeaseId>>,
    units: u64,
}

impl Load {
    fn new() -> Self {
        let scheduler = Scheduler::new(Config::default());
        let (now, queue, held) = (Timestamp::START, VecDeque::new(), BTreeMap::new());
        let mut load = Self { scheduler, now, queue, held, units: 0 };
        joined(&mut load.scheduler);
        load.scheduler.handle(load.now, submitted(Vec::new()));
        load.perform();
        load
    }

    fn perform(&mut self) {
        while let Some(action) = self.scheduler.poll_action() {
            if let Action::Grant { worker, lease, job, unit, .. } = action {
                self.held.entry(worker).or_default().push(lease);
                self.queue.push_back(Delivery { worker, lease, job, unit, digest: Digest([0; 32]) });
            }
        }
    }

    /// One result: claimed, and durable a moment later. 5,000 of them in a second.
    fn deliver(&mut self, delivery: Delivery) {
        self.now = self.now.after(Duration::from_micros(200));
        if let Some(held) = self.held.get_mut(&delivery.worker) {
            held.retain(|lease| *lease != delivery.lease);
        }
        let verdict = self.scheduler.claim(self.now, &delivery);
        if verdict == Verdict::Wanted {
            let event = Event::UnitAccepted { delivery, render: Duration::from_millis(200) };
            self.scheduler.handle(self.now, event);
            self.units += 1;
        }
        self.perform();
    }

    fn heartbeats(&mut self) -> u32 {
        for (worker, leases) in &self.held {
            let event = Event::Heartbeat { worker: *worker, leases: leases.clone(), round_trip: None };
            self.scheduler.handle(self.now, event);
        }
        self.held.len() as u32
    }
}

/// Memory that the process holds now, where the system tells.
fn resident_kilobytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmRSS"));
    line.and_then(|line| line.split_whitespace().nth(1)?.parse().ok()).unwrap_or(0)
}
