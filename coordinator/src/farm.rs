//! The farm as its shell sees it: what can be told to the driver, and asked.

use crate::assembly::Task;
use crate::check::{Checked, Defect};
use crate::chronicle::Chronicle;
use crate::open_frame::Outlook;
use crate::outputs::{FrameSummary, Outputs};
use crate::registry::Registry;
use crate::store::{Holding, Store};
use crate::tally::Tally;
use bytes::Bytes;
use farm_film::{Counters, FilmTile, FrameIndex};
use farm_job::{JobId, JobSpec, WorkerId};
use farm_proto::convert::{FromWorker, Heartbeat, Hello, ToWorker, UnitResult};
use farm_scene::SceneId;
use farm_scheduler::{Origin, Reputation, Status};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};
use tokio::sync::{mpsc, oneshot};

/// What the driver is told.
pub(crate) enum Input {
    /// A worker has introduced itself.
    Join { hello: Hello, outgoing: mpsc::Sender<ToWorker>, reply: oneshot::Sender<WorkerId> },
    /// A worker said something else than a result.
    Said { worker: WorkerId, message: FromWorker },
    /// A worker lives.
    Beat(Heartbeat),
    /// A result came and was looked at.
    Arrived(Box<Arrived>),
    /// A connection is gone.
    Left { worker: WorkerId },
    /// A new job, or one from before a restart.
    Submit(Box<Submission>),
    /// Its owner has decided something.
    Order { job: JobId, order: JobOrder, reply: oneshot::Sender<bool> },
    /// What was known of workers before the coordinator started.
    Recall(Reputation),
    /// Trust a worker again; whether it was not trusted, or had been in quarantine.
    Forgive { name: String, reply: oneshot::Sender<bool> },
    /// Forget a job that has ended; answered when nothing more of it is on its way to the store.
    Forget { job: JobId, done: oneshot::Sender<()> },
    /// Let a worker finish what it holds and leave; whether it is known.
    Drain { worker: WorkerId, reply: oneshot::Sender<bool> },
    /// How things are.
    Status { reply: oneshot::Sender<Overview> },
    /// Send everybody home.
    Farewell { reason: String, done: oneshot::Sender<()> },
}

/// A result that was looked at.
pub(crate) struct Arrived {
    pub worker: WorkerId,
    pub result: UnitResult,
    /// None when its job is not known.
    pub outcome: Option<Result<Checked, Defect>>,
    pub at: Instant,
}

/// A job on its way to the driver.
pub struct Submission {
    /// Its name from now on.
    pub job: JobId,
    /// What is asked.
    pub spec: JobSpec,
    /// Where its frames go.
    pub outputs: Outputs,
    /// Who hears of its events, if anyone.
    pub listener: Option<mpsc::UnboundedSender<JobEvent>>,
    /// Frames that are written already.
    pub finished: Vec<FrameIndex>,
    /// Partials of other frames that are safe already.
    pub durable: Vec<(FrameIndex, Vec<(FilmTile, Counters)>)>,
    /// In which objects those are, where there is a store.
    pub stored: Vec<(FrameIndex, Vec<Holding>)>,
    /// Who delivered what of it, where that was kept.
    pub origins: Vec<Origin>,
    /// When its frames that are not finished were begun, where that was kept.
    pub begun: BTreeMap<FrameIndex, SystemTime>,
}

impl Submission {
    /// A new job, of whose events nobody hears.
    pub fn new(job: JobId, spec: JobSpec, outputs: Outputs) -> Self {
        let (finished, durable, stored, origins) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let begun = BTreeMap::new();
        Self { job, spec, outputs, listener: None, finished, durable, stored, origins, begun }
    }
}

/// What the owner of a job may decide.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JobOrder {
    /// Give out nothing more for now.
    Pause,
    /// Go on.
    Resume,
    /// Give it up.
    Cancel,
    /// Let it go before jobs of lower priority.
    Priority(i32),
}

impl std::fmt::Display for JobOrder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Pause => f.write_str("paused by its owner"),
            Self::Resume => f.write_str("resumed"),
            Self::Cancel => f.write_str("cancelled"),
            Self::Priority(priority) => write!(f, "its priority is {priority} now"),
        }
    }
}

/// What happens to a job.
#[derive(Debug)]
pub enum JobEvent {
    /// A worker has made a frame ready.
    Prepared {
        /// To build what rays need.
        build: Duration,
    },
    /// A frame is written.
    Frame(Box<FrameSummary>),
    /// A frame that was written was wrong and is rendered again.
    Withdrawn(FrameIndex),
    /// The job cannot be finished.
    Failed(String),
}

