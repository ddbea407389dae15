//! One farm, from its start over its accidents to its end.

use crate::coordinator::{self, Seen};
use crate::faults::{Dice, Fault, Plan, TROUBLE};
use crate::network::COORDINATOR;
use crate::store::Disk;
use crate::witness::{self, Sayings, WITNESS};
use crate::worker;
use std::cell::RefCell;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::mpsc;
use turmoil::Sim;

/// Granularity of simulated time.
const TICK: Duration = Duration::from_millis(10);

/// Once nothing goes wrong any more everything is done within this. The longest wait is a quarantine that was doubled.
const LIVENESS: Duration = Duration::from_secs(400);

/// What happened in one farm, or in many.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Story {
    pub faults: u64,
    pub restarts: u64,
    pub units: u64,
    pub duplicates: u64,
    pub failures: u64,
    pub verified: u64,
    pub tried_again: u64,
    pub liars: u64,
    /// Simulated seconds.
    pub seconds: u64,
}

impl std::ops::AddAssign for Story {
    fn add_assign(&mut self, other: Self) {
        self.faults += other.faults;
        self.restarts += other.restarts;
        self.units += other.units;
        self.duplicates += other.duplicates;
        self.failures += other.failures;
        self.verified += other.verified;
        self.tried_again += other.tried_again;
        self.liars += other.liars;
        self.seconds += other.seconds;
    }
}

