//! What people and scripts call.

use super::policy::Peer;
use super::uploads::{UploadError, UploadLimits, Uploads};
use crate::cli::check_tile;
use crate::farm::{Farm, JobOrder, Submission};
use crate::outputs::Outputs;
use crate::registry::chunks;
use crate::serve::restore;
use crate::store::{Store, StoreError, StoredJob};
use crate::views;
use farm_film::FrameIndex;
use farm_job::{Digest, JobId, JobSpec, JobState, WorkerId};
use farm_proto::convert::{JobView, WatchView};
use farm_proto::v1::{self, control_server::Control};
use farm_scene::{SceneId, decode};
use futures::{StreamExt, TryStreamExt};
use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};
use tracing::{info, warn};

/// Largest scene that may be brought: it is held in memory while it is checked.
const UPLOAD_BYTES_MAX: usize = 4 << 30;

/// Pieces that are put into the store at the same time.
const PIECES_AT_ONCE: usize = 8;

/// How often a watched job is looked at.
const WATCH_EVERY: Duration = Duration::from_millis(300);

/// Answers people.
pub struct ControlService {
    farm: Farm,
    store: Arc<Store>,
    /// Every job ever submitted, as it is kept.
    jobs: Arc<Mutex<BTreeMap<JobId, StoredJob>>>,
    uploads: Arc<Uploads>,
    /// Held while it is decided about a job: what is kept and what is done must be the same.
    deciding: tokio::sync::Mutex<()>,
}

type Answers<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

fn ending(_: impl std::error::Error) -> Status {
    Status::unavailable("the coordinator is ending")
}

fn no_job(job: JobId) -> Status {
    Status::not_found(format!("there is no job {job}"))
}

fn not_stored(error: StoreError) -> Status {
    Status::unavailable(error.to_string())
}

fn not_brought(error: UploadError) -> Status {
    match error {
        UploadError::Store(error) => not_stored(error),
        UploadError::Quota(exceeded) => Status::resource_exhausted(exceeded.to_string()),
    }
}

/// Runs what takes its time away from the threads that answer messages.
async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Status> + Send + 'static,
) -> Result<T, Status> {
    tokio::task::spawn_blocking(work).await.map_err(ending)?
}

impl ControlService {
    /// For a farm with a store, which holds `jobs`.
    pub fn new(farm: Farm, store: Arc<Store>, jobs: Vec<StoredJob>, limits: UploadLimits) -> Self {
        let jobs = jobs.into_iter().map(|job| (job.job, job)).collect();
        let jobs: Arc<Mutex<BTreeMap<JobId, StoredJob>>> = Arc::new(Mutex::new(jobs));
        let uploads = Arc::new(Uploads::new(store.clone(), limits));
        let known = jobs.clone();
        tokio::spawn(uploads.clone().sweep_for_ever(move || {
            let jobs = known.lock().unwrap_or_else(PoisonError::into_inner);
            jobs.values().map(|job| job.spec.scene).collect()
        }));
        Self { farm, store, jobs, uploads, deciding: tokio::sync::Mutex::default() }
    }

    fn record(&self, job: JobId) -> Result<StoredJob, Status> {
        let jobs = self.jobs.lock().unwrap_or_else(PoisonError::into_inner);
        jobs.get(&job).cloned().ok_or_else(|| no_job(job))
    }

    /// A job that its caller may change and fetch.
    fn own<T>(&self, request: &Request<T>, job: JobId) -> Result<StoredJob, Status> {
        let (peer, record) = (Peer::of(request)?, self.record(job)?);
        if peer.standing.may_touch(record.owner) {
            return Ok(record);
        }
        let whose = record.owner.map_or("nobody's".to_owned(), |owner| format!("that of token {owner}"));
        let reason = format!(
            "job {job} is {whose}: only its owner and admins may change, fetch and forget it; its status is for everybody"
        );
        warn!(peer = %peer.address, reason, "call refused");
        Err(Status::permission_denied(reason))
    }

