//! What the scheduler knows about the workers.

use crate::health::Health;
use crate::{Timestamp, policy};
use farm_job::{JobId, LeaseId, WorkerId};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// One connected worker.
#[derive(Debug)]
pub(crate) struct Worker {
    pub name: Arc<str>,
    pub slots: u32,
    /// When it was last heard.
    pub heard: Timestamp,
    pub round_trip: Option<Duration>,
    /// What it holds; the oldest, being rendered, come first.
    pub leases: BTreeSet<LeaseId>,
    /// Its results that are on their way to the store.
    pub storing: usize,
    /// Pixel samples of cost 1 per second and slot, by job.
    speeds: BTreeMap<JobId, f64>,
    /// Pixel samples per second and slot, smoothed over all jobs; zero at first.
    pub speed: f64,
    /// Seconds of a unit on a slot, smoothed.
    unit_time: Option<f64>,
    pub draining: bool,
    /// It has been told to go.
    pub dismissed: bool,
    /// Jobs it cannot render, with its reasons.
    pub refused: BTreeMap<JobId, String>,
    pub units_done: u64,
    pub failures: u64,
    /// Its place among those with room, if it has one.
    pub filed: Option<u64>,
}

impl Worker {
    /// The load at which every slot has something to render.
    pub const FULL: u64 = 1024;

    pub fn new(name: Arc<str>, slots: u32, now: Timestamp) -> Self {
        Self {
            name,
            slots: slots.clamp(1, policy::SLOTS_MAX),
            heard: now,
            round_trip: None,
            leases: BTreeSet::new(),
            storing: 0,
            speeds: BTreeMap::new(),
            speed: 0.0,
            unit_time: None,
            draining: false,
            dismissed: false,
            refused: BTreeMap::new(),
            units_done: 0,
            failures: 0,
            filed: None,
        }
    }

    /// Learns from a unit of `samples` pixel samples, as many as `work` of cost 1, that one slot rendered in `render`; how many of
    /// these it renders per second.
    pub fn measure(&mut self, job: JobId, samples: f64, work: f64, render: Duration) -> f64 {
        let seconds = render.as_secs_f64();
        let smoothed = policy::smooth(self.speeds.get(&job).copied(), work / seconds);
        self.speeds.insert(job, smoothed);
        self.speed = policy::smooth(Some(self.speed).filter(|_| self.unit_time.is_some()), samples / seconds);
        self.unit_time = Some(policy::smooth(self.unit_time, seconds));
        smoothed
    }

    /// Pixel samples of cost 1 per second and slot in a job, once measured.
    pub fn speed_in(&self, job: JobId) -> Option<f64> {
        self.speeds.get(&job).copied()
    }

    /// Forgets what it knows of a job that has ended.
    pub fn forget(&mut self, job: JobId) {
        self.speeds.remove(&job);
        self.refused.remove(&job);
    }

    /// Units it may hold, waiting ones included.
    pub fn window(&self, target_unit: Duration) -> usize {
        let unit = self.unit_time.map(Duration::from_secs_f64);
        policy::window(self.slots, unit, self.round_trip, target_unit)
    }

    /// Whether it has enough when little is left to do.
    pub fn hoards(&self) -> bool {
        let unit = self.unit_time.map(Duration::from_secs_f64);
        self.leases.len() >= policy::last_window(self.slots, unit, self.round_trip)
    }

    /// Whether it could take one more unit; a slow store holds it back.
    pub fn has_room(&self, target_unit: Duration) -> bool {
        let window = self.window(target_unit);
        !self.draining && self.leases.len() < window && self.storing < policy::STORING_PER_WINDOW * window
    }

    /// How full it is; the emptiest is served first.
    pub fn load(&self) -> u64 {
        self.leases.len() as u64 * Self::FULL / u64::from(self.slots)
    }

    /// Units that one of its slots renders until one more is done.
    pub fn turns(&self) -> u32 {
        self.leases.len() as u32 / self.slots + 1
    }

    /// When the result of a unit that waits for its turn is there, if each takes `unit`.
    pub fn expected(&self, granted: Timestamp, turns: u32, unit: Duration) -> Timestamp {
        granted.after(unit.saturating_mul(turns)).after(self.round_trip.unwrap_or(policy::ROUND_TRIP_GUESS))
    }
}

/// All connected workers.
#[derive(Debug, Default)]
pub(crate) struct Workers {
    pub by_id: BTreeMap<WorkerId, Worker>,
    /// Those with room, the emptiest first.
    pub with_room: BTreeSet<(u64, WorkerId)>,
    /// Each worker at a moment not after that at which it counts as silent.
    checks: BTreeSet<(Timestamp, WorkerId)>,
}

impl Workers {
    pub fn add(&mut self, id: WorkerId, worker: Worker, silent_at: Timestamp) {
        self.by_id.insert(id, worker);
        self.checks.insert((silent_at, id));
    }

    pub fn get(&self, id: WorkerId) -> Option<&Worker> {
        self.by_id.get(&id)
    }

    pub fn get_mut(&mut self, id: WorkerId) -> Option<&mut Worker> {
        self.by_id.get_mut(&id)
    }

    pub fn remove(&mut self, id: WorkerId) -> Option<Worker> {
        self.set_room(id, false);
        self.by_id.remove(&id)
    }

    /// Those that may be given something.
    pub fn usable<'a>(&'a self, health: &'a Health) -> impl Iterator<Item = (WorkerId, &'a Worker)> {
        self.by_id
            .iter()
            .map(|(id, worker)| (*id, worker))
            .filter(|(_, worker)| !worker.draining && health.is_trusted(&worker.name))
    }

    /// Files a worker by how full it is, or takes it out.
    pub fn set_room(&mut self, id: WorkerId, has_room: bool) {
        let Some(worker) = self.by_id.get_mut(&id) else { return };
        let place = has_room.then(|| worker.load());
        if worker.filed == place {
            return;
        }
        if let Some(load) = worker.filed {
            self.with_room.remove(&(load, id));
        }
        if let Some(load) = place {
            self.with_room.insert((load, id));
        }
        worker.filed = place;
    }

    /// The next moment at which somebody may have been silent for too long.
    pub fn next_check(&self) -> Option<Timestamp> {
        self.checks.first().map(|(moment, _)| *moment)
    }

    /// A worker that has been silent for `patience`.
    pub fn silent(&mut self, now: Timestamp, patience: Duration) -> Option<WorkerId> {
        while let Some(&(moment, id)) = self.checks.first().filter(|(moment, _)| *moment <= now) {
            self.checks.remove(&(moment, id));
            match self.by_id.get(&id).map(|worker| worker.heard.after(patience)) {
                Some(silent_at) if silent_at > now => self.checks.insert((silent_at, id)),
                Some(_) => return Some(id),
                None => false,
            };
        }
        None
    }
}
