//! What one sees of a job on a coordinator elsewhere, until it ends.

use super::jobs::{job_json, job_line, worker_json};
use super::print_json;
use crate::client::Client;
use farm_job::{JobId, JobState};
use farm_proto::convert::{LogView, WatchView};
use farm_worker::cli::Fault;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};
use std::io::IsTerminal;
use std::time::{Duration, Instant, UNIX_EPOCH};

/// A coordinator that went away is looked for this often, and for this long.
const TRY_AGAIN_EVERY: Duration = Duration::from_secs(1);
const GONE_MAX: Duration = Duration::from_secs(120);

/// Where there is no terminal, a line this often unless something happens.
const LINE_EVERY: Duration = Duration::from_secs(2);

/// Shows a job's progress and what happens to it; an end other than done is a failure. A coordinator that restarts is waited
/// for.
pub async fn watch(client: &mut Client, job: JobId, json: bool) -> Result<(), Fault> {
    let mut screen = Screen::new();
    let mut heard = Instant::now();
    let mut is_gone = false;
    let last = loop {
        let watched = client.watch(job, |view| {
            (heard, is_gone) = (Instant::now(), false);
            match json {
                // A line that cannot be printed is no reason to stop the job.
                true => drop(print_json(&watch_json(view))),
                false => screen.show(view),
            }
        });
        if let Some(last) = watched.await? {
            break last;
        }
        if heard.elapsed() > GONE_MAX {
            return Err(Fault::failed("the coordinator went away; the job goes on when it is back"));
        }
        if !std::mem::replace(&mut is_gone, true) {
            screen.tell("the coordinator went away; waiting for it");
        }
        tokio::time::sleep(TRY_AGAIN_EVERY).await;
    };
    screen.bar.finish_and_clear();
    match last.job.state {
        JobState::Done => Ok(()),
        state => Err(Fault::failed(format!("job {job} is {state}: {}", last.job.reason))),
    }
}

/// Progress on standard error: one line that changes on a terminal, lines elsewhere.
struct Screen {
    bar: ProgressBar,
    terminal: bool,
    last_line: Option<Instant>,
}

impl Screen {
    fn new() -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar = if terminal { ProgressBar::new(1000) } else { ProgressBar::hidden() };
        if let Ok(style) = ProgressStyle::with_template("{bar:24} {msg}") {
            bar.set_style(style);
        }
        Self { bar, terminal, last_line: None }
    }

    fn tell(&self, line: &str) {
        if self.terminal { self.bar.println(line) } else { eprintln!("{line}") }
    }

    fn show(&mut self, view: &WatchView) {
        view.log.iter().for_each(|entry| self.tell(&log_line(entry)));
        let job = &view.job;
        let working = view.workers.iter().filter(|worker| worker.state == "working").count();
        let line = format!("{}  {working} of {} workers at work", job_line(job), view.workers.len());
        let due = self.last_line.is_none_or(|last| last.elapsed() >= LINE_EVERY);
        if !self.terminal && (due || job.state.is_final()) {
            self.last_line = Some(Instant::now());
            eprintln!("{line}");
        }
        self.bar.set_position(job.samples_done.saturating_mul(1000) / job.samples_total.max(1));
        self.bar.set_message(line);
    }
}

/// The time of day in UTC, and what happened.
fn log_line(entry: &LogView) -> String {
    let seconds = entry.at.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs() % 86_400;
    format!("{:02}:{:02}:{:02}  {}", seconds / 3600, seconds / 60 % 60, seconds % 60, entry.text)
}

fn watch_json(view: &WatchView) -> Value {
    let mut value = job_json(&view.job);
    let since_epoch = |entry: &LogView| entry.at.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
    value["workers"] = view.workers.iter().map(worker_json).collect();
    value["log"] =
        view.log.iter().map(|entry| json!({ "at": since_epoch(entry), "text": entry.text })).collect();
    value
}
