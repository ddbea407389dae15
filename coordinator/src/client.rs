//! Calls to a coordinator that serves, from the command line.

use crate::pieces;
use bytes::Bytes;
use farm_film::FrameIndex;
use farm_job::{Digest, JobId, JobSpec, WorkerId};
use farm_proto::CONTROL_BYTES_MAX;
use farm_proto::convert::{ConvertError, JobView, WatchView, WorkerView};
use farm_proto::v1::{self, control_client::ControlClient};
use farm_scene::SceneId;
use farm_worker::access::{Access, DialError, dial, refused_by_tls};
use farm_worker::cli::Fault;
use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use tonic::transport::Channel;
use tonic::{Code, Status};

/// A coordinator elsewhere.
pub struct Client {
    control: ControlClient<Channel>,
}

/// What the user asked wrongly is told from what went wrong.
fn fault(status: Status) -> Fault {
    if let Some(reason) = status.source().and_then(refused_by_tls) {
        return Fault::failed(format!("coordinator: {reason}"));
    }
    let sentence =
        if status.message().is_empty() { status.code().to_string() } else { status.message().to_owned() };
    match status.code() {
        Code::InvalidArgument | Code::NotFound | Code::FailedPrecondition => Fault::input(sentence),
        _ => Fault::failed(format!("coordinator: {sentence}")),
    }
}

/// A coordinator that is killed or ends leaves one of these behind, or no answer at all.
fn gone_or_fault<T>(status: Status) -> Result<Option<T>, Fault> {
    match status.code() {
        Code::Unavailable | Code::Unknown | Code::Internal | Code::Cancelled => Ok(None),
        _ => Err(fault(status)),
    }
}

fn nonsense(err: ConvertError) -> Fault {
    Fault::failed(format!("coordinator sent nonsense: {err}"))
}

impl Client {
    /// Connects to `HOST:PORT`.
    pub async fn connect(address: &str, access: &Access) -> Result<Self, Fault> {
        let channel = dial(address, access).await.map_err(|err| match err {
            DialError::Address(_) => Fault::input(err),
            DialError::Refused(reason) => Fault::failed(format!("the coordinator at {address}: {reason}")),
            DialError::Failed(reason) => Fault::failed(format!(
                "no coordinator at {address} ({reason}): start one there with coordinator serve"
            )),
        })?;
        let control = ControlClient::new(channel)
            .max_decoding_message_size(CONTROL_BYTES_MAX)
            .max_encoding_message_size(CONTROL_BYTES_MAX);
        Ok(Self { control })
    }

    /// Brings what the coordinator lacks of a scene; how many bytes that was.
    pub async fn bring(&mut self, scene: SceneId, snapshot: Vec<u8>) -> Result<u64, Fault> {
        let request = v1::MissingScenesRequest { scenes: vec![scene.into()] };
        let missing = self.control.missing_scenes(request).await.map_err(fault)?.into_inner().scenes;
        if missing.is_empty() {
            return Ok(0);
        }
        let pieces = pieces::cut(&snapshot.into());
        let names: Vec<v1::Digest> = pieces.iter().map(|(digest, _)| (*digest).into()).collect();
        let request = v1::MissingPiecesRequest { pieces: names.clone() };
        let missing = self.control.missing_pieces(request).await.map_err(fault)?.into_inner().pieces;
        let missing: BTreeSet<Digest> =
            missing.into_iter().map(Digest::try_from).collect::<Result<_, _>>().map_err(nonsense)?;
        // A scene may have the same piece twice.
        let new: BTreeMap<Digest, Bytes> =
            pieces.into_iter().filter(|(digest, _)| missing.contains(digest)).collect();
        let sent = new.values().map(|piece| piece.len() as u64).sum();
        let messages = new.into_values().map(|data| v1::PutPieceRequest { data });
        self.control.put_pieces(tokio_stream::iter(messages)).await.map_err(fault)?;
        let request = v1::PutSceneRequest { scene: Some(scene.into()), pieces: names };
        self.control.put_scene(request).await.map_err(fault)?;
        Ok(sent)
    }

    /// Submits a job whose scene is there.
    pub async fn submit(&mut self, spec: JobSpec) -> Result<JobId, Fault> {
        let request = v1::SubmitRequest { spec: Some(spec.into()) };
        Ok(JobId(self.control.submit(request).await.map_err(fault)?.into_inner().job))
    }

