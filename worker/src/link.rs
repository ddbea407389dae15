//! Keeps a worker connected: dials, introduces it, passes messages on, and dials again when the connection is lost.

use crate::access::{Access, DialError, dial, refused_by_tls, root_cause, sentence, tuned};
use crate::client::Client;
use farm_job::WorkerId;
use farm_proto::convert::{FromWorker, Hello, ToWorker};
use farm_proto::v1;
use hyper_util::rt::TokioIo;
use std::error::Error;
use std::time::Duration;
use tokio::io::DuplexStream;
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Status, Streaming};

/// Messages that wait for the wire; beyond this the worker waits for it.
const OUTGOING_MAX: usize = 64;

/// Bytes in flight between a coordinator and the worker inside it.
const MEMORY_PIPE_BYTES: usize = 1 << 20;

/// First pause before a new attempt to connect; doubles up to [`BACKOFF_MAX`].
const BACKOFF_MIN: Duration = Duration::from_millis(100);

/// Longest pause between attempts: a restarted coordinator is found again within this.
const BACKOFF_MAX: Duration = Duration::from_secs(3);

/// Where the coordinator is.
#[derive(Clone, Debug)]
pub enum Target {
    /// At the first of some `HOST:PORT` that answers, and by which right.
    Tcp(Vec<String>, Access),
    /// In this process; takes the far ends of pipes.
    Memory(mpsc::Sender<DuplexStream>),
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Tcp(addresses, _) => f.write_str(&addresses.join(", ")),
            Self::Memory(pipes) => Place::Memory(pipes).fmt(f),
        }
    }
}

impl Target {
    fn places(&self) -> Vec<Place<'_>> {
        match self {
            Self::Tcp(addresses, access) => {
                addresses.iter().map(|address| Place::Tcp(address, access)).collect()
            }
            Self::Memory(pipes) => vec![Place::Memory(pipes)],
        }
    }
}

/// One place where a coordinator may be.
#[derive(Clone, Copy)]
enum Place<'a> {
    Tcp(&'a str, &'a Access),
    Memory(&'a mpsc::Sender<DuplexStream>),
}

impl std::fmt::Display for Place<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Tcp(address, _) => f.write_str(address),
            Self::Memory(_) => f.write_str("this process"),
        }
    }
}

/// What the link has to tell.
pub enum LinkEvent {
    /// Taken in by a coordinator.
    Up(Up),
    /// It said something.
    Message(ToWorker),
    /// The connection is gone; a new one is being tried.
    Down {
        /// Why.
        reason: String,
    },
    /// There will be no further attempt.
    Ended(LinkError),
}

/// A connection in use.
pub struct Up {
    /// As whom the worker is known.
    pub worker: WorkerId,
    /// Names the coordinator's life.
    pub session: u64,
    /// How often to say that the worker lives.
    pub heartbeat: Duration,
    /// For everything beside the work stream.
    pub client: Client,
    /// What the worker has to say.
    pub outgoing: mpsc::Sender<FromWorker>,
}

/// Why a worker is not connected and will not be.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// An address that is none.
    #[error("{address:?} is no address of a coordinator: write HOST:PORT")]
    Address {
        /// What was given.
        address: String,
    },
    /// The coordinator does not want this worker.
    #[error("the coordinator at {target} refuses this worker: {reason}")]
    Refused {
        /// Which one.
        target: String,
        /// In its words.
        reason: String,
    },
    /// Tried for as long as told.
    #[error(
        "no coordinator at {target} for {} s: {reason}; start one there, or wait longer with --retry-for", .waited.as_secs()
    )]
    GaveUp {
        /// Where.
        target: String,
        /// How long.
        waited: Duration,
        /// The last failure.
        reason: String,
    },
}

/// An attempt that failed.
enum Failure {
    Final(LinkError),
    MayPass(String),
}

/// Stays connected to `target` until the receiver of `events` is gone, a coordinator refuses, or there was none for
/// `retry_for`. Where there are several addresses, one that is not answered at leads to the next.
pub async fn keep_connected(
    target: Target,
    hello: Hello,
    retry_for: Duration,
    events: mpsc::Sender<LinkEvent>,
) {
    let mut alone_since = Instant::now();
    let mut pause = BACKOFF_MIN;
    let places = target.places();
    loop {
        let reason = match connect_to_any(&places, &hello).await {
            Ok((up, mut incoming)) => {
                if events.send(LinkEvent::Up(up)).await.is_err() {
                    return;
                }
                let reason = pass_on(&mut incoming, &events).await;
                (alone_since, pause) = (Instant::now(), BACKOFF_MIN);
                if events.send(LinkEvent::Down { reason: reason.clone() }).await.is_err() {
                    return;
                }
                reason
            }
            Err(Failure::Final(error)) => {
                let _ = events.send(LinkEvent::Ended(error)).await;
                return;
            }
            Err(Failure::MayPass(reason)) => reason,
        };
        let waited = alone_since.elapsed();
        if waited + pause > retry_for {
            let ended = LinkError::GaveUp { target: target.to_string(), waited, reason };
            let _ = events.send(LinkEvent::Ended(ended)).await;
            return;
        }
        // Jitter keeps a farm's workers from coming back all in the same moment.
        tokio::time::sleep(pause.mul_f64(0.5 + fastrand::f64())).await;
        pause = (pause * 2).min(BACKOFF_MAX);
    }
}

