//! What people and scripts call.

use crate::cli::check_tile;
use crate::farm::{Farm, JobOrder, Submission};
use crate::outputs::{FrameNames, OutputPlan};
use crate::registry::chunks;
use crate::store::{Store, StoredJob};
use crate::views;
use bytes::BytesMut;
use farm_film::FrameIndex;
use farm_job::{JobId, JobSpec, JobState, WorkerId};
use farm_proto::convert::JobView;
use farm_proto::v1::{self, control_server::Control};
use farm_scene::{SceneId, decode};
use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};

/// Largest scene that may be brought: it is held in memory while it is checked.
const UPLOAD_BYTES_MAX: usize = 4 << 30;

/// How often a watched job is looked at.
const WATCH_EVERY: Duration = Duration::from_millis(300);

/// Answers people.
pub struct ControlService {
    farm: Farm,
    store: Arc<Store>,
    /// Every job ever submitted, as it is kept.
    jobs: Arc<Mutex<BTreeMap<JobId, StoredJob>>>,
}

type Answers<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

fn ending(_: impl std::error::Error) -> Status {
    Status::unavailable("the coordinator is ending")
}

fn no_job(job: JobId) -> Status {
    Status::not_found(format!("there is no job {job}"))
}

/// Runs what touches files away from the threads that answer messages.
async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Status> + Send + 'static,
) -> Result<T, Status> {
    tokio::task::spawn_blocking(work).await.map_err(ending)?
}

impl ControlService {
    /// For a farm with a store, which holds `jobs`.
    pub fn new(farm: Farm, store: Arc<Store>, jobs: Vec<StoredJob>) -> Self {
        let jobs = jobs.into_iter().map(|job| (job.job, job)).collect();
        Self { farm, store, jobs: Arc::new(Mutex::new(jobs)) }
    }

    fn record(&self, job: JobId) -> Result<StoredJob, Status> {
        let jobs = self.jobs.lock().unwrap_or_else(PoisonError::into_inner);
        jobs.get(&job).cloned().ok_or_else(|| no_job(job))
    }

    async fn keep(&self, job: StoredJob) -> Result<(), Status> {
        let (store, kept) = (self.store.clone(), job.clone());
        blocking(move || store.put_job(&kept).map_err(|err| Status::resource_exhausted(err.to_string())))
            .await?;
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner).insert(job.job, job);
        Ok(())
    }

    async fn view(&self, job: JobId) -> Result<JobView, Status> {
        let record = self.record(job)?;
        let overview = self.farm.overview().await.map_err(ending)?;
        views::job(&self.farm, &record, &overview).await.map_err(ending)
    }

    /// Keeps what the owner decided, then does it.
    async fn decide(
        &self,
        job: JobId,
        order: JobOrder,
        change: impl FnOnce(&mut StoredJob),
    ) -> Result<Response<v1::JobStatus>, Status> {
        let view = self.view(job).await?;
        if view.state.is_final() {
            return Err(Status::failed_precondition(format!(
                "job {job} is {}: nothing can be changed",
                view.state
            )));
        }
        let mut record = self.record(job)?;
        change(&mut record);
        self.keep(record).await?;
        if !self.farm.order(job, order).await.map_err(ending)? {
            return Err(no_job(job));
        }
        Ok(Response::new(self.view(job).await?.into()))
    }

    /// The next number, kept before it is used.
    async fn new_job(&self, spec: JobSpec) -> Result<JobId, Status> {
        let record = {
            let mut jobs = self.jobs.lock().unwrap_or_else(PoisonError::into_inner);
            let job = JobId(jobs.keys().next_back().map_or(1, |last| last.0 + 1));
            let record = StoredJob { job, spec, state: JobState::Running, reason: None };
            jobs.insert(job, record.clone());
            record
        };
        let job = record.job;
        self.keep(record).await?;
        Ok(job)
    }
}

/// Where a job's frames go.
pub fn plan(store: &Store, job: JobId, name: &str) -> Result<OutputPlan, String> {
    let pattern = store.frames_folder(job).join("frame.####.exr");
    let names = FrameNames::new(&pattern, true).map_err(|err| err.to_string())?;
    Ok(OutputPlan { names, preview: false, scene_name: name.to_owned() })
}

#[tonic::async_trait]
impl Control for ControlService {
    type WatchStream = Answers<v1::JobStatus>;
    type FetchStream = Answers<v1::FileChunk>;

    async fn put_scene(
        &self,
        request: Request<Streaming<v1::PutSceneRequest>>,
    ) -> Result<Response<v1::PutSceneResponse>, Status> {
        let mut messages = request.into_inner();
        let (mut announced, mut bytes) = (None, BytesMut::new());
        while let Some(message) = messages.message().await? {
            if let Some(scene) = message.scene {
                announced = Some(SceneId::try_from(scene)?);
            }
            if bytes.len() + message.data.len() > UPLOAD_BYTES_MAX {
                return Err(Status::resource_exhausted(format!("a scene may have {UPLOAD_BYTES_MAX} bytes")));
            }
            bytes.extend_from_slice(&message.data);
        }
        let scene = announced.ok_or_else(|| Status::invalid_argument("message has no scene"))?;
        let store = self.store.clone();
        blocking(move || {
            if SceneId::of(&bytes) != scene {
                return Err(Status::data_loss(format!(
                    "scene {scene} did not arrive as it was sent: its digest differs"
                )));
            }
            decode(&bytes).map_err(|err| Status::invalid_argument(err.to_string()))?;
            store.put_scene(scene, &bytes).map_err(|err| Status::resource_exhausted(err.to_string()))
        })
        .await?;
        Ok(Response::new(v1::PutSceneResponse {}))
    }

