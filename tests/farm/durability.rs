//! Acknowledged is durable: programs are killed, stopped and woken, disks fill up, and the picture is the same.

use crate::harness::{Place, Running, coordinator, joining};
use crate::server::{PICTURE, Server};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// A dead or frozen worker's units are given to another within this.
const REQUEUE_WITHIN: Duration = Duration::from_secs(5);

/// Samples of one leaf of a tile of [`PICTURE`].
const SMALLEST_UNIT: u64 = 16 * 16 * 16;

#[test]
fn a_coordinator_killed_ten_times_in_one_frame_goes_on_where_it_was() {
    let place = Place::new();
    let start = |listen: &str| Server::start_telling(&place, listen);
    let mut server = start("127.0.0.1:0");
    let address = server.address.clone();
    let job = server.submit(&place, &PICTURE);
    let mut worker = joining(&address, "loyal");
    let mut watch = coordinator();
    watch.args(["watch", &job, "--to", &address]);
    let watch = Running::start(watch);
    // Killed as soon as it has acknowledged something, so that nobody gets far in one life.
    let mut acknowledged = 0;
    for _ in 0..10 {
        server.running.wait_for("a result", |said| said.contains("unit accepted").then_some(()));
        server.running.kill();
        acknowledged += server.running.stderr().matches("unit accepted").count();
        let dead = Instant::now();
        server = start(&address);
        assert!(dead.elapsed() < Duration::from_secs(5), "blind for {:?}", dead.elapsed());
        let status = server.status(&job);
        assert_eq!(status["state"], "running", "there is more to do after {acknowledged} units: {status}");
        let done = status["samples_done"].as_u64().unwrap();
        let least = acknowledged as u64 * SMALLEST_UNIT;
        assert!(done >= least, "{done} samples of {acknowledged} units: something acknowledged was lost");
    }
    assert_eq!(server.difference(&place, &job), 0.0);
    assert!(worker.is_running(), "a restart is no error, only a wait");
    let watched = watch.wait();
    assert!(watched.status.success() && watched.stderr.contains("waiting for it"), "{}", watched.stderr);
    let end = server.status(&job);
    assert_eq!((&end["state"], &end["samples_done"]), (&"done".into(), &end["samples_total"]));
}

#[test]
fn both_sides_are_killed_in_turn() {
    let place = Place::new();
    let mut server = Server::start(&place, "127.0.0.1:0");
    let address = server.address.clone();
    let job = server.submit(&place, &PICTURE);
    let mut done = 0;
    for round in 0..3 {
        let mut victim = joining(&address, &format!("victim-{round}"));
        done = server.wait_for_more(&job, done);
        victim.kill();
        server.running.kill();
        server = Server::start(&place, &address);
    }
    let _heir = joining(&address, "heir");
    assert_eq!(server.difference(&place, &job), 0.0);
}

#[test]
fn a_frozen_worker_is_given_up_and_may_come_back() {
    let place = Place::new();
    let mut server = Server::start(&place, "127.0.0.1:0");
    let job = server.submit(&place, &PICTURE);
    let frozen = joining(&server.address, "frozen");
    let done = server.wait_for_more(&job, 0);
    frozen.freeze();
    let since = Instant::now();
    let _heir = joining(&server.address, "heir");
    server.running.wait_for("the end of patience", |said| said.contains("why=Silent").then_some(()));
    assert!(since.elapsed() < REQUEUE_WITHIN, "{:?}", since.elapsed());
    server.wait_for_more(&job, done);
    frozen.thaw();
    assert_eq!(server.difference(&place, &job), 0.0);
}

#[test]
fn a_coordinator_that_stands_by_takes_over_from_a_dead_one() {
    let place = Place::new();
    let mut first = Server::start(&place, "127.0.0.1:0");
    let address = first.address.clone();
    let job = first.submit(&place, &PICTURE);
    let mut command = Server::command(&address, place.path("store").to_str().unwrap());
    command.arg("--standby");
    let mut second = Running::start(command);
    second.wait_for("its patience", |said| said.contains("standing by").then_some(()));
    let _worker = joining(&address, "loyal");
    let done = first.wait_for_more(&job, 0);
    assert!(!second.stderr().contains("listening"), "one at a time");
    first.running.kill();
    let second = Server::once_it_listens(second);
    assert!(second.samples_done(&job) >= done);
    assert_eq!(second.difference(&place, &job), 0.0);
}

