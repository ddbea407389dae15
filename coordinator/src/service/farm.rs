//! What workers call.

use super::connection;
use crate::farm::{Farm, Input};
use crate::registry::chunks;
use farm_job::JobId;
use farm_proto::convert::{FromWorker, Hello, ToWorker};
use farm_proto::v1::{self, farm_server};
use farm_proto::{PROTOCOL_VERSION, v1::CoordinatorMessage};
use farm_scene::SceneId;
use farm_scheduler::HEARTBEAT;
use farm_worker::renderer::FINGERPRINT;
use std::pin::Pin;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use tokio_stream::wrappers::ReceiverStream;
use tokio_stream::{Stream, StreamExt};
use tonic::{Request, Response, Status, Streaming};

/// Messages to a worker that wait for the wire. Far more than there can be while it listens: a few per lease.
const OUTGOING_MAX: usize = 16_384;

/// A connection that does not say who it is for this long is closed.
const HELLO_WITHIN: Duration = Duration::from_secs(10);

/// Answers workers.
pub(super) struct FarmService {
    pub farm: Farm,
}

type Answers<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

#[tonic::async_trait]
impl farm_server::Farm for FarmService {
    type WorkStream = Answers<CoordinatorMessage>;
    type GetSceneStream = Answers<v1::SceneChunk>;

    async fn work(
        &self,
        request: Request<Streaming<v1::WorkerMessage>>,
    ) -> Result<Response<Self::WorkStream>, Status> {
        let mut incoming = request.into_inner();
        let hello = introduction(&mut incoming).await?;
        let (outgoing, messages) = mpsc::channel(OUTGOING_MAX);
        let (reply, joined) = oneshot::channel();
        let ending = |_| Status::unavailable("the coordinator is ending");
        self.farm
            .tell(Input::Join { hello, outgoing, reply })
            .await
            .map_err(|err| Status::unavailable(err.to_string()))?;
        let worker = joined.await.map_err(ending)?;
        tokio::spawn(connection::listen(worker, incoming, self.farm.clone()));
        let welcome = ToWorker::Welcome { worker, heartbeat: HEARTBEAT, session: self.farm.session };
        let answers = tokio_stream::once(welcome)
            .chain(ReceiverStream::new(messages))
            .map(|message| Ok(message.into()));
        Ok(Response::new(Box::pin(answers)))
    }

    async fn beat(&self, request: Request<v1::Heartbeat>) -> Result<Response<v1::Heard>, Status> {
        let beat = Input::Beat(request.into_inner().into());
        self.farm.tell(beat).await.map_err(|err| Status::unavailable(err.to_string()))?;
        Ok(Response::new(v1::Heard {}))
    }

    async fn get_job(&self, request: Request<v1::GetJobRequest>) -> Result<Response<v1::JobSpec>, Status> {
        let job = JobId(request.into_inner().job);
        let spec =
            self.farm.registry.job(job).ok_or_else(|| Status::not_found(format!("there is no job {job}")))?;
        Ok(Response::new((*spec).clone().into()))
    }

    async fn get_scene(
        &self,
        request: Request<v1::GetSceneRequest>,
    ) -> Result<Response<Self::GetSceneStream>, Status> {
        let request = request.into_inner();
        let scene = SceneId::try_from(
            request.scene.ok_or_else(|| Status::invalid_argument("message has no scene"))?,
        )?;
        let snapshot = self.farm.scene(scene).await;
        let snapshot = snapshot.ok_or_else(|| Status::not_found(format!("there is no scene {scene}")))?;
        let total = snapshot.len() as u64;
        let offset = usize::try_from(request.offset)
            .ok()
            .filter(|offset| *offset < snapshot.len())
            .ok_or_else(|| {
                Status::out_of_range(format!(
                    "scene {scene} has {total} bytes and none from {} on",
                    request.offset
                ))
            })?;
        let answers = chunks(snapshot, offset)
            .map(move |(start, data)| Ok(v1::SceneChunk { total, offset: start as u64, data }));
        Ok(Response::new(Box::pin(tokio_stream::iter(answers))))
    }
}

/// The first message, from a worker that this coordinator can work with.
async fn introduction(incoming: &mut Streaming<v1::WorkerMessage>) -> Result<Hello, Status> {
    let first = tokio::time::timeout(HELLO_WITHIN, incoming.message())
        .await
        .map_err(|_| Status::deadline_exceeded("the worker did not introduce itself"))??
        .ok_or_else(|| Status::invalid_argument("the worker said nothing"))?;
    let FromWorker::Hello(hello) = FromWorker::try_from(first)? else {
        return Err(Status::invalid_argument("the worker did not introduce itself first"));
    };
    if hello.protocol != PROTOCOL_VERSION {
        return Err(refusal(&hello, "protocol version", &hello.protocol, &PROTOCOL_VERSION));
    }
    if hello.fingerprint != FINGERPRINT {
        return Err(refusal(&hello, "renderer", &hello.fingerprint, &FINGERPRINT));
    }
    Ok(hello)
}

/// One sentence on both sides.
fn refusal(
    hello: &Hello,
    what: &str,
    theirs: &dyn std::fmt::Display,
    ours: &dyn std::fmt::Display,
) -> Status {
    tracing::warn!(name = %hello.name, "worker refused: its {what} is {theirs} and ours is {ours}");
    Status::failed_precondition(format!(
        "its {what} is {theirs}, the coordinator's is {ours}: run the same version on both sides"
    ))
}
