//! A coordinator that serves many jobs, dies, and goes on where it was.

use crate::harness::{Place, Running, Said, coordinator, joining, render, run};
use serde_json::Value;

const PICTURE: [&str; 6] = ["--resolution", "96x64", "--spp", "128", "--tile", "16"];

/// A coordinator that serves, with its store in the test's folder.
struct Server {
    running: Running,
    address: String,
}

impl Server {
    fn start(place: &Place, listen: &str) -> Self {
        let mut command = coordinator();
        command.args(["serve", "--listen", listen, "--store"]).arg(place.path("store"));
        let mut running = Running::start(command);
        let address = running.wait_for("an address", |said| {
            let line = said.lines().find(|line| line.starts_with("listening on "))?;
            Some(line["listening on ".len()..].to_owned())
        });
        Self { running, address }
    }

    fn ask(&self, what: &[&str]) -> Said {
        let mut command = coordinator();
        command.args(what).args(["--to", &self.address, "--json"]);
        run(command)
    }

    fn submit(&self, place: &Place, flags: &[&str]) -> String {
        let scene = place.scene();
        let mut what = vec!["submit", scene.to_str().unwrap()];
        what.extend(flags);
        self.ask(&what).json()["job"].to_string()
    }

    fn status(&self, job: &str) -> Value {
        self.ask(&["status", job]).json()[0].clone()
    }

    /// Waits until the job has ended and gives the digest of its only frame.
    fn digest(&self, place: &Place, job: &str) -> Value {
        let mut watch = coordinator();
        watch.args(["watch", job, "--to", &self.address]);
        let said = run(watch);
        assert!(said.status.success(), "{}", said.stderr);
        let fetched = place.path("fetched.exr");
        self.ask(&["fetch", job, "-o", fetched.to_str().unwrap()]).json();
        let mut compare = coordinator();
        compare.arg("compare").arg(&fetched).arg(place.path("alone.exr")).arg("--json");
        run(compare).json()["max_abs"].clone()
    }
}

fn alone(place: &Place) {
    run(render(place, "alone.exr", &PICTURE)).json();
}

#[test]
fn a_killed_coordinator_goes_on_where_it_was() {
    let place = Place::new();
    alone(&place);
    let mut server = Server::start(&place, "127.0.0.1:0");
    let address = server.address.clone();
    let job = server.submit(&place, &PICTURE);
    let mut worker = joining(&address, "loyal");
    for _ in 0..3 {
        // In the middle of things, with something kept.
        let before = server.status(&job)["samples_done"].as_u64().unwrap();
        server.running.wait_for("the worker", |said| said.contains("name=loyal").then_some(()));
        std::thread::sleep(std::time::Duration::from_millis(700));
        server.running.kill();
        server = Server::start(&place, &address);
        let after = server.status(&job)["samples_done"].as_u64().unwrap();
        assert!(after >= before, "{after} samples after {before}: something acknowledged was lost");
    }
    assert_eq!(server.digest(&place, &job), 0.0);
    assert!(worker.is_running(), "a restart is no error, only a wait");
    assert_eq!(server.status(&job)["state"], "done");
}

#[test]
fn two_coordinators_never_share_a_store() {
    let place = Place::new();
    let _first = Server::start(&place, "127.0.0.1:0");
    let mut command = coordinator();
    command.args(["serve", "--listen", "127.0.0.1:0", "--store"]).arg(place.path("store"));
    let said = run(command);
    assert_eq!(said.status.code(), Some(1));
    assert!(said.stderr.contains("in use by another coordinator"), "{}", said.stderr);
}

#[test]
fn jobs_are_held_resumed_preferred_and_given_up() {
    let place = Place::new();
    alone(&place);
    let server = Server::start(&place, "127.0.0.1:0");
    let kept = server.submit(&place, &PICTURE);
    let dropped = server.submit(&place, &["--resolution", "32x32", "--spp", "16", "--priority", "-5"]);
    assert_eq!(server.ask(&["pause", &kept]).json()["state"], "paused");
    assert_eq!(server.ask(&["cancel", &dropped]).json()["state"], "cancelled");
    assert_eq!(server.ask(&["priority", &kept, "7"]).json()["spec"]["priority"], 7);
    let _worker = joining(&server.address, "ann");
    std::thread::sleep(std::time::Duration::from_millis(500));
    let held = server.status(&kept);
    assert_eq!((&held["state"], &held["samples_done"]), (&Value::from("paused"), &Value::from(0)));
    assert_eq!(server.ask(&["resume", &kept]).json()["state"], "running");
    assert_eq!(server.digest(&place, &kept), 0.0);
    let refused = server.ask(&["resume", &dropped]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(refused.stderr.contains("cancelled"), "{}", refused.stderr);
}

#[test]
fn a_worker_is_sent_home() {
    let place = Place::new();
    let server = Server::start(&place, "127.0.0.1:0");
    let worker = joining(&server.address, "ann");
    let workers = loop {
        let workers = server.ask(&["workers"]).json();
        if !workers.as_array().unwrap().is_empty() {
            break workers;
        }
    };
    assert_eq!(workers[0]["name"], "ann");
    assert!(server.ask(&["drain", &workers[0]["worker"].to_string()]).status.success());
    assert!(worker.wait().status.success());
    assert_eq!(server.ask(&["drain", "999"]).status.code(), Some(2));
    assert_eq!(server.ask(&["status", "999"]).status.code(), Some(2));
    let nowhere = run({
        let mut command = coordinator();
        command.args(["status", "--to", "127.0.0.1:1"]);
        command
    });
    assert_eq!(nowhere.status.code(), Some(1));
    assert!(nowhere.stderr.contains("no coordinator at 127.0.0.1:1"), "{}", nowhere.stderr);
}
