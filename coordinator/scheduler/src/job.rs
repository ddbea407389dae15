//! The jobs, and whose turn it is.

use crate::checks::Checks;
use crate::cost::Costs;
use crate::plan::{Plan, pixel_samples};
use crate::policy;
use crate::provenance::Provenance;
use crate::queue::Queue;
use farm_film::WorkUnit;
use farm_job::{JobId, JobSpec, JobSpecError, JobState, LeaseId};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// One job.
#[derive(Debug)]
pub(crate) struct Job {
    pub name: String,
    pub state: JobState,
    pub queue: Queue,
    /// What is being compared.
    pub checks: Checks,
    /// Frames that have all their samples and wait for their checks, by position, with their samples per pixel.
    pub held: BTreeMap<u32, u64>,
    pub provenance: Provenance,
    priority: i32,
    /// Nanoseconds of rendering granted to it, on the scale of its priority class.
    charged: u64,
    /// Its place among those whose turn it may be.
    filed: Option<Turn>,
    /// What its tiles cost.
    pub costs: Costs,
    /// Pixel samples of cost 1 per second and slot over all workers, smoothed.
    pub speed: Option<f64>,
    /// The same over the last few units of every slot, slow ones and fast ones: what the farm as a whole gets done.
    pub pace: Pace,
    pub leases: u64,
    pub units_done: u64,
    pub failures: u64,
    pub expired: u64,
    pub duplicates: u64,
    pub verified: u64,
    pub unverified: u64,
    pub render: Duration,
    pub fault: Option<String>,
}

/// What slots get done, by time.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Pace {
    samples: f64,
    seconds: f64,
}

impl Pace {
    /// Learns from a unit, and forgets what was before the last few of each of `slots` slots.
    pub fn measure(&mut self, samples: f64, render: Duration, slots: u64) {
        let keep = 1.0 - 1.0 / (policy::UNITS_REMEMBERED * slots.max(1) as f64);
        self.samples = self.samples * keep + samples;
        self.seconds = self.seconds * keep + render.as_secs_f64();
    }

    /// Pixel samples per second and slot, once measured.
    pub fn speed(&self) -> Option<f64> {
        (self.seconds > 0.0).then(|| self.samples / self.seconds)
    }
}

/// Higher priority first, then who got least.
type Turn = (Reverse<i32>, u64, JobId);

impl Job {
    fn new(spec: &JobSpec, charged: u64) -> Result<Self, JobSpecError> {
        Ok(Self {
            name: spec.name.clone(),
            state: JobState::Running,
            queue: Queue::new(Plan::new(spec)?),
            checks: Checks::default(),
            held: BTreeMap::new(),
            provenance: Provenance::default(),
            priority: spec.priority,
            charged,
            filed: None,
            costs: Costs::default(),
            speed: None,
            pace: Pace::default(),
            leases: 0,
            units_done: 0,
            failures: 0,
            expired: 0,
            duplicates: 0,
            verified: 0,
            unverified: 0,
            render: Duration::ZERO,
            fault: None,
        })
    }

    pub fn priority(&self) -> i32 {
        self.priority
    }

    /// Pixel samples that are not durable.
    pub fn samples_left(&self) -> u128 {
        self.queue.progress().samples() - self.queue.progress().samples_done()
    }

    /// A unit as pixel samples of cost 1.
    pub fn work(&self, unit: &WorkUnit) -> f64 {
        let tile = self.queue.plan().tile_position(unit.tile);
        pixel_samples(unit) * tile.map_or(1.0, |tile| self.costs.of(tile))
    }

    /// Seconds until all of it is done if `slots` slots do nothing else; none before anything was measured.
    pub fn seconds_left(&self, slots: u64) -> Option<f64> {
        let work = self.samples_left() as f64 * self.costs.mean();
        self.pace.speed().map(|pace| work / (pace * slots.max(1) as f64))
    }

    /// Whether there is anything to give out.
    pub fn has_open(&self) -> bool {
        self.queue.has_open() || self.checks.any_waiting()
    }

    /// Whether nothing is left to do.
    pub fn is_done(&self) -> bool {
        self.queue.is_done() && self.held.is_empty() && self.checks.is_empty()
    }

