//! The shell around the agent: waits for messages, threads and clocks, and does what the agent says.

use crate::agent::{Action, Agent, Event, FrameKey};
use crate::blocking::blocking;
use crate::frames::{self, FrameError, Prepared};
use crate::heartbeat::Heartbeats;
use crate::link::{LinkError, LinkEvent, Target, Up, keep_connected};
use crate::render_pool::{Assignment, Ended, MakePool, Pool, ReadyFrame, Stop};
use crate::renderer::FINGERPRINT;
use crate::scene_cache::SceneCache;
use farm_job::LeaseId;
use farm_proto::PROTOCOL_VERSION;
use farm_proto::convert::{FromWorker, Grant, Hello, ToWorker, UnitResult};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::Instant;
use tracing::{debug, info, warn};

/// Of the time to leave, this much is kept to send back what is finished.
const HAND_BACK_WITHIN: Duration = Duration::from_secs(2);

/// How a worker works.
#[derive(Clone)]
pub struct Config {
    /// Names it across connections.
    pub name: String,
    /// Units rendered at once, at least 1.
    pub threads: usize,
    /// What renders.
    pub pool: MakePool,
    /// Scenes at hand.
    pub scenes: Arc<SceneCache>,
    /// Where the coordinator is.
    pub target: Target,
    /// How long to look for a coordinator in vain.
    pub retry_for: Duration,
}

/// What a worker is told from outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Finish what is running, hand back the rest, leave; what takes longer than this goes back unfinished.
    Drain(Duration),
    /// Leave now.
    Leave,
}

/// Why a worker left of its own accord.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Left {
    /// It was told to.
    Drained,
    /// It was told to, and the time for it was over before everything was acknowledged.
    Late,
    /// It was told to leave everything behind.
    AtOnce,
    /// The coordinator has no more work, for this reason.
    Farewell(String),
}

/// Why a worker failed.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// No coordinator.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// No threads.
    #[error("cannot start {threads} render threads: {error}")]
    Threads {
        /// How many.
        threads: usize,
        /// Why not.
        error: std::io::Error,
    },
}

/// Works until told to leave, by `orders` or by the coordinator.
pub async fn run(config: Config, mut orders: mpsc::Receiver<Order>) -> Result<Left, WorkerError> {
    let threads = config.threads;
    let hello = Hello {
        protocol: PROTOCOL_VERSION,
        name: config.name.clone(),
        slots: u32::try_from(threads).unwrap_or(u32::MAX),
        fingerprint: FINGERPRINT.to_owned(),
    };
    // At most one message per thread is ever in here.
    let (ended_sender, mut ended) = mpsc::unbounded_channel();
    let pool =
        (config.pool)(threads, ended_sender).map_err(|error| WorkerError::Threads { threads, error })?;
    let (prepared_sender, mut prepared) = mpsc::channel(2);
    let (link_sender, mut link) = mpsc::channel(64);
    let connection = tokio::spawn(keep_connected(config.target, hello, config.retry_for, link_sender));
    let mut driver = Driver {
        agent: Agent::new(threads),
        pool,
        scenes: config.scenes,
        up: None,
        beats: None,
        frames: BTreeMap::new(),
        stops: BTreeMap::new(),
        results: BTreeMap::new(),
        prepared: prepared_sender,
        leaving: None,
    };
    let left = loop {
        let hand_back = driver.leaving.as_ref().and_then(|leaving| leaving.hand_back);
        let gone = driver.leaving.as_ref().map(|leaving| leaving.gone);
        let event = tokio::select! {
            biased;
            () = at(hand_back) => {
                driver.leaving.iter_mut().for_each(|leaving| leaving.hand_back = None);
                Some(Event::TimeIsUp)
            }
            () = at(gone) => break Ok(Left::Late),
            Some(event) = link.recv() => match driver.heard(event).await {
                Ok(event) => event,
                Err(end) => break end,
            },
            Some(end) = ended.recv() => Some(driver.ended(end)),
            Some(done) = prepared.recv() => driver.prepared(done).await,
            order = orders.recv() => match order {
                Some(Order::Drain(within)) => {
                    driver.leaving.get_or_insert_with(|| Leaving::within(within));
                    Some(Event::Drain)
                }
                Some(Order::Leave) | None => break Ok(Left::AtOnce),
            },
        };
        if let Some(event) = event {
            driver.agent.handle(event);
            if let Some(beats) = &driver.beats {
                beats.hold(driver.agent.leases());
            }
            if driver.perform().await {
                break Ok(Left::Drained);
            }
        }
    };
    driver.stop_all();
    connection.abort();
    left
}

/// Waits for a moment; forever when there is none.
async fn at(moment: Option<Instant>) {
    match moment {
        Some(moment) => tokio::time::sleep_until(moment).await,
        None => std::future::pending().await,
    }
}

/// When a worker that drains stops waiting for what it renders, and for everything.
struct Leaving {
    hand_back: Option<Instant>,
    gone: Instant,
}

impl Leaving {
    fn within(within: Duration) -> Self {
        let gone = Instant::now() + within;
        Self { hand_back: Some(gone - HAND_BACK_WITHIN.min(within / 4)), gone }
    }
}

/// A frame that was prepared, for the session that wanted it.
struct PrepareDone {
    session: u64,
    key: FrameKey,
    outcome: Result<Prepared, FrameError>,
}

struct Driver {
    agent: Agent,
    pool: Box<dyn Pool>,
    scenes: Arc<SceneCache>,
    up: Option<Up>,
    beats: Option<Heartbeats>,
    frames: BTreeMap<FrameKey, Arc<ReadyFrame>>,
    stops: BTreeMap<LeaseId, Arc<Stop>>,
    results: BTreeMap<LeaseId, UnitResult>,
    prepared: mpsc::Sender<PrepareDone>,
    leaving: Option<Leaving>,
}

