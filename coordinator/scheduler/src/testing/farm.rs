//! A farm that does what a story says, and nothing else.

use super::honest;
use crate::{Action, Config, Delivery, Event, JobStatus, Origin, Scheduler, Timestamp, Verdict};
use farm_film::{FrameIndex, SampleBlock, WorkUnit};
use farm_job::{Digest, JobId, JobSpec, JobState, LeaseId, WorkerId};
use std::collections::BTreeSet;
use std::time::Duration;

pub(crate) const A: WorkerId = WorkerId(1);
pub(crate) const B: WorkerId = WorkerId(2);
pub(crate) const C: WorkerId = WorkerId(3);

pub(crate) const JOB: JobId = JobId(0);
pub(crate) const OTHER_JOB: JobId = JobId(1);

/// A unit in a worker's hands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Held {
    pub worker: WorkerId,
    pub lease: LeaseId,
    pub job: JobId,
    pub unit: WorkUnit,
    pub attempt: u32,
}

/// A scheduler with its workers, who obey and send heartbeats unless they are silenced, and render when told to.
pub(crate) struct Farm {
    pub scheduler: Scheduler,
    pub now: Timestamp,
    pub held: Vec<Held>,
    /// Everything but grants and revocations.
    pub news: Vec<Action>,
    connected: BTreeSet<WorkerId>,
    silent: BTreeSet<WorkerId>,
    jobs: u64,
}

impl Farm {
    /// `count` workers of one slot, called A, B, ..; nobody speculates.
    pub fn with_workers(count: u64) -> Self {
        Self::of(count, Config { speculate: false, ..Config::default() })
    }

    /// The same, but idle workers copy slow units.
    pub fn speculating(count: u64) -> Self {
        Self::of(count, Config::default())
    }

    /// The same, but nobody speculates and each result is compared with that of another worker.
    pub fn verifying(count: u64) -> Self {
        Self::of(count, Config { speculate: false, verify: 1.0, ..Config::default() })
    }

    pub fn of(count: u64, config: Config) -> Self {
        let mut farm = Self {
            scheduler: Scheduler::new(config),
            now: Timestamp::START,
            held: Vec::new(),
            news: Vec::new(),
            connected: BTreeSet::new(),
            silent: BTreeSet::new(),
            jobs: 0,
        };
        for id in 1..=count {
            farm.join(WorkerId(id), 1);
        }
        farm
    }

    pub fn join(&mut self, worker: WorkerId, slots: u32) {
        self.connected.insert(worker);
        let name = char::from(b'A' + worker.0 as u8 - 1).to_string();
        self.tell(Event::WorkerJoined { worker, name, slots });
    }

    /// Submits the next job: [`JOB`], then [`OTHER_JOB`].
    pub fn submit(self, spec: JobSpec) -> Self {
        self.restarted_with(spec, Vec::new())
    }

    /// Submits a job of which some is there already.
    pub fn restarted_with(self, spec: JobSpec, durable: Vec<WorkUnit>) -> Self {
        self.recalling(spec, Vec::new(), durable, Vec::new())
    }

    /// Submits a job of which some is there already, of known origin.
    pub fn recalling(
        mut self,
        spec: JobSpec,
        finished: Vec<FrameIndex>,
        durable: Vec<WorkUnit>,
        origins: Vec<Origin>,
    ) -> Self {
        let job = JobId(self.jobs);
        self.jobs += 1;
        self.tell(Event::JobSubmitted { job, spec: Box::new(spec), finished, durable, origins });
        self
    }

    pub fn tell(&mut self, event: Event) {
        self.scheduler.handle(self.now, event);
        self.perform();
    }

    fn perform(&mut self) {
        while let Some(action) = self.scheduler.poll_action() {
            match action {
                Action::Grant { worker, lease, job, unit, attempt, .. } => {
                    self.held.push(Held { worker, lease, job, unit, attempt });
                }
                Action::Revoke { lease, .. } => self.held.retain(|held| held.lease != lease),
                Action::Disconnect { worker, .. } => {
                    self.connected.remove(&worker);
                    self.news.push(action);
                }
                action => self.news.push(action),
            }
        }
    }