thread_local! {
    static PANIC: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// A panic in a task ends the task only; here it ends the simulation.
pub fn note_panics() {
    std::panic::set_hook(Box::new(|panic| {
        eprintln!("{panic}");
        PANIC.with_borrow_mut(|noted| *noted = Some(panic.to_string()));
    }));
}

/// What outlives hosts.
struct World {
    disk: Disk,
    seen: Arc<Mutex<Seen>>,
    bucket: bool,
    leave: Vec<mpsc::Sender<()>>,
    dead: Vec<(Duration, String)>,
    /// When what ends by itself ends.
    ends: Vec<(Duration, Fault)>,
}

/// Lives through a farm; a sentence when a promise was broken.
pub fn attempt(seed: u64) -> Result<Story, String> {
    let outcome = std::panic::catch_unwind(|| simulate(seed));
    outcome.unwrap_or_else(|_| Err(PANIC.with_borrow_mut(Option::take).unwrap_or_default()))
}

fn simulate(seed: u64) -> Result<Story, String> {
    PANIC.with_borrow_mut(|noted| *noted = None);
    fastrand::seed(seed);
    let mut dice = Dice::new(seed);
    let plan = Plan::new(&mut dice);
    tracing::info!(?plan, "a farm");
    let mut sim = turmoil::Builder::new()
        .tick_duration(TICK)
        .min_message_latency(Duration::from_millis(1))
        .max_message_latency(plan.latency_max)
        .simulation_duration(TROUBLE + LIVENESS * 2)
        .tcp_capacity(1 << 20)
        .rng_seed(seed)
        .build();
    let mut world = World {
        disk: Disk::new(),
        seen: Arc::default(),
        bucket: plan.bucket,
        leave: Vec::new(),
        dead: Vec::new(),
        ends: Vec::new(),
    };
    world.build(&mut sim, &plan, seed);
    let mut faults = plan.faults.iter().copied().peekable();
    let quiet = |world: &World| world.dead.is_empty() && world.ends.is_empty();
    let mut calm_since = None;
    loop {
        let now = sim.elapsed();
        while let Some((_, fault)) = faults.next_if(|(at, _)| *at <= now) {
            tracing::info!(?fault, ?now, "fault");
            world.begin(&mut sim, fault, now);
        }
        world.end_what_ends(&mut sim, now);
        sim.step().map_err(|error| error.to_string())?;
        if let Some(panic) = PANIC.with_borrow_mut(Option::take) {
            return Err(panic);
        }
        let calm = faults.peek().is_none() && quiet(&world);
        let since = *calm_since.get_or_insert(now);
        if !calm {
            calm_since = None;
        }
        let seen = world.seen.lock().expect("nothing panics in here");
        if let Some(fault) = &seen.broken {
            return Err(fault.clone());
        }
        if calm && seen.done {
            break;
        }
        if calm && now - since > LIVENESS {
            return Err(format!("not done {} s after the last fault: {seen:#?}", LIVENESS.as_secs()));
        }
    }
    let seconds = sim.elapsed().as_secs();
    drop(sim);
    coordinator::check_pictures(&world.disk)?;
    let seen = world.seen.lock().expect("nothing panics in here");
    coordinator::check_state(&world.disk, &seen)?;
    let liars = plan.workers.iter().filter(|worker| worker.lies).count() as u64;
    Ok(Story { faults: plan.faults.len() as u64, liars, seconds, ..seen.story() })
}

impl World {
    fn build(&mut self, sim: &mut Sim<'_>, plan: &Plan, seed: u64) {
        let (disk, seen, verify) = (self.disk.clone(), self.seen.clone(), plan.verify);
        sim.host(COORDINATOR, move || coordinator::live(disk.clone(), seen.clone(), verify));
        let sayings = Sayings::default();
        if plan.witness {
            let (sayings, seen) = (sayings.clone(), self.seen.clone());
            sim.host(WITNESS, move || witness::live(sayings.clone(), seen.clone(), seed));
        }
        for (index, character) in plan.workers.iter().enumerate() {
            let (sender, leave) = mpsc::channel(8);
            self.leave.push(sender);
            let (character, leave) = (character.clone(), Arc::new(Mutex::new(leave)));
            let (name, sayings) = (character.name.clone(), sayings.clone());
            sim.host(name, move || {
                let (character, leave, sayings) = (character.clone(), leave.clone(), sayings.clone());
                async move { Ok(worker::live(character, seed ^ index as u64, leave, sayings).await?) }
            });
        }
    }

    fn begin(&mut self, sim: &mut Sim<'_>, fault: Fault, now: Duration) {
        let name = |worker: usize| format!("worker-{worker}");
        let mood = &self.disk.mood;
        let lasts = match fault {
            Fault::WorkerDies(worker, lasts) => {
                let worker = name(worker);
                if !self.dead.iter().any(|(_, dead)| *dead == worker) {
                    sim.crash(worker.as_str());
                    self.dead.push((now + lasts, worker));
                }
                return;
            }
            Fault::CoordinatorDies(lasts) => {
                if !self.dead.iter().any(|(_, dead)| dead == COORDINATOR) {
                    sim.crash(COORDINATOR);
                    if !self.bucket {
                        coordinator::process_is_dead(&self.disk);
                    }
                    self.dead.push((now + lasts, COORDINATOR.to_owned()));
                }
                return;
            }
            Fault::WorkerLeaves(worker) => {
                let _ = self.leave[worker].try_send(());
                return;
            }
            Fault::Audit => {
                let mut seen = self.seen.lock().expect("nothing panics in here");
                if let Err(fault) = coordinator::audit(&self.disk, &seen) {
                    seen.broken.get_or_insert(fault);
                }
                return;
            }
            Fault::ClockJumps(ahead) => {
                self.seen.lock().expect("nothing panics in here").clock_jump += ahead;
                return;
            }
            Fault::Partition(worker, lasts) => {
                sim.partition(name(worker), COORDINATOR);
                lasts
            }
            Fault::Deaf(worker, lasts) => {
                sim.partition_oneway(name(worker), COORDINATOR);
                lasts
            }
            Fault::Mute(worker, lasts) => {
                sim.partition_oneway(COORDINATOR, name(worker));
                lasts
            }
            Fault::Hold(worker, lasts) => {
                sim.hold(name(worker), COORDINATOR);
                lasts
            }
            Fault::Slow(worker, lasts) => {
                sim.set_link_latency(name(worker), COORDINATOR, Duration::from_millis(700));
                lasts
            }
            Fault::StoreFull(lasts) => {
                mood.full.store(true, Ordering::Relaxed);
                lasts
            }
            Fault::StoreDenies(lasts) => {
                mood.denies.store(true, Ordering::Relaxed);
                lasts
            }
            Fault::StoreSlow(lasts) => {
                mood.delay_ms.store(400, Ordering::Relaxed);
                lasts
            }
        };
        self.ends.push((now + lasts, fault));
    }

    fn end_what_ends(&mut self, sim: &mut Sim<'_>, now: Duration) {
        let over = |(at, _): &(Duration, _)| *at <= now;
        while let Some(place) = self.dead.iter().position(|(at, _)| *at <= now) {
            let (_, host) = self.dead.swap_remove(place);
            tracing::info!(host, ?now, "is back");
            sim.bounce(host.as_str());
        }
        while let Some(place) = self.ends.iter().position(over) {
            let (_, fault) = self.ends.swap_remove(place);
            tracing::info!(?fault, ?now, "is over");
            self.end(sim, fault);
        }
    }

    fn end(&self, sim: &mut Sim<'_>, fault: Fault) {
        let name = |worker: usize| format!("worker-{worker}");
        let mood = &self.disk.mood;
        match fault {
            Fault::Partition(worker, _) | Fault::Deaf(worker, _) | Fault::Mute(worker, _) => {
                sim.repair(name(worker), COORDINATOR);
            }
            Fault::Hold(worker, _) => sim.release(name(worker), COORDINATOR),
            Fault::Slow(worker, _) => {
                sim.set_link_latency(name(worker), COORDINATOR, Duration::from_millis(5));
            }
            Fault::StoreFull(_) => mood.full.store(false, Ordering::Relaxed),
            Fault::StoreDenies(_) => mood.denies.store(false, Ordering::Relaxed),
            Fault::StoreSlow(_) => mood.delay_ms.store(0, Ordering::Relaxed),
            Fault::WorkerDies(..) | Fault::WorkerLeaves(_) | Fault::CoordinatorDies(_) => {}
            Fault::ClockJumps(_) | Fault::Audit => {}
        }
    }
}
