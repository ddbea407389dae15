//! Farms in which everything goes wrong, by seed. The shell, its store, the network and the workers are played here; after
//! each step the promises hold, and once the accidents stop every job completes.

use super::{honest, spec};
use crate::{Action, Config, Delivery, Event, Scheduler, Timestamp, Verdict};
use farm_film::{FrameIndex, SampleBlock, Tile, WorkUnit};
use farm_job::{JobId, JobSpec, JobState, LeaseId, WorkerId};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Simulated farms per run of the tests.
const SEEDS: u64 = 400;

/// Steps in which accidents happen.
const ACCIDENTS: u32 = 400;

/// Steps of a quarter of a second within which everything is done after the last accident. The longest wait is that for
/// a worker whose quarantine was doubled often.
const LIVENESS_BOUND: u32 = 20_000;

#[test]
fn any_accident_leaves_every_sample_counted_once_and_every_job_done() {
    for seed in 0..SEEDS {
        simulate(seed);
    }
}

/// Set `SIMULATION_SEED` to see one farm alone.
#[test]
fn one_seed_alone() {
    let seed = std::env::var("SIMULATION_SEED").ok().and_then(|text| text.parse().ok());
    simulate(seed.unwrap_or(0));
}

fn simulate(seed: u64) {
    let outcome = std::panic::catch_unwind(|| {
        let mut world = World::new(seed);
        world.have_accidents();
        world.recover();
        world.check_replay();
    });
    assert!(
        outcome.is_ok(),
        "seed {seed} failed; rerun with SIMULATION_SEED={seed} cargo test one_seed_alone"
    );
}

/// SplitMix64.
struct Dice(u64);

impl Dice {
    fn roll(&mut self, sides: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) % sides
    }

    fn percent(&mut self, chance: u64) -> bool {
        self.roll(100) < chance
    }

    fn pick<T: Clone>(&mut self, from: &[T]) -> Option<T> {
        (!from.is_empty()).then(|| from[self.roll(from.len() as u64) as usize].clone())
    }
}

/// What a scheduler was told; replayed to see that it does the same again.
enum Input {
    Handle(Timestamp, Event),
    Claim(Timestamp, Delivery),
}

/// On its way from a worker.
#[derive(Clone)]
enum Message {
    Event(Event),
    Result(Delivery),
}

#[derive(Clone, Copy)]
struct Held {
    lease: LeaseId,
    job: JobId,
    unit: WorkUnit,
}

struct SimWorker {
    name: String,
    slots: u32,
    held: Vec<Held>,
}

struct SimJob {
    spec: JobSpec,
    durable: BTreeMap<(FrameIndex, Tile), Vec<SampleBlock>>,
    finished: BTreeMap<FrameIndex, u64>,
    /// Samples per pixel that each frame has announced.
    rounds: BTreeMap<FrameIndex, u64>,
    /// Samples per pixel of the tiles that were ended since the coordinator was started.
    ended: BTreeMap<(FrameIndex, Tile), u64>,
    done: bool,
}

struct World {
    dice: Dice,
    now: Timestamp,
    scheduler: Scheduler,
    config: Config,
    inputs: Vec<Input>,
    actions: Vec<Action>,
    workers: BTreeMap<WorkerId, SimWorker>,
    network: Vec<Message>,
    storing: Vec<Delivery>,
    jobs: BTreeMap<JobId, SimJob>,
    names: u64,
}

impl World {
    fn new(seed: u64) -> Self {
        let mut dice = Dice(seed);
        let verify = if dice.percent(50) { 0.3 } else { 0.0 };
        let config = Config { speculate: dice.percent(80), verify, ..Config::default() };
        let mut world = Self {
            dice,
            now: Timestamp::START,
            scheduler: Scheduler::new(config.clone()),
            config,
            inputs: Vec::new(),
            actions: Vec::new(),
            workers: BTreeMap::new(),
            network: Vec::new(),
            storing: Vec::new(),
            jobs: BTreeMap::new(),
            names: 0,
        };
        for id in 0..1 + world.dice.roll(3) {
            world.submit(JobId(id));
        }
        world.join();
        world
    }