    async fn missing_scenes(
        &self,
        request: Request<v1::MissingScenesRequest>,
    ) -> Result<Response<v1::MissingScenesResponse>, Status> {
        let mut missing = Vec::new();
        for scene in request.into_inner().scenes {
            let scene = SceneId::try_from(scene)?;
            let farm = self.farm.clone();
            if !blocking(move || Ok(farm.scene(scene).is_some())).await? {
                missing.push(scene.into());
            }
        }
        Ok(Response::new(v1::MissingScenesResponse { scenes: missing }))
    }

    async fn submit(
        &self,
        request: Request<v1::SubmitRequest>,
    ) -> Result<Response<v1::SubmitResponse>, Status> {
        let spec = request.into_inner().spec.ok_or_else(|| Status::invalid_argument("message has no job"))?;
        let spec = JobSpec::try_from(spec)?;
        let (farm, checked) = (self.farm.clone(), spec.clone());
        blocking(move || check(&farm, &checked)).await?;
        let job = self.new_job(spec.clone()).await?;
        let plan = plan(&self.store, job, &spec.name).map_err(Status::internal)?;
        let submission =
            Submission { job, spec, plan, listener: None, finished: Vec::new(), durable: Vec::new() };
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
            let mut shown: Option<JobView> = None;
            loop {
                let Ok(overview) = farm.overview().await else { return };
                let Ok(view) = views::job(&farm, &record, &overview).await else { return };
                let ended = view.state.is_final();
                if shown.as_ref() != Some(&view) && sender.send(Ok(view.clone().into())).await.is_err() {
                    return;
                }
                if ended {
                    return;
                }
                shown = Some(view);
                tokio::time::sleep(WATCH_EVERY).await;
            }
        });
        Ok(Response::new(Box::pin(ReceiverStream::new(answers))))
    }

    async fn cancel(&self, request: Request<v1::JobRequest>) -> Result<Response<v1::JobStatus>, Status> {
        let job = JobId(request.into_inner().job);
        self.decide(job, JobOrder::Cancel, |job| job.state = JobState::Cancelled).await
    }

    async fn pause(&self, request: Request<v1::JobRequest>) -> Result<Response<v1::JobStatus>, Status> {
        let job = JobId(request.into_inner().job);
        self.decide(job, JobOrder::Pause, |job| job.state = JobState::Paused).await
    }

    async fn resume(&self, request: Request<v1::JobRequest>) -> Result<Response<v1::JobStatus>, Status> {
        let job = JobId(request.into_inner().job);
        self.decide(job, JobOrder::Resume, |job| job.state = JobState::Running).await
    }

    async fn set_priority(
        &self,
        request: Request<v1::SetPriorityRequest>,
    ) -> Result<Response<v1::JobStatus>, Status> {
        let v1::SetPriorityRequest { job, priority } = request.into_inner();
        self.decide(JobId(job), JobOrder::Priority(priority), |job| job.spec.priority = priority).await
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

    async fn fetch(&self, request: Request<v1::FetchRequest>) -> Result<Response<Self::FetchStream>, Status> {
        let v1::FetchRequest { job, frame } = request.into_inner();
        let record = self.record(JobId(job))?;
        let plan = plan(&self.store, record.job, &record.spec.name).map_err(Status::internal)?;
        let path = plan.names.path(FrameIndex(frame));
        let file = blocking(move || {
            std::fs::read(&path)
                .map_err(|_| Status::not_found(format!("frame {frame} of job {job} is not finished")))
        })
        .await?;
        let total = file.len() as u64;
        let answers = chunks(file.into(), 0).map(move |(_, data)| Ok(v1::FileChunk { total, data }));
        Ok(Response::new(Box::pin(tokio_stream::iter(answers))))
    }
}

/// What the specification alone cannot tell.
fn check(farm: &Farm, spec: &JobSpec) -> Result<(), Status> {
    let resolution = spec.resolution().map_err(|err| Status::invalid_argument(err.to_string()))?;
    check_tile(resolution, spec.tile_side).map_err(Status::invalid_argument)?;
    let snapshot = farm.scene(spec.scene).ok_or_else(|| {
        Status::failed_precondition(format!("scene {} is not here: bring it first", spec.scene))
    })?;
    let scene = decode(&snapshot).map_err(|err| Status::invalid_argument(err.to_string()))?;
    let (camera, cameras) = (spec.settings.camera, scene.cameras.len());
    if camera as usize >= cameras {
        return Err(Status::invalid_argument(format!(
            "there is no camera {camera}: the scene has {cameras}"
        )));
    }
    Ok(())
}