    async fn keep(&self, job: StoredJob) -> Result<(), Status> {
        self.store.put_fate(job.job, &job.fate()).await.map_err(not_stored)?;
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner).insert(job.job, job);
        Ok(())
    }

    async fn view(&self, job: JobId) -> Result<JobView, Status> {
        let record = self.record(job)?;
        let overview = self.farm.overview().await.map_err(ending)?;
        views::job(&self.farm, &record, &overview).await.map_err(ending)
    }

    /// Keeps what the owner decided, then does it.
    async fn decide<T>(
        &self,
        request: &Request<T>,
        job: JobId,
        order: JobOrder,
        change: impl FnOnce(&mut StoredJob),
    ) -> Result<Response<v1::JobStatus>, Status> {
        let _deciding = self.deciding.lock().await;
        let mut record = self.own(request, job)?;
        let view = self.view(job).await?;
        if order == JobOrder::Resume && view.state == JobState::Failed {
            return self.try_again(record).await;
        }
        if view.state.is_final() {
            return Err(Status::failed_precondition(format!(
                "job {job} is {}: nothing can be changed",
                view.state
            )));
        }
        change(&mut record);
        self.keep(record).await?;
        if !self.farm.order(job, order).await.map_err(ending)? {
            return Err(no_job(job));
        }
        Ok(Response::new(self.view(job).await?.into()))
    }

    /// Goes on with a failed job from what is kept of it, as after a restart.
    async fn try_again(&self, record: StoredJob) -> Result<Response<v1::JobStatus>, Status> {
        let record = StoredJob { state: JobState::Running, reason: None, ..record };
        self.keep(record.clone()).await?;
        restore(&self.farm, &self.store, &record)
            .await
            .map_err(|err| Status::unavailable(err.to_string()))?;
        self.farm.chronicle.note(Some(record.job), "tried again");
        Ok(Response::new(self.view(record.job).await?.into()))
    }
}

#[tonic::async_trait]
impl Control for ControlService {
    type WatchStream = Answers<v1::WatchUpdate>;
    type FetchStream = Answers<v1::FileChunk>;

    async fn missing_scenes(
        &self,
        request: Request<v1::MissingScenesRequest>,
    ) -> Result<Response<v1::MissingScenesResponse>, Status> {
        let mut missing = Vec::new();
        for scene in request.into_inner().scenes {
            let scene = SceneId::try_from(scene)?;
            if !self.uploads.has_scene(scene).await.map_err(not_stored)? {
                missing.push(scene.into());
            }
        }
        Ok(Response::new(v1::MissingScenesResponse { scenes: missing }))
    }

    async fn missing_pieces(
        &self,
        request: Request<v1::MissingPiecesRequest>,
    ) -> Result<Response<v1::MissingPiecesResponse>, Status> {
        let mut missing = Vec::new();
        for piece in request.into_inner().pieces {
            let piece = Digest::try_from(piece)?;
            if !self.uploads.has_piece(piece).await.map_err(not_stored)? {
                missing.push(piece.into());
            }
        }
        Ok(Response::new(v1::MissingPiecesResponse { pieces: missing }))
    }

    async fn put_pieces(
        &self,
        request: Request<Streaming<v1::PutPieceRequest>>,
    ) -> Result<Response<v1::PutPiecesResponse>, Status> {
        let peer = Peer::of(&request)?;
        let kept = request.into_inner().map(|piece| {
            let (uploads, peer) = (self.uploads.clone(), peer.clone());
            async move { uploads.bring(&peer, piece?.data).await.map_err(not_brought) }
        });
        kept.buffer_unordered(PIECES_AT_ONCE).try_collect::<()>().await?;
        Ok(Response::new(v1::PutPiecesResponse {}))
    }

