//! One farm, from its start over its accidents to its end.

use crate::coordinator::{self, Seen};
use crate::faults::{Dice, Fault, Plan, TROUBLE};
use crate::network::{COORDINATORS, Cable};
use crate::picture::PICTURE;
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
    /// The disk as each coordinator sees it.
    views: Vec<Disk>,
    cables: Vec<Arc<Cable>>,
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
    let has_liar = plan.workers.iter().any(|worker| worker.lies);
    let bound = plan.bound(PICTURE.samples() * PICTURE.spec.frames.count());
    let mut sim = turmoil::Builder::new()
        .tick_duration(TICK)
        .min_message_latency(Duration::from_millis(1))
        .max_message_latency(plan.latency_max)
        .simulation_duration((TROUBLE + bound) * 2)
        .tcp_capacity(1 << 20)
        .rng_seed(seed)
        .build();
    let mut world = World {
        disk: Disk::new(),
        views: Vec::new(),
        cables: Vec::new(),
        seen: Arc::default(),
        bucket: plan.bucket,
        leave: Vec::new(),
        dead: Vec::new(),
        ends: Vec::new(),
    };
    world.seen.lock().expect("nothing panics in here").has_liar = has_liar;
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
        world.end_who_is_fenced(&mut sim, now);
        if world.disk.mood.removed.swap(false, Ordering::Relaxed) {
            world.audit();
        }
        let seen = world.seen.lock().expect("nothing panics in here");
        if let Some(fault) = &seen.broken {
            return Err(fault.clone());
        }
        if calm && seen.done {
            break;
        }
        if calm && now - since > bound {
            return Err(format!("not done {} s after the last fault: {seen:#?}", bound.as_secs()));
        }
    }
    let seconds = sim.elapsed().as_secs();
    drop(sim);
    coordinator::check_pictures(&world.disk)?;
    let seen = world.seen.lock().expect("nothing panics in here");
    coordinator::check_state(&world.disk, &seen)?;
    let (faults, liars) = (plan.faults.len() as u64, u64::from(has_liar));
    Ok(Story { faults, liars, seconds, ..seen.story() })
}

impl World {
    fn build(&mut self, sim: &mut Sim<'_>, plan: &Plan, seed: u64) {
        for (host, name) in COORDINATORS.iter().enumerate().take(plan.coordinators) {
            let (disk, seen, verify) = (self.disk.elsewhere(), self.seen.clone(), plan.verify);
            self.views.push(disk.clone());
            sim.host(*name, move || coordinator::live(disk.clone(), seen.clone(), verify, host));
        }
        let sayings = Sayings::default();
        if plan.witness {
            let (sayings, seen) = (sayings.clone(), self.seen.clone());
            sim.host(WITNESS, move || witness::live(sayings.clone(), seen.clone(), seed));
        }
        for (index, character) in plan.workers.iter().enumerate() {
            let (sender, leave) = mpsc::channel(8);
            self.leave.push(sender);
            let (character, leave) = (character.clone(), Arc::new(Mutex::new(leave)));
            let (name, sayings, seed) = (character.name.clone(), sayings.clone(), seed ^ index as u64);
            let cable = Arc::new(Cable::new(seed));
            self.cables.push(cable.clone());
            sim.host(name, move || {
                let (character, leave) = (character.clone(), leave.clone());
                let (cable, sayings) = (cable.clone(), sayings.clone());
                async move { Ok(worker::live(character, seed, leave, cable, sayings).await?) }
            });
        }
    }