    fn submit(&mut self, id: JobId) {
        let spp = self.dice.pick(&[1, 16, 48, 100, 256]).unwrap_or(16);
        let side = self.dice.pick(&[3, 8, 50]).unwrap_or(8);
        let last = self.dice.roll(3);
        let mut spec = spec(16, 11, side, spp, &format!("0-{last}"));
        spec.priority = self.dice.roll(2) as i32;
        let (durable, finished, rounds, ended) = Default::default();
        self.jobs.insert(id, SimJob { spec, durable, finished, rounds, ended, done: false });
        self.resubmit(id);
    }

    /// Tells the scheduler of a job and of what the store has of it.
    fn resubmit(&mut self, id: JobId) {
        let job = self.jobs.get_mut(&id).expect("the job was submitted");
        job.rounds.clear();
        job.ended.clear();
        let durable = job.durable.iter().flat_map(|(&(frame, tile), blocks)| {
            blocks.iter().map(move |&block| WorkUnit { frame, block, tile })
        });
        let event = Event::JobSubmitted {
            job: id,
            spec: Box::new(job.spec.clone()),
            finished: job.finished.keys().copied().collect(),
            durable: durable.collect(),
            origins: Vec::new(),
        };
        self.tell(event);
    }

    fn join(&mut self) {
        let name = format!("worker {}", self.dice.roll(5));
        let slots = 1 + self.dice.roll(3) as u32;
        self.connect(SimWorker { name, slots, held: Vec::new() });
    }

    fn connect(&mut self, worker: SimWorker) {
        self.names += 1;
        let id = WorkerId(self.names);
        let event = Event::WorkerJoined { worker: id, name: worker.name.clone(), slots: worker.slots };
        self.workers.insert(id, worker);
        self.tell(event);
    }

    fn tell(&mut self, event: Event) {
        self.inputs.push(Input::Handle(self.now, event.clone()));
        self.scheduler.handle(self.now, event);
        self.perform();
    }

    fn perform(&mut self) {
        while let Some(action) = self.scheduler.poll_action() {
            self.actions.push(action.clone());
            match action {
                Action::Grant { worker, lease, job, unit, .. } => {
                    self.granted(worker, Held { lease, job, unit })
                }
                Action::Revoke { worker, lease } => {
                    let obeys = self.dice.percent(70);
                    if let Some(worker) = self.workers.get_mut(&worker).filter(|_| obeys) {
                        worker.held.retain(|held| held.lease != lease);
                    }
                }
                Action::RoundComplete { job, frame, spp } => {
                    let before = self.job(job).rounds.insert(frame, spp);
                    assert!(before.is_none_or(|before| before < spp), "rounds are announced once, in order");
                    self.check_covered(job, frame, spp);
                }
                Action::FrameComplete { job, frame, spp } => {
                    self.check_covered(job, frame, spp);
                    let before = self.job(job).finished.insert(frame, spp);
                    assert_eq!(before, None, "frame {frame} of job {job} is complete once");
                }
                Action::JobDone { job } => {
                    let job = self.job(job);
                    assert!(!job.done, "a job is done once");
                    job.done = true;
                    assert_eq!(job.finished.len() as u64, job.spec.frames.count());
                }
                Action::Disconnect { worker, .. } => {
                    self.workers.remove(&worker);
                }
                Action::JobFailed { .. } | Action::Quarantine { .. } => {}
                Action::Distrust { .. } | Action::Reopened { .. } => panic!("nobody lies here: {action:?}"),
            }
        }
    }

    fn job(&mut self, id: JobId) -> &mut SimJob {
        self.jobs.get_mut(&id).expect("actions speak of jobs that exist")
    }

    fn granted(&mut self, id: WorkerId, new: Held) {
        // The connection may have broken meanwhile, or the message is lost.
        let lost = self.dice.percent(2);
        let Some(worker) = self.workers.get_mut(&id).filter(|_| !lost) else { return };
        worker.held.push(new);
        let status = self.scheduler.status(self.now);
        let known = status.workers.iter().find(|status| status.worker == id).expect("it is connected");
        assert!(known.in_flight <= u64::from(known.slots) * 65, "a worker holds no more than its window");
    }

