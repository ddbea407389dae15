//! Times of day, as people say them.

use chrono::{Days, Local, NaiveDateTime, NaiveTime};
use std::time::Duration;

/// How often the clock is looked at: it may be set, and summer time begins.
const LOOK_EVERY: Duration = Duration::from_secs(30);

/// `07:00`, by this host's clock.
pub(crate) fn time_of_day(text: &str) -> Result<NaiveTime, String> {
    NaiveTime::parse_from_str(text, "%H:%M").map_err(|_| "write a time of day such as 07:00".to_owned())
}

/// Waits until it is this time of day for the next time, less `early`; forever when there is none.
pub(crate) async fn reached(time: Option<NaiveTime>, early: Duration) {
    let Some(time) = time else { return std::future::pending().await };
    let end = next(Local::now().naive_local(), time);
    loop {
        let left = (end - Local::now().naive_local()).to_std().unwrap_or_default();
        let left = left.saturating_sub(early);
        if left.is_zero() {
            return;
        }
        tokio::time::sleep(left.min(LOOK_EVERY)).await;
    }
}

/// Today if it is still to come, else tomorrow.
fn next(now: NaiveDateTime, time: NaiveTime) -> NaiveDateTime {
    let today = now.date().and_time(time);
    if today > now { today } else { today.checked_add_days(Days::new(1)).unwrap_or(today) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_such_time_is_today_or_tomorrow() {
        let now = |hour, minute| {
            chrono::NaiveDate::from_ymd_opt(2026, 12, 31).unwrap().and_hms_opt(hour, minute, 0).unwrap()
        };
        let seven = time_of_day("07:00").unwrap();
        assert_eq!(next(now(6, 59), seven), now(7, 0));
        assert_eq!(next(now(7, 0), seven).to_string(), "2027-01-01 07:00:00");
        for wrong in ["", "7", "25:00", "07:60", "soon"] {
            assert!(time_of_day(wrong).is_err(), "{wrong:?}");
        }
    }
}
