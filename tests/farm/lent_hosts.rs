//! Workers on hosts that are not theirs alone: bounds of memory and disk, leaving in time, making way for others.

use crate::harness::{Place, Running, joining, joining_on, joining_with, nice, render, run, serving, worker};
use crate::played_host::PlayedHost;
use crate::server::Server;
use std::time::{Duration, Instant};

/// Renders in a moment.
const SMALL: [&str; 4] = ["--resolution", "16x16", "--spp", "1"];

/// One tile of one leaf: a unit that takes a minute and of which nothing is finished before.
const ENDLESS: [&str; 6] = ["--resolution", "2048x2048", "--spp", "16", "--tile", "2048"];

#[test]
fn a_scene_beyond_the_memory_is_refused_and_left_to_others() {
    let place = Place::new();
    let server = Server::start(&place, "127.0.0.1:0");
    let job = server.submit(&place, &SMALL);
    let mut small = joining_on(&server.address, "small", &["--memory", "1k"]);
    let waiting = server.wait_until(&job, "a reason", |status| {
        status["reason"].as_str().unwrap().contains("refuses the job")
    });
    let reason = waiting["reason"].as_str().unwrap();
    assert!(reason.contains("this worker may use 1000: give it more with --memory"), "{reason}");
    small.wait_for("a line in its log", |said| said.contains("job refused").then_some(()));
    let _large = joining_on(&server.address, "large", &["--memory", "100M"]);
    assert!(server.ask(&["watch", &job]).status.success());
    assert!(small.is_running(), "another job may be within its means");
}

