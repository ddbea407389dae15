//! Workers that send what they should not: damaged, malformed, of something else, or plainly wrong. The picture is the same.

use crate::harness::{Place, joining, render, run, serving};
use crate::server::{self, Server};
use farm_film::{FilmTile, Tile, WorkUnit};
use farm_image::{PartialHeader, encode_partial};
use farm_job::JobSpec;
use farm_proto::PROTOCOL_VERSION;
use farm_proto::convert::{FromWorker, Grant, Heartbeat, Hello, ToWorker, UnitResult};
use farm_proto::v1::{self, farm_client::FarmClient};
use farm_worker::frames::partial_header;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;

const PICTURE: [&str; 6] = ["--resolution", "64x40", "--spp", "256", "--tile", "16"];

/// What an impostor makes of a unit.
type Forgery = fn(&Grant, &JobSpec) -> UnitResult;

/// A result that says of itself whatever it is told to say.
fn forged(grant: &Grant, header: PartialHeader, unit: WorkUnit, value: f32) -> UnitResult {
    let tile = FilmTile::new(unit.tile, unit.block, vec![[value; 3]; unit.tile.area()]);
    let partial_exr = bytes::Bytes::from(encode_partial(&tile, &header));
    UnitResult {
        lease: grant.lease,
        job: grant.job,
        unit: grant.unit,
        digest: farm_job::Digest(*blake3::hash(&partial_exr).as_bytes()),
        partial_exr,
        render: Duration::from_millis(1),
        cpu: Duration::from_millis(1),
        counters: header.counters,
    }
}

fn header(grant: &Grant, spec: &JobSpec) -> PartialHeader {
    partial_header(spec.resolution().unwrap(), spec.scene, &spec.settings, grant.unit.frame)
}

/// Well-formed in every respect, and wrong.
fn lie(grant: &Grant, spec: &JobSpec) -> UnitResult {
    forged(grant, header(grant, spec), grant.unit, 7.0)
}

fn damaged(grant: &Grant, spec: &JobSpec) -> UnitResult {
    let mut result = lie(grant, spec);
    let mut bytes = result.partial_exr.to_vec();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    result.partial_exr = bytes.into();
    result
}

fn truncated(grant: &Grant, spec: &JobSpec) -> UnitResult {
    let mut result = lie(grant, spec);
    result.partial_exr = result.partial_exr.slice(..result.partial_exr.len() - 9);
    result.digest = farm_job::Digest(*blake3::hash(&result.partial_exr).as_bytes());
    result
}

fn not_finite(grant: &Grant, spec: &JobSpec) -> UnitResult {
    forged(grant, header(grant, spec), grant.unit, f32::NAN)
}

fn of_another_renderer(grant: &Grant, spec: &JobSpec) -> UnitResult {
    let header = PartialHeader { renderer: "another".to_owned(), ..header(grant, spec) };
    forged(grant, header, grant.unit, 7.0)
}

fn of_another_window(grant: &Grant, spec: &JobSpec) -> UnitResult {
    let tile = Tile::new(0, 0, 8, 8).unwrap();
    forged(grant, header(grant, spec), WorkUnit { tile, ..grant.unit }, 7.0)
}

fn of_no_unit(grant: &Grant, spec: &JobSpec) -> UnitResult {
    let unit = WorkUnit { tile: Tile::new(0, 0, 8, 8).unwrap(), ..grant.unit };
    UnitResult { unit, ..forged(grant, header(grant, spec), unit, 7.0) }
}

/// Joins, and answers every grant with a forgery until the coordinator ends.
fn impostor(address: &str, name: &str, forgery: Forgery) -> std::thread::JoinHandle<()> {
    let (address, name) = (format!("http://{address}"), name.to_owned());
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(pretend(address, name, forgery));
    })
}

async fn pretend(address: String, name: String, forgery: Forgery) {
    let mut client = FarmClient::connect(address).await.unwrap();
    let (outgoing, messages) = mpsc::channel(64);
    let fingerprint = farm_render::FINGERPRINT.to_owned();
    let hello = Hello { protocol: PROTOCOL_VERSION, name, slots: 2, fingerprint };
    outgoing.send(FromWorker::Hello(hello)).await.unwrap();
    let messages = ReceiverStream::new(messages).map(v1::WorkerMessage::from);
    let mut incoming = client.work(messages).await.unwrap().into_inner();
    while let Ok(Some(message)) = incoming.message().await {
        match ToWorker::try_from(message).unwrap() {
            ToWorker::Welcome { worker, heartbeat, .. } => {
                let mut client = client.clone();
                tokio::spawn(async move {
                    let beat = Heartbeat { worker, leases: Vec::new(), round_trip: None };
                    while client.beat(v1::Heartbeat::from(beat.clone())).await.is_ok() {
                        tokio::time::sleep(heartbeat).await;
                    }
                });
            }
            ToWorker::Grant(grant) => {
                let request = v1::GetJobRequest { job: grant.job.0 };
                let Ok(spec) = client.get_job(request).await else { return };
                let spec = JobSpec::try_from(spec.into_inner()).unwrap();
                // Others shall get something to do.
                tokio::time::sleep(Duration::from_millis(20)).await;
                let _ = outgoing.send(FromWorker::Result(forgery(&grant, &spec))).await;
            }
            ToWorker::Drained | ToWorker::Farewell(_) => return,
            _ => {}
        }
    }
}

