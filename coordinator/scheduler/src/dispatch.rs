//! Who gets what.

use crate::job::Job;
use crate::lease::{Lease, Work};
use crate::piece::Piece;
use crate::worker::Worker;
use crate::{Action, Scheduler, policy};
use farm_film::Tile;
use farm_job::{JobId, JobState, LeaseId, WorkerId};
use std::time::Duration;

impl Scheduler {
    /// Fills the workers, the emptiest first and one unit at a time, until none has room or nothing is open.
    pub(crate) fn dispatch(&mut self) {
        let mut passed_over = Vec::new();
        let is_ending = self.jobs.are_done_within(self.config.target_unit * policy::ENDING_UNITS, self.slots);
        while self.jobs.any_turn() {
            let Some(&(load, worker)) = self.workers.with_room.first() else { break };
            // What waits at one worker may soon be missing at another; the next one is not emptier.
            let hoards = || self.workers.get(worker).is_some_and(Worker::hoards);
            if is_ending && load >= Worker::FULL && hoards() {
                break;
            }
            if !self.grant_any(worker) {
                self.workers.set_room(worker, false);
                passed_over.push(worker);
            }
        }
        for worker in passed_over {
            self.refile_worker(worker);
        }
        if self.may_speculate() {
            self.speculate();
        }
    }

    /// Whether somebody has nothing to do while somebody else has.
    pub(crate) fn may_speculate(&self) -> bool {
        self.config.speculate
            && self.leases.any_alone()
            && self.workers.by_id.len() > 1
            && self.workers.with_room.first().is_some_and(|(load, _)| *load < Worker::FULL)
    }

    /// Gives a worker the next unit of the first job that has one for it.
    fn grant_any(&mut self, id: WorkerId) -> bool {
        let mut turn = self.jobs.next_turn(None);
        while let Some(job) = turn {
            if let Some(work) = self.next_work(id, job) {
                self.grant(id, job, work);
                return true;
            }
            turn = self.jobs.next_turn(Some(job));
        }
        false
    }

    fn next_work(&mut self, id: WorkerId, job_id: JobId) -> Option<Work> {
        let job = self.jobs.get_mut(job_id)?;
        let worker = self.workers.get(id).filter(|worker| !worker.refused.contains_key(&job_id))?;
        // The sooner a liar is found, the less of what it does is believed.
        let mut waiting = job.checks.waiting().take(policy::PIECES_LOOKED_AT);
        if let Some(unit) = waiting.find(|unit| job.checks.may(unit, &worker.name)) {
            return Some(Work::Check(unit));
        }
        let (target, slots) = (self.config.target_unit, self.slots);
        let speed = worker.speed_in(job_id).or(job.speed);
        let left = job.seconds_left(slots);
        // What failed here goes elsewhere, as long as there is an elsewhere.
        let may = |piece: &Piece| {
            let untried = |other: &Worker| {
                !other.refused.contains_key(&job_id) && !piece.history.disappointed(&other.name)
            };
            !piece.history.disappointed(&worker.name)
                || !self.workers.usable(&self.health).any(|(_, other)| untried(other))
        };
        let Job { queue, costs, .. } = job;
        let samples_max = |position: u32, tile: Tile| {
            policy::unit_samples(target, speed, tile.area() as f64 * costs.of(position), left)
        };
        queue.take(samples_max, may).map(Work::Piece)
    }

