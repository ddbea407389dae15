//! The shell around the scheduler: one task that owns it, tells it what happens and does what it says.

use crate::assembly::{self, Claimed, Report, StorePart, Task};
use crate::check::Defect;
use crate::checkpoint::Spent;
use crate::chronicle::Chronicle;
use crate::clocks::Clocks;
use crate::farm::{Arrived, Farm, Input, JobEvent, JobOrder, Overview, Submission};
use crate::keeper::{Keeper, Reopened};
use crate::outputs::{self, Outputs};
use crate::registry::Registry;
use crate::store::{Fate, Store, StoreError};
use crate::tally::Tally;
use farm_film::{FrameIndex, Tile, WorkUnit};
use farm_job::{JobId, JobSpec, JobState, LeaseId, WorkerId};
use farm_proto::convert::{FromWorker, Grant, Heartbeat, Hello, ToWorker};
use farm_scheduler::{Action, Config, Delivery, Event, Scheduler, Timestamp, Verdict, WhyDisconnect};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant as Moment, SystemTime};
use tokio::sync::{mpsc, oneshot};
use tokio::time::Instant;
use tracing::{debug, error, info, warn};

/// Things told to the driver that wait for it; beyond this, those who tell have to wait.
const INPUTS_MAX: usize = 1024;

/// Pause before what has become of a job is put again into a store that failed.
const RETRY_AFTER: Duration = Duration::from_secs(2);

/// When a frame that was begun at a moment is to end, if its job says so: early enough to be written by then.
fn due(spec: &JobSpec, begun: Moment) -> Option<Moment> {
    Some(begun + spec.stop.time?.saturating_sub(outputs::writing(spec)))
}

/// Starts the farm. It ends when the last handle is dropped. With a store, nothing is acknowledged that is not durable.
/// `verify`: part of the units that two workers render, to compare.
pub fn start(store: Option<Arc<Store>>, verify: f64) -> std::io::Result<Farm> {
    let session = store.as_ref().map_or_else(|| fastrand::u64(..), |store| store.session());
    // There are few reports per claimed partial or finished frame, and reports are small.
    let (report_sender, reports) = mpsc::unbounded_channel();
    let assembly = assembly::start(store.clone(), report_sender.clone())?;
    let keeper = store
        .clone()
        .map(|store| Keeper::start(store, verify > 0.0, assembly.clone(), report_sender.clone()));
    let (inputs, receiver) = mpsc::channel(INPUTS_MAX);
    // A restarted coordinator gives out other leases than before, so that late results find no wrong one.
    let first_lease = LeaseId(u64::from(fastrand::u32(..)) << 24 | 1);
    let config = Config { first_lease, verify, verify_seed: fastrand::u64(..), ..Config::default() };
    let chronicle = Arc::new(Chronicle::default());
    let driver = Driver {
        scheduler: Scheduler::new(config),
        started: Instant::now(),
        workers: BTreeMap::new(),
        next_worker: 1,
        jobs: BTreeMap::new(),
        clocks: Clocks::default(),
        assembly: assembly.clone(),
        keeper,
        store: store.clone(),
        reports: report_sender,
        chronicle: chronicle.clone(),
        trouble: BTreeMap::new(),
    };
    tokio::spawn(driver.run(receiver, reports));
    Ok(Farm { inputs, assembly, session, store, registry: Arc::new(Registry::default()), chronicle })
}

struct Worker {
    name: String,
    outgoing: mpsc::Sender<ToWorker>,
}

struct Job {
    spec: JobSpec,
    tally: Tally,
    outputs: Outputs,
    written: BTreeSet<FrameIndex>,
    /// Finished frames that are wrong and not yet taken away.
    withdrawn: BTreeSet<FrameIndex>,
    listener: Option<mpsc::UnboundedSender<JobEvent>>,
    /// Its owner paused it, rather than the store.
    paused: bool,
}

struct Driver {
    scheduler: Scheduler,
    started: Instant,
    workers: BTreeMap<WorkerId, Worker>,
    next_worker: u64,
    jobs: BTreeMap<JobId, Job>,
    clocks: Clocks,
    assembly: mpsc::Sender<Task>,
    /// Where there is a store.
    keeper: Option<Keeper>,
    store: Option<Arc<Store>>,
    reports: mpsc::UnboundedSender<Report>,
    chronicle: Arc<Chronicle>,
    /// What cannot be stored at present, and why.
    trouble: BTreeMap<StorePart, String>,
}

