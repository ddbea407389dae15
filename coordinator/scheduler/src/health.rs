//! Which workers may be trusted. Kept by name, so that a quarantine outlasts a reconnect.

use crate::{Timestamp, policy};
use farm_job::JobId;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// What each worker has done wrong lately.
#[derive(Debug, Default)]
pub(crate) struct Health {
    records: BTreeMap<Arc<str>, Record>,
    /// Those whose results were wrong, although they arrived as they were sent. Nothing else they say is worth anything, and
    /// time does not heal it.
    liars: BTreeSet<Arc<str>>,
}

#[derive(Debug, Default)]
struct Record {
    /// The jobs of its failures since the last success.
    strikes: Vec<JobId>,
    /// Quarantines so far; each is twice as long as the one before.
    quarantines: u32,
    /// Successes since the last failure.
    successes: u32,
    until: Option<Timestamp>,
}

impl Health {
    /// When a worker is forgiven, if it is in quarantine.
    pub fn quarantined_until(&self, name: &str) -> Option<Timestamp> {
        self.records.get(name)?.until
    }

    /// Whether a worker may be given something.
    pub fn is_trusted(&self, name: &str) -> bool {
        !self.is_liar(name) && self.quarantined_until(name).is_none()
    }

    /// Whether a worker's results were wrong.
    pub fn is_liar(&self, name: &str) -> bool {
        self.liars.contains(name)
    }

    /// Never trusts a worker again.
    pub fn distrust(&mut self, name: Arc<str>) {
        self.liars.insert(name);
    }

    /// Counts a success; after enough of them in a row the past is forgotten.
    pub fn success(&mut self, name: &str) {
        let Some(record) = self.records.get_mut(name) else { return };
        record.strikes.clear();
        record.successes += 1;
        if record.successes >= policy::SUCCESSES_TO_FORGET && record.until.is_none() {
            self.records.remove(name);
        }
    }

    /// Counts a failure in `job`; the end of the quarantine that it earns.
    /// The last worker that is left is spared if the failure may be the unit's fault: nobody else could do the work.
    pub fn strike(&mut self, name: &Arc<str>, job: JobId, spare: bool, now: Timestamp) -> Option<Timestamp> {
        let record = self.records.entry(name.clone()).or_default();
        record.successes = 0;
        record.strikes.push(job);
        if record.until.is_some() || spare || record.strikes.len() < policy::STRIKES {
            record.strikes.truncate(policy::STRIKES);
            return None;
        }
        let until = now.after(policy::quarantine(record.quarantines));
        record.quarantines += 1;
        // Back from quarantine, one more failure suffices.
        record.strikes.truncate(policy::STRIKES - 1);
        record.until = Some(until);
        Some(until)
    }

    /// Forgives every failure in a job that turned out to be at fault itself; whether that freed somebody.
    pub fn absolve(&mut self, job: JobId) -> bool {
        let mut freed = false;
        for record in self.records.values_mut() {
            let before = record.strikes.len();
            record.strikes.retain(|by| *by != job);
            if record.strikes.len() < before && record.until.take().is_some() {
                record.quarantines -= 1;
                freed = true;
            }
        }
        freed
    }

    /// The next moment at which somebody is forgiven.
    pub fn next_pardon(&self) -> Option<Timestamp> {
        self.records.values().filter_map(|record| record.until).min()
    }

    /// Ends the quarantines whose time has come; whether there were any.
    pub fn pardon(&mut self, now: Timestamp) -> bool {
        let mut freed = false;
        for record in self.records.values_mut() {
            if record.until.is_some_and(|until| until <= now) {
                record.until = None;
                freed = true;
            }
        }
        freed
    }
}
