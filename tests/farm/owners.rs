//! Everybody sees how jobs are; only their owners and admins change, fetch and forget them. And what a submitter may bring.

use crate::closed::Closed;
use crate::harness::{Place, Said};
use crate::server::Server;
use farm_trust::Role;

const SMALL: [&str; 4] = ["--resolution", "32x20", "--spp", "16"];

fn submit(closed: &Closed, who: &str) -> String {
    let scene = closed.place.scene();
    let what = [&["submit", scene.to_str().unwrap()], &SMALL[..]].concat();
    closed.ask_as(Role::Submitter, who, &what).json()["job"].to_string()
}

fn refused(said: &Said, words: &str) {
    assert_eq!(said.status.code(), Some(1), "{}", said.stderr);
    assert!(said.stderr.contains(words), "{}", said.stderr);
}

#[test]
fn a_job_is_its_owners() {
    let mut closed = Closed::start();
    let job = submit(&closed, "ann");
    let out = closed.place.path("got.exr");
    let fetch = ["fetch", &job, "-o", out.to_str().unwrap()];
    let ask = |who: &str, what: &[&str]| closed.ask_as(Role::Submitter, who, what);
    let status = ask("bob", &["status", &job]).json()[0].clone();
    assert_eq!((&status["state"], status["owner"].as_str().unwrap().len()), (&"running".into(), 12));
    for what in [&["cancel", &job][..], &["pause", &job], &["resume", &job], &["priority", &job, "9"]] {
        refused(&ask("bob", what), "only its owner and admins may change");
    }
    for what in [&fetch[..], &["forget", &job]] {
        refused(&ask("bob", what), "only its owner and admins may change, fetch and forget it");
    }
    assert_eq!(ask("ann", &["priority", &job, "3"]).json()["spec"]["priority"], 3);

    // That is kept: the coordinator is killed, and everybody is who they were.
    closed.restart();
    let ask = |who: &str, what: &[&str]| closed.ask_as(Role::Submitter, who, what);
    refused(&ask("bob", &["cancel", &job]), "only its owner and admins");
    assert_eq!(ask("ann", &["pause", &job]).json()["state"], "paused");
    assert_eq!(closed.ask(Role::Admin, &["resume", &job]).json()["state"], "running");
    let _worker = closed.worker(&closed.token(Role::Worker, None), "friend");
    assert!(ask("bob", &["watch", &job]).status.success(), "anybody may watch");
    refused(&ask("bob", &fetch), "only its owner and admins");
    assert!(!out.exists());
    ask("ann", &fetch).json();
    assert!(out.exists());
    assert!(ask("ann", &["forget", &job]).status.success());
    let gone = ask("ann", &["status", &job]);
    assert_eq!(gone.status.code(), Some(2), "{}", gone.stderr);
    closed.logged("call refused");
}

#[test]
fn a_submitter_may_bring_so_much_and_an_admin_more() {
    let closed = Closed::start_with(&["--upload-quota", "100"]);
    let scene = closed.place.scene();
    let what = [&["submit", scene.to_str().unwrap()], &SMALL[..]].concat();
    refused(&closed.ask_as(Role::Submitter, "ann", &what), "may bring 100 bytes of scenes within an hour");
    assert!(closed.ask(Role::Admin, &what).status.success());
    // What is there already costs nothing.
    assert!(closed.ask_as(Role::Submitter, "ann", &what).status.success());
}

#[test]
fn what_ended_jobs_leave_behind_goes() {
    let place = Place::new();
    let mut command = Server::command("127.0.0.1:0", place.path("store").to_str().unwrap());
    command.args(["--keep-uploads", "1s"]);
    let mut server = Server::from_command(command);
    let count = |folder: &str| match std::fs::read_dir(place.path("store").join(folder)) {
        Ok(entries) => entries.count(),
        Err(_) => 0,
    };
    let until = |what: &str, is_so: &dyn Fn() -> bool| {
        let begun = std::time::Instant::now();
        while !is_so() {
            assert!(begun.elapsed() < std::time::Duration::from_secs(60), "{what}");
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
    };
    // The second has a scene of its own.
    let kept = server.submit(&place, &["--resolution", "96x64", "--spp", "4096", "--tile", "16"]);
    let given_up = server.submit(
        &place,
        &[
            "--resolution",
            "96x64",
            "--spp",
            "4096",
            "--tile",
            "16",
            "--aperture-radius",
            "0.2",
            "--priority",
            "1",
        ],
    );
    assert_eq!((count("scenes"), count("pieces")), (2, 2));
    let worker = crate::harness::joining(&server.address, "ann");
    server.wait_for_more(&given_up, 0);
    assert!(count(&format!("jobs/{given_up}/partials")) > 0);
    let refused = server.ask(&["forget", &given_up]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(refused.stderr.contains("cancel it first"), "{}", refused.stderr);
    server.ask(&["cancel", &given_up]).json();
    until("its partials go", &|| count(&format!("jobs/{given_up}/partials")) == 0);
    // Its worker is not to blame for what came too late, and the other job needs the scene that is in use.
    server.wait_for_more(&kept, 0);
    assert!(!server.running.stderr().contains("quarantine"), "{}", server.running.stderr());
    assert_eq!(count("scenes"), 2, "a job that was given up is still listed");
    assert!(server.ask(&["forget", &given_up]).status.success());
    server.running.wait_for("a line in the log", |said| said.contains("no job refers to them").then_some(()));
    assert_eq!((count("scenes"), count("pieces")), (1, 1));
    drop(worker);
    // Its number stays taken, also after a crash.
    server.running.kill();
    let server = Server::start(&place, "127.0.0.1:0");
    assert_eq!(server.ask(&["status", &given_up]).status.code(), Some(2));
    assert!(server.samples_done(&kept) > 0);
    let next = server.submit(&place, &SMALL);
    assert_eq!(next.parse::<u64>().unwrap(), given_up.parse::<u64>().unwrap() + 1);
}
