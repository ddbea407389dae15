//! The state machine: takes events in, and sends each to the part that it concerns.

use crate::cost::Costs;
use crate::health::{Health, Reputation};
use crate::job::Jobs;
use crate::lease::{Lease, Leases, Work};
use crate::piece::PieceKey;
use crate::progress::Milestone;
use crate::queue::Accepted;
use crate::verify::Claim;
use crate::worker::Workers;
use crate::{Action, Config, Delivery, Event, JobFault, Origin, Timestamp, WhyDisconnect, policy};
use farm_film::{FrameIndex, Tile, WorkUnit};
use farm_job::{JobId, JobSpec, JobState, LeaseId, WorkerId};
use std::collections::{BTreeMap, VecDeque};

/// The mind of the farm.
#[derive(Debug)]
pub struct Scheduler {
    pub(crate) config: Config,
    pub(crate) now: Timestamp,
    /// Nobody counts as silent before this.
    grace_until: Timestamp,
    /// Until this, comparisons wait for workers that may come back.
    pub(crate) checks_until: Timestamp,
    pub(crate) jobs: Jobs,
    pub(crate) workers: Workers,
    pub(crate) health: Health,
    pub(crate) leases: Leases,
    /// Deliveries on their way to the store.
    pub(crate) claims: BTreeMap<Delivery, Claim>,
    /// Workers that were sent off and are forgotten when the event at hand is dealt with.
    pub(crate) dismissed: Vec<WorkerId>,
    /// Slots of all workers that may be given something.
    pub(crate) slots: u64,
    pub(crate) actions: VecDeque<Action>,
}

impl Scheduler {
    /// A farm without jobs and workers.
    pub fn new(config: Config) -> Self {
        Self {
            leases: Leases::new(config.first_lease),
            config,
            now: Timestamp::START,
            grace_until: Timestamp::START,
            checks_until: Timestamp::START,
            jobs: Jobs::default(),
            workers: Workers::default(),
            health: Health::default(),
            claims: BTreeMap::new(),
            dismissed: Vec::new(),
            slots: 0,
            actions: VecDeque::new(),
        }
    }

    /// Takes notice of an event. `now` never runs backwards; an earlier moment counts as the latest one seen.
    /// Names that are not known, any more or yet, are no error: messages cross on the wire.
    pub fn handle(&mut self, now: Timestamp, event: Event) {
        self.pass_time(now);
        match event {
            Event::JobSubmitted { job, spec, finished, durable, origins } => {
                self.job_submitted(job, &spec, &finished, &durable, &origins);
            }
            Event::ReputationRecalled(reputation) => {
                self.health.recall(reputation, self.now);
                self.refile_workers();
            }
            Event::WorkerForgiven { name } => {
                self.health.forgive(&name);
                self.refile_workers();
            }
            Event::JobPaused { job } => self.set_state(job, JobState::Running, JobState::Paused),
            Event::JobResumed { job } => self.set_state(job, JobState::Paused, JobState::Running),
            Event::JobCancelled { job } => self.job_cancelled(job),
            Event::JobRequeued { job } => self.job_requeued(job),
            Event::JobForgotten { job } => self.job_forgotten(job),
            Event::PriorityChanged { job, priority } => self.jobs.set_priority(job, priority),
            Event::FrameTruncated { job, frame, spp } => {
                self.truncate(job, frame, spp);
            }
            Event::TilesEnded { job, frame, tiles, spp } => self.end_tiles(job, frame, &tiles, spp),
            Event::WorkerJoined { worker, name, slots } => self.worker_joined(worker, name, slots),
            Event::Heartbeat { worker, leases, round_trip } => self.heartbeat(worker, &leases, round_trip),
            Event::WorkerDraining { worker } => self.worker_draining(worker),
            Event::WorkerLeft { worker } => self.worker_left(worker),
            Event::JobRefused { worker, job, reason } => self.job_refused(worker, job, reason),
            Event::UnitAccepted { delivery, render } => self.unit_accepted(&delivery, render),
            Event::StoreFailed { delivery } => self.store_failed(&delivery),
            Event::ResultRejected { delivery, reason } => self.result_rejected(&delivery, reason),
            Event::UnitFailed { worker, lease, reason } => self.unit_failed(worker, lease, reason),
            Event::UnitReturned { worker, lease } => self.unit_returned(worker, lease),
            Event::Tick => {}
        }
        self.expire();
        self.dispatch();
        self.waive_checks();
        self.forget_dismissed();
    }

    /// What is to be remembered of workers.
    pub fn reputation(&self) -> Reputation {
        self.health.reputation(self.now)
    }