#[test]
fn a_worker_that_knows_two_addresses_finds_whoever_takes_over_at_the_other() {
    let place = Place::new();
    let mut first = Server::start(&place, "127.0.0.1:0");
    let job = first.submit(&place, &PICTURE);
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    let mut command = Server::command(&free, place.path("store").to_str().unwrap());
    command.arg("--standby");
    let mut second = Running::start(command);
    second.wait_for("its patience", |said| said.contains("standing by").then_some(()));
    let mut worker = joining(&format!("{free},{}", first.address), "loyal");
    let done = first.wait_for_more(&job, 0);
    first.running.kill();
    let second = Server::once_it_listens(second);
    assert_eq!(second.address, free);
    assert!(second.samples_done(&job) >= done);
    assert_eq!(second.difference(&place, &job), 0.0);
    assert!(worker.is_running(), "it has gone over");
}

#[test]
fn a_coordinator_that_slept_through_its_end_writes_nothing_more() {
    let place = Place::new();
    let store = place.path("store");
    let first = Server::start(&place, "127.0.0.1:0");
    let job = first.submit(&place, &PICTURE);
    let mut command = Server::command("127.0.0.1:0", store.to_str().unwrap());
    command.arg("--standby");
    let mut second = Running::start(command);
    second.wait_for("its patience", |said| said.contains("standing by").then_some(()));
    let _early = joining(&first.address, "early");
    let done = first.wait_for_more(&job, 0);
    first.running.freeze();
    let mut second = Server::once_it_listens(second);
    second.running.wait_for("a reason", |said| said.contains("no sign of life").then_some(()));
    assert!(second.samples_done(&job) >= done);
    let before = files(&store);
    first.running.thaw();
    // It has an unfinished frame, a worker that delivers to it, and nothing to say any more.
    let said = first.running.wait();
    assert_eq!(said.status.code(), Some(1));
    assert!(said.stderr.contains("has taken over the store"), "{}", said.stderr);
    // The second has no worker yet: whatever is there besides its signs of life came from the first.
    assert_eq!(files(&store), before);
    let _late = joining(&second.address, "late");
    assert_eq!(second.difference(&place, &job), 0.0);
}

/// All files below a folder, without signs of life.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else if !path.to_string_lossy().contains(".beat") {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// A small disk of its own, where one may be mounted.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn mount(place: &Place) -> Option<Self> {
        let folder = place.path("store");
        std::fs::create_dir(&folder).unwrap();
        let mounted =
            Command::new("mount").args(["-t", "tmpfs", "-o", "size=8m", "tmpfs"]).arg(&folder).output();
        mounted.is_ok_and(|output| output.status.success()).then_some(Self(folder))
    }

    /// Takes all the room there is.
    fn fill(&self) {
        let mut filler = std::fs::File::create(self.0.join("filler")).unwrap();
        while std::io::Write::write(&mut filler, &[1; 4096]).is_ok_and(|written| written > 0) {}
    }

    fn empty(&self) {
        std::fs::remove_file(self.0.join("filler")).unwrap();
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("--lazy").arg(&self.0).status();
    }
}

#[test]
fn a_full_disk_is_waited_for() {
    let place = Place::new();
    let Some(disk) = SmallDisk::mount(&place) else {
        eprintln!("skipped: mounting a small disk is not permitted here");
        return;
    };
    let mut server = Server::start(&place, "127.0.0.1:0");
    let job = server.submit(&place, &PICTURE);
    let mut worker = joining(&server.address, "patient");
    server.wait_for_more(&job, 0);
    disk.fill();
    let full = server.wait_until(&job, "a full disk", |status| status["state"] == "paused");
    let reason = full["reason"].as_str().unwrap();
    assert!(reason.contains("waits for the store") && reason.contains("No space left on device"), "{reason}");
    std::thread::sleep(Duration::from_secs(3));
    assert_eq!(server.samples_done(&job), full["samples_done"].as_u64().unwrap(), "nothing is acknowledged");
    server.running.wait_for("a line in the log", |said| said.contains("the store fails").then_some(()));
    assert!(worker.is_running());
    disk.empty();
    server.running.wait_for("a line in the log", |said| said.contains("works again").then_some(()));
    assert_eq!(server.difference(&place, &job), 0.0);
    drop(server);
}