    fn grant(&mut self, id: WorkerId, job_id: JobId, work: Work) {
        let (Some(worker), Some(job)) = (self.workers.get(id), self.jobs.get_mut(job_id)) else { return };
        let unit = match work {
            Work::Check(unit) => Some(unit),
            Work::Piece(key) => {
                let holders = job.queue.piece(key).map(|piece| &piece.leases[..]).unwrap_or_default();
                let held = holders.iter().any(|lease| worker.leases.contains(lease));
                assert!(!held, "a worker holds a unit at most once");
                job.queue.unit(key)
            }
        };
        let Some(unit) = unit else { return };
        let time =
            render_time(job.work(&unit), worker.speed_in(job_id).or(job.speed), self.config.target_unit);
        let deadline = self.now.after(self.config.lease_ttl);
        let lease = Lease {
            worker: id,
            job: job_id,
            work,
            granted: self.now,
            deadline,
            turns: worker.turns(),
            expected: worker.expected(self.now, worker.turns(), time),
            cost: u64::try_from(time.as_nanos()).unwrap_or(u64::MAX),
        };
        let lease_id = self.leases.add(lease.clone());
        let attempt = match work {
            Work::Piece(key) => job.queue.lease(key, lease_id),
            Work::Check(unit) => job.checks.lease(&unit, lease_id),
        };
        job.leases += 1;
        if let Some(worker) = self.workers.get_mut(id) {
            worker.leases.insert(lease_id);
        }
        if let Work::Piece(key) = work {
            self.refile_piece(job_id, key);
        }
        self.refile_worker(id);
        self.jobs.charge(job_id, lease.cost);
        self.actions.push_back(Action::Grant {
            worker: id,
            lease: lease_id,
            job: job_id,
            unit,
            attempt,
            deadline,
        });
    }

    /// Gives idle slots a second copy of the slowest units, where that promises to be faster.
    fn speculate(&mut self) {
        let mut passed_over = Vec::new();
        while self.may_speculate() && passed_over.len() < policy::SPECULATORS_LOOKED_AT {
            let Some(&(_, worker)) = self.workers.with_room.first() else { break };
            match self.worth_a_copy(worker) {
                Some((job, work)) => self.grant(worker, job, work),
                None => {
                    self.workers.set_room(worker, false);
                    passed_over.push(worker);
                }
            }
        }
        for worker in passed_over {
            self.refile_worker(worker);
        }
    }

    fn worth_a_copy(&self, id: WorkerId) -> Option<(JobId, Work)> {
        let worker = self.workers.get(id)?;
        self.leases
            .slowest(self.now)
            .take(policy::SLOWEST_LOOKED_AT)
            .find(|(lease_id, lease)| self.is_worth_a_copy(worker, *lease_id, lease))
            .map(|(_, lease)| (lease.job, lease.work))
    }

    fn is_worth_a_copy(&self, worker: &Worker, lease_id: LeaseId, lease: &Lease) -> bool {
        let Some(job) = self.jobs.get(lease.job).filter(|job| job.state == JobState::Running) else {
            return false;
        };
        // Whoever is to be compared is not helped.
        let Work::Piece(key) = lease.work else { return false };
        let (Some(piece), Some(unit)) = (job.queue.piece(key), job.queue.unit(key)) else { return false };
        let excluded = worker.leases.contains(&lease_id)
            || worker.refused.contains_key(&lease.job)
            || piece.history.disappointed(&worker.name);
        if excluded {
            return false;
        }
        let Some(holder) = self.workers.get(lease.worker) else { return false };
        let time_on = |worker: &Worker| {
            render_time(job.work(&unit), worker.speed_in(lease.job).or(job.speed), self.config.target_unit)
        };
        // Late by half of its time, a result is expected after as long again as it took so far.
        let (own, its) = (time_on(worker), time_on(holder));
        let expected = holder.expected(lease.granted, lease.turns, its);
        let is_late = self.now > expected.after(its / 2);
        let predicted = if is_late { self.now.after(self.now.since(lease.granted)) } else { expected };
        // To win narrowly is not worth the work.
        worker.expected(self.now, worker.turns(), own + own / 2) < predicted
    }
}

/// Time that one slot needs for `work` pixel samples of cost 1; `unknown` before anything was measured.
fn render_time(work: f64, speed: Option<f64>, unknown: Duration) -> Duration {
    let seconds = speed.map(|speed| work / speed);
    seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok()).unwrap_or(unknown)
}
