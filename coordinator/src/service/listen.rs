//! Where connections come from.

use super::accept::{Security, accept, look_after_admin, watch_revoked};
use super::control::ControlService;
use super::enrol::EnrolmentService;
use super::farm::FarmService;
use super::guard::GuardLayer;
use crate::cli::Doors;
use crate::farm::Farm;
use farm_proto::v1::control_server::ControlServer;
use farm_proto::v1::enrolment_server::EnrolmentServer;
use farm_proto::v1::farm_server::FarmServer;
use farm_proto::{CONTROL_BYTES_MAX, ENROL_BYTES_MAX, MESSAGE_BYTES_MAX};
use farm_worker::cli::Fault;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::io::DuplexStream;
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::Server;
use tracing::error;

/// Bytes that may be on their way within one stream and one connection; as on the worker's side.
const STREAM_WINDOW: u32 = 8 << 20;
const CONNECTION_WINDOW: u32 = 32 << 20;

/// Calls at a time over one connection: a worker has one for its work and a few for scenes.
const STREAMS_MAX: u32 = 64;

/// Headers of a call: ours have a few hundred bytes.
const HEADERS_BYTES_MAX: u32 = 16 << 10;

/// A port that is ours, before anyone is answered.
pub struct Listener {
    listener: TcpListener,
    address: SocketAddr,
    security: Security,
}

impl Listener {
    /// Takes the port; 0 takes any.
    pub async fn bind(doors: &Doors) -> Result<Self, Fault> {
        let Doors { address, security } = doors.clone();
        let failed = |err| Fault::failed(format!("cannot listen on {address}: {err}"));
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        Ok(Self { listener, address, security })
    }

    /// The address with its real port.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers workers, and with `control` also people, from now on until the runtime ends.
    pub fn serve(self, farm: Farm, control: Option<ControlService>) -> Result<(), Fault> {
        let revoked = watch_revoked(&self.security);
        let lines = accept(self.listener, &self.security, revoked.clone()).map_err(Fault::failed)?;
        let mut server = server().layer(GuardLayer { revoked: revoked.clone() });
        let mut router = server.add_service(workers(farm));
        if let Security::Closed(authority) = self.security {
            look_after_admin(authority.clone());
            let enrolment = EnrolmentServer::new(EnrolmentService { authority, revoked });
            router = router.add_service(enrolment.max_decoding_message_size(ENROL_BYTES_MAX));
        }
        let (health, health_service) = tonic_health::server::health_reporter();
        let serves_people = control.is_some();
        if let Some(control) = control {
            // Ordinary gRPC tools find out by themselves what is served here, and whether it is well.
            let reflection = tonic_reflection::server::Builder::configure()
                .register_encoded_file_descriptor_set(farm_proto::DESCRIPTOR)
                .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
                .build_v1()
                .expect("our own description is well-formed");
            let control = ControlServer::new(control)
                .max_decoding_message_size(CONTROL_BYTES_MAX)
                .max_encoding_message_size(CONTROL_BYTES_MAX);
            router = router.add_service(control).add_service(reflection).add_service(health_service);
        }
        tokio::spawn(async move {
            if serves_people {
                health.set_serving::<FarmServer<FarmService>>().await;
                health.set_serving::<ControlServer<ControlService>>().await;
            }
            if let Err(error) = router.serve_with_incoming(ReceiverStream::new(lines)).await {
                error!(%error, "the listener has failed");
            }
        });
        Ok(())
    }
}

/// Answers workers inside this process; what is returned takes the far ends of their pipes.
pub fn serve_memory(farm: Farm) -> mpsc::Sender<DuplexStream> {
    let (pipes, incoming) = mpsc::channel(1);
    let incoming = ReceiverStream::new(incoming).map(Ok::<DuplexStream, std::io::Error>);
    tokio::spawn(async move {
        if let Err(error) = server().add_service(workers(farm)).serve_with_incoming(incoming).await {
            error!(%error, "the worker in this process cannot be answered");
        }
    });
    pipes
}

fn workers(farm: Farm) -> FarmServer<FarmService> {
    FarmServer::new(FarmService { farm })
        .max_decoding_message_size(MESSAGE_BYTES_MAX)
        .max_encoding_message_size(MESSAGE_BYTES_MAX)
}

fn server() -> Server {
    Server::builder()
        .initial_stream_window_size(STREAM_WINDOW)
        .initial_connection_window_size(CONNECTION_WINDOW)
        .max_concurrent_streams(STREAMS_MAX)
        .http2_max_header_list_size(HEADERS_BYTES_MAX)
        .http2_keepalive_interval(Some(Duration::from_secs(5)))
        .http2_keepalive_timeout(Some(Duration::from_secs(10)))
}
