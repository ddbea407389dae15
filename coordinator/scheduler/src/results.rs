//! Results come in, are claimed, and settled.

use crate::lease::Work;
use crate::piece::History;
use crate::plan::pixel_samples;
use crate::verify::Claim;
use crate::{Delivery, JobFault, Scheduler, Timestamp, policy};
use farm_film::WorkUnit;
use farm_job::{JobId, LeaseId, WorkerId};
use std::sync::Arc;
use std::time::Duration;

/// What to do with a result that has come in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// All its samples are open: verify it, store it, acknowledge it.
    Wanted,
    /// Some or all of its samples are there or on their way to the store, or its job or frame has ended: acknowledge it
    /// as not needed and drop it.
    NotNeeded,
    /// It is no unit of its job: refuse it.
    Foreign,
    /// Its samples are there already, and it was compared with them: acknowledge it as not needed and drop it.
    Compared,
    /// Whoever sent it delivers wrong results, or left so long ago that nobody could be held to it: refuse it.
    Distrusted,
}

impl Scheduler {
    /// Whether a result would be claimed, without claiming it.
    pub fn wants(&self, job: JobId, unit: &WorkUnit) -> Verdict {
        match self.jobs.get(job) {
            Some(job) if !job.state.is_final() => job.queue.verdict(unit),
            _ => Verdict::NotNeeded,
        }
    }

    /// Takes a result off its worker's hands, whose lease ends with it, and reserves its samples if they are
    /// [`Verdict::Wanted`]. Then exactly one of [`crate::Event::UnitAccepted`], [`crate::Event::StoreFailed`] and
    /// [`crate::Event::ResultRejected`] must follow for the same delivery, also when the worker has left meanwhile.
    pub fn claim(&mut self, now: Timestamp, delivery: &Delivery) -> Verdict {
        self.pass_time(now);
        self.hear(delivery.worker);
        let verdict = self.reserve(delivery);
        self.dispatch();
        self.waive_checks();
        self.forget_dismissed();
        verdict
    }

    pub(crate) fn unit_accepted(&mut self, delivery: &Delivery, render: Duration) {
        let claim = match self.end_claim(delivery) {
            Some(claim) => claim,
            // A shell that did not ask before gets the answer now.
            None if self.reserve(delivery) == Verdict::Wanted => match self.end_claim(delivery) {
                Some(claim) => claim,
                None => return,
            },
            None => return,
        };
        if claim.void {
            return;
        }
        let Some(job) = self.jobs.get_mut(delivery.job) else { return };
        let accepted = job.queue.accept(&delivery.unit);
        if accepted.is_some() {
            let render = policy::plausible(render);
            let samples = pixel_samples(&delivery.unit);
            let work = job.work(&delivery.unit);
            job.speed = Some(policy::smooth(job.speed, work / render.as_secs_f64()));
            job.pace.measure(work, render, self.slots);
            job.units_done += 1;
            job.render = job.render.saturating_add(render);
            if let Some(worker) = self.workers.get_mut(delivery.worker) {
                let speed = worker.measure(delivery.job, samples, work, render);
                if let Some(tile) = job.queue.plan().tile_position(delivery.unit.tile) {
                    job.costs.learn(tile, render.as_secs_f64() * speed / samples);
                }
                worker.units_done += 1;
                self.health.success(&worker.name);
            }
            if let Some(name) = &claim.name {
                self.note_origin(delivery, name);
            }
        }
        self.settle(delivery.job, accepted);
        self.refile_worker(delivery.worker);
    }

    pub(crate) fn store_failed(&mut self, delivery: &Delivery) {
        if self.end_claim(delivery).is_some_and(|claim| !claim.void) {
            self.unreserve(delivery, None);
        }
    }

    pub(crate) fn result_rejected(&mut self, delivery: &Delivery, reason: String) {
        self.hear(delivery.worker);
        let name = self.workers.get(delivery.worker).map(|worker| worker.name.clone());
        match self.end_claim(delivery) {
            Some(claim) if claim.void => {}
            Some(_) => self.unreserve(delivery, name),
            None => {
                let given_up = self.give_up_lease(delivery.worker, delivery.lease);
                self.note_rejected(given_up, name);
            }
        }
        let Some(job) = self.jobs.get_mut(delivery.job) else { return };
        job.failures += 1;
        // What came too late is nobody's fault.
        if !job.state.is_final() {
            self.blame(delivery.worker, delivery.job, false, reason);
        }
    }

