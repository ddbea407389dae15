//! Workers come, are heard, and go.

use crate::lease::Work;
use crate::worker::Worker;
use crate::{Action, JobFault, Scheduler, WhyDisconnect, policy};
use farm_job::{JobId, LeaseId, WorkerId};
use std::time::Duration;

impl Scheduler {
    pub(crate) fn worker_joined(&mut self, id: WorkerId, name: String, slots: u32) {
        self.worker_left(id);
        let silent_at = self.now.after(self.config.lease_ttl);
        self.workers.add(id, Worker::new(name.into(), slots, self.now), silent_at);
        self.refile_worker(id);
        self.count_slots();
    }

    pub(crate) fn heartbeat(&mut self, id: WorkerId, leases: &[LeaseId], round_trip: Option<Duration>) {
        self.hear(id);
        let Some(worker) = self.workers.get_mut(id) else { return };
        worker.round_trip = round_trip.or(worker.round_trip);
        let deadline = self.now.after(self.config.lease_ttl);
        for lease in leases {
            self.leases.renew(id, *lease, deadline);
        }
        self.refile_worker(id);
    }

    /// Notes a sign of life.
    pub(crate) fn hear(&mut self, id: WorkerId) {
        let now = self.now;
        if let Some(worker) = self.workers.get_mut(id) {
            worker.heard = now;
        }
    }

    pub(crate) fn worker_draining(&mut self, id: WorkerId) {
        self.hear(id);
        let Some(worker) = self.workers.get_mut(id) else { return };
        worker.draining = true;
        self.refile_worker(id);
        self.count_slots();
    }

    /// Sends a worker off that drains and owes nothing any more.
    pub(crate) fn dismiss_if_drained(&mut self, id: WorkerId) {
        let Some(worker) = self.workers.get_mut(id) else { return };
        if worker.draining && !worker.dismissed && worker.leases.is_empty() && worker.storing == 0 {
            worker.dismissed = true;
            self.dismissed.push(id);
            self.actions.push_back(Action::Disconnect { worker: id, why: WhyDisconnect::Drained });
        }
    }

    /// Forgets those that were sent off: their connections end without another word.
    pub(crate) fn forget_dismissed(&mut self) {
        while let Some(id) = self.dismissed.pop() {
            self.workers.remove(id);
        }
    }

    pub(crate) fn worker_left(&mut self, id: WorkerId) {
        let Some(worker) = self.workers.remove(id) else { return };
        // It was rendering its oldest leases; the others only waited.
        for (position, lease_id) in worker.leases.iter().enumerate() {
            let lease = self.end_lease(*lease_id);
            let at = lease.as_ref().map(|lease| (lease.job, lease.work));
            self.count_expired(lease.as_ref());
            self.open_again(*lease_id, lease);
            if let Some((job, Work::Piece(piece))) = at.filter(|_| position < worker.slots as usize) {
                self.count_loss(job, piece);
            }
        }
        self.count_slots();
    }

    fn count_loss(&mut self, id: JobId, key: crate::piece::PieceKey) {
        let Some(job) = self.jobs.get_mut(id) else { return };
        let Some(history) = job.queue.history_mut(key) else { return };
        history.losses += 1;
        let times = history.losses;
        let unit = job.queue.unit(key);
        if let Some(unit) = unit.filter(|_| times >= policy::LOSSES_MAX) {
            self.fail_job(id, JobFault::UnitLost { unit, times });
        }
    }

    pub(crate) fn job_refused(&mut self, id: WorkerId, job: JobId, reason: String) {
        self.hear(id);
        let is_open = self.jobs.get(job).is_some_and(|job| !job.state.is_final());
        let Some(worker) = self.workers.get_mut(id).filter(|_| is_open) else { return };
        worker.refused.insert(job, reason);
        let held: Vec<LeaseId> = worker.leases.iter().copied().collect();
        for lease in held {
            if self.leases.get(lease).is_some_and(|lease| lease.job == job) {
                self.take_back(lease);
            }
        }
    }

    /// Counts a failure against a worker. `of_unit`: the unit may be at fault as well, so that the last worker left is spared.
    pub(crate) fn blame(&mut self, id: WorkerId, job: JobId, of_unit: bool, reason: String) {
        let Some(worker) = self.workers.get_mut(id) else { return };
        worker.failures += 1;
        let name = worker.name.clone();
        let is_last = !self.workers.usable(&self.health).any(|(_, other)| other.name != name);
        let Some(until) = self.health.strike(&name, job, of_unit && is_last, self.now) else { return };
        self.actions.push_back(Action::Quarantine { worker: id, until, reason });
        let held: Vec<LeaseId> = self
            .workers
            .by_id
            .values()
            .filter(|worker| worker.name == name)
            .flat_map(|worker| worker.leases.iter().copied())
            .collect();
        for lease in held {
            self.take_back(lease);
        }
        self.refile_workers();
    }

    /// After somebody's quarantine began or ended.
    pub(crate) fn refile_workers(&mut self) {
        let ids: Vec<WorkerId> = self.workers.by_id.keys().copied().collect();
        for id in ids {
            self.refile_worker(id);
        }
        self.count_slots();
    }

    fn count_slots(&mut self) {
        self.slots = self.workers.usable(&self.health).map(|(_, worker)| u64::from(worker.slots)).sum();
    }
}
