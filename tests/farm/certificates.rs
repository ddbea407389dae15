//! Certificates end; whoever is there in time gets the next one, and whoever was away for too long hears what to do.

use crate::closed::Closed;
use crate::harness::{Running, coordinator, run};
use farm_trust::{Identity, Role};
use std::path::Path;
use std::time::{Duration, Instant, SystemTime};

const DAY: Duration = Duration::from_secs(24 * 3600);

/// Renewed from the sixth second on.
const SHORT: Duration = Duration::from_secs(9);

fn lasts_a_day(file: &Path) -> bool {
    Identity::load(file).unwrap().unwrap().holder().unwrap().expires > SystemTime::now() + DAY
}

fn submit(closed: &Closed, identity: &Path) -> String {
    let scene = closed.place.scene();
    let what = ["submit", scene.to_str().unwrap(), "--resolution", "16x10", "--spp", "16"];
    closed.ask_with(identity, &what).json()["job"].to_string()
}

#[test]
fn certificates_are_renewed_before_they_run_out() {
    let mut closed = Closed::start();
    let (_, submitter) = closed.identity_for(Role::Submitter, SHORT, "artist");
    let (_, kept) = closed.identity_for(Role::Worker, SHORT, "friend");
    let mut friend = Running::start(closed.worker_command("friend"));
    closed.logged("name=friend");
    // A program that comes now and then asks for the next one when it comes.
    let begun = Instant::now();
    while !lasts_a_day(&submitter) {
        let said = closed.ask_with(&submitter, &["status"]);
        assert!(said.status.success() && begun.elapsed() < SHORT, "{}", said.stderr);
        std::thread::sleep(Duration::from_millis(500));
    }
    // One that stays asks by itself; the line of the old certificate ends with it, and the worker is back with the new one.
    friend.wait_for("the renewal", |said| said.contains("certificate was renewed").then_some(()));
    assert!(lasts_a_day(&kept));
    closed.logged_line(&["hanging up", "certificate has expired"]);
    let job = submit(&closed, &submitter);
    let watched = closed.ask_with(&submitter, &["watch", &job]);
    assert!(watched.status.success(), "{}", watched.stderr);
    assert!(friend.is_running());
}

#[test]
fn whoever_was_away_when_the_certificate_ran_out_hears_what_to_do() {
    let mut closed = Closed::start();
    let token = closed.token(Role::Worker, None);
    let (_, late) = closed.identity_for(Role::Submitter, Duration::from_secs(1), "late");
    closed.identity_for(Role::Worker, Duration::from_secs(1), "sleeper");
    std::thread::sleep(Duration::from_secs(2));
    let said = closed.ask_with(&late, &["status"]);
    assert_eq!(said.status.code(), Some(2));
    assert!(said.stderr.contains("token create --role submitter"), "{}", said.stderr);
    let said = run(closed.worker_command("sleeper"));
    assert_eq!(said.status.code(), Some(2));
    assert!(said.stderr.contains("token create --role worker"), "{}", said.stderr);
    // Which is what helps.
    let mut awake = closed.worker(&token, "sleeper");
    closed.logged("name=sleeper");
    assert!(lasts_a_day(&closed.place.path("sleeper.pem")) && awake.is_running());
    // The coordinator is gone when the certificate should be renewed, and for longer than it lasts.
    closed.identity_for(Role::Worker, SHORT, "patient");
    let mut patient = Running::start(closed.worker_command("patient"));
    closed.logged("name=patient");
    closed.running.kill();
    patient.wait_for("the loss", |said| said.contains("connection lost").then_some(()));
    let said = patient.wait();
    assert_eq!(said.status.code(), Some(1));
    assert!(said.stderr.contains("token create --role worker"), "{}", said.stderr);
    // What it says to do can be done.
    let mut create = coordinator();
    create.args(["token", "create", "--role", "worker", "--trust"]).arg(closed.place.path("trust"));
    assert!(run(create).stdout.starts_with("FARM_TOKEN=tessera-"));
}