/// Passes messages on until the stream ends; gives the reason.
async fn pass_on(
    incoming: &mut Streaming<v1::CoordinatorMessage>,
    events: &mpsc::Sender<LinkEvent>,
) -> String {
    loop {
        match incoming.message().await {
            Ok(Some(message)) => match ToWorker::try_from(message) {
                Ok(message) => {
                    if events.send(LinkEvent::Message(message)).await.is_err() {
                        return "the worker has ended".to_owned();
                    }
                }
                Err(err) => return format!("the coordinator sent nonsense: {err}"),
            },
            Ok(None) => return "the coordinator closed the connection".to_owned(),
            Err(status) => return sentence(&status),
        }
    }
}

/// At the first place where one is taken in, or refused for good.
async fn connect_to_any(
    places: &[Place<'_>],
    hello: &Hello,
) -> Result<(Up, Streaming<v1::CoordinatorMessage>), Failure> {
    let mut reasons = Vec::new();
    for place in places.iter().copied() {
        match connect(place, hello).await {
            Err(Failure::MayPass(reason)) if places.len() == 1 => reasons.push(reason),
            Err(Failure::MayPass(reason)) => reasons.push(format!("{place}: {reason}")),
            end => return end,
        }
    }
    Err(Failure::MayPass(reasons.join("; ")))
}

async fn connect(
    place: Place<'_>,
    hello: &Hello,
) -> Result<(Up, Streaming<v1::CoordinatorMessage>), Failure> {
    let client = Client::new(channel(place).await?);
    let (outgoing, messages) = mpsc::channel(OUTGOING_MAX);
    let first = FromWorker::Hello(hello.clone());
    let messages =
        tokio_stream::once(first).chain(ReceiverStream::new(messages)).map(v1::WorkerMessage::from);
    let failed = |status: Status| failure(place, &status);
    let mut incoming = client.stub().work(messages).await.map_err(failed)?.into_inner();
    let first = incoming.message().await.map_err(failed)?.map(ToWorker::try_from);
    match first {
        Some(Ok(ToWorker::Welcome { worker, heartbeat, session })) => {
            Ok((Up { worker, session, heartbeat, client, outgoing }, incoming))
        }
        _ => Err(Failure::MayPass("the coordinator did not say welcome".to_owned())),
    }
}

/// What the other side will not take back is final; everything else may pass.
fn failure(place: Place<'_>, status: &Status) -> Failure {
    match status.code() {
        Code::FailedPrecondition
        | Code::InvalidArgument
        | Code::PermissionDenied
        | Code::Unauthenticated
        | Code::Unimplemented => Failure::Final(LinkError::Refused {
            target: place.to_string(),
            reason: status.message().to_owned(),
        }),
        // The other side's last word in a handshake may come only after it.
        _ => match status.source().and_then(refused_by_tls) {
            Some(reason) => Failure::Final(LinkError::Refused { target: place.to_string(), reason }),
            None => Failure::MayPass(sentence(status)),
        },
    }
}

async fn channel(place: Place<'_>) -> Result<Channel, Failure> {
    match place {
        Place::Tcp(address, access) => dial(address, access).await.map_err(|err| match err {
            DialError::Address(address) => Failure::Final(LinkError::Address { address }),
            DialError::Refused(reason) => {
                Failure::Final(LinkError::Refused { target: place.to_string(), reason })
            }
            DialError::Failed(reason) => Failure::MayPass(reason),
        }),
        Place::Memory(pipes) => {
            let pipes = pipes.clone();
            let connector = tower::service_fn(move |_| {
                let pipes = pipes.clone();
                async move {
                    let (near, far) = tokio::io::duplex(MEMORY_PIPE_BYTES);
                    pipes.send(far).await.map_err(|_| std::io::ErrorKind::ConnectionRefused)?;
                    Ok::<_, std::io::Error>(TokioIo::new(near))
                }
            });
            tuned(Endpoint::from_static("http://memory"))
                .connect_with_connector(connector)
                .await
                .map_err(|err| Failure::MayPass(root_cause(&err)))
        }
    }
}
