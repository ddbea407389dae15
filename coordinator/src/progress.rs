//! What one sees while a job renders.

use crate::farm::Progress;
use crate::forecast::Left;
use crate::open_frame::Outlook;
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
    spec: JobSpec,
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
        Self { bar, lines: !terminal && !quiet, last_line: Instant::now(), spec: spec.clone() }
    }

    /// Shows where the job is.
    pub fn show(&mut self, progress: &Progress) {
        if self.bar.is_hidden() && !self.lines {
            return;
        }
        let left =
            progress.outlook.as_ref().and_then(|outlook| Left::of_job(&self.spec, progress.written, outlook));
        let part = self.part(progress, left.as_ref());
        let line = line(progress, part, left.as_ref());
        self.bar.set_position((part * 1000.0) as u64);
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

    /// How much of the job is done, of 1.
    fn part(&self, progress: &Progress, left: Option<&Left>) -> f64 {
        let done = progress.tally.spent.counters.samples as f64;
        match left {
            Some(left) => (done / left.samples).min(1.0),
            None => progress.written as f64 / self.spec.frames.count() as f64,
        }
    }
}

fn line(progress: &Progress, part: f64, left: Option<&Left>) -> String {
    let mut line = format!("{:5.1} %", part * 100.0);
    let done = progress.tally.spent.counters.samples;
    let seconds = progress.tally.running().map_or(0.0, |running| running.as_secs_f64());
    if done > 0 && seconds > 0.0 {
        line += &format!("  {}samples/s", metric(done as f64 / seconds));
    }
    if let Some(left) = left {
        line += &format!("  eta {}", range(left.seconds, left.seconds_low, left.seconds_high));
    }
    let workers = progress.workers;
    line += &format!("  {workers} worker{}", if workers == 1 { "" } else { "s" });
    if let Some(outlook) = &progress.outlook {
        line += &error_text(outlook);
    }
    if let (Some(why), 0) = (&progress.why_idle, done) {
        line += &format!("  {why}");
    }
    line
}

fn error_text(outlook: &Outlook) -> String {
    let Some(error) = outlook.error else { return String::new() };
    let mut text = format!("  error {:.4} (relMSE {:.2e}) at {} spp", error.rmse, error.rel_mse, outlook.spp);
    if let Some(slope) = outlook.slope {
        text += &format!(", slope {slope:.2}");
    }
    text
}

/// `1:20`, or `1:20 (1:05-1:50)` where the bounds are not the same to the second.
pub fn range(seconds: f64, low: f64, high: f64) -> String {
    let (shown, low, high) = (clock(seconds), clock(low), clock(high));
    if low == high { shown } else { format!("{shown} ({low}-{high})") }
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
        assert_eq!(range(80.0, 65.2, 110.0), "1:20 (1:05-1:50)");
        assert_eq!(range(80.0, 79.9, 80.2), "1:20");
    }
}
