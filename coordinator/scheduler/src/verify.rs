//! Results are compared with those of other workers. Units are pure: of two workers whose results differ, one is broken or lies,
//! and a third tells which. What it had a hand in is rendered again, and it gets nothing any more.
//!
//! Two who lie alike are believed; a worker alone cannot be compared with anybody.

use crate::checks::{Settled, Vote};
use crate::lease::Work;
use crate::provenance::Tainted;
use crate::worker::Worker;
use crate::{Action, Delivery, Origin, Scheduler, Verdict, policy};
use farm_film::{FrameIndex, Tile, WorkUnit};
use farm_job::{JobId, JobState, LeaseId, WorkerId};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

impl Scheduler {
    /// Notes who delivered an accepted unit, and begins to compare it if it is chosen.
    pub(crate) fn note_origin(&mut self, delivery: &Delivery, name: &Arc<str>) {
        if self.config.verify <= 0.0 {
            return;
        }
        let chosen = lot(self.config.verify_seed, delivery.job, &delivery.unit) < self.config.verify;
        let Some(job) = self.jobs.get_mut(delivery.job) else { return };
        let Some(cell) = job.queue.plan().locate(&delivery.unit) else { return };
        job.provenance.add(cell.frame, cell.tile, name.clone());
        if chosen {
            job.checks.begin(delivery.unit, name.clone(), delivery.digest);
        }
    }

    /// Goes on where an earlier life was: what is there of open frames may be wrong, and what is chosen of it is compared, once
    /// more if it was before.
    pub(crate) fn recall_origins(&mut self, id: JobId, finished: &[FrameIndex], origins: &[Origin]) {
        let Some(job) = self.jobs.get_mut(id).filter(|_| self.config.verify > 0.0) else { return };
        let finished: BTreeSet<FrameIndex> = finished.iter().copied().collect();
        for Origin { frame, name, part } in origins {
            let Some(position) = job.queue.plan().frame_position(*frame) else { continue };
            let name: Arc<str> = name.as_str().into();
            if finished.contains(frame) {
                job.provenance.add(position, 0, name);
                job.provenance.finish(position);
                continue;
            }
            let Some((unit, digest)) = part else { continue };
            let Some(cell) = job.queue.plan().locate(unit) else { continue };
            job.provenance.add(position, cell.tile, name.clone());
            let is_there = job.queue.verdict(unit) == Verdict::NotNeeded;
            if is_there && lot(self.config.verify_seed, id, unit) < self.config.verify {
                job.checks.begin(*unit, name, *digest);
                self.checks_until = self.now.after(policy::COME_BACK);
            }
        }
    }

    /// Takes a result that is not needed as a vote on one that is there; whether it was one.
    pub(crate) fn compare(&mut self, delivery: &Delivery) -> bool {
        let Some(name) = self.workers.get(delivery.worker).map(|worker| worker.name.clone()) else {
            return false;
        };
        let Some(job) = self.jobs.get_mut(delivery.job) else { return false };
        match job.checks.vote(&delivery.unit, &name, delivery.digest) {
            Vote::Pointless => return false,
            Vote::Disputed => {}
            Vote::Settled(settled) => self.settle_check(delivery, &name, settled),
        }
        self.jobs.file(delivery.job);
        true
    }

    fn settle_check(&mut self, delivery: &Delivery, name: &Arc<str>, settled: Settled) {
        if let Some(job) = self.jobs.get_mut(delivery.job) {
            job.verified += 1;
        }
        self.health.success(name);
        self.revoke(settled.displaced.into_iter().collect());
        for liar in settled.liars {
            self.convict(&liar, &delivery.unit);
        }
        self.release_held(delivery.job);
    }

    /// Never trusts a worker again, and opens again what it had a hand in.
    fn convict(&mut self, liar: &Arc<str>, unit: &WorkUnit) {
        self.health.distrust(liar.clone());
        let reason = format!("it rendered {unit} otherwise than two others");
        let named = self.workers.by_id.iter().filter(|(_, worker)| worker.name == *liar);
        let connections: Vec<WorkerId> = named.map(|(id, _)| *id).collect();
        self.actions.push_back(Action::Distrust { name: liar.to_string(), reason });
        for worker in connections {
            let held = self.workers.get(worker).map(|worker| worker.leases.clone()).unwrap_or_default();
            held.into_iter().for_each(|lease| self.take_back(lease));
        }
        let jobs = self.jobs.by_id.iter().filter(|(_, job)| job.state != JobState::Cancelled);
        for id in jobs.map(|(id, _)| *id).collect::<Vec<_>>() {
            self.reopen_all_of(id, liar);
        }
        self.refile_workers();
    }

    fn reopen_all_of(&mut self, id: JobId, liar: &Arc<str>) {
        let Some(job) = self.jobs.get_mut(id) else { return };
        job.checks.unhear(liar);
        let mut tainted: BTreeMap<u32, Tainted> = job.provenance.take(liar).into_iter().collect();
        // What is on its way to the store counts as well.
        for (delivery, claim) in &self.claims {
            if delivery.job != id || claim.void || claim.name.as_ref() != Some(liar) {
                continue;
            }
            let Some(cell) = job.queue.plan().locate(&delivery.unit) else { continue };
            if let Tainted::Tiles(tiles) = tainted.entry(cell.frame).or_insert(Tainted::Tiles(Vec::new())) {
                tiles.push(cell.tile);
            }
        }
        for (frame, tainted) in tainted {
            self.reopen(id, frame, tainted);
        }
        self.jobs.file(id);
    }