#[test]
fn what_is_no_result_is_refused_and_rendered_elsewhere() {
    let place = Place::new();
    let expected = run(render(&place, "alone.exr", &PICTURE)).digest();
    let forgeries: [(Forgery, &str); 6] = [
        (damaged, "digest differs"),
        (truncated, "cannot be read"),
        (not_finite, "not finite"),
        (of_another_renderer, "another renderer"),
        (of_another_window, "another tile"),
        (of_no_unit, "no unit of its job"),
    ];
    for (forgery, reason) in forgeries {
        let (mut coordinator, address) = serving(&place, &PICTURE);
        let _honest = joining(&address, "honest");
        coordinator.wait_for("the honest one", |said| said.contains("name=honest").then_some(()));
        let impostor = impostor(&address, "impostor", forgery);
        coordinator.wait_for("a quarantine", |said| said.contains("worker in quarantine").then_some(()));
        assert!(coordinator.stderr().contains(reason), "{reason}:\n{}", coordinator.stderr());
        assert_eq!(coordinator.wait().digest(), expected, "{reason}");
        impostor.join().unwrap();
    }
}

#[test]
fn a_liar_is_found_and_all_it_delivered_is_rendered_again() {
    let place = Place::new();
    let picture = ["--resolution", "96x64", "--spp", "128", "--tile", "16"];
    let expected = run(render(&place, "alone.exr", &picture)).digest();
    let mut flags = picture.to_vec();
    flags.extend(["--verify", "0.3"]);
    let (mut coordinator, address) = serving(&place, &flags);
    let _honest: Vec<_> = ["ann", "bob"].map(|name| joining(&address, name)).into();
    coordinator.wait_for("the honest ones", |said| {
        (said.contains("name=ann") && said.contains("name=bob")).then_some(())
    });
    let liar = impostor(&address, "liar", lie);
    coordinator.wait_for("the verdict", |said| said.contains("delivers wrong results").then_some(()));
    let said = coordinator.wait();
    assert_eq!(said.digest(), expected);
    assert!(said.stderr.contains("rendering it again"), "{}", said.stderr);
    liar.join().unwrap();
}

#[test]
fn a_restart_does_not_hide_a_liar() {
    let place = Place::new();
    let serve = |listen: &str| {
        let mut command = Server::command(listen, place.path("store").to_str().unwrap());
        command.args(["--verify", "0.5"]).env("FARM_LOG", "info,farm_coordinator=debug");
        Server::from_command(command)
    };
    let mut server = serve("127.0.0.1:0");
    let address = server.address.clone();
    let job = server.submit(&place, &server::PICTURE);
    // Alone, it is compared with nobody.
    let liar = impostor(&address, "liar", lie);
    server.running.wait_for("a lie", |said| said.contains("unit accepted").then_some(()));
    server.running.kill();
    liar.join().unwrap();

    let mut server = serve(&address);
    assert!(server.samples_done(&job) > 0);
    let _honest: Vec<_> = ["ann", "bob"].map(|name| joining(&address, name)).into();
    server.running.wait_for("the honest ones", |said| {
        (said.contains("name=ann") && said.contains("name=bob")).then_some(())
    });
    let liar = impostor(&address, "liar", lie);
    server.running.wait_for("the verdict", |said| said.contains("delivers wrong results").then_some(()));
    server.running.wait_for("a consequence", |said| said.contains("rendering it again").then_some(()));

    // Killed at once: what follows from the verdict is still done, and the liar is known.
    server.running.kill();
    liar.join().unwrap();
    let server = serve(&address);
    let liar = impostor(&address, "liar", lie);
    assert_eq!(server.difference(&place, &job), 0.0, "also what it delivered before anybody suspected it");
    let workers = server.ask(&["workers"]).json();
    let state = |name: &str| {
        let found = workers.as_array().unwrap().iter().find(|worker| worker["name"] == name);
        found.unwrap_or_else(|| panic!("{name} in {workers}"))["state"].as_str().unwrap().to_owned()
    };
    assert!(state("liar").contains("distrusted") && !state("ann").contains("distrusted"), "{workers}");
    assert!(server.ask(&["forgive", "liar"]).status.success());
    assert_eq!(server.ask(&["forgive", "ann"]).status.code(), Some(2));
    drop(server);
    liar.join().unwrap();
}
