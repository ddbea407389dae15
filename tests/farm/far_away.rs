//! A coordinator and a worker on hosts that are far apart, with a line between them that loses packets and breaks.

use crate::harness::{Place, Running, Said, coordinator, run, worker};
use crate::line::{ADDRESSES, Line, Weather};
use crate::server::{PICTURE, Server, difference_to_alone};
use serde_json::Value;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

/// Over an ocean, by a bad radio link.
const WEATHER: Weather = Weather { delay: Duration::from_millis(40), lost_of: 50 };

#[test]
fn a_line_that_delays_loses_and_breaks_costs_time_but_no_bits() {
    let Some(line) = Line::lay(WEATHER) else {
        eprintln!("skipped: network namespaces and tunnels between them are not permitted here");
        return;
    };
    let place = Place::new();
    let trust = place.path("trust");
    let mut serve = Server::command(&format!("{}:0", ADDRESSES[0]), place.path("store").to_str().unwrap());
    serve.arg("--trust").arg(&trust);
    let mut server = Server::from_command(line.on(0, &serve));
    server.running.wait_for("the authority", |said| said.contains("coordinator token create").then_some(()));
    let mut create = coordinator();
    create.args(["token", "create", "--role", "worker", "--json", "--trust"]).arg(&trust);
    let token = run(create).json();

    // The coordinator's owner, on the same host.
    let ask = |what: &[&str]| -> Said {
        let mut command = coordinator();
        command.args(what).args(["--to", &server.address, "--json"]);
        command.env("FARM_IDENTITY", trust.join("admin.pem"));
        run(line.on(0, &command))
    };
    let scene = place.scene();
    let job = ask(&[&["submit", scene.to_str().unwrap()], &PICTURE[..]].concat()).json()["job"].to_string();
    let mut far = Running::start(line.on(1, &far_worker(&server.address, &token, &place.path("far.pem"))));
    far.wait_for("a welcome", |said| said.contains("connected").then_some(()));
    let some = |said: &Value| said["samples_done"].as_u64().unwrap() > 0;
    while !some(&ask(&["status", &job]).json()[0]) {}

    // Neither side hears anything, not even that the other is gone.
    line.cut(true);
    server.running.wait_for("the end of patience", |said| said.contains("why=Silent").then_some(()));
    far.wait_for("a loss", |said| said.contains("connection lost").then_some(()));
    line.cut(false);
    far.wait_for("a welcome", |said| (said.matches("connected").count() > 1).then_some(()));
    assert!(ask(&["watch", &job]).status.success());
    let fetched = place.path("fetched.exr");
    ask(&["fetch", &job, "-o", fetched.to_str().unwrap()]).json();
    assert_eq!(difference_to_alone(&fetched), 0.0);
    assert!(far.is_running());
}

/// A worker on the far host, which joins with a token.
fn far_worker(address: &str, token: &Value, identity: &Path) -> Command {
    let mut command = worker();
    command.args(["--connect", address, "--threads", "1", "--name", "far", "--ca-fingerprint"]);
    command.arg(token["ca_fingerprint"].as_str().unwrap()).arg("--identity").arg(identity);
    command.env("FARM_TOKEN", token["token"].as_str().unwrap());
    command
}