    async fn put_scene(
        &self,
        request: Request<v1::PutSceneRequest>,
    ) -> Result<Response<v1::PutSceneResponse>, Status> {
        let v1::PutSceneRequest { scene, pieces } = request.into_inner();
        let scene = scene.ok_or_else(|| Status::invalid_argument("message has no scene"))?;
        let scene = SceneId::try_from(scene)?;
        let pieces: Vec<Digest> = pieces.into_iter().map(Digest::try_from).collect::<Result<_, _>>()?;
        let _room = self.uploads.checks.acquire().await.map_err(ending)?;
        self.uploads.touch(pieces.iter().copied().chain([Digest(scene.0)])).await;
        let snapshot = self.store.join(&pieces, UPLOAD_BYTES_MAX).await.map_err(not_stored)?;
        let snapshot = snapshot.ok_or_else(|| {
            Status::failed_precondition(format!(
                "pieces of scene {scene} are missing, or it has more than {UPLOAD_BYTES_MAX} bytes"
            ))
        })?;
        blocking(move || {
            if SceneId::of(&snapshot) != scene {
                return Err(Status::data_loss(format!(
                    "the pieces do not make up scene {scene}: its digest differs"
                )));
            }
            decode(&snapshot).map_err(|err| Status::invalid_argument(err.to_string())).map(drop)
        })
        .await?;
        self.store.put_scene(scene, &pieces).await.map_err(not_stored)?;
        Ok(Response::new(v1::PutSceneResponse {}))
    }