    /// Every pixel of a frame has each of the first `spp` samples exactly once, or of those that its tile gets.
    fn check_covered(&mut self, id: JobId, frame: FrameIndex, spp: u64) {
        let job = self.job(id);
        for tile in job.spec.resolution().expect("a good job").tiles(job.spec.tile_side) {
            let blocks = job.durable.get(&(frame, tile)).cloned().unwrap_or_default();
            let spp = job.ended.get(&(frame, tile)).map_or(spp, |end| spp.min(*end));
            let within = blocks.iter().filter(|block| block.end() <= spp);
            let samples: u64 = within.map(|block| block.samples()).sum();
            assert_eq!(samples, spp, "job {id} frame {frame} tile {tile}: {blocks:?}");
        }
    }

    fn store(&mut self, delivery: &Delivery) {
        let unit = delivery.unit;
        let blocks = self.job(delivery.job).durable.entry((unit.frame, unit.tile)).or_default();
        let overlap = blocks.iter().find(|block| block.overlaps(unit.block));
        assert_eq!(overlap, None, "{unit} is stored although some of it is there");
        blocks.push(unit.block);
    }

    fn have_accidents(&mut self) {
        for _ in 0..ACCIDENTS {
            match self.dice.roll(100) {
                0..3 => self.join(),
                3..5 => self.kill(),
                5..7 => self.reconnect(),
                7 => self.restart_coordinator(),
                8..10 => self.say_to_worker(|worker| Event::WorkerDraining { worker }),
                10..13 => self.command(),
                13 => self.end_tiles(),
                14..18 => self.fail_unit(),
                18..22 => self.return_unit(),
                22..40 => self.heartbeat_some(),
                40..70 => self.finish_unit(),
                70..85 => self.settle_claim(),
                _ => self.now = self.now.after(Duration::from_millis(self.dice.roll(900))),
            }
            for _ in 0..self.dice.roll(4) {
                self.deliver();
            }
            self.tell(Event::Tick);
        }
    }

    fn random_worker(&mut self) -> Option<WorkerId> {
        let ids: Vec<_> = self.workers.keys().copied().collect();
        self.dice.pick(&ids)
    }

    fn kill(&mut self) {
        let Some(id) = self.random_worker() else { return };
        self.workers.remove(&id);
        // Its end is noticed at once, or only by its silence.
        if self.dice.percent(50) {
            self.tell(Event::WorkerLeft { worker: id });
        }
    }

    /// A worker loses its connection, keeps what it holds, and comes back under another identifier.
    fn reconnect(&mut self) {
        let Some(id) = self.random_worker() else { return };
        let Some(worker) = self.workers.remove(&id) else { return };
        if self.dice.percent(70) {
            self.tell(Event::WorkerLeft { worker: id });
        }
        self.connect(worker);
    }

    fn restart_coordinator(&mut self) {
        self.check_replay();
        self.inputs.clear();
        self.actions.clear();
        // Some of what was on its way to the store has arrived there.
        for delivery in std::mem::take(&mut self.storing) {
            if self.dice.percent(50) {
                self.store(&delivery);
            }
        }
        self.config.first_lease = LeaseId(self.config.first_lease.0 + 1_000_000);
        self.scheduler = Scheduler::new(self.config.clone());
        let unfinished: Vec<_> = self.jobs.iter().filter(|(_, job)| !job.done).map(|(id, _)| *id).collect();
        for id in unfinished {
            self.resubmit(id);
        }
        for worker in std::mem::take(&mut self.workers).into_values() {
            self.connect(worker);
        }
    }

    fn say_to_worker(&mut self, event: impl Fn(WorkerId) -> Event) {
        if let Some(id) = self.random_worker() {
            self.tell(event(id));
        }
    }

