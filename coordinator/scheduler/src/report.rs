//! Answers to those who ask how it goes.

use crate::job::Job;
use crate::worker::Worker;
use crate::{FrameStatus, JobStatus, Scheduler, Status, Timestamp, WhyIdle, WorkerStatus};
use farm_job::{JobId, JobState, WorkerId};

impl Scheduler {
    /// Everything one may want to show.
    pub fn status(&self, now: Timestamp) -> Status {
        Status {
            jobs: self.jobs.by_id.iter().map(|(id, job)| self.job_status(*id, job, now)).collect(),
            workers: self
                .workers
                .by_id
                .iter()
                .map(|(id, worker)| self.worker_status(*id, worker, now))
                .collect(),
            why_idle: self.why_idle(now),
        }
    }

    fn job_status(&self, id: JobId, job: &Job, now: Timestamp) -> JobStatus {
        let progress = job.queue.progress();
        JobStatus {
            job: id,
            name: job.name.clone(),
            state: job.state,
            priority: job.priority(),
            frames_done: progress.frames_done() - job.held.len() as u64,
            frames: job.queue.plan().frames(),
            current: self.frame_status(job),
            samples_done: progress.samples_done(),
            samples: progress.samples(),
            units_done: job.units_done,
            leases: job.leases,
            failures: job.failures,
            expired: job.expired,
            duplicates: job.duplicates,
            verified: job.verified,
            unverified: job.unverified,
            render: job.render,
            fault: job.fault.clone(),
            why_idle: self.why_job_idle(id, job, now),
        }
    }

    fn frame_status(&self, job: &Job) -> Option<FrameStatus> {
        let (position, complete, begun) = job.queue.progress().current()?;
        let plan = job.queue.plan();
        let spp = |rounds: u8| plan.rounds()[..usize::from(rounds)].last().map_or(0, |round| round.end());
        Some(FrameStatus { frame: plan.frame(position), spp_complete: spp(complete), spp_begun: spp(begun) })
    }

    fn worker_status(&self, id: WorkerId, worker: &Worker, now: Timestamp) -> WorkerStatus {
        WorkerStatus {
            worker: id,
            name: worker.name.to_string(),
            slots: worker.slots,
            in_flight: worker.leases.len() as u64,
            samples_per_s: worker.speed * f64::from(worker.slots),
            units_done: worker.units_done,
            failures: worker.failures,
            silent_for: now.since(worker.heard),
            draining: worker.draining,
            distrusted: self.health.is_liar(&worker.name),
            quarantined_for: self.health.quarantined_until(&worker.name).map(|until| until.since(now)),
        }
    }

    fn why_idle(&self, now: Timestamp) -> Option<WhyIdle> {
        if self.leases.any() {
            return None;
        }
        let mut open = self.jobs.by_id.iter().filter(|(_, job)| !job.state.is_final()).peekable();
        if open.peek().is_none() {
            return Some(WhyIdle::NoJobs);
        }
        match open.find(|(_, job)| job.state == JobState::Running) {
            Some((id, job)) => self.why_job_idle(*id, job, now),
            None => Some(WhyIdle::Paused),
        }
    }

    fn why_job_idle(&self, id: JobId, job: &Job, now: Timestamp) -> Option<WhyIdle> {
        if job.state.is_final() || job.leases > 0 {
            return None;
        }
        if job.state == JobState::Paused {
            return Some(WhyIdle::Paused);
        }
        if !job.has_open() {
            return Some(WhyIdle::Storing);
        }
        if let Some(unit) = job.checks.disputed().filter(|_| !job.queue.has_open()) {
            return Some(WhyIdle::Disputed { unit });
        }
        self.why_no_worker(id, now).or_else(|| {
            let busy = self.jobs.by_id.iter().find(|(_, other)| other.leases > 0);
            busy.map(|(ahead, _)| WhyIdle::Behind { ahead: *ahead })
        })
    }

    fn why_no_worker(&self, job: JobId, now: Timestamp) -> Option<WhyIdle> {
        let workers = || self.workers.by_id.values();
        let mut usable = self.workers.usable(&self.health).map(|(_, worker)| worker).peekable();
        if usable.peek().is_some() {
            let reasons: Option<Vec<&String>> = usable.map(|worker| worker.refused.get(&job)).collect();
            return Some(WhyIdle::Refused { reason: reasons?.first()?.to_string() });
        }
        let quarantines = workers().filter_map(|worker| self.health.quarantined_until(&worker.name));
        if workers().next().is_none() {
            Some(WhyIdle::NoWorkers)
        } else if workers().all(|worker| self.health.is_liar(&worker.name)) {
            Some(WhyIdle::Distrusted)
        } else if let Some(until) = quarantines.min() {
            Some(WhyIdle::Quarantined { soonest: until.since(now) })
        } else {
            Some(WhyIdle::Draining)
        }
    }
}