    pub(crate) fn unit_failed(&mut self, id: WorkerId, lease: LeaseId, reason: String) {
        self.hear(id);
        let Some((job_id, work)) = self.give_up_lease(id, lease) else { return };
        let name = self.workers.get(id).map(|worker| worker.name.clone());
        if let Some(job) = self.jobs.get_mut(job_id) {
            job.failures += 1;
            if let Work::Piece(key) = work
                && let Some(history) = job.queue.history_mut(key)
            {
                history.failures.extend(name.clone());
            }
        }
        self.check_failed(job_id, work, name);
        self.blame(id, job_id, true, reason.clone());
        let Work::Piece(key) = work else { return };
        let Some(job) = self.jobs.get(job_id) else { return };
        let (Some(piece), Some(unit)) = (job.queue.piece(key), job.queue.unit(key)) else { return };
        if !self.is_hopeless(job_id, &piece.history) {
            return;
        }
        let fault = JobFault::UnitFailed {
            unit,
            times: piece.history.failures.len() as u32,
            workers: piece.history.failed_on().into_iter().map(|name| name.to_string()).collect(),
            reason,
        };
        self.fail_job(job_id, fault);
        if self.health.absolve(job_id) {
            self.refile_workers();
        }
    }

    pub(crate) fn unit_returned(&mut self, id: WorkerId, lease: LeaseId) {
        self.hear(id);
        self.give_up_lease(id, lease);
    }

    /// Ends a lease that its worker will not answer; the piece it was for.
    fn give_up_lease(&mut self, worker: WorkerId, id: LeaseId) -> Option<(JobId, Work)> {
        self.leases.get(id).filter(|lease| lease.worker == worker)?;
        let lease = self.end_lease(id)?;
        let at = (lease.job, lease.work);
        self.open_again(id, Some(lease));
        Some(at)
    }

    fn reserve(&mut self, delivery: &Delivery) -> Verdict {
        let answered = self.leases.get(delivery.lease).filter(|lease| lease.worker == delivery.worker);
        if answered.is_some_and(|lease| lease.job == delivery.job) {
            let lease = self.end_lease(delivery.lease).expect("the lease was just seen");
            self.release(delivery.lease, &lease);
        }
        let name = self.workers.get(delivery.worker).map(|worker| worker.name.clone());
        let accountable = name.as_ref().is_some_and(|name| !self.health.is_liar(name));
        if self.config.verify > 0.0 && !accountable {
            return Verdict::Distrusted;
        }
        let verdict = self.wants(delivery.job, &delivery.unit);
        let Some(job) = self.jobs.get_mut(delivery.job) else { return verdict };
        match verdict {
            Verdict::Wanted => {
                let displaced = job.queue.reserve(&delivery.unit);
                self.revoke(displaced);
                self.claims.insert(*delivery, Claim { name, void: false });
                if let Some(worker) = self.workers.get_mut(delivery.worker) {
                    worker.storing += 1;
                }
                self.refile_worker(delivery.worker);
            }
            Verdict::NotNeeded => {
                job.duplicates += 1;
                if self.compare(delivery) {
                    return Verdict::Compared;
                }
            }
            Verdict::Foreign | Verdict::Compared | Verdict::Distrusted => {}
        }
        self.jobs.file(delivery.job);
        verdict
    }

    /// Opens a claimed unit again; `rejected`: for others than whoever sent this.
    fn unreserve(&mut self, delivery: &Delivery, rejected: Option<Arc<str>>) {
        if let Some(job) = self.jobs.get_mut(delivery.job) {
            job.queue.unreserve(&delivery.unit, rejected);
            self.jobs.file(delivery.job);
        }
    }

    /// Ends a claim, if there was one.
    fn end_claim(&mut self, delivery: &Delivery) -> Option<Claim> {
        let claim = self.claims.remove(delivery)?;
        if let Some(worker) = self.workers.get_mut(delivery.worker) {
            worker.storing = worker.storing.saturating_sub(1);
            self.refile_worker(delivery.worker);
        }
        Some(claim)
    }

    /// What is on its way to the store for an earlier job of the same name counts for nothing.
    pub(crate) fn forget_claims(&mut self, job: JobId) {
        for (_, claim) in self.claims.iter_mut().filter(|(delivery, _)| delivery.job == job) {
            claim.void = true;
        }
    }

    /// Lets others try a unit first of which a worker sent something that is no result.
    fn note_rejected(&mut self, given_up: Option<(JobId, Work)>, name: Option<Arc<str>>) {
        let Some((job, work)) = given_up else { return };
        if let (Some(job), Work::Piece(key)) = (self.jobs.get_mut(job), work)
            && let Some(history) = job.queue.history_mut(key)
        {
            history.rejected.extend(name.clone());
        }
        self.check_failed(job, work, name);
    }

    /// Whether a unit has failed wherever it could be tried.
    fn is_hopeless(&self, job: JobId, history: &History) -> bool {
        let untried = || {
            self.workers
                .usable(&self.health)
                .any(|(_, worker)| !worker.refused.contains_key(&job) && !history.disappointed(&worker.name))
        };
        let times = history.failures.len();
        times >= policy::FAILURES_MAX
            && (history.failed_on().len() >= policy::FAILURES_MAX
                || times >= policy::FAILURES_EVER
                || !untried())
    }
}