    /// Every lease on anything.
    pub fn all_leases(&self) -> Vec<LeaseId> {
        self.queue.leases().chain(self.checks.leases()).collect()
    }

    fn turn(&self, id: JobId) -> Option<Turn> {
        (self.state == JobState::Running && self.has_open()).then_some((
            Reverse(self.priority),
            self.charged,
            id,
        ))
    }
}

/// All jobs.
#[derive(Debug, Default)]
pub(crate) struct Jobs {
    pub by_id: BTreeMap<JobId, Job>,
    /// Running jobs with open units, the next one first.
    turns: BTreeSet<Turn>,
    /// What the job that was served last in each priority class had been charged. Who comes or comes back starts there:
    /// time spent idle is no credit.
    floors: BTreeMap<i32, u64>,
}

impl Jobs {
    /// Adds a job, in place of one of the same name. It takes its turns from the next `file` on.
    pub fn add(&mut self, id: JobId, spec: &JobSpec) -> Result<&mut Job, JobSpecError> {
        let job = Job::new(spec, self.floor(spec.priority))?;
        if let Some(turn) = self.by_id.remove(&id).and_then(|before| before.filed) {
            self.turns.remove(&turn);
        }
        Ok(self.by_id.entry(id).or_insert(job))
    }

    pub fn get(&self, id: JobId) -> Option<&Job> {
        self.by_id.get(&id)
    }

    pub fn get_mut(&mut self, id: JobId) -> Option<&mut Job> {
        self.by_id.get_mut(&id)
    }

    /// Whether some job has something to give out.
    pub fn any_turn(&self) -> bool {
        !self.turns.is_empty()
    }

    /// The job whose turn is next after `before`, or first.
    pub fn next_turn(&self, before: Option<JobId>) -> Option<JobId> {
        let turn = before.and_then(|id| self.get(id)?.filed);
        match turn {
            Some(turn) => {
                self.turns.range((std::ops::Bound::Excluded(turn), std::ops::Bound::Unbounded)).next()
            }
            None => self.turns.first(),
        }
        .map(|(_, _, id)| *id)
    }

    /// Whether all jobs with something open are done within `time` if `slots` slots do nothing else.
    pub fn are_done_within(&self, time: Duration, slots: u64) -> bool {
        let mut left = 0.0;
        self.turns.iter().filter_map(|(_, _, id)| self.get(*id)).all(|job| {
            left += job.seconds_left(slots).unwrap_or(f64::INFINITY);
            left <= time.as_secs_f64()
        })
    }

    /// Puts a job in line, or takes it out, after its state or its units have changed.
    pub fn file(&mut self, id: JobId) {
        let floor = self.get(id).map_or(0, |job| self.floor(job.priority));
        let Some(job) = self.by_id.get_mut(&id) else { return };
        if job.filed.is_none() {
            job.charged = job.charged.max(floor);
        }
        let turn = job.turn(id);
        if job.filed == turn {
            return;
        }
        if let Some(before) = std::mem::replace(&mut job.filed, turn) {
            self.turns.remove(&before);
        }
        self.turns.extend(turn);
    }

    /// Charges a job for a unit that takes `nanoseconds`.
    pub fn charge(&mut self, id: JobId, nanoseconds: u64) {
        let Some(job) = self.by_id.get_mut(&id) else { return };
        self.floors.insert(job.priority, job.charged);
        job.charged = job.charged.saturating_add(nanoseconds);
        self.file(id);
    }

    /// Takes back the charge for a unit that was not rendered.
    pub fn refund(&mut self, id: JobId, nanoseconds: u64) {
        let Some(job) = self.by_id.get_mut(&id) else { return };
        job.charged = job.charged.saturating_sub(nanoseconds);
        self.file(id);
    }

    /// Moves a job to another priority class, where it starts like a newcomer.
    pub fn set_priority(&mut self, id: JobId, priority: i32) {
        let floor = self.floor(priority);
        let Some(job) = self.by_id.get_mut(&id) else { return };
        if job.priority != priority {
            (job.priority, job.charged) = (priority, floor);
        }
        self.file(id);
    }

    fn floor(&self, priority: i32) -> u64 {
        self.floors.get(&priority).copied().unwrap_or(0)
    }
}
