//! Whoever speaks another version, or no protocol at all, is turned away with a sentence; the farm goes on.

use crate::harness::{Place, Running, joining, serving, worker};
use farm_proto::PROTOCOL_VERSION;
use farm_proto::v1::farm_server::{Farm, FarmServer};
use farm_proto::v1::{self, farm_client::FarmClient, worker_message::Message};
use std::io::Write;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::{Code, Request, Response, Status, Streaming};

const SMALL: [&str; 4] = ["--resolution", "32x20", "--spp", "16"];

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
}

fn hello(protocol: u32, fingerprint: &str) -> v1::WorkerMessage {
    let hello =
        v1::Hello { protocol, name: "stranger".into(), slots: 1, fingerprint: fingerprint.to_owned() };
    v1::WorkerMessage { message: Some(Message::Hello(hello)) }
}

/// What a coordinator says to a worker whose first message is this.
fn answer(address: &str, first: v1::WorkerMessage) -> Status {
    runtime().block_on(async {
        let mut client = FarmClient::connect(format!("http://{address}")).await.unwrap();
        client.work(tokio_stream::iter([first])).await.expect_err("strangers are refused")
    })
}

#[test]
fn a_coordinator_refuses_workers_of_another_version() {
    let place = Place::new();
    let (mut coordinator, address) = serving(&place, &SMALL);
    let newer = answer(&address, hello(PROTOCOL_VERSION + 1, farm_render::FINGERPRINT));
    assert_eq!(newer.code(), Code::FailedPrecondition);
    assert!(newer.message().contains("protocol version"), "{}", newer.message());
    let other = answer(&address, hello(PROTOCOL_VERSION, "another renderer"));
    assert_eq!(other.code(), Code::FailedPrecondition);
    assert!(
        other.message().contains("another renderer") && other.message().contains(farm_render::FINGERPRINT)
    );
    let silent = answer(&address, v1::WorkerMessage { message: None });
    assert_eq!(silent.code(), Code::InvalidArgument);
    coordinator.wait_for("a line in the log", |said| said.contains("worker refused").then_some(()));
    let _worker = joining(&address, "friend");
    assert!(coordinator.wait().status.success());
}

#[test]
fn garbage_on_the_line_harms_nobody() {
    let place = Place::new();
    let (coordinator, address) = serving(&place, &SMALL);
    let mut lines: Vec<_> = (0..8).map(|_| std::net::TcpStream::connect(&address).unwrap()).collect();
    for (index, line) in lines.iter_mut().enumerate() {
        let garbage: Vec<u8> = (0..10_000u32).map(|byte| (byte * 31 + index as u32 * 7) as u8).collect();
        // The coordinator may hang up in between.
        let _ = line.write_all(&garbage);
    }
    let _worker = joining(&address, "friend");
    let said = coordinator.wait();
    assert!(said.status.success() && said.stderr.contains("what it says is no HTTP/2"), "{}", said.stderr);
}

/// A coordinator of another version, as a worker meets it.
struct Elsewhere;

#[tonic::async_trait]
impl Farm for Elsewhere {
    type WorkStream = tokio_stream::Empty<Result<v1::CoordinatorMessage, Status>>;
    type GetSceneStream = tokio_stream::Empty<Result<v1::SceneChunk, Status>>;

    async fn work(
        &self,
        _: Request<Streaming<v1::WorkerMessage>>,
    ) -> Result<Response<Self::WorkStream>, Status> {
        Err(Status::failed_precondition("its renderer is young, the coordinator's is old"))
    }

    async fn beat(&self, _: Request<v1::Heartbeat>) -> Result<Response<v1::Heard>, Status> {
        Err(Status::not_found("no"))
    }

    async fn get_job(&self, _: Request<v1::GetJobRequest>) -> Result<Response<v1::JobSpec>, Status> {
        Err(Status::not_found("no"))
    }

    async fn get_scene(
        &self,
        _: Request<v1::GetSceneRequest>,
    ) -> Result<Response<Self::GetSceneStream>, Status> {
        Err(Status::not_found("no"))
    }
}

#[test]
fn a_worker_that_is_refused_says_why_and_does_not_insist() {
    let runtime = runtime();
    let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0")).unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let server = tonic::transport::Server::builder().add_service(FarmServer::new(Elsewhere));
    std::thread::spawn(move || {
        runtime.block_on(server.serve_with_incoming(TcpListenerStream::new(listener)))
    });
    let mut command = worker();
    command.args(["--connect", &address, "--threads", "1", "--retry-for", "1h"]);
    let said = Running::start(command).wait();
    assert_eq!(said.status.code(), Some(1));
    assert!(said.stderr.contains("refuses this worker: its renderer is young"), "{}", said.stderr);
}
