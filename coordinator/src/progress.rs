//! What one sees while a job renders.

use crate::farm::Progress;
use farm_job::JobSpec;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Where there is no terminal, a line this often.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// Progress on standard error: a bar on a terminal, lines elsewhere, nothing when told to be quiet.
pub struct Display {
    bar: ProgressBar,
    lines: bool,
    last_line: Instant,
    samples: u128,
}

impl Display {
    /// For one job.
    pub fn new(spec: &JobSpec, quiet: bool) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let target = match terminal && !quiet {
            true => ProgressDrawTarget::stderr(),
            false => ProgressDrawTarget::hidden(),
        };
        let bar = ProgressBar::with_draw_target(Some(1000), target);
        if let Ok(style) = ProgressStyle::with_template("{bar:32} {msg}") {
            bar.set_style(style);
        }
        let area = u128::from(spec.settings.width) * u128::from(spec.settings.height);
        let samples = area * u128::from(spec.spp) * u128::from(spec.frames.count());
        Self { bar, lines: !terminal && !quiet, last_line: Instant::now(), samples }
    }

    /// Shows where the job is.
    pub fn show(&mut self, progress: &Progress) {
        if self.bar.is_hidden() && !self.lines {
            return;
        }
        let line = self.line(progress);
        let done = u128::from(progress.tally.counters.samples).min(self.samples);
        self.bar.set_position((done * 1000 / self.samples) as u64);
        if self.lines && self.last_line.elapsed() >= LINE_EVERY {
            self.last_line = Instant::now();
            eprintln!("{line}");
        }
        self.bar.set_message(line);
    }

    /// Clears the bar.
    pub fn end(&self) {
        self.bar.finish_and_clear();
    }

    fn line(&self, progress: &Progress) -> String {
        let done = u128::from(progress.tally.counters.samples).min(self.samples);
        let mut line = format!("{:5.1} %", done as f64 / self.samples as f64 * 100.0);
        let seconds = progress.tally.running().map_or(0.0, |running| running.as_secs_f64());
        if done > 0 && seconds > 0.0 {
            let speed = done as f64 / seconds;
            line +=
                &format!("  {}samples/s  eta {}", metric(speed), clock((self.samples - done) as f64 / speed));
        }
        let workers = progress.workers;
        line += &format!("  {workers} worker{}", if workers == 1 { "" } else { "s" });
        if let Some(error) = &progress.error {
            line += &format!("  error {:.4} at {} spp", error.rmse, error.spp);
        }
        if let (Some(why), 0) = (&progress.why_idle, done) {
            line += &format!("  {why}");
        }
        line
    }
}

/// `12.3 M`, for people.
pub fn metric(value: f64) -> String {
    let steps = [(1e9, "G"), (1e6, "M"), (1e3, "k")];
    let (unit, name) = steps.into_iter().find(|(unit, _)| value >= *unit).unwrap_or((1.0, ""));
    format!("{:.2} {name}", value / unit)
}

/// `1:02:03` or `2:03`.
pub fn clock(seconds: f64) -> String {
    let seconds = seconds.round() as u64;
    let (hours, minutes, seconds) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    if hours > 0 { format!("{hours}:{minutes:02}:{seconds:02}") } else { format!("{minutes}:{seconds:02}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        assert_eq!(metric(2_345_678.0), "2.35 M");
        assert_eq!(metric(12.0), "12.00 ");
        assert_eq!(clock(3723.4), "1:02:03");
        assert_eq!(clock(59.6), "1:00");
    }
}