#[test]
fn a_full_cache_lets_the_scene_go_that_was_not_needed_for_longest() {
    let place = Place::new();
    let server = Server::start(&place, "127.0.0.1:0");
    let cache = place.path("cache");
    let submit = |aperture: &str| {
        let scene = place.scene();
        let what = ["submit", scene.to_str().unwrap(), "--aperture-radius", aperture];
        let job = server.ask(&[&what[..], &SMALL].concat()).json();
        (job["job"].to_string(), job["scene_id"].as_str().unwrap().to_owned(), job["scene_bytes"].as_u64())
    };
    let (job, first, bytes) = submit("0.1");
    let two_scenes = (bytes.unwrap() * 5 / 2).to_string();
    let joined = || {
        joining_on(&server.address, "ann", &["--cache", cache.to_str().unwrap(), "--cache-size", &two_scenes])
    };
    let rendered = |job: &str| assert!(server.ask(&["watch", job]).status.success());
    let kept = || {
        let files = std::fs::read_dir(&cache).unwrap();
        let mut names: Vec<_> = files.map(|file| file.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    };
    let sorted = |mut names: [String; 2]| {
        names.sort();
        names
    };
    let ann = joined();
    rendered(&job);
    let (job, second, _) = submit("0.2");
    rendered(&job);
    assert_eq!(kept(), sorted([first.clone(), second]));

    // Another process needs the first one again, which it has never fetched.
    ann.terminate();
    assert!(ann.wait().status.success());
    let _ann = joined();
    rendered(&submit("0.1").0);
    let (job, third, _) = submit("0.3");
    rendered(&job);
    assert_eq!(kept(), sorted([first, third]), "the second was not needed for longest");
}

#[test]
fn a_second_signal_leaves_everything_behind_at_once() {
    let place = Place::new();
    let server = Server::start(&place, "127.0.0.1:0");
    let job = server.submit(&place, &ENDLESS);
    let mut command = worker();
    command.args(["--connect", &server.address, "--threads", "1", "--name", "hasty"]);
    command.env("FARM_LOG", "info,farm_worker=debug");
    let mut worker = Running::start(command);
    worker.wait_for("its first unit", |said| said.contains("unit begins").then_some(()));
    worker.terminate();
    worker.wait_for("its patience", |said| said.contains("a second signal leaves at once").then_some(()));
    assert!(worker.is_running(), "it finishes what it renders");
    worker.terminate();
    let told = Instant::now();
    let said = worker.wait();
    assert!(told.elapsed() < Duration::from_secs(2), "{:?}", told.elapsed());
    assert_eq!(said.status.code(), Some(1));
    assert!(said.stderr.contains("left at once"), "{}", said.stderr);
    let left = server.wait_until(&job, "an open unit", |status| status["counts"]["expired"] == 1);
    assert!(left["reason"].as_str().unwrap().contains("no worker is connected"), "{left}");
}

#[test]
fn a_worker_is_gone_at_the_time_it_was_told() {
    let place = Place::new();
    let server = Server::start(&place, "127.0.0.1:0");
    let job = server.submit(&place, &SMALL);
    // The last minutes before are for finishing.
    let soon = chrono::Local::now() + chrono::TimeDelta::minutes(2);
    let until = soon.format("%H:%M").to_string();
    let worker = joining_on(&server.address, "guest", &["--until", &until, "--grace", "3m"]);
    let said = worker.wait();
    assert!(said.status.success() && said.stderr.contains("drained; leaving"), "{}", said.stderr);
    let _heir = joining(&server.address, "heir");
    assert!(server.ask(&["watch", &job]).status.success());
}

#[test]
fn a_worker_for_idle_hosts_does_not_join_a_busy_one() {
    let place = Place::new();
    let server = Server::start(&place, "127.0.0.1:0");
    let mut guest = joining_on(&server.address, "guest", &["--max-load", "0.000001", "--nice", "7"]);
    guest.wait_for("its patience", |said| {
        said.contains("waiting for others to leave this host alone").then_some(())
    });
    assert_eq!(guest.nice(), nice("self") + 7);
    assert_eq!(server.ask(&["workers"]).json().as_array().unwrap().len(), 0);
    guest.terminate();
    assert!(guest.wait().status.success());
}

/// One tile, of which a leaf takes a tenth of a second, so that a unit of a second has a middle.
const DEEP: [&str; 6] = ["--resolution", "48x48", "--spp", "4096", "--tile", "48"];

#[test]
fn a_worker_whose_time_is_up_hands_back_what_it_has_finished() {
    let place = Place::new();
    let (mut coordinator, address) = serving(&place, &DEEP);
    // Whether a leaf of its unit is finished in time is luck on a busy machine, so others try as well.
    let part = (0..5).find_map(|number| {
        let leaver = joining_on(&address, &format!("leaver-{number}"), &["--grace", "700ms"]);
        let known = accepted(&coordinator.stderr()).len();
        coordinator.wait_for("units of several leaves", |said| {
            accepted(said)[known..].iter().any(|(start, end)| end - start >= 64).then_some(())
        });
        leaver.terminate();
        let told = Instant::now();
        let said = leaver.wait();
        assert!(said.status.success(), "{}", said.stderr);
        assert!(told.elapsed() < Duration::from_secs(10), "{:?}", told.elapsed());
        block(said.stderr.split_once("finished=")?.1)
    });
    let part = part.expect("somebody leaves in the middle of a unit");
    let _heir = joining_with(&address, "heir", &["--threads", "2"]);
    let said = coordinator.wait();
    assert_eq!(said.digest(), run(render(&place, "alone.exr", &DEEP)).digest());
    let mut taken = accepted(&said.stderr);
    assert!(taken.contains(&part), "{part:?} is among what was accepted: {taken:?}");
    taken.sort_unstable();
    let ends = std::iter::once(0).chain(taken.iter().map(|block| block.1));
    assert!(ends.zip(&taken).all(|(end, block)| end == block.0), "each sample once: {taken:?}");
}

/// The samples of the units that were accepted.
fn accepted(log: &str) -> Vec<(u64, u64)> {
    let lines = log.lines().filter(|line| line.contains("unit accepted"));
    lines.filter_map(|line| block(line.split_once("samples ")?.1)).collect()
}

/// A block at the beginning of a text: `32..64`.
fn block(text: &str) -> Option<(u64, u64)> {
    let (start, rest) = text.split_once("..")?;
    let end = rest.split(|letter: char| !letter.is_ascii_digit()).next()?;
    Some((start.parse().ok()?, end.parse().ok()?))
}

#[test]
fn a_worker_makes_way_for_others_and_comes_back() {
    let place = Place::new();
    let Some(host) = PlayedHost::start(&place) else {
        eprintln!("skipped: mounting over /proc/stat is not permitted here");
        return;
    };
    let server = Server::start(&place, "127.0.0.1:0");
    let mut command = worker();
    command.args(["--connect", &server.address, "--threads", "1", "--name", "guest", "--max-load", "0.5"]);
    let mut guest = Running::start(host.on(&command));
    guest.wait_for("a quiet host", |said| said.contains("connected").then_some(()));
    host.keep_busy(4);
    guest.wait_for("others", |said| said.contains("others need this host").then_some(()));
    server.wait_for_workers(0);
    host.keep_busy(0);
    server.wait_for_workers(1);
}