    fn begin(&mut self, sim: &mut Sim<'_>, fault: Fault, now: Duration) {
        let mood = &self.disk.mood;
        let lasts = match fault {
            Fault::WorkerDies(worker, lasts) => {
                self.kill(sim, name(worker), now + lasts);
                return;
            }
            Fault::CoordinatorDies(host, lasts) => {
                self.kill_coordinator(sim, host, now + lasts);
                return;
            }
            Fault::WorkerLeaves(worker) => {
                let _ = self.leave[worker].try_send(());
                return;
            }
            Fault::Audit => {
                self.audit();
                return;
            }
            Fault::ClockJumps(ahead) => {
                self.seen.lock().expect("nothing panics in here").clock_jump += ahead;
                return;
            }
            Fault::CoordinatorHangs(host, lasts) => {
                self.views[host].hangs.store(true, Ordering::Relaxed);
                lasts
            }
            Fault::Partition(worker, lasts) => {
                self.coordinators().for_each(|host| sim.partition(name(worker), host));
                lasts
            }
            Fault::Deaf(worker, lasts) => {
                self.coordinators().for_each(|host| sim.partition_oneway(name(worker), host));
                lasts
            }
            Fault::Mute(worker, lasts) => {
                self.coordinators().for_each(|host| sim.partition_oneway(host, name(worker)));
                lasts
            }
            Fault::Hold(worker, lasts) => {
                self.coordinators().for_each(|host| sim.hold(name(worker), host));
                lasts
            }
            Fault::LooseCable(worker, lasts) => {
                self.cables[worker].loose.store(true, Ordering::Relaxed);
                lasts
            }
            Fault::Slow(worker, lasts) => {
                let latency = Duration::from_millis(700);
                self.coordinators().for_each(|host| sim.set_link_latency(name(worker), host, latency));
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
        let mood = &self.disk.mood;
        match fault {
            Fault::Partition(worker, _) | Fault::Deaf(worker, _) | Fault::Mute(worker, _) => {
                self.coordinators().for_each(|host| sim.repair(name(worker), host));
            }
            Fault::Hold(worker, _) => {
                self.coordinators().for_each(|host| sim.release(name(worker), host));
            }
            Fault::Slow(worker, _) => {
                let latency = Duration::from_millis(5);
                self.coordinators().for_each(|host| sim.set_link_latency(name(worker), host, latency));
            }
            Fault::LooseCable(worker, _) => self.cables[worker].loose.store(false, Ordering::Relaxed),
            Fault::CoordinatorHangs(host, _) => self.views[host].hangs.store(false, Ordering::Relaxed),
            Fault::StoreFull(_) => mood.full.store(false, Ordering::Relaxed),
            Fault::StoreDenies(_) => mood.denies.store(false, Ordering::Relaxed),
            Fault::StoreSlow(_) => mood.delay_ms.store(0, Ordering::Relaxed),
            Fault::WorkerDies(..) | Fault::WorkerLeaves(_) | Fault::CoordinatorDies(..) => {}
            Fault::ClockJumps(_) | Fault::Audit => {}
        }
    }

    fn coordinators(&self) -> impl Iterator<Item = &'static str> + use<> {
        COORDINATORS.into_iter().take(self.views.len())
    }

    fn kill(&mut self, sim: &mut Sim<'_>, host: String, until: Duration) -> bool {
        let lives = !self.dead.iter().any(|(_, dead)| *dead == host);
        if lives {
            sim.crash(host.as_str());
            self.dead.push((until, host));
        }
        lives
    }

    fn kill_coordinator(&mut self, sim: &mut Sim<'_>, host: usize, until: Duration) {
        if self.kill(sim, COORDINATORS[host].to_owned(), until) && !self.bucket {
            let turn = self.seen.lock().expect("nothing panics in here").turns.get(&host).copied();
            turn.into_iter().for_each(|turn| coordinator::process_is_dead(&self.disk, turn));
        }
    }

    /// A coordinator that has lost the store ends, and is started again as a service would be.
    fn end_who_is_fenced(&mut self, sim: &mut Sim<'_>, now: Duration) {
        let fenced = std::mem::take(&mut self.seen.lock().expect("nothing panics in here").fenced);
        fenced.into_iter().for_each(|host| self.kill_coordinator(sim, host, now + Duration::from_secs(1)));
    }

    fn audit(&self) {
        let mut seen = self.seen.lock().expect("nothing panics in here");
        if let Err(fault) = coordinator::audit(&self.disk, &seen) {
            seen.broken.get_or_insert(fault);
        }
    }
}

/// A worker's host.
fn name(worker: usize) -> String {
    format!("worker-{worker}")
}