impl Driver {
    /// What the link says, in the agent's words.
    async fn heard(&mut self, event: LinkEvent) -> Result<Option<Event>, Result<Left, WorkerError>> {
        Ok(match event {
            LinkEvent::Up(up) => {
                info!(worker = %up.worker, "connected");
                let session = up.session;
                self.beats = Some(Heartbeats::start(up.client.clone(), up.worker, up.heartbeat));
                self.up = Some(up);
                Some(Event::Welcomed { session })
            }
            LinkEvent::Down { reason } => {
                warn!(%reason, "connection lost; trying again");
                self.up = None;
                self.beats = None;
                Some(Event::Disconnected)
            }
            LinkEvent::Ended(error) => return Err(Err(error.into())),
            LinkEvent::Message(message) => match message {
                ToWorker::Welcome { .. } => None,
                ToWorker::Grant(grant) => Some(Event::Granted(grant)),
                ToWorker::Revoke(lease) => Some(Event::Revoked(lease)),
                ToWorker::Ack(lease) => Some(Event::Settled(lease)),
                ToWorker::Reject { lease, reason } => {
                    info!(%lease, %reason, "result not wanted");
                    Some(Event::Settled(lease))
                }
                ToWorker::Drained => return Err(Ok(Left::Drained)),
                ToWorker::Farewell(reason) => return Err(Ok(Left::Farewell(reason))),
            },
        })
    }

    fn ended(&mut self, end: Ended) -> Event {
        match end {
            Ended::Rendered(result) => {
                let lease = result.lease;
                self.stops.remove(&lease);
                self.results.insert(lease, *result);
                Event::Rendered(lease)
            }
            Ended::Stopped(lease) => {
                self.stops.remove(&lease);
                Event::Stopped(lease)
            }
            Ended::Failed(lease, reason) => {
                warn!(%lease, %reason, "unit failed");
                self.stops.remove(&lease);
                Event::Failed(lease, reason)
            }
        }
    }

    async fn prepared(&mut self, done: PrepareDone) -> Option<Event> {
        let PrepareDone { session, key, outcome } = done;
        // Prepared for a coordinator that is gone: the same numbers mean another picture now.
        if self.up.as_ref().is_some_and(|up| up.session != session) {
            return None;
        }
        match outcome {
            Ok(Prepared { frame, memory_short, fetch, build }) => {
                debug!(job = %key.job, frame = %key.frame, ?fetch, ?build, "frame prepared");
                self.frames.insert(key, frame);
                if memory_short {
                    self.agent.handle(Event::MemoryShort);
                }
                self.say(FromWorker::Prepared { job: key.job, frame: key.frame, fetch, build }).await;
                Some(Event::Prepared(key))
            }
            Err(error) if error.is_for_others() => {
                warn!(job = %key.job, %error, "job refused");
                Some(Event::TooLarge(key, error.to_string()))
            }
            Err(error) => {
                warn!(job = %key.job, frame = %key.frame, %error, "frame cannot be prepared");
                Some(Event::PrepareFailed(key, error.to_string()))
            }
        }
    }

    /// Does what the agent wants; true when it wants to leave.
    async fn perform(&mut self) -> bool {
        while let Some(action) = self.agent.poll_action() {
            match action {
                Action::Prepare(key) => self.prepare(key),
                Action::Forget(key) => {
                    // Memory of this size is given back elsewhere than between two units.
                    let frame = self.frames.remove(&key);
                    tokio::spawn(blocking(move || drop(frame)));
                }
                Action::Start(grant) => self.start(grant),
                Action::Stop(lease) => {
                    if let Some(stop) = self.stops.get(&lease) {
                        stop.drop_it();
                    }
                }
                Action::HandBack(lease) => {
                    if let Some(stop) = self.stops.get(&lease) {
                        stop.hand_back();
                    }
                }
                Action::Deliver(lease) => {
                    if let Some(result) = self.results.get(&lease) {
                        self.say(FromWorker::Result(result.clone())).await;
                    }
                }
                Action::Discard(lease) => {
                    self.results.remove(&lease);
                }
                Action::Report(lease, reason) => self.say(FromWorker::UnitFailed { lease, reason }).await,
                Action::Refuse(job, reason) => self.say(FromWorker::JobRefused { job, reason }).await,
                Action::Return(lease) => self.say(FromWorker::Returned(lease)).await,
                Action::AnnounceDraining => self.say(FromWorker::Draining).await,
                Action::Leave => return true,
            }
        }
        false
    }

    /// A message that cannot be sent is no error: the link will say that it is down.
    async fn say(&self, message: FromWorker) {
        if let Some(up) = &self.up {
            let _ = up.outgoing.send(message).await;
        }
    }

    fn prepare(&self, key: FrameKey) {
        let Some(up) = &self.up else { return };
        let (session, client) = (up.session, up.client.clone());
        let (scenes, done) = (self.scenes.clone(), self.prepared.clone());
        tokio::spawn(async move {
            let outcome = frames::prepare(key, client, scenes).await;
            let _ = done.send(PrepareDone { session, key, outcome }).await;
        });
    }

    fn start(&mut self, grant: Grant) {
        let frame = self.frames.get(&FrameKey::from(&grant)).expect("units start on prepared frames").clone();
        let stop = Arc::new(Stop::default());
        self.stops.insert(grant.lease, stop.clone());
        self.pool.push(Assignment { grant, frame, stop });
    }

    fn stop_all(&self) {
        self.stops.values().for_each(|stop| stop.drop_it());
    }
}