    fn command(&mut self) {
        let jobs: Vec<_> = self.jobs.keys().copied().collect();
        let Some(job) = self.dice.pick(&jobs) else { return };
        let event = match self.dice.roll(6) {
            0 => Event::JobPaused { job },
            1 => Event::JobRequeued { job },
            2 => Event::PriorityChanged { job, priority: self.dice.roll(3) as i32 },
            3 => {
                let spp = self.dice.pick(&[16, 32, 64, 96]).unwrap_or(16);
                Event::FrameTruncated { job, frame: FrameIndex(self.dice.roll(3) as u32), spp }
            }
            _ => Event::JobResumed { job },
        };
        self.tell(event);
    }

    /// Some tiles of a frame have enough after a round that was announced.
    fn end_tiles(&mut self) {
        let jobs: Vec<_> = self.jobs.keys().copied().collect();
        let Some(id) = self.dice.pick(&jobs) else { return };
        let rounds: Vec<_> = self.job(id).rounds.iter().map(|(frame, spp)| (*frame, *spp)).collect();
        let Some((frame, spp)) = self.dice.pick(&rounds) else { return };
        let spec = self.job(id).spec.clone();
        let mut tiles: Vec<_> = spec.resolution().expect("a good job").tiles(spec.tile_side).collect();
        tiles.retain(|_| self.dice.percent(40));
        for tile in &tiles {
            self.job(id).ended.entry((frame, *tile)).or_insert(spp);
        }
        self.tell(Event::TilesEnded { job: id, frame, tiles, spp });
    }

    fn random_held(&mut self) -> Option<(WorkerId, Held)> {
        let held: Vec<_> = self
            .workers
            .iter()
            .flat_map(|(id, worker)| worker.held.iter().map(move |held| (*id, *held)))
            .collect();
        self.dice.pick(&held)
    }

    fn let_go(&mut self, worker: WorkerId, lease: LeaseId) {
        if let Some(worker) = self.workers.get_mut(&worker) {
            worker.held.retain(|held| held.lease != lease);
        }
    }

    fn fail_unit(&mut self) {
        let Some((worker, held)) = self.random_held() else { return };
        self.let_go(worker, held.lease);
        let reason = "no reason".to_owned();
        self.send(Message::Event(Event::UnitFailed { worker, lease: held.lease, reason }));
    }

    fn return_unit(&mut self) {
        let Some((worker, held)) = self.random_held() else { return };
        self.let_go(worker, held.lease);
        self.send(Message::Event(Event::UnitReturned { worker, lease: held.lease }));
    }

    fn finish_unit(&mut self) {
        let Some((worker, held)) = self.random_held() else { return };
        self.let_go(worker, held.lease);
        let mut unit = held.unit;
        // Sometimes only a part of it.
        while let Some((left, right)) = unit.block.children().filter(|_| self.dice.percent(15)) {
            unit.block = if self.dice.percent(50) { left } else { right };
        }
        self.send(Message::Result(Delivery {
            worker,
            lease: held.lease,
            job: held.job,
            unit,
            digest: honest(&unit),
        }));
    }

    /// Puts a message on the network, which may double it.
    fn send(&mut self, message: Message) {
        if self.dice.percent(10) {
            self.network.push(message.clone());
        }
        self.network.push(message);
    }

    /// Lets any message arrive; the order in which they were sent means nothing.
    fn deliver(&mut self) {
        if self.network.is_empty() {
            return;
        }
        let position = self.dice.roll(self.network.len() as u64) as usize;
        match self.network.swap_remove(position) {
            Message::Event(event) => self.tell(event),
            Message::Result(delivery) => self.receive(delivery),
        }
    }

    fn receive(&mut self, delivery: Delivery) {
        // The second copy of a message still being stored is the same delivery; the shell knows it by its lease.
        if self.storing.contains(&delivery) {
            return;
        }
        if self.dice.percent(3) {
            return self.tell(Event::ResultRejected { delivery, reason: "digest differs".to_owned() });
        }
        self.inputs.push(Input::Claim(self.now, delivery));
        let verdict = self.scheduler.claim(self.now, &delivery);
        if verdict == Verdict::Wanted {
            self.storing.push(delivery);
        }
        assert_ne!(verdict, Verdict::Foreign, "workers render what they were given");
        self.perform();
    }