    fn reopen(&mut self, id: JobId, position: u32, tainted: Tainted) {
        let Some(job) = self.jobs.get_mut(id) else { return };
        let plan = job.queue.plan();
        let finished = tainted == Tainted::Frame;
        let tiles: Vec<u32> = match tainted {
            Tainted::Frame => (0..plan.tiles() as u32).collect(),
            // What was wrong may have decided about any of them.
            Tainted::Tiles(_) if plan.is_adaptive() => (0..plan.tiles() as u32).collect(),
            Tainted::Tiles(tiles) => tiles.into_iter().collect::<BTreeSet<_>>().into_iter().collect(),
        };
        let frame = plan.frame(position);
        let windows: Vec<Tile> = tiles.iter().map(|tile| plan.tile(*tile)).collect();
        let within: BTreeSet<Tile> = windows.iter().copied().collect();
        let gone = |unit: &WorkUnit| unit.frame == frame && within.contains(&unit.tile);
        let mut displaced = job.queue.reopen(position, &tiles);
        displaced.extend(job.checks.remove_if(gone));
        job.held.remove(&position);
        if job.state == JobState::Done {
            job.state = JobState::Running;
        }
        for (_, claim) in self.claims.iter_mut().filter(|(claim, _)| claim.job == id && gone(&claim.unit)) {
            claim.void = true;
        }
        self.revoke(displaced);
        self.actions.push_back(Action::Reopened { job: id, frame, tiles: windows, finished });
    }

    /// Announces frames that waited for their checks.
    pub(crate) fn release_held(&mut self, id: JobId) {
        let Some(job) = self.jobs.get_mut(id) else { return };
        let is_free = |job: &crate::job::Job, at: u32| !job.checks.any_of(job.queue.plan().frame(at));
        let free: Vec<(u32, u64)> =
            job.held.iter().map(|(at, spp)| (*at, *spp)).filter(|(at, _)| is_free(job, *at)).collect();
        for (at, spp) in free {
            job.held.remove(&at);
            job.provenance.finish(at);
            let frame = job.queue.plan().frame(at);
            self.actions.push_back(Action::FrameComplete { job: id, frame, spp });
        }
        self.end_if_done(id);
    }

    /// Stops waiting for checks that nobody can do while a frame waits for them. A dispute waits nevertheless: one of the two is
    /// wrong.
    pub(crate) fn waive_checks(&mut self) {
        if self.config.verify <= 0.0 || self.now < self.checks_until {
            return;
        }
        let holding = self.jobs.by_id.iter().filter(|(_, job)| !job.state.is_final() && !job.held.is_empty());
        for id in holding.map(|(id, _)| *id).collect::<Vec<_>>() {
            let hopeless = self.hopeless_checks(id);
            let Some(job) = self.jobs.get_mut(id).filter(|_| !hopeless.is_empty()) else { continue };
            job.unverified += hopeless.len() as u64;
            let _: Vec<LeaseId> = hopeless.iter().filter_map(|unit| job.checks.remove(unit)).collect();
            self.release_held(id);
            self.jobs.file(id);
        }
    }

    fn hopeless_checks(&self, id: JobId) -> Vec<WorkUnit> {
        let Some(job) = self.jobs.get(id) else { return Vec::new() };
        let waits = |unit: &WorkUnit| job.held.keys().any(|at| job.queue.plan().frame(*at) == unit.frame);
        let usable = || self.workers.usable(&self.health).map(|(_, worker)| worker);
        let may = |worker: &Worker, unit: &WorkUnit| {
            !worker.refused.contains_key(&id) && job.checks.may(unit, &worker.name)
        };
        job.checks
            .waiting()
            .filter(|unit| waits(unit) && !job.checks.is_disputed(unit))
            .filter(|unit| !usable().any(|worker| may(worker, unit)))
            .collect()
    }

    /// Ends a lease on a unit that was to be compared.
    pub(crate) fn release_check(&mut self, job: JobId, unit: &WorkUnit, lease: LeaseId) {
        if let Some(job) = self.jobs.get_mut(job) {
            job.checks.release(unit, lease);
        }
    }

    /// Notes that a worker cannot render what it was to be compared with.
    pub(crate) fn check_failed(&mut self, job: JobId, work: Work, name: Option<Arc<str>>) {
        if let (Some(job), Work::Check(unit), Some(name)) = (self.jobs.get_mut(job), work, name) {
            job.checks.fail(&unit, name);
        }
    }
}

/// A number in `[0, 1)` that a unit draws once and for all.
fn lot(seed: u64, job: JobId, unit: &WorkUnit) -> f64 {
    let facts = [
        job.0,
        u64::from(unit.frame.0),
        u64::from(unit.tile.x0()) << 32 | u64::from(unit.tile.y0()),
        unit.block.start(),
        unit.block.samples(),
    ];
    let mixed = facts.into_iter().fold(seed, |state, fact| mix(state ^ fact));
    (mixed >> 11) as f64 / (1u64 << 53) as f64
}

/// The lot of the first leaf of a tile of eight pixels.
#[cfg(test)]
pub(crate) fn lot_of_tile(seed: u64, job: u64, x0: u32) -> f64 {
    let tile = Tile::new(x0, 0, x0 + 8, 8).expect("a tile");
    let block = farm_film::SampleBlock::new(0..16).expect("a leaf");
    lot(seed, JobId(job), &WorkUnit { frame: FrameIndex(0), block, tile })
}

/// SplitMix64's finaliser: every bit of the outcome depends on every bit of `value`.
fn mix(value: u64) -> u64 {
    let z = value.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// A delivery on its way to the store.
#[derive(Clone, Debug)]
pub(crate) struct Claim {
    /// Whose it is, if that is known.
    pub name: Option<Arc<str>>,
    /// What it was part of has been opened again meanwhile: whatever becomes of it counts for nothing.
    pub void: bool,
}