/// How things are.
#[derive(Clone, Debug, Default)]
pub struct Overview {
    /// Of the whole farm.
    pub status: Option<Status>,
    /// What each job has cost, since the coordinator started.
    pub tallies: BTreeMap<JobId, Tally>,
    /// How many frames of each job are written.
    pub written: BTreeMap<JobId, u64>,
    /// Why nothing can be stored at present.
    pub trouble: Option<String>,
}

/// How things are with one job.
#[derive(Clone, Debug)]
pub struct Progress {
    /// Connected workers.
    pub workers: usize,
    /// Why nothing is being rendered.
    pub why_idle: Option<String>,
    /// What the job has cost.
    pub tally: Tally,
    /// How many of its frames are written.
    pub written: u64,
    /// Of its oldest open frame.
    pub outlook: Option<Outlook>,
}

/// The farm is gone; only while the program ends.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("the coordinator is ending")]
pub struct Ending;

/// A handle to the farm.
#[derive(Clone)]
pub struct Farm {
    pub(crate) inputs: mpsc::Sender<Input>,
    pub(crate) assembly: mpsc::Sender<Task>,
    pub(crate) session: u64,
    pub(crate) store: Option<Arc<Store>>,
    /// What workers may ask for.
    pub registry: Arc<Registry>,
    /// What has happened.
    pub chronicle: Arc<Chronicle>,
}

impl Farm {
    pub(crate) async fn tell(&self, input: Input) -> Result<(), Ending> {
        self.inputs.send(input).await.map_err(|_| Ending)
    }

    /// A scene's snapshot, from memory or from the store.
    pub async fn scene(&self, scene: SceneId) -> Option<Bytes> {
        match (self.registry.scene(scene), &self.store) {
            (None, Some(store)) => store.scene(scene).await,
            (known, _) => known,
        }
    }

    /// Starts a job, or goes on with it.
    pub async fn submit(&self, submission: Submission) -> Result<(), Ending> {
        self.registry.put_job(submission.job, submission.spec.clone());
        self.tell(Input::Submit(Box::new(submission))).await
    }

    /// Passes an order on; whether the job is known and not at its end.
    pub async fn order(&self, job: JobId, order: JobOrder) -> Result<bool, Ending> {
        let (reply, done) = oneshot::channel();
        self.tell(Input::Order { job, order, reply }).await?;
        done.await.map_err(|_| Ending)
    }

    /// Recalls what was known of workers before the coordinator started.
    pub async fn recall(&self, reputation: Reputation) -> Result<(), Ending> {
        self.tell(Input::Recall(reputation)).await
    }

    /// Trusts a worker again; whether it was not trusted, or had been in quarantine.
    pub async fn forgive(&self, name: String) -> Result<bool, Ending> {
        let (reply, known) = oneshot::channel();
        self.tell(Input::Forgive { name, reply }).await?;
        known.await.map_err(|_| Ending)
    }

    /// Forgets a job that has ended. From then on nothing of it goes to the store.
    pub async fn forget(&self, job: JobId) -> Result<(), Ending> {
        self.registry.remove_job(job);
        let (done, gone) = oneshot::channel();
        self.tell(Input::Forget { job, done }).await?;
        gone.await.map_err(|_| Ending)
    }

    /// Lets a worker finish what it holds and leave; whether it is known.
    pub async fn drain(&self, worker: WorkerId) -> Result<bool, Ending> {
        let (reply, done) = oneshot::channel();
        self.tell(Input::Drain { worker, reply }).await?;
        done.await.map_err(|_| Ending)
    }

    /// How things are.
    pub async fn overview(&self) -> Result<Overview, Ending> {
        let (reply, overview) = oneshot::channel();
        self.tell(Input::Status { reply }).await?;
        overview.await.map_err(|_| Ending)
    }

    /// How it stands with the oldest open frame of `job`.
    pub async fn outlook(&self, job: JobId) -> Result<Option<Outlook>, Ending> {
        let (reply, outlook) = oneshot::channel();
        self.assembly.send(Task::Outlook(job, reply)).await.map_err(|_| Ending)?;
        outlook.await.map_err(|_| Ending)
    }

    /// How things are with `job`.
    pub async fn progress(&self, job: JobId) -> Result<Progress, Ending> {
        let mut overview = self.overview().await?;
        let status = overview.status.take();
        Ok(Progress {
            workers: status.as_ref().map_or(0, |status| status.workers.len()),
            why_idle: status.and_then(|status| status.why_idle).map(|why| why.to_string()),
            tally: overview.tallies.remove(&job).unwrap_or_default(),
            written: overview.written.get(&job).copied().unwrap_or(0),
            outlook: self.outlook(job).await?,
        })
    }

    /// Tells every worker that there is no more work.
    pub async fn farewell(&self, reason: &str) {
        let (done, said) = oneshot::channel();
        if self.tell(Input::Farewell { reason: reason.to_owned(), done }).await.is_ok() {
            let _ = said.await;
        }
    }
}
