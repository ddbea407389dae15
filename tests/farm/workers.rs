//! Workers come, go and die; the frame is finished and its bits are the same.

use crate::harness::{Place, Running, joining, serving, worker};
use crate::server::{PICTURE, digest_alone};
use std::time::{Duration, Instant};

#[test]
fn four_processes_render_one_frame() {
    let place = Place::new();
    let (coordinator, address) = serving(&place, &PICTURE);
    let workers: Vec<_> = ["ann", "bob", "cid"].map(|name| joining(&address, name)).into();
    let json = coordinator.wait().json();
    assert_eq!(json["digest"], digest_alone());
    assert_eq!(json["workers"], 3, "everybody has helped");
    for worker in workers {
        let said = worker.wait();
        assert!(said.status.success() && said.stderr.contains("no more work"), "{}", said.stderr);
    }
}

#[test]
fn a_worker_that_joins_late_helps() {
    let place = Place::new();
    let (mut coordinator, address) = serving(&place, &PICTURE);
    let _early = joining(&address, "early");
    coordinator.wait_for("the first worker", |said| said.contains("name=early").then_some(()));
    coordinator.wait_for("its first unit", |said| said.contains("unit accepted").then_some(()));
    let _late = joining(&address, "late");
    let json = coordinator.wait().json();
    assert_eq!(json["digest"], digest_alone());
    assert_eq!(json["workers"], 2);
}

#[test]
fn a_worker_killed_in_mid_frame_costs_time_but_no_bits() {
    let place = Place::new();
    let (mut coordinator, address) = serving(&place, &PICTURE);
    let mut victim = joining(&address, "victim");
    coordinator.wait_for("the victim", |said| said.contains("name=victim").then_some(()));
    coordinator.wait_for("its first unit", |said| said.contains("unit accepted").then_some(()));
    victim.kill();
    assert!(coordinator.is_running(), "the victim died in mid-frame");
    let killed = Instant::now();
    let _heir = joining(&address, "heir");
    let json = coordinator.wait().json();
    assert_eq!(json["digest"], digest_alone());
    assert_eq!(json["workers"], 2, "the victim had delivered something");
    assert!(killed.elapsed() < Duration::from_secs(120));
}

#[test]
fn a_worker_that_is_told_to_stop_finishes_its_unit_and_leaves() {
    let place = Place::new();
    let (mut coordinator, address) = serving(&place, &PICTURE);
    let leaver = joining(&address, "leaver");
    coordinator.wait_for("the leaver", |said| said.contains("name=leaver").then_some(()));
    coordinator.wait_for("its first unit", |said| said.contains("unit accepted").then_some(()));
    leaver.terminate();
    let said = leaver.wait();
    assert!(said.status.success() && said.stderr.contains("drained"), "{}", said.stderr);
    assert!(coordinator.is_running(), "the leaver left in mid-frame");
    let _heir = joining(&address, "heir");
    assert_eq!(coordinator.wait().digest(), digest_alone());
}

#[test]
fn a_coordinator_that_goes_away_is_waited_for_and_then_given_up() {
    let place = Place::new();
    let (mut coordinator, address) = serving(&place, &PICTURE);
    let mut command = worker();
    command.args(["--connect", &address, "--threads", "1", "--name", "loyal", "--retry-for", "2s"]);
    let mut loyal = Running::start(command);
    coordinator.wait_for("the worker", |said| said.contains("name=loyal").then_some(()));
    coordinator.kill();
    loyal.wait_for("the loss", |said| said.contains("connection lost").then_some(()));
    let said = loyal.wait();
    assert_eq!(said.status.code(), Some(1));
    assert!(said.stderr.contains(&format!("no coordinator at {address}")), "{}", said.stderr);
    assert_eq!(place.files(), [""; 0], "nothing half-written");
}
