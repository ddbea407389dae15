//! How much a submitter may bring.

use farm_trust::TokenId;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

const HOUR: f64 = 3600.0;

/// Bytes that each submitter may bring within an hour. What was brought is forgotten bit by bit, so that there is no moment to
/// wait for.
pub struct Quota {
    bytes_per_hour: u64,
    accounts: Mutex<BTreeMap<Option<TokenId>, Account>>,
}

struct Account {
    /// Bytes that count, at that moment.
    brought: f64,
    at: Instant,
}

/// Somebody has brought too much.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "upload quota: a submitter may bring {bytes_per_hour} bytes of scenes within an hour, and this one has; go on in {} s, or \
     have the coordinator started with a larger --upload-quota", .wait.as_secs() + 1
)]
pub struct QuotaExceeded {
    bytes_per_hour: u64,
    wait: Duration,
}

impl Quota {
    /// Nobody has brought anything yet.
    pub fn new(bytes_per_hour: u64) -> Self {
        Self { bytes_per_hour, accounts: Mutex::default() }
    }

    /// Counts `bytes` that somebody brings, if they are not too many.
    pub fn take(&self, who: Option<TokenId>, bytes: usize, now: Instant) -> Result<(), QuotaExceeded> {
        let quota = self.bytes_per_hour as f64;
        let per_second = quota / HOUR;
        let mut accounts = self.accounts.lock().unwrap_or_else(PoisonError::into_inner);
        let brought = |account: &Account| {
            (account.brought - per_second * now.saturating_duration_since(account.at).as_secs_f64()).max(0.0)
        };
        let with_these = accounts.get(&who).map_or(0.0, brought) + bytes as f64;
        if with_these > quota {
            let seconds = ((with_these - quota) / per_second).min(HOUR);
            let wait = Duration::try_from_secs_f64(seconds).unwrap_or_default();
            return Err(QuotaExceeded { bytes_per_hour: self.bytes_per_hour, wait });
        }
        // There are as many as tokens whose holders have brought something of late.
        accounts.retain(|_, account| brought(account) > 0.0);
        accounts.insert(who, Account { brought: with_these, at: now });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_may_bring_so_much_within_an_hour() {
        let (quota, start) = (Quota::new(3600), Instant::now());
        let after = |seconds| start + Duration::from_secs(seconds);
        let ann = Some("00000000000a".parse().unwrap());
        assert_eq!(quota.take(ann, 3000, start), Ok(()));
        let refused = quota.take(ann, 700, start).unwrap_err();
        assert_eq!(refused, QuotaExceeded { bytes_per_hour: 3600, wait: Duration::from_secs(100) });
        assert!(refused.to_string().contains("go on in 101 s"), "{refused}");
        assert_eq!(quota.take(None, 3600, start), Ok(()), "others are not concerned");
        assert!(quota.take(ann, 700, after(99)).is_err());
        assert_eq!(quota.take(ann, 700, after(100)), Ok(()));
        assert!(quota.take(ann, 3601, after(9000)).is_err(), "more than an hour's worth at once");
        assert_eq!(quota.take(ann, 3600, after(9000)), Ok(()));
        assert_eq!(quota.accounts.lock().unwrap().len(), 1, "who has waited is forgotten");
        assert!(Quota::new(0).take(None, 1, start).is_err());
    }
}