    /// One job, or all.
    pub async fn status(&mut self, job: Option<JobId>) -> Result<Vec<JobView>, Fault> {
        let request = v1::StatusRequest { job: job.map(|job| job.0) };
        let jobs = self.control.status(request).await.map_err(fault)?.into_inner().jobs;
        jobs.into_iter().map(|job| JobView::try_from(job).map_err(nonsense)).collect()
    }

    /// Shows every change of a job until its end; gives the last. None when the coordinator goes away before: the next call
    /// finds it again when it is back.
    pub async fn watch(
        &mut self,
        job: JobId,
        mut show: impl FnMut(&WatchView),
    ) -> Result<Option<WatchView>, Fault> {
        let mut updates = match self.control.watch(v1::WatchRequest { job: job.0 }).await {
            Ok(answer) => answer.into_inner(),
            Err(status) => return gone_or_fault(status),
        };
        loop {
            let update = match updates.message().await {
                Ok(Some(update)) => update,
                Ok(None) => return Ok(None),
                Err(status) => return gone_or_fault(status),
            };
            let view = WatchView::try_from(update).map_err(nonsense)?;
            show(&view);
            if view.job.state.is_final() {
                return Ok(Some(view));
            }
        }
    }

    /// Gives a job up.
    pub async fn cancel(&mut self, job: JobId) -> Result<JobView, Fault> {
        let answer = self.control.cancel(v1::JobRequest { job: job.0 }).await.map_err(fault)?;
        JobView::try_from(answer.into_inner()).map_err(nonsense)
    }

    /// Holds a job.
    pub async fn pause(&mut self, job: JobId) -> Result<JobView, Fault> {
        let answer = self.control.pause(v1::JobRequest { job: job.0 }).await.map_err(fault)?;
        JobView::try_from(answer.into_inner()).map_err(nonsense)
    }

    /// Goes on with a job.
    pub async fn resume(&mut self, job: JobId) -> Result<JobView, Fault> {
        let answer = self.control.resume(v1::JobRequest { job: job.0 }).await.map_err(fault)?;
        JobView::try_from(answer.into_inner()).map_err(nonsense)
    }

    /// Lets a job go before or after others.
    pub async fn set_priority(&mut self, job: JobId, priority: i32) -> Result<JobView, Fault> {
        let request = v1::SetPriorityRequest { job: job.0, priority };
        let answer = self.control.set_priority(request).await.map_err(fault)?;
        JobView::try_from(answer.into_inner()).map_err(nonsense)
    }

    /// Removes a job that has ended, with its frames.
    pub async fn forget(&mut self, job: JobId) -> Result<(), Fault> {
        self.control.forget(v1::JobRequest { job: job.0 }).await.map_err(fault)?;
        Ok(())
    }

    /// Everybody who is connected.
    pub async fn workers(&mut self) -> Result<Vec<WorkerView>, Fault> {
        let workers = self.control.workers(v1::WorkersRequest {}).await.map_err(fault)?.into_inner().workers;
        workers.into_iter().map(|worker| WorkerView::try_from(worker).map_err(nonsense)).collect()
    }

    /// Lets a worker finish what it holds and leave.
    pub async fn drain(&mut self, worker: WorkerId) -> Result<(), Fault> {
        self.control.drain(v1::DrainRequest { worker: worker.0 }).await.map_err(fault)?;
        Ok(())
    }

    /// Trusts a worker again.
    pub async fn forgive(&mut self, name: String) -> Result<(), Fault> {
        self.control.forgive(v1::ForgiveRequest { name }).await.map_err(fault)?;
        Ok(())
    }

    /// The file of a finished frame.
    pub async fn fetch(&mut self, job: JobId, frame: FrameIndex) -> Result<Vec<u8>, Fault> {
        let request = v1::FetchRequest { job: job.0, frame: frame.0 };
        let mut chunks = self.control.fetch(request).await.map_err(fault)?.into_inner();
        let (mut file, mut total) = (Vec::new(), 0);
        while let Some(chunk) = chunks.message().await.map_err(fault)? {
            total = chunk.total;
            file.extend_from_slice(&chunk.data);
        }
        if file.len() as u64 != total {
            return Err(Fault::failed(format!(
                "frame {frame} broke off after {} of {total} bytes",
                file.len()
            )));
        }
        Ok(file)
    }
}