    /// Lets time pass, with heartbeats and at the scheduler's deadlines.
    pub fn advance(&mut self, time: Duration) {
        let end = self.now.after(time);
        while self.now < end {
            let next = self.now.after(Duration::from_millis(500)).min(end);
            self.now = self.scheduler.next_deadline().map_or(next, |due| due.clamp(self.now, next));
            self.tell(Event::Tick);
            if self.now == next {
                self.heartbeats();
            } else {
                self.now = self.now.after(Duration::from_nanos(1));
            }
        }
    }

    pub fn heartbeats(&mut self) {
        for worker in self.connected.difference(&self.silent).copied().collect::<Vec<_>>() {
            let leases = self.held_by(worker).iter().map(|held| held.lease).collect();
            self.tell(Event::Heartbeat { worker, leases, round_trip: None });
        }
    }

    /// Nothing more is heard of a worker.
    pub fn silence(&mut self, worker: WorkerId) {
        self.silent.insert(worker);
    }

    pub fn held_by(&self, worker: WorkerId) -> Vec<Held> {
        self.held.iter().filter(|held| held.worker == worker).copied().collect()
    }

    /// The first unit that a worker holds.
    pub fn first_of(&self, worker: WorkerId) -> Held {
        *self.held_by(worker).first().unwrap_or_else(|| panic!("worker {worker} holds nothing"))
    }

    pub fn claim(&mut self, held: Held) -> Verdict {
        self.claim_as(held, honest(&held.unit))
    }

    fn claim_as(&mut self, held: Held, digest: Digest) -> Verdict {
        self.held.retain(|other| other.lease != held.lease);
        let verdict = self.scheduler.claim(self.now, &Delivery { digest, ..delivery(held) });
        self.perform();
        verdict
    }

    /// A worker delivers some result of what it holds, which the store takes if it is wanted.
    pub fn finish_as(&mut self, held: Held, digest: Digest) -> Verdict {
        let verdict = self.claim_as(held, digest);
        if verdict == Verdict::Wanted {
            let delivery = Delivery { digest, ..delivery(held) };
            self.tell(Event::UnitAccepted { delivery, render: Duration::from_millis(100) });
        }
        verdict
    }

    /// A worker delivers what it holds after `render`, and the store takes it.
    pub fn finish(&mut self, held: Held, render: Duration) {
        assert_eq!(self.claim(held), Verdict::Wanted, "{} is wanted", held.unit);
        self.tell(Event::UnitAccepted { delivery: delivery(held), render });
    }

    pub fn fail(&mut self, held: Held) {
        self.held.retain(|other| other.lease != held.lease);
        let reason = "pdf is not finite".to_owned();
        self.tell(Event::UnitFailed { worker: held.worker, lease: held.lease, reason });
    }

    pub fn reject(&mut self, held: Held) {
        self.held.retain(|other| other.lease != held.lease);
        self.tell(Event::ResultRejected { delivery: delivery(held), reason: "digest differs".to_owned() });
    }

    /// Renders everything, each unit in a tenth of a second, until nobody holds anything.
    pub fn finish_all(&mut self) -> Vec<Held> {
        let mut finished = Vec::new();
        while let Some(&held) = self.held.first() {
            self.finish(held, Duration::from_millis(100));
            finished.push(held);
        }
        finished
    }

    /// The same where results are compared.
    pub fn finish_everything(&mut self) {
        while let Some(&held) = self.held.first() {
            self.finish_as(held, honest(&held.unit));
        }
    }

    pub fn job(&self, job: JobId) -> JobStatus {
        let status = self.scheduler.status(self.now);
        status.jobs.into_iter().find(|status| status.job == job).expect("the job was submitted")
    }

    pub fn expect_state(&self, job: JobId, state: JobState) {
        assert_eq!(self.job(job).state, state, "{:?}", self.job(job));
    }
}

/// What a worker sends when it has rendered what it holds.
pub(crate) fn delivery(held: Held) -> Delivery {
    Delivery {
        worker: held.worker,
        lease: held.lease,
        job: held.job,
        unit: held.unit,
        digest: honest(&held.unit),
    }
}

pub(crate) fn block(range: std::ops::Range<u64>) -> SampleBlock {
    SampleBlock::new(range).expect("a block")
}