    /// The next thing to do; none when all is done.
    pub fn poll_action(&mut self) -> Option<Action> {
        self.actions.pop_front()
    }

    /// When to send a [`Event::Tick`] if nothing happens before; never if none.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        let silence = [self.leases.next_check(), self.workers.next_check()].into_iter().flatten().min();
        let silence = silence.map(|moment| moment.max(self.grace_until));
        let again = self.may_speculate().then(|| self.now.after(policy::SPECULATE_AGAIN));
        let waive = (self.now < self.checks_until).then_some(self.checks_until);
        [silence, self.health.next_pardon(), again, waive].into_iter().flatten().min()
    }

    pub(crate) fn pass_time(&mut self, now: Timestamp) {
        let overslept = self.next_deadline().is_some_and(|due| now > due.after(policy::OVERSLEPT));
        if overslept {
            self.grace_until = now.after(self.config.lease_ttl);
        }
        self.now = self.now.max(now);
    }

    /// Ends what has run out by now.
    fn expire(&mut self) {
        if self.health.pardon(self.now) {
            self.refile_workers();
        }
        if self.now < self.grace_until {
            return;
        }
        while let Some(id) = self.leases.expired(self.now) {
            let lease = self.end_lease(id);
            self.count_expired(lease.as_ref());
            self.open_again(id, lease);
        }
        while let Some(worker) = self.workers.silent(self.now, self.config.lease_ttl) {
            self.actions.push_back(Action::Disconnect { worker, why: WhyDisconnect::Silent });
            self.worker_left(worker);
        }
    }

    fn job_submitted(
        &mut self,
        id: JobId,
        spec: &JobSpec,
        finished: &[FrameIndex],
        durable: &[WorkUnit],
        origins: &[Origin],
    ) {
        if self.jobs.get(id).is_some_and(|job| !job.state.is_final()) {
            return;
        }
        self.forget_claims(id);
        let job = match self.jobs.add(id, spec) {
            Ok(job) => job,
            Err(error) => {
                self.actions.push_back(Action::JobFailed { job: id, fault: JobFault::Spec(error) });
                return;
            }
        };
        for frame in finished {
            job.queue.complete_frame(*frame);
        }
        let milestones = durable.iter().flat_map(|unit| job.queue.cover(unit)).collect();
        self.recall_origins(id, finished, origins);
        self.settle(id, Some(Accepted { displaced: Vec::new(), milestones }));
    }

    fn set_state(&mut self, id: JobId, from: JobState, to: JobState) {
        if let Some(job) = self.jobs.get_mut(id).filter(|job| job.state == from) {
            job.state = to;
            self.jobs.file(id);
        }
    }

    fn truncate(&mut self, id: JobId, frame: FrameIndex, spp: u64) {
        let Some(job) = self.jobs.get_mut(id) else { return };
        let Some(truncated) = job.queue.truncate(frame, spp) else { return };
        let compared = job.checks.remove_if(|unit| unit.frame == frame && unit.block.end() > spp);
        self.revoke(compared);
        self.settle(id, Some(truncated));
    }

    fn end_tiles(&mut self, id: JobId, frame: FrameIndex, tiles: &[Tile], spp: u64) {
        let Some(job) = self.jobs.get_mut(id) else { return };
        let Some(ended) = job.queue.end_tiles(frame, tiles, spp) else { return };
        let is_pointless =
            |unit: &WorkUnit| unit.frame == frame && unit.block.end() > spp && tiles.contains(&unit.tile);
        let compared = job.checks.remove_if(is_pointless);
        self.revoke(compared);
        self.settle(id, Some(ended));
    }

    fn job_cancelled(&mut self, id: JobId) {
        let Some(job) = self.jobs.get_mut(id).filter(|job| job.state != JobState::Done) else { return };
        job.state = JobState::Cancelled;
        let mut leases = job.queue.abandon();
        leases.extend(job.checks.remove_if(|_| true));
        job.held.clear();
        self.revoke(leases);
        self.end_job(id);
    }

    fn job_forgotten(&mut self, id: JobId) {
        if self.jobs.get(id).is_some_and(|job| job.state.is_final()) {
            self.forget_claims(id);
            self.jobs.by_id.remove(&id);
        }
    }

    fn job_requeued(&mut self, id: JobId) {
        let Some(job) = self.jobs.get_mut(id).filter(|job| job.state == JobState::Failed) else { return };
        job.state = JobState::Running;
        job.fault = None;
        job.queue.forgive();
        self.settle(id, None);
    }

    /// Gives a job up. What it has stays, for a new try.
    pub(crate) fn fail_job(&mut self, id: JobId, fault: JobFault) {
        let Some(job) = self.jobs.get_mut(id).filter(|job| !job.state.is_final()) else { return };
        job.state = JobState::Failed;
        job.fault = Some(fault.to_string());
        self.actions.push_back(Action::JobFailed { job: id, fault });
        let leases = self.jobs.get(id).map(|job| job.all_leases()).unwrap_or_default();
        for lease in leases {
            self.take_back(lease);
        }
        self.end_job(id);
    }

    /// Announces what was reached, and ends what became pointless and the job if nothing of it is left.
    pub(crate) fn settle(&mut self, id: JobId, accepted: Option<Accepted>) {
        let Some(job) = self.jobs.get_mut(id) else { return };
        if let Some(accepted) = accepted {
            for milestone in accepted.milestones {
                match milestone {
                    Milestone::Round { frame, spp } => {
                        let frame = job.queue.plan().frame(frame);
                        self.actions.push_back(Action::RoundComplete { job: id, frame, spp });
                    }
                    Milestone::Frame { frame, spp } => {
                        job.held.insert(frame, spp);
                    }
                }
            }
            self.revoke(accepted.displaced);
        }
        self.release_held(id);
        self.jobs.file(id);
    }

    /// Ends a job of which nothing is left to do.
    pub(crate) fn end_if_done(&mut self, id: JobId) {
        if let Some(job) = self.jobs.get_mut(id).filter(|job| !job.state.is_final() && job.is_done()) {
            job.state = JobState::Done;
            self.actions.push_back(Action::JobDone { job: id });
            self.end_job(id);
        }
    }

    fn end_job(&mut self, id: JobId) {
        for worker in self.workers.by_id.values_mut() {
            worker.forget(id);
        }
        if let Some(job) = self.jobs.get_mut(id) {
            job.costs = Costs::default();
        }
        self.jobs.file(id);
    }

    /// Ends leases whose pieces are gone.
    pub(crate) fn revoke(&mut self, leases: Vec<LeaseId>) {
        for id in leases {
            if let Some(lease) = self.end_lease(id) {
                self.actions.push_back(Action::Revoke { worker: lease.worker, lease: id });
            }
        }
    }

    /// Ends a lease that its worker still holds, and opens its piece again.
    pub(crate) fn take_back(&mut self, id: LeaseId) {
        let lease = self.end_lease(id);
        if let Some(lease) = &lease {
            self.actions.push_back(Action::Revoke { worker: lease.worker, lease: id });
        }
        self.open_again(id, lease);
    }

    /// Ends a lease; its piece does not know yet.
    pub(crate) fn end_lease(&mut self, id: LeaseId) -> Option<Lease> {
        let lease = self.leases.remove(id)?;
        if let Some(job) = self.jobs.get_mut(lease.job) {
            job.leases -= 1;
        }
        if let Some(worker) = self.workers.get_mut(lease.worker) {
            worker.leases.remove(&id);
        }
        self.refile_worker(lease.worker);
        Some(lease)
    }

    /// Gives a lease's piece back to its job, which takes its charge back.
    pub(crate) fn open_again(&mut self, id: LeaseId, lease: Option<Lease>) {
        let Some(lease) = lease else { return };
        self.release(id, &lease);
        self.jobs.refund(lease.job, lease.cost);
    }

    pub(crate) fn count_expired(&mut self, lease: Option<&Lease>) {
        if let Some(job) = lease.and_then(|lease| self.jobs.get_mut(lease.job)) {
            job.expired += 1;
        }
    }

    /// Tells what an ended lease was for that it has ended.
    pub(crate) fn release(&mut self, id: LeaseId, lease: &Lease) {
        match lease.work {
            Work::Piece(piece) => {
                if let Some(job) = self.jobs.get_mut(lease.job) {
                    job.queue.release(piece, id);
                }
                self.refile_piece(lease.job, piece);
            }
            Work::Check(unit) => self.release_check(lease.job, &unit, id),
        }
    }

    /// Notes whether exactly one worker renders a piece, which makes it fit for a duplicate.
    pub(crate) fn refile_piece(&mut self, job: JobId, key: PieceKey) {
        let piece = self.jobs.get(job).and_then(|job| job.queue.piece(key));
        let Some(piece) = piece else { return };
        let alone = piece.leases.len() == 1 && !piece.storing;
        for id in piece.leases.clone() {
            self.leases.set_alone(id, alone);
        }
    }

    /// Notes whether a worker has room for more.
    pub(crate) fn refile_worker(&mut self, id: WorkerId) {
        let Some(worker) = self.workers.get(id) else { return };
        let has_room = self.health.is_trusted(&worker.name) && worker.has_room(self.config.target_unit);
        self.workers.set_room(id, has_room);
        self.dismiss_if_drained(id);
    }
}
