//! A coordinator that serves, and what one asks of it.

use crate::harness::{Place, Running, Said, coordinator, render, run};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

/// A picture that takes seconds, so that there is a middle of it.
pub const PICTURE: [&str; 6] = ["--resolution", "96x64", "--spp", "256", "--tile", "16"];

/// What [`PICTURE`] looks like when one process renders it: rendered once for all stories.
static ALONE: LazyLock<(Place, String)> = LazyLock::new(|| {
    let place = Place::new();
    let digest = run(render(&place, "alone.exr", &PICTURE)).digest();
    (place, digest)
});

/// The digest of [`PICTURE`] when one process renders it.
pub fn digest_alone() -> &'static str {
    &ALONE.1
}

/// A coordinator under way, and where it is.
pub struct Server {
    pub running: Running,
    pub address: String,
}

impl Server {
    /// Serves from the store in the test's folder.
    pub fn start(place: &Place, listen: &str) -> Self {
        Self::from_command(Self::command(listen, place.path("store").to_str().unwrap()))
    }

    /// The same, and its log tells of each unit and decision.
    pub fn start_telling(place: &Place, listen: &str) -> Self {
        let mut command = Self::command(listen, place.path("store").to_str().unwrap());
        command.env("FARM_LOG", "info,farm_coordinator=debug");
        Self::from_command(command)
    }

    /// `coordinator serve`, for further flags and settings.
    pub fn command(listen: &str, store: &str) -> Command {
        let mut command = coordinator();
        command.args(["serve", "--listen", listen, "--store", store]);
        command
    }

    /// Waits until it listens.
    pub fn from_command(command: Command) -> Self {
        Self::once_it_listens(Running::start(command))
    }

    /// Waits until a coordinator that was standing by listens.
    pub fn once_it_listens(mut running: Running) -> Self {
        let address = running.wait_for("an address", |said| {
            let line = said.lines().find(|line| line.starts_with("listening on "))?;
            Some(line["listening on ".len()..].to_owned())
        });
        Self { running, address }
    }

    pub fn ask(&self, what: &[&str]) -> Said {
        let mut command = coordinator();
        command.args(what).args(["--to", &self.address, "--json"]);
        run(command)
    }

    pub fn submit(&self, place: &Place, flags: &[&str]) -> String {
        let scene = place.scene();
        let mut what = vec!["submit", scene.to_str().unwrap()];
        what.extend(flags);
        self.ask(&what).json()["job"].to_string()
    }

    pub fn status(&self, job: &str) -> Value {
        self.ask(&["status", job]).json()[0].clone()
    }

    pub fn samples_done(&self, job: &str) -> u64 {
        self.status(job)["samples_done"].as_u64().unwrap()
    }

    /// Waits until the job is as one wants it; gives its status then.
    pub fn wait_until(&self, job: &str, what: &str, is_so: impl Fn(&Value) -> bool) -> Value {
        let begun = Instant::now();
        loop {
            let status = self.status(job);
            if is_so(&status) {
                return status;
            }
            assert!(begun.elapsed() < Duration::from_secs(120), "{what} does not come: {status}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Waits until so many workers are connected.
    pub fn wait_for_workers(&self, count: usize) {
        let begun = Instant::now();
        while self.ask(&["workers"]).json().as_array().unwrap().len() != count {
            assert!(begun.elapsed() < Duration::from_secs(120), "there are never {count} workers");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Waits until more samples are done than there were.
    pub fn wait_for_more(&self, job: &str, samples: u64) -> u64 {
        let more =
            self.wait_until(job, "progress", |status| status["samples_done"].as_u64().unwrap() > samples);
        more["samples_done"].as_u64().unwrap()
    }

    /// Waits until the job has ended, and compares its only frame with the one that was rendered alone: the largest difference.
    pub fn difference(&self, place: &Place, job: &str) -> Value {
        difference_to_alone(&self.fetched(place, job))
    }

    /// Waits until the job has ended, and fetches its only frame.
    pub fn fetched(&self, place: &Place, job: &str) -> PathBuf {
        let mut watch = coordinator();
        watch.args(["watch", job, "--to", &self.address]);
        let said = run(watch);
        assert!(said.status.success(), "{}", said.stderr);
        let fetched = place.path("fetched.exr");
        self.ask(&["fetch", job, "-o", fetched.to_str().unwrap()]).json();
        fetched
    }
}

/// The largest difference between a picture of [`PICTURE`] and the one that was rendered alone.
pub fn difference_to_alone(picture: &Path) -> Value {
    difference(picture, &ALONE.0.path("alone.exr"))
}

/// The largest difference between two pictures.
pub fn difference(one: &Path, other: &Path) -> Value {
    let mut compare = coordinator();
    compare.arg("compare").arg(one).arg(other).arg("--json");
    run(compare).json()["max_abs"].clone()
}
