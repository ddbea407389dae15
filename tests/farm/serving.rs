//! A coordinator that serves many jobs.

use crate::harness::{Place, coordinator, joining, render, run};
use crate::server::{PICTURE, Server};
use farm_proto::PROTOCOL_VERSION;
use farm_proto::v1::coordinator_message::Message as Heard;
use farm_proto::v1::worker_message::Message as Said;
use farm_proto::v1::{self, farm_client::FarmClient};
use serde_json::Value;
use tokio_stream::wrappers::ReceiverStream;

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
    assert_eq!(server.difference(&place, &kept), 0.0);
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

#[test]
fn ordinary_tools_find_out_what_is_served_and_whether_it_is_well() {
    use tonic_health::pb::{
        HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient,
    };
    use tonic_reflection::pb::v1::ServerReflectionRequest;
    use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
    use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
    use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;
    let place = Place::new();
    let server = Server::start(&place, "127.0.0.1:0");
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let channel = tonic::transport::Endpoint::from_shared(format!("http://{}", server.address)).unwrap();
        let channel = channel.connect().await.unwrap();
        for service in ["", "farm.v1.Farm", "farm.v1.Control"] {
            let request = HealthCheckRequest { service: service.to_owned() };
            let answer = HealthClient::new(channel.clone()).check(request).await.unwrap().into_inner();
            assert_eq!(answer.status(), ServingStatus::Serving, "{service}");
        }
        let list = MessageRequest::ListServices(String::new());
        let request = ServerReflectionRequest { host: String::new(), message_request: Some(list) };
        let mut answers = ServerReflectionClient::new(channel)
            .server_reflection_info(tokio_stream::iter([request]))
            .await
            .unwrap()
            .into_inner();
        let answer = answers.message().await.unwrap().unwrap().message_response;
        let Some(MessageResponse::ListServicesResponse(list)) = answer else { panic!("{answer:?}") };
        let names: Vec<&str> = list.service.iter().map(|service| service.name.as_str()).collect();
        for service in ["farm.v1.Farm", "farm.v1.Control", "grpc.health.v1.Health"] {
            assert!(names.contains(&service), "{service} in {names:?}");
        }
    });
}

#[test]
fn what_the_store_has_is_not_sent_again() {
    let place = Place::new();
    let server = Server::start(&place, "127.0.0.1:0");
    let submit = |flags: &[&str]| {
        let scene = place.scene();
        let what = ["submit", scene.to_str().unwrap(), "--resolution", "8x8", "--spp"];
        server.ask(&[&what[..], flags].concat()).json()
    };
    let first = submit(&["1"]);
    assert_eq!(first["sent_bytes"], first["scene_bytes"]);
    assert_eq!(submit(&["2"])["sent_bytes"], 0);
    let other = submit(&["1", "--aperture-radius", "0.2"]);
    assert_ne!(other["scene_id"], first["scene_id"], "the lens is part of the scene");
    assert_eq!(other["sent_bytes"], other["scene_bytes"], "a scene this small is one piece");
}

#[test]
fn an_animation_is_watched_and_fetched() {
    let place = Place::new();
    let server = Server::start(&place, "127.0.0.1:0");
    let picture = ["--resolution", "32x20", "--spp", "32", "--frames", "1-3"];
    let job = server.submit(&place, &picture);
    let _worker = joining(&server.address, "ann");
    let watched = server.ask(&["watch", &job]);
    assert!(watched.status.success(), "{}", watched.stderr);
    let updates: Vec<Value> =
        watched.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let last = updates.last().unwrap();
    assert_eq!((&last["state"], &last["frames_done"]), (&Value::from("done"), &Value::from(3)));
    assert!(updates.iter().any(|update| update["workers"][0]["name"] == "ann"));
    let log: Vec<&str> = updates
        .iter()
        .flat_map(|update| update["log"].as_array().unwrap())
        .map(|entry| entry["text"].as_str().unwrap())
        .collect();
    for event in ["worker ann joined", "frame 1 is written", "frame 3 is written"] {
        assert!(log.iter().any(|text| text.starts_with(event)), "{event} in {log:?}");
    }
    server.ask(&["fetch", &job, "-o", place.path("got.####.exr").to_str().unwrap()]).json();
    run(render(&place, "alone.####.exr", &picture)).json();
    for frame in ["0001", "0002", "0003"] {
        let mut compare = coordinator();
        compare
            .args(["compare", "--json"])
            .args(["got", "alone"].map(|name| place.path(&format!("{name}.{frame}.exr"))));
        assert_eq!(run(compare).json()["max_abs"], 0.0, "frame {frame}");
    }
}

/// A worker that fails at the first unit it gets, and leaves.
fn fail(address: &str, name: String) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut client = FarmClient::connect(format!("http://{address}")).await.unwrap();
        let (outgoing, messages) = tokio::sync::mpsc::channel(16);
        let say = async |message| outgoing.send(v1::WorkerMessage { message: Some(message) }).await.unwrap();
        let fingerprint = farm_render::FINGERPRINT.to_owned();
        let hello = v1::Hello { protocol: PROTOCOL_VERSION, name, slots: 1, fingerprint };
        say(Said::Hello(hello)).await;
        let mut heard = client.work(ReceiverStream::new(messages)).await.unwrap().into_inner();
        let lease = loop {
            if let Some(Heard::Grant(grant)) = heard.message().await.unwrap().unwrap().message {
                break grant.lease;
            }
        };
        say(Said::UnitFailed(v1::UnitFailed { lease, reason: "no hands".into() })).await;
        // The last word must have arrived before the line is cut.
        tokio::time::sleep(std::time::Duration::from_millis(200)).await;
    });
}

#[test]
fn a_failed_job_is_tried_again_with_what_it_has() {
    let place = Place::new();
    let mut server = Server::start(&place, "127.0.0.1:0");
    let address = server.address.clone();
    let job = server.submit(&place, &PICTURE);
    // The same unit on one worker after the other.
    let clumsy = (0..10).map(|number| format!("clumsy-{number}"));
    let mut failed = clumsy.map(|name| {
        fail(&address, name);
        server.status(&job)
    });
    let failed = failed.find(|status| status["state"] == "failed").expect("it is given up");
    assert!(failed["reason"].as_str().unwrap().contains("no hands"), "{failed}");
    server.running.kill();
    server = Server::start(&place, &address);
    assert_eq!(server.status(&job)["state"], "failed", "that is kept, too");
    assert_eq!(server.ask(&["resume", &job]).json()["state"], "running");
    let _worker = joining(&address, "ann");
    assert_eq!(server.difference(&place, &job), 0.0);
}