    async fn submit(
        &self,
        request: Request<v1::SubmitRequest>,
    ) -> Result<Response<v1::SubmitResponse>, Status> {
        let owner = Peer::of(&request)?.standing.owner();
        let spec = request.into_inner().spec.ok_or_else(|| Status::invalid_argument("message has no job"))?;
        let spec = JobSpec::try_from(spec)?;
        let not_here =
            || Status::failed_precondition(format!("scene {} is not here: bring it first", spec.scene));
        let snapshot = self.farm.scene(spec.scene).await.ok_or_else(not_here)?;
        let checked = spec.clone();
        blocking(move || check(&snapshot, &checked)).await?;
        if !self.uploads.has_scene(spec.scene).await.map_err(not_stored)? {
            return Err(not_here());
        }
        let job = self.store.create_job(&spec, owner).await.map_err(not_stored)?;
        let record = StoredJob { job, spec: spec.clone(), owner, state: JobState::Running, reason: None };
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner).insert(job, record);
        let outputs = Outputs::Store { scene_name: spec.name.clone() };
        let submission = Submission::new(job, spec, outputs);
        self.farm.submit(submission).await.map_err(ending)?;
        Ok(Response::new(v1::SubmitResponse { job: job.0 }))
    }

    async fn status(
        &self,
        request: Request<v1::StatusRequest>,
    ) -> Result<Response<v1::StatusResponse>, Status> {
        let records: Vec<StoredJob> = match request.into_inner().job {
            Some(job) => vec![self.record(JobId(job))?],
            None => self.jobs.lock().unwrap_or_else(PoisonError::into_inner).values().cloned().collect(),
        };
        let overview = self.farm.overview().await.map_err(ending)?;
        let mut jobs = Vec::new();
        for record in records {
            jobs.push(views::job(&self.farm, &record, &overview).await.map_err(ending)?.into());
        }
        Ok(Response::new(v1::StatusResponse { jobs }))
    }

    async fn watch(&self, request: Request<v1::WatchRequest>) -> Result<Response<Self::WatchStream>, Status> {
        let record = self.record(JobId(request.into_inner().job))?;
        let farm = self.farm.clone();
        let (sender, answers) = tokio::sync::mpsc::channel(1);
        tokio::spawn(async move {
            let (mut shown, mut noted) = (None, 0);
            loop {
                let Ok(overview) = farm.overview().await else { return };
                let Ok(job) = views::job(&farm, &record, &overview).await else { return };
                let (latest, log) = farm.chronicle.after(noted, record.job);
                noted = latest;
                let ended = job.state.is_final();
                if shown.as_ref() != Some(&job) || !log.is_empty() {
                    let update = WatchView { job: job.clone(), workers: views::workers(&overview), log };
                    if sender.send(Ok(update.into())).await.is_err() {
                        return;
                    }
                }
                if ended {
                    return;
                }
                shown = Some(job);
                tokio::time::sleep(WATCH_EVERY).await;
            }
        });
        Ok(Response::new(Box::pin(ReceiverStream::new(answers))))
    }

    async fn cancel(&self, request: Request<v1::JobRequest>) -> Result<Response<v1::JobStatus>, Status> {
        let job = JobId(request.get_ref().job);
        self.decide(&request, job, JobOrder::Cancel, |job| job.state = JobState::Cancelled).await
    }

    async fn pause(&self, request: Request<v1::JobRequest>) -> Result<Response<v1::JobStatus>, Status> {
        let job = JobId(request.get_ref().job);
        self.decide(&request, job, JobOrder::Pause, |job| job.state = JobState::Paused).await
    }

    async fn resume(&self, request: Request<v1::JobRequest>) -> Result<Response<v1::JobStatus>, Status> {
        let job = JobId(request.get_ref().job);
        self.decide(&request, job, JobOrder::Resume, |job| job.state = JobState::Running).await
    }

    async fn set_priority(
        &self,
        request: Request<v1::SetPriorityRequest>,
    ) -> Result<Response<v1::JobStatus>, Status> {
        let v1::SetPriorityRequest { job, priority } = *request.get_ref();
        self.decide(&request, JobId(job), JobOrder::Priority(priority), |job| job.spec.priority = priority)
            .await
    }

    async fn forget(&self, request: Request<v1::JobRequest>) -> Result<Response<v1::ForgetResponse>, Status> {
        let job = JobId(request.get_ref().job);
        self.own(&request, job)?;
        let _deciding = self.deciding.lock().await;
        let state = self.view(job).await?.state;
        if !state.is_final() {
            return Err(Status::failed_precondition(format!("job {job} is {state}: cancel it first")));
        }
        self.store.forget_job(job).await.map_err(not_stored)?;
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner).remove(&job);
        // What is on its way to the store must be there, so that it goes, too.
        self.farm.forget(job).await.map_err(ending)?;
        self.store.remove_job(job).await.map_err(not_stored)?;
        info!(%job, "forgotten");
        Ok(Response::new(v1::ForgetResponse {}))
    }

    async fn workers(&self, _: Request<v1::WorkersRequest>) -> Result<Response<v1::WorkersResponse>, Status> {
        let overview = self.farm.overview().await.map_err(ending)?;
        let workers = views::workers(&overview).into_iter().map(Into::into).collect();
        Ok(Response::new(v1::WorkersResponse { workers }))
    }

    async fn drain(&self, request: Request<v1::DrainRequest>) -> Result<Response<v1::DrainResponse>, Status> {
        let worker = WorkerId(request.into_inner().worker);
        if !self.farm.drain(worker).await.map_err(ending)? {
            return Err(Status::not_found(format!("there is no worker {worker}")));
        }
        Ok(Response::new(v1::DrainResponse {}))
    }

    async fn forgive(
        &self,
        request: Request<v1::ForgiveRequest>,
    ) -> Result<Response<v1::ForgiveResponse>, Status> {
        let name = request.into_inner().name;
        if !self.farm.forgive(name.clone()).await.map_err(ending)? {
            return Err(Status::not_found(format!("no worker called {name:?} has done anything wrong")));
        }
        info!(name, "trusted again");
        Ok(Response::new(v1::ForgiveResponse {}))
    }

    async fn fetch(&self, request: Request<v1::FetchRequest>) -> Result<Response<Self::FetchStream>, Status> {
        let v1::FetchRequest { job, frame } = *request.get_ref();
        let record = self.own(&request, JobId(job))?;
        let file = self.store.frame(record.job, FrameIndex(frame)).await.map_err(not_stored)?;
        let file =
            file.ok_or_else(|| Status::not_found(format!("frame {frame} of job {job} is not finished")))?;
        let total = file.len() as u64;
        let answers = chunks(file, 0).map(move |(_, data)| Ok(v1::FileChunk { total, data }));
        Ok(Response::new(Box::pin(tokio_stream::iter(answers))))
    }
}

/// What the specification alone cannot tell.
fn check(snapshot: &[u8], spec: &JobSpec) -> Result<(), Status> {
    let resolution = spec.resolution().map_err(|err| Status::invalid_argument(err.to_string()))?;
    check_tile(resolution, spec.tile_side).map_err(Status::invalid_argument)?;
    let scene = decode(snapshot).map_err(|err| Status::invalid_argument(err.to_string()))?;
    let (camera, cameras) = (spec.settings.camera, scene.cameras.len());
    if camera as usize >= cameras {
        return Err(Status::invalid_argument(format!(
            "there is no camera {camera}: the scene has {cameras}"
        )));
    }
    Ok(())
}
