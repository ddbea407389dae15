//! Where connections come from.

use super::control::ControlService;
use super::farm::FarmService;
use crate::farm::Farm;
use farm_proto::MESSAGE_BYTES_MAX;
use farm_proto::v1::control_server::ControlServer;
use farm_proto::v1::farm_server::FarmServer;
use farm_worker::cli::Fault;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::io::DuplexStream;
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::{ReceiverStream, TcpListenerStream};
use tonic::transport::Server;
use tonic::transport::server::Router;
use tracing::error;

/// Bytes that may be on their way within one stream and one connection; as on the worker's side.
const STREAM_WINDOW: u32 = 8 << 20;
const CONNECTION_WINDOW: u32 = 32 << 20;

/// Calls at a time over one connection: a worker has one for its work and a few for scenes.
const STREAMS_MAX: u32 = 64;

/// An address that cannot be listened on.
#[derive(Debug, thiserror::Error)]
pub enum ListenError {
    /// Reachable from elsewhere.
    #[error(
        "{0} can be reached from other hosts, and connections are not encrypted yet: listen on 127.0.0.1 and reach it from elsewhere through a tunnel"
    )]
    NotLoopback(SocketAddr),
    /// Taken, or not ours.
    #[error("cannot listen on {address}: {error}")]
    Bind {
        /// Which one.
        address: SocketAddr,
        /// Why not.
        error: std::io::Error,
    },
}

/// A port that is ours, before anyone is answered.
pub struct Listener {
    listener: TcpListener,
    address: SocketAddr,
}

impl Listener {
    /// Takes the port; 0 takes any.
    pub async fn bind(address: SocketAddr) -> Result<Self, ListenError> {
        if !address.ip().is_loopback() {
            return Err(ListenError::NotLoopback(address));
        }
        let failed = |error| ListenError::Bind { address, error };
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        Ok(Self { listener, address })
    }

    /// Takes the port, or says why the program cannot.
    pub async fn bind_or_fault(address: SocketAddr) -> Result<Self, Fault> {
        Self::bind(address).await.map_err(|err| match err {
            ListenError::NotLoopback(_) => Fault::input(err),
            ListenError::Bind { .. } => Fault::failed(err),
        })
    }

    /// The address with its real port.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers workers, and with `control` also people, from now on until the runtime ends.
    pub fn serve(self, farm: Farm, control: Option<ControlService>) {
        let incoming = TcpListenerStream::new(self.listener).map(|accepted| {
            accepted.inspect(|stream| {
                // Grants and acknowledgements are small and must not wait for more.
                let _ = stream.set_nodelay(true);
            })
        });
        let mut router = router(farm);
        if let Some(control) = control {
            // Ordinary gRPC tools find out by themselves what is served here, and whether it is well.
            let reflection = tonic_reflection::server::Builder::configure()
                .register_encoded_file_descriptor_set(farm_proto::DESCRIPTOR)
                .build_v1()
                .expect("our own description is well-formed");
            let (_, health) = tonic_health::server::health_reporter();
            router =
                router.add_service(ControlServer::new(control)).add_service(reflection).add_service(health);
        }
        tokio::spawn(async move {
            if let Err(error) = router.serve_with_incoming(incoming).await {
                error!(%error, "the listener has failed");
            }
        });
    }
}

/// Answers workers inside this process; what is returned takes the far ends of their pipes.
pub fn serve_memory(farm: Farm) -> mpsc::Sender<DuplexStream> {
    let (pipes, incoming) = mpsc::channel(1);
    let incoming = ReceiverStream::new(incoming).map(Ok::<DuplexStream, std::io::Error>);
    tokio::spawn(async move {
        if let Err(error) = router(farm).serve_with_incoming(incoming).await {
            error!(%error, "the worker in this process cannot be answered");
        }
    });
    pipes
}

fn router(farm: Farm) -> Router {
    let service = FarmServer::new(FarmService { farm })
        .max_decoding_message_size(MESSAGE_BYTES_MAX)
        .max_encoding_message_size(MESSAGE_BYTES_MAX);
    Server::builder()
        .initial_stream_window_size(STREAM_WINDOW)
        .initial_connection_window_size(CONNECTION_WINDOW)
        .max_concurrent_streams(STREAMS_MAX)
        .http2_keepalive_interval(Some(Duration::from_secs(5)))
        .http2_keepalive_timeout(Some(Duration::from_secs(10)))
        .add_service(service)
}
