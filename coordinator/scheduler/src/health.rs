//! Which workers may be trusted. Kept by name, so that a quarantine outlasts a reconnect.

use crate::{Timestamp, policy};
use farm_job::JobId;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// What is to be remembered of workers when the coordinator starts again.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Reputation {
    /// Names of those whose results were wrong.
    pub distrusted: BTreeSet<String>,
    /// Those that were in quarantine of late.
    pub quarantined: Vec<Quarantined>,
}

impl Reputation {
    /// Whether there is anything to be said of a worker.
    pub fn knows(&self, name: &str) -> bool {
        self.distrusted.contains(name) || self.quarantined.iter().any(|quarantined| quarantined.name == name)
    }
}

/// A worker that is, or was, in quarantine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Quarantined {
    /// Names it across connections.
    pub name: String,
    /// Quarantines so far.
    pub times: u32,
    /// Time until it is forgiven; zero when it is.
    pub left: Duration,
}

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

    /// What is to be remembered.
    pub fn reputation(&self, now: Timestamp) -> Reputation {
        let quarantined = self.records.iter().filter(|(_, record)| record.quarantines > 0);
        let quarantined = quarantined.map(|(name, record)| Quarantined {
            name: name.to_string(),
            times: record.quarantines,
            left: record.until.map(|until| until.since(now)).unwrap_or_default(),
        });
        Reputation {
            distrusted: self.liars.iter().map(|name| name.to_string()).collect(),
            quarantined: quarantined.collect(),
        }
    }

    /// Remembers what was known in a former life.
    pub fn recall(&mut self, reputation: Reputation, now: Timestamp) {
        self.liars.extend(reputation.distrusted.into_iter().map(Arc::from));
        for Quarantined { name, times, left } in reputation.quarantined {
            let record = self.records.entry(name.into()).or_default();
            record.quarantines = times;
            record.until = (!left.is_zero()).then(|| now.after(left));
        }
    }

    /// Trusts a worker as one that was never seen; whether it was not trusted, or had been in quarantine.
    pub fn forgive(&mut self, name: &str) -> bool {
        let known = self.records.remove(name).is_some_and(|record| record.quarantines > 0);
        self.liars.remove(name) || known
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

#[cfg(test)]
mod tests {
    use super::*;

    const JOB: JobId = JobId(1);

    #[test]
    fn a_reputation_outlives_its_scheduler() {
        let (mut health, clumsy, liar) = (Health::default(), Arc::from("clumsy"), Arc::from("liar"));
        let mut now = Timestamp::START;
        let fail = |health: &mut Health, now| {
            (0..policy::STRIKES).filter_map(|_| health.strike(&clumsy, JOB, false, now)).last().unwrap()
        };
        now = fail(&mut health, now);
        health.pardon(now);
        let until = fail(&mut health, now);
        health.distrust(liar);
        let half = now.after(until.since(now) / 2);
        let mut heir = Health::default();
        heir.recall(health.reputation(half), Timestamp::START);
        assert!(heir.is_liar("liar") && !heir.is_trusted("clumsy"));
        let left = until.since(half);
        assert_eq!(heir.quarantined_until("clumsy"), Some(Timestamp::START.after(left)));
        assert!(heir.pardon(Timestamp::START.after(left)) && heir.is_trusted("clumsy"));
        let next = fail(&mut heir, now);
        assert_eq!(next.since(now), policy::quarantine(2), "the third one is longer than the second");
        assert!(heir.forgive("liar") && heir.forgive("clumsy") && !heir.forgive("honest"));
        assert!(heir.is_trusted("liar") && heir.is_trusted("clumsy"));
    }
}
