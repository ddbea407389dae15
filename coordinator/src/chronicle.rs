//! What happened on the farm lately, for those who watch.

use farm_job::JobId;
use farm_proto::convert::LogView;
use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

/// Entries that are kept: hours of a quiet farm, minutes of a troubled one, and little memory.
const ENTRIES_MAX: usize = 2000;

/// The latest events. Those of the whole farm belong to every job.
#[derive(Default)]
pub struct Chronicle {
    log: Mutex<Log>,
}

#[derive(Default)]
struct Log {
    /// How many there ever were.
    noted: u64,
    latest: VecDeque<(Option<JobId>, LogView)>,
}

impl Chronicle {
    /// Notes what happened, to a job or to the farm.
    pub fn note(&self, job: Option<JobId>, text: impl Into<String>) {
        let entry = LogView { at: SystemTime::now(), text: text.into() };
        let mut log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
        log.noted += 1;
        log.latest.push_back((job, entry));
        if log.latest.len() > ENTRIES_MAX {
            log.latest.pop_front();
        }
    }

    /// What concerns a job after the first `seen` events, and how many events there are now.
    pub fn after(&self, seen: u64, job: JobId) -> (u64, Vec<LogView>) {
        let log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
        let forgotten = log.noted - log.latest.len() as u64;
        let known = usize::try_from(seen.saturating_sub(forgotten)).unwrap_or(usize::MAX);
        let concerns = |about: Option<JobId>| about.is_none_or(|about| about == job);
        let new = log.latest.iter().skip(known).filter(|(about, _)| concerns(*about));
        (log.noted, new.map(|(_, entry)| entry.clone()).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everybody_hears_of_the_farm_and_of_their_own_job() {
        let chronicle = Chronicle::default();
        let texts = |seen, job| {
            let (noted, entries) = chronicle.after(seen, JobId(job));
            (noted, entries.into_iter().map(|entry| entry.text).collect::<Vec<_>>())
        };
        chronicle.note(None, "ann joined");
        chronicle.note(Some(JobId(1)), "paused");
        assert_eq!(texts(0, 1), (2, vec!["ann joined".into(), "paused".into()]));
        assert_eq!(texts(0, 2), (2, vec!["ann joined".into()]));
        assert_eq!(texts(2, 1), (2, vec![]));
        for number in 0..ENTRIES_MAX {
            chronicle.note(Some(JobId(1)), number.to_string());
        }
        let (noted, entries) = texts(1, 1);
        assert_eq!((noted, entries.len()), (ENTRIES_MAX as u64 + 2, ENTRIES_MAX));
        assert_eq!(texts(noted - 1, 1).1, [(ENTRIES_MAX - 1).to_string()]);
    }
}