    fn settle_claim(&mut self) {
        if self.storing.is_empty() {
            return;
        }
        let position = self.dice.roll(self.storing.len() as u64) as usize;
        let delivery = self.storing.swap_remove(position);
        match self.dice.roll(20) {
            0 => self.tell(Event::StoreFailed { delivery }),
            1 => self.tell(Event::ResultRejected { delivery, reason: "truncated".to_owned() }),
            _ => self.accept(delivery),
        }
    }

    fn accept(&mut self, delivery: Delivery) {
        self.store(&delivery);
        let render = Duration::from_millis(1 + self.dice.roll(2000));
        self.tell(Event::UnitAccepted { delivery, render });
    }

    fn heartbeat_some(&mut self) {
        for worker in self.workers.keys().copied().collect::<Vec<_>>() {
            if self.dice.percent(80) {
                self.heartbeat(worker);
            }
        }
    }

    fn heartbeat(&mut self, worker: WorkerId) {
        let Some(known) = self.workers.get(&worker) else { return };
        let leases = known.held.iter().map(|held| held.lease).collect();
        let round_trip = Some(Duration::from_millis(self.dice.roll(100)));
        self.tell(Event::Heartbeat { worker, leases, round_trip });
    }

    /// The accidents stop: everything that is held is rendered and stored, and what had failed or was paused goes on.
    fn recover(&mut self) {
        self.dice = Dice(1);
        for job in self.jobs.keys().copied().collect::<Vec<_>>() {
            self.tell(Event::JobRequeued { job });
            self.tell(Event::JobResumed { job });
        }
        for _ in 0..LIVENESS_BOUND {
            if self.jobs.values().all(|job| job.done) {
                return self.check_end();
            }
            self.work_a_moment();
        }
        panic!("still not done: {:#?}", self.scheduler.status(self.now));
    }

    fn work_a_moment(&mut self) {
        self.now = self.now.after(Duration::from_millis(250));
        if self.workers.len() < 2 {
            self.join();
        }
        for worker in self.workers.keys().copied().collect::<Vec<_>>() {
            self.heartbeat(worker);
            for held in self.workers.get(&worker).map(|known| known.held.clone()).unwrap_or_default() {
                self.let_go(worker, held.lease);
                let (lease, job, unit, digest) = (held.lease, held.job, held.unit, honest(&held.unit));
                let delivery = Delivery { worker, lease, job, unit, digest };
                self.network.push(Message::Result(delivery));
            }
        }
        while !self.network.is_empty() {
            self.deliver();
        }
        for delivery in std::mem::take(&mut self.storing) {
            self.accept(delivery);
        }
        let failed = self.scheduler.status(self.now).jobs;
        for job in failed.into_iter().filter(|job| job.state == JobState::Failed) {
            self.tell(Event::JobRequeued { job: job.job });
        }
        self.tell(Event::Tick);
    }

    fn check_end(&mut self) {
        for status in self.scheduler.status(self.now).jobs {
            assert_eq!(status.state, JobState::Done);
            assert_eq!(status.leases, 0, "a job that is done has nothing out");
            assert_eq!(status.samples_done, status.samples);
        }
    }

    /// The same events give the same actions, and each grant is a lease of its own.
    fn check_replay(&self) {
        let mut again = Scheduler::new(self.config.clone());
        let mut actions = Vec::new();
        for input in &self.inputs {
            match input {
                Input::Handle(now, event) => again.handle(*now, event.clone()),
                Input::Claim(now, delivery) => {
                    again.claim(*now, delivery);
                }
            }
            while let Some(action) = again.poll_action() {
                actions.push(action);
            }
        }
        assert_eq!(actions, self.actions, "the same events give the same actions");
        let leases: BTreeSet<_> = actions
            .iter()
            .filter_map(|action| match action {
                Action::Grant { lease, .. } => Some(*lease),
                _ => None,
            })
            .collect();
        let grants = actions.iter().filter(|action| matches!(action, Action::Grant { .. })).count();
        assert_eq!(leases.len(), grants, "each grant is a new lease");
    }
}
