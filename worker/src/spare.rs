//! When a host may be used: how busy its owner keeps it, and until what time of day.

use crate::cli::Fault;
use rustix::time::{ClockId, clock_gettime};
use std::time::{Duration, Instant};
use tracing::info;

/// The load is measured over this long: a page that loads is no reason to go.
const MEASURE_OVER: Duration = Duration::from_secs(5);

/// Measurements below the limit in a row before a worker comes back: people pause when they think.
const QUIET_TIMES: u32 = 4;

/// How much of this host others use.
pub struct Load {
    others: Sample,
}

#[derive(Clone, Copy)]
struct Sample {
    at: Instant,
    /// Processor time of everybody since the start of the machine.
    all: Duration,
    /// Of this process.
    own: Duration,
}

impl Load {
    /// Begins to measure; fails where the system does not tell.
    pub fn new() -> Result<Self, Fault> {
        let others = Sample::now().ok_or_else(|| {
            Fault::input(
                "this system does not tell how busy it is: --max-load and --idle-only need /proc/stat",
            )
        })?;
        Ok(Self { others })
    }

    /// Waits until others use less than `limit` processors for a while.
    pub async fn quiet(&mut self, limit: f64) {
        let mut quiet = 0;
        while quiet < QUIET_TIMES {
            let load = self.measure().await;
            quiet = if load < limit { quiet + 1 } else { 0 };
        }
    }

    /// Waits until others use more than `limit` processors; how many they use.
    pub async fn busy(&mut self, limit: f64) -> f64 {
        loop {
            let load = self.measure().await;
            if load > limit {
                info!(processors = load, limit, "others need this host");
                return load;
            }
        }
    }

    /// Processors that others used over the last few seconds.
    async fn measure(&mut self) -> f64 {
        tokio::time::sleep(MEASURE_OVER).await;
        let Some(now) = Sample::now() else { return 0.0 };
        let before = std::mem::replace(&mut self.others, now);
        now.others_since(before)
    }
}

impl Sample {
    fn now() -> Option<Self> {
        let stat = std::fs::read_to_string("/proc/stat").ok()?;
        let own = clock_gettime(ClockId::ProcessCPUTime);
        let own = Duration::new(u64::try_from(own.tv_sec).ok()?, u32::try_from(own.tv_nsec).ok()?);
        Some(Self { at: Instant::now(), all: busy_time(&stat)?, own })
    }

    fn others_since(self, before: Self) -> f64 {
        let all = self.all.saturating_sub(before.all);
        let own = self.own.saturating_sub(before.own);
        all.saturating_sub(own).as_secs_f64() / (self.at - before.at).as_secs_f64().max(1e-3)
    }
}

/// Processor time that was not idle, from the first line of /proc/stat: user, nice, system, idle, iowait, irq, softirq, in
/// hundredths of a second.
fn busy_time(stat: &str) -> Option<Duration> {
    let numbers = stat.lines().next()?.strip_prefix("cpu ")?.split_whitespace();
    let ticks: Vec<u64> = numbers.map_while(|number| number.parse().ok()).collect();
    let busy = [0, 1, 2, 5, 6].iter().map(|place| ticks.get(*place).copied().unwrap_or(0)).sum::<u64>();
    (ticks.len() >= 4).then(|| Duration::from_millis(busy * 10))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn busy_time_leaves_idle_and_waiting_out() {
        let stat = "cpu  100 20 30 4000 500 6 7 8 0 0\ncpu0 1 2 3 4 5 6 7 8 0 0\n";
        assert_eq!(busy_time(stat), Some(Duration::from_millis(1630)));
        assert_eq!(busy_time("intr 1 2 3"), None);
    }

    #[test]
    fn own_work_is_no_load_of_others() {
        let at = Instant::now();
        let sample =
            |at, all, own| Sample { at, all: Duration::from_secs(all), own: Duration::from_secs(own) };
        let later = sample(at + Duration::from_secs(10), 125, 55);
        assert_eq!(later.others_since(sample(at, 100, 40)), 1.0);
        assert_eq!(later.others_since(later), 0.0);
    }
}