impl Driver {
    async fn run(mut self, mut inputs: mpsc::Receiver<Input>, mut reports: mpsc::UnboundedReceiver<Report>) {
        loop {
            let deadline = self.scheduler.next_deadline().map(|Timestamp(after)| self.started + after);
            let deadline = [deadline, self.clocks.next().map(Instant::from_std)].into_iter().flatten().min();
            let tick = async {
                match deadline {
                    Some(deadline) => tokio::time::sleep_until(deadline).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                // Time and reports bring less than they settle, so that inputs wait for them but not forever.
                biased;
                () = tick => self.tick(),
                Some(report) = reports.recv() => self.report(report),
                input = inputs.recv() => match input {
                    Some(input) => self.input(input).await,
                    None => break,
                },
            }
            while let Some(action) = self.scheduler.poll_action() {
                self.perform(action).await;
            }
        }
    }

    fn now(&self) -> Timestamp {
        Timestamp(self.started.elapsed())
    }

    fn handle(&mut self, event: Event) {
        self.scheduler.handle(self.now(), event);
    }

    fn tick(&mut self) {
        for (job, frame, spp) in self.clocks.take_due(Instant::now().into_std()) {
            self.handle(Event::FrameTruncated { job, frame, spp });
        }
        self.handle(Event::Tick);
    }

    async fn input(&mut self, input: Input) {
        match input {
            Input::Join { hello, outgoing, reply } => self.join(hello, outgoing, reply),
            Input::Said { worker, message } => self.said(worker, message),
            Input::Beat(Heartbeat { worker, leases, round_trip }) => {
                self.handle(Event::Heartbeat { worker, leases, round_trip });
            }
            Input::Arrived(arrived) => self.arrived(*arrived).await,
            Input::Left { worker } => {
                if let Some(left) = self.workers.remove(&worker) {
                    info!(%worker, name = %left.name, "worker left");
                    self.chronicle.note(None, format!("worker {} left", left.name));
                    self.handle(Event::WorkerLeft { worker });
                }
            }
            Input::Submit(submission) => self.submit(*submission).await,
            Input::Order { job, order, reply } => {
                let _ = reply.send(self.order(job, order).await);
            }
            Input::Recall(reputation) => self.handle(Event::ReputationRecalled(reputation)),
            Input::Forgive { name, reply } => {
                let known = self.scheduler.reputation().knows(&name);
                if known {
                    self.chronicle.note(None, format!("worker {name} is trusted again"));
                    self.handle(Event::WorkerForgiven { name });
                    self.remember(oneshot::channel().0);
                }
                let _ = reply.send(known);
            }
            Input::Forget { job, done } => {
                self.jobs.remove(&job);
                self.handle(Event::JobForgotten { job });
                self.discard(job, done);
            }
            Input::Drain { worker, reply } => {
                let _ = reply.send(self.workers.contains_key(&worker));
                self.handle(Event::WorkerDraining { worker });
            }
            Input::Status { reply } => {
                let _ = reply.send(self.overview());
            }
            Input::Farewell { reason, done } => {
                for worker in self.workers.values() {
                    let _ = worker.outgoing.try_send(ToWorker::Farewell(reason.clone()));
                }
                self.workers.clear();
                let _ = done.send(());
            }
        }
    }

    fn join(&mut self, hello: Hello, outgoing: mpsc::Sender<ToWorker>, reply: oneshot::Sender<WorkerId>) {
        let worker = WorkerId(self.next_worker);
        self.next_worker += 1;
        info!(%worker, name = %hello.name, slots = hello.slots, "worker joined");
        self.chronicle.note(None, format!("worker {} joined with {} slots", hello.name, hello.slots));
        self.workers.insert(worker, Worker { name: hello.name.clone(), outgoing });
        // Whoever connected may be gone again; then its stream says so next.
        let _ = reply.send(worker);
        self.handle(Event::WorkerJoined { worker, name: hello.name, slots: hello.slots });
    }

    fn said(&mut self, worker: WorkerId, message: FromWorker) {
        match message {
            FromWorker::UnitFailed { lease, reason } => {
                warn!(%worker, %lease, %reason, "unit failed");
                self.chronicle.note(None, format!("a unit failed on {}: {reason}", self.name(worker)));
                self.handle(Event::UnitFailed { worker, lease, reason });
            }
            FromWorker::Returned(lease) => self.handle(Event::UnitReturned { worker, lease }),
            FromWorker::JobRefused { job, reason } => {
                warn!(%worker, %job, %reason, "job refused");
                self.chronicle
                    .note(Some(job), format!("worker {} refuses the job: {reason}", self.name(worker)));
                self.handle(Event::JobRefused { worker, job, reason });
            }
            FromWorker::Draining => {
                info!(%worker, "worker drains");
                self.chronicle.note(None, format!("worker {} takes no more units", self.name(worker)));
                self.handle(Event::WorkerDraining { worker });
            }
            FromWorker::Prepared { job, build, .. } => {
                self.tell_listener(job, JobEvent::Prepared { build });
            }
            // The service keeps these to itself.
            FromWorker::Hello(_) | FromWorker::Result(_) => {}
        }
    }

    async fn arrived(&mut self, arrived: Arrived) {
        let Arrived { worker, result, outcome, at } = arrived;
        let (lease, job, unit) = (result.lease, result.job, result.unit);
        let delivery = Delivery { worker, lease, job, unit, digest: result.digest };
        match outcome {
            None => self.reject(&delivery, "its job is not known here"),
            Some(Err(defect @ Defect::NotFinite)) => {
                warn!(%worker, %lease, %unit, error = %defect, "result rejected");
                self.reject(&delivery, &defect.to_string());
                self.handle(Event::UnitFailed { worker, lease, reason: defect.to_string() });
            }
            Some(Err(defect)) => {
                warn!(%worker, %lease, %unit, error = %defect, "result rejected");
                self.chronicle
                    .note(Some(job), format!("a result of {} was rejected: {defect}", self.name(worker)));
                self.reject(&delivery, &defect.to_string());
                self.handle(Event::ResultRejected { delivery, reason: defect.to_string() });
            }
            Some(Ok(checked)) => match self.scheduler.claim(self.now(), &delivery) {
                Verdict::Wanted => {
                    let claimed = Claimed {
                        delivery,
                        worker: self.name(worker).to_owned(),
                        tile: checked.tile,
                        partial_exr: result.partial_exr,
                        spent: Spent { counters: checked.counters, busy: result.render, cpu: result.cpu },
                        arrived: at,
                    };
                    self.take(Box::new(claimed)).await;
                }
                Verdict::Compared => self.reject(&delivery, "it was compared with what is there already"),
                Verdict::Distrusted => self.reject(&delivery, "results of this worker were wrong"),
                Verdict::NotNeeded => self.reject(&delivery, "its samples are there already"),
                Verdict::Foreign => {
                    warn!(%worker, %lease, %unit, "result is of no unit of its job");
                    let reason = "it is no unit of its job";
                    self.reject(&delivery, reason);
                    self.handle(Event::ResultRejected { delivery, reason: reason.to_owned() });
                }
            },
        }
    }

    /// Passes a result on to where it is kept and merged. The assembly outlives the driver, and never waits for it.
    async fn take(&mut self, claimed: Box<Claimed>) {
        let Some(keeper) = &self.keeper else {
            let _ = self.assembly.send(Task::Add(claimed)).await;
            return;
        };
        if let Err(claimed) = keeper.keep(claimed) {
            self.reject(
                &claimed.delivery,
                "it cannot be stored at present, and too much waits for the store",
            );
            self.handle(Event::StoreFailed { delivery: claimed.delivery });
        }
    }

    fn reject(&mut self, delivery: &Delivery, reason: &str) {
        self.say(delivery.worker, ToWorker::Reject { lease: delivery.lease, reason: reason.to_owned() });
    }

    async fn submit(&mut self, submission: Submission) {
        let Submission { job, spec, outputs, listener, finished, durable, stored, origins, begun } =
            submission;
        let ago = |begun: &SystemTime| Moment::now().checked_sub(begun.elapsed().unwrap_or_default());
        let begun: BTreeMap<FrameIndex, Moment> =
            begun.iter().filter_map(|(frame, begun)| Some((*frame, ago(begun)?))).collect();
        for (frame, begun) in &begun {
            if let Some(due) = due(&spec, *begun) {
                self.clocks.set(job, *frame, due);
            }
        }
        let known = Job {
            spec: spec.clone(),
            tally: Tally::default(),
            outputs: outputs.clone(),
            written: finished.iter().copied().collect(),
            withdrawn: BTreeSet::new(),
            listener,
            paused: false,
        };
        self.jobs.insert(job, known);
        let spec = Arc::new(spec);
        let _ = self.assembly.send(Task::Open(job, spec.clone(), outputs)).await;
        if let Some(keeper) = &self.keeper {
            keeper.open(job, spec.clone(), stored);
        }
        let mut units = Vec::new();
        for (frame, partials) in durable {
            units.extend(partials.iter().map(|(tile, _)| WorkUnit {
                frame,
                tile: tile.tile(),
                block: tile.block(),
            }));
            let begun = begun.get(&frame).copied();
            let _ = self.assembly.send(Task::Restore(job, frame, partials, begun)).await;
        }
        let spec = Box::new((*spec).clone());
        self.handle(Event::JobSubmitted { job, spec, finished, durable: units, origins });
        if !self.trouble.is_empty() {
            self.handle(Event::JobPaused { job });
        }
    }

    /// For people: what a worker calls itself.
    fn name(&self, worker: WorkerId) -> &str {
        self.workers.get(&worker).map_or("someone who left", |known| &known.name)
    }

    /// Does what a job's owner wants; whether there is such a job.
    async fn order(&mut self, id: JobId, order: JobOrder) -> bool {
        let Some(job) = self.jobs.get_mut(&id) else { return false };
        match order {
            JobOrder::Pause => job.paused = true,
            JobOrder::Resume => job.paused = false,
            JobOrder::Priority(priority) => job.spec.priority = priority,
            JobOrder::Cancel => {}
        }
        self.chronicle.note(Some(id), order.to_string());
        let event = match order {
            JobOrder::Pause => Event::JobPaused { job: id },
            // The store resumes it once it works.
            JobOrder::Resume if !self.trouble.is_empty() => return true,
            JobOrder::Resume => Event::JobResumed { job: id },
            JobOrder::Priority(priority) => Event::PriorityChanged { job: id, priority },
            JobOrder::Cancel => Event::JobCancelled { job: id },
        };
        self.handle(event);
        if order == JobOrder::Cancel {
            self.clocks.end_job(id);
            let _ = self.assembly.send(Task::Close(id)).await;
            self.discard(id, oneshot::channel().0);
        }
        true
    }

    /// Removes what is kept of a job that needs nothing more, and says so.
    fn discard(&self, job: JobId, done: oneshot::Sender<()>) {
        if let Some(keeper) = &self.keeper {
            keeper.discard(job, done);
        }
    }

    fn overview(&self) -> Overview {
        Overview {
            status: Some(self.scheduler.status(self.now())),
            tallies: self.jobs.iter().map(|(id, job)| (*id, job.tally.clone())).collect(),
            written: self.jobs.iter().map(|(id, job)| (*id, job.written.len() as u64)).collect(),
            trouble: self.trouble.values().next().cloned(),
        }
    }

    /// Pauses everything until the store works again.
    fn store_failed(&mut self, part: StorePart, reason: String) {
        if self.trouble.is_empty() {
            error!(%reason, "the store fails: all jobs are paused until it works again");
            self.chronicle
                .note(None, format!("the store fails, all jobs are paused until it works again: {reason}"));
            for job in self.jobs.keys().copied().collect::<Vec<_>>() {
                self.handle(Event::JobPaused { job });
            }
        }
        self.trouble.insert(part, reason);
    }

    fn store_works(&mut self, part: StorePart) {
        if self.trouble.remove(&part).is_some() && self.trouble.is_empty() {
            warn!("the store works again: going on");
            self.chronicle.note(None, "the store works again, going on");
            let waiting = self.jobs.iter().filter(|(_, job)| !job.paused).map(|(id, _)| *id);
            for job in waiting.collect::<Vec<_>>() {
                self.handle(Event::JobResumed { job });
            }
        }
    }

    /// Keeps that a job has failed.
    fn record(&self, job: JobId, fate: Fate) {
        let Some(store) = self.store.clone() else { return };
        let reports = self.reports.clone();
        tokio::spawn(async move {
            while let Err(error) = store.put_fate(job, &fate).await {
                if matches!(error, StoreError::TurnOver(_)) {
                    return;
                }
                let _ = reports.send(Report::Store(StorePart::States, Err(error.to_string())));
                tokio::time::sleep(RETRY_AFTER).await;
            }
            let _ = reports.send(Report::Store(StorePart::States, Ok(())));
        });
    }

    /// Keeps when a frame was begun that ends at a time.
    fn record_begun(&self, job: JobId, frame: FrameIndex, begun: Moment) {
        let Some(store) = self.store.clone() else { return };
        let begun = SystemTime::now() - begun.elapsed();
        tokio::spawn(async move {
            if let Err(error) = store.put_begun(job, frame, begun).await {
                warn!(%job, %frame, %error, "it cannot be kept when the frame was begun: after a restart its time would begin anew");
            }
        });
    }

    fn report(&mut self, report: Report) {
        match report {
            Report::Added { delivery, spent, arrived } => {
                if let Some(job) = self.jobs.get_mut(&delivery.job) {
                    job.tally.add(delivery.worker, spent, arrived);
                    let (begun, frame) = (spent.begun(arrived), delivery.unit.frame);
                    if let Some(due) = due(&job.spec, begun)
                        && self.clocks.set(delivery.job, frame, due)
                    {
                        self.record_begun(delivery.job, frame, begun);
                    }
                }
                debug!(worker = %delivery.worker, lease = %delivery.lease, unit = %delivery.unit, "unit accepted");
                self.say(delivery.worker, ToWorker::Ack(delivery.lease));
                self.handle(Event::UnitAccepted { delivery, render: spent.busy });
            }
            Report::Enough(job, frame, spp) => self.handle(Event::FrameTruncated { job, frame, spp }),
            Report::TilesEnded(job, frame, tiles, spp) => {
                debug!(%job, %frame, spp, tiles = tiles.len(), "tiles ended");
                self.handle(Event::TilesEnded { job, frame, tiles, spp });
            }
            Report::Refused { delivery, reason } => {
                warn!(worker = %delivery.worker, unit = %delivery.unit, %reason, "partial cannot be merged");
                self.reject(&delivery, &reason);
                self.handle(Event::ResultRejected { delivery, reason });
            }
            Report::Store(part, Ok(())) => self.store_works(part),
            Report::Store(part, Err(reason)) => self.store_failed(part, reason),
            Report::Frame { job: id, outcome } => {
                if let (Ok(summary), Some(job)) = (&outcome, self.jobs.get_mut(&id)) {
                    job.written.insert(FrameIndex(summary.frame));
                    self.chronicle.note(Some(id), format!("frame {} is written", summary.frame));
                    // One that is about to be taken away has its results ahead.
                    let frame = FrameIndex(summary.frame);
                    if let Some(keeper) = self.keeper.as_ref().filter(|_| !job.withdrawn.contains(&frame)) {
                        keeper.finished(id, frame);
                    }
                }
                let event = match outcome {
                    Ok(summary) => JobEvent::Frame(Box::new(summary)),
                    Err(reason) => JobEvent::Failed(reason),
                };
                self.tell_listener(id, event);
            }
            Report::Withdrawn(job, frame) => {
                if let Some(job) = self.jobs.get_mut(&job) {
                    job.written.remove(&frame);
                    job.withdrawn.remove(&frame);
                }
                self.tell_listener(job, JobEvent::Withdrawn(frame));
            }
        }
    }

    async fn perform(&mut self, action: Action) {
        match action {
            Action::Grant { worker, lease, job, unit, attempt, deadline } => {
                let ttl = deadline.since(self.now());
                self.say(worker, ToWorker::Grant(Grant { lease, job, unit, attempt, ttl }));
            }
            Action::Revoke { worker, lease } => self.say(worker, ToWorker::Revoke(lease)),
            Action::RoundComplete { job, frame, spp } => {
                self.clocks.round(job, frame, spp);
                let _ = self.assembly.send(Task::Round(job, frame, spp)).await;
            }
            Action::FrameComplete { job, frame, spp } => {
                self.clocks.end(job, frame);
                let _ = self.assembly.send(Task::Finish(job, frame, spp)).await;
            }
            Action::JobDone { job } => {
                self.clocks.end_job(job);
                let _ = self.assembly.send(Task::Close(job)).await;
            }
            Action::JobFailed { job, fault } => {
                self.clocks.end_job(job);
                let _ = self.assembly.send(Task::Close(job)).await;
                if let Some(known) = self.jobs.get(&job) {
                    let (state, priority) = (JobState::Failed, known.spec.priority);
                    self.record(job, Fate { state, reason: Some(fault.to_string()), priority });
                }
                self.tell_listener(job, JobEvent::Failed(fault.to_string()));
            }
            Action::Quarantine { worker, until, reason } => {
                let seconds = until.since(self.now()).as_secs();
                warn!(%worker, %reason, seconds, "worker in quarantine");
                let name = self.name(worker);
                self.chronicle
                    .note(None, format!("worker {name} is in quarantine for {seconds} s: {reason}"));
                self.remember(oneshot::channel().0);
            }
            Action::Distrust { name, reason } => {
                error!(name, %reason, "worker delivers wrong results; it gets nothing any more");
                self.chronicle
                    .note(None, format!("worker {name} delivers wrong results and gets nothing any more"));
                self.remember(oneshot::channel().0);
            }
            Action::Reopened { job, frame, tiles, finished } => {
                warn!(%job, %frame, tiles = tiles.len(), "a worker that delivers wrong results had a hand in this; rendering it again");
                self.reopen(job, frame, tiles, finished).await;
            }
            Action::Disconnect { worker, why } => {
                if why == WhyDisconnect::Drained {
                    self.say(worker, ToWorker::Drained);
                }
                if let Some(left) = self.workers.remove(&worker) {
                    info!(%worker, name = %left.name, ?why, "worker disconnected");
                    let why = match why {
                        WhyDisconnect::Silent => "is silent; what it held is given to others",
                        WhyDisconnect::Drained => "was sent home",
                    };
                    self.chronicle.note(None, format!("worker {} {why}", left.name));
                }
            }
        }
    }

    async fn reopen(&mut self, id: JobId, frame: FrameIndex, tiles: Vec<Tile>, finished: bool) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        if finished {
            job.withdrawn.insert(frame);
            // Its job may have been closed.
            let open = Task::Open(id, Arc::new(job.spec.clone()), job.outputs.clone());
            let _ = self.assembly.send(open).await;
        }
        if let Some(keeper) = &self.keeper {
            keeper.reopen(Reopened { job: id, frame, tiles, finished });
            return;
        }
        let task = if finished { Task::Withdraw(id, frame) } else { Task::Reopen(id, frame, tiles) };
        let _ = self.assembly.send(task).await;
    }

    /// Keeps what is known of workers, and says so.
    fn remember(&self, done: oneshot::Sender<()>) {
        if let Some(keeper) = &self.keeper {
            keeper.remember(self.scheduler.reputation(), done);
        }
    }

    /// Hands a message to a worker's stream. A worker that does not read what it is told is disconnected: the driver
    /// waits for nobody.
    fn say(&mut self, worker: WorkerId, message: ToWorker) {
        let Some(known) = self.workers.get(&worker) else { return };
        if known.outgoing.try_send(message).is_err() {
            warn!(%worker, name = %known.name, "worker does not listen; disconnecting it");
            self.workers.remove(&worker);
            self.handle(Event::WorkerLeft { worker });
        }
    }

    fn tell_listener(&self, job: JobId, event: JobEvent) {
        if let Some(listener) = self.jobs.get(&job).and_then(|job| job.listener.as_ref()) {
            let _ = listener.send(event);
        }
    }
}
