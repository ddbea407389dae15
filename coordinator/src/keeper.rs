//! Makes results durable before anything is acknowledged: what waits is put together, as one put costs the same for one
//! result as for hundreds. While the store fails, results are held and tried again.

use crate::assembly::{Claimed, Report, StorePart, Task};
use crate::store::{Store, StoreError};
use farm_film::{FrameIndex, Tile};
use farm_job::JobId;
use farm_scheduler::Reputation;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinSet;

/// Results in one object at most, and their bytes: what is lost when one object is damaged, and has to be held in memory
/// twice while it is packed.
const BATCH_MAX: usize = 1024;
const BATCH_BYTES_MAX: usize = 32 << 20;

/// Bytes of results that wait for the store. Beyond this they are turned away, and rendered again when the store works.
const WAITING_BYTES_MAX: usize = 1 << 30;

/// Pause before a store that failed is tried again.
const RETRY_AFTER: Duration = Duration::from_secs(1);

enum Order {
    Keep(Box<Claimed>),
    Reopen(Reopened),
    Remember(Reputation, oneshot::Sender<()>),
    Finished(JobId, FrameIndex),
    Discard(JobId, oneshot::Sender<()>),
}

/// What is rendered again.
pub struct Reopened {
    /// Whose.
    pub job: JobId,
    /// Which picture.
    pub frame: FrameIndex,
    /// Which part of it.
    pub tiles: Vec<Tile>,
    /// The frame was finished, and all of it is rendered again.
    pub finished: bool,
}

/// Takes results that are to be kept.
pub struct Keeper {
    inbox: mpsc::UnboundedSender<Order>,
    waiting_bytes: Arc<AtomicUsize>,
}

impl Keeper {
    /// Starts to keep results in `store`, each of which goes on to `assembly` when it is durable. `origins`: keep as well who
    /// delivered them.
    pub fn start(
        store: Arc<Store>,
        origins: bool,
        assembly: mpsc::Sender<Task>,
        reports: mpsc::UnboundedSender<Report>,
    ) -> Self {
        // Bounded by the bytes in it.
        let (inbox, orders) = mpsc::unbounded_channel();
        let waiting_bytes = Arc::new(AtomicUsize::new(0));
        let desk = Desk {
            store,
            assembly,
            reports,
            waiting: BTreeMap::new(),
            turns: VecDeque::new(),
            waiting_bytes: waiting_bytes.clone(),
            origins,
            noted: BTreeMap::new(),
            fails: false,
        };
        tokio::spawn(desk.run(orders));
        Self { inbox, waiting_bytes }
    }

    /// Keeps a result; gives it back when there is no room for it.
    pub fn keep(&self, claimed: Box<Claimed>) -> Result<(), Box<Claimed>> {
        let bytes = claimed.partial_exr.len();
        if self.waiting_bytes.fetch_add(bytes, Ordering::Relaxed) + bytes > WAITING_BYTES_MAX {
            self.waiting_bytes.fetch_sub(bytes, Ordering::Relaxed);
            return Err(claimed);
        }
        // The desk lives as long as the program.
        let _ = self.inbox.send(Order::Keep(claimed));
        Ok(())
    }

    /// Forgets what is kept of some tiles, or of a finished frame, and lets the assembly forget it.
    pub fn reopen(&self, reopened: Reopened) {
        let _ = self.inbox.send(Order::Reopen(reopened));
    }

    /// Keeps what is known of workers, before anything that is asked later; says when it is durable.
    pub fn remember(&self, reputation: Reputation, done: oneshot::Sender<()>) {
        let _ = self.inbox.send(Order::Remember(reputation, done));
    }

    /// A frame is finished: nothing more of it comes.
    pub fn finished(&self, job: JobId, frame: FrameIndex) {
        let _ = self.inbox.send(Order::Finished(job, frame));
    }

    /// Forgets all results of a job that was given up or forgotten; says when they are gone.
    pub fn discard(&self, job: JobId, done: oneshot::Sender<()>) {
        let _ = self.inbox.send(Order::Discard(job, done));
    }
}

/// Results of one frame go together.
type Key = (JobId, FrameIndex);

struct Desk {
    store: Arc<Store>,
    assembly: mpsc::Sender<Task>,
    reports: mpsc::UnboundedSender<Report>,
    waiting: BTreeMap<Key, VecDeque<Claimed>>,
    /// Frames of which results wait, the longest waiting first.
    turns: VecDeque<Key>,
    waiting_bytes: Arc<AtomicUsize>,
    /// Whether it is kept who delivered what.
    origins: bool,
    /// What of that is durable already.
    noted: BTreeMap<Key, BTreeSet<(Tile, String)>>,
    fails: bool,
}

/// A put that has ended.
struct Ended {
    batch: Vec<Claimed>,
    origins: Vec<(Tile, String)>,
    outcome: Result<(), StoreError>,
}

impl Desk {
    async fn run(mut self, mut orders: mpsc::UnboundedReceiver<Order>) {
        let mut puts = JoinSet::new();
        loop {
            tokio::select! {
                biased;
                order = orders.recv() => match order {
                    Some(order) => self.obey(order, &mut puts).await,
                    None => return,
                },
                Some(Ok(ended)) = puts.join_next() => self.ended(ended).await,
            }
            while let Ok(order) = orders.try_recv() {
                self.obey(order, &mut puts).await;
            }
            self.begin_puts(&mut puts);
        }
    }

    async fn obey(&mut self, order: Order, puts: &mut JoinSet<Ended>) {
        match order {
            Order::Keep(claimed) => self.file(*claimed),
            Order::Reopen(reopened) => {
                self.catch_up(puts).await;
                self.reopen(reopened).await;
            }
            Order::Remember(reputation, done) => {
                let store = self.store.clone();
                self.insist(|| store.put_reputation(&reputation)).await;
                let _ = done.send(());
            }
            Order::Finished(job, frame) => drop(self.noted.remove(&(job, frame))),
            Order::Discard(job, done) => {
                self.drop_waiting(job);
                self.catch_up(puts).await;
                self.store.remove_all_partials(job).await;
                self.noted.retain(|key, _| key.0 != job);
                let _ = done.send(());
            }
        }
    }

    /// What came before must be there, so that it goes, too.
    async fn catch_up(&mut self, puts: &mut JoinSet<Ended>) {
        self.begin_puts(puts);
        while let Some(Ok(ended)) = puts.join_next().await {
            self.ended(ended).await;
            self.begin_puts(puts);
        }
    }

    fn begin_puts(&mut self, puts: &mut JoinSet<Ended>) {
        // A store that fails is tried with one put at a time.
        let puts_max = if self.fails { 1 } else { self.store.puts() };
        while puts.len() < puts_max
            && let Some(batch) = self.next_batch()
        {
            let pause = if self.fails { RETRY_AFTER } else { Duration::ZERO };
            let origins = self.new_origins(&batch);
            puts.spawn(put(self.store.clone(), batch, origins, pause));
        }
    }

    /// What is left behind would be merged again, or taken for good, after a restart; so it must go. Who delivered it is
    /// forgotten last.
    async fn reopen(&mut self, Reopened { job, frame, tiles, finished }: Reopened) {
        let store = self.store.clone();
        self.noted.remove(&(job, frame));
        // Partials of a finished frame may be there still, as it may not have been written yet.
        self.insist(|| store.remove_tiles(job, frame, &tiles)).await;
        if finished {
            self.insist(|| store.remove_frame(job, frame)).await;
            self.insist(|| store.remove_origins(job, frame, None)).await;
            let _ = self.assembly.send(Task::Withdraw(job, frame)).await;
        } else {
            self.insist(|| store.remove_origins(job, frame, Some(&tiles))).await;
            let _ = self.assembly.send(Task::Reopen(job, frame, tiles)).await;
        }
    }

    /// Does something with the store until it is done, or until the store is another coordinator's.
    async fn insist<F: Future<Output = Result<(), StoreError>>>(&mut self, act: impl Fn() -> F) {
        while let Err(error) = act().await {
            if matches!(error, StoreError::TurnOver(_)) {
                return;
            }
            self.fails = true;
            let _ = self.reports.send(Report::Store(StorePart::Partials, Err(error.to_string())));
            tokio::time::sleep(RETRY_AFTER).await;
        }
        self.works();
    }

    /// Who delivered what of a batch, as far as that is news.
    fn new_origins(&self, batch: &[Claimed]) -> Vec<(Tile, String)> {
        if !self.origins {
            return Vec::new();
        }
        let key = (batch[0].delivery.job, batch[0].delivery.unit.frame);
        let noted = self.noted.get(&key);
        let all = batch.iter().map(|claimed| (claimed.delivery.unit.tile, claimed.worker.clone()));
        let new: BTreeSet<_> =
            all.filter(|origin| noted.is_none_or(|noted| !noted.contains(origin))).collect();
        new.into_iter().collect()
    }

    /// What of this is durable is not noted again.
    fn note_origins(&mut self, batch: &[Claimed], origins: Vec<(Tile, String)>) {
        if let Some(first) = batch.first().filter(|_| !origins.is_empty()) {
            let key = (first.delivery.job, first.delivery.unit.frame);
            self.noted.entry(key).or_default().extend(origins);
        }
    }

    fn works(&mut self) {
        if std::mem::take(&mut self.fails) {
            let _ = self.reports.send(Report::Store(StorePart::Partials, Ok(())));
        }
    }

    /// Keeps nothing more of a job that has ended.
    fn drop_waiting(&mut self, job: JobId) {
        self.turns.retain(|key| key.0 != job);
        let frames: Vec<Key> = self.waiting.keys().filter(|key| key.0 == job).copied().collect();
        for Claimed { delivery, partial_exr, .. } in
            frames.iter().filter_map(|key| self.waiting.remove(key)).flatten()
        {
            self.waiting_bytes.fetch_sub(partial_exr.len(), Ordering::Relaxed);
            let _ = self.reports.send(Report::Refused { delivery, reason: "its job has ended".to_owned() });
        }
    }

    fn file(&mut self, claimed: Claimed) {
        let key = (claimed.delivery.job, claimed.delivery.unit.frame);
        let waiting = self.waiting.entry(key).or_default();
        if waiting.is_empty() {
            self.turns.push_back(key);
        }
        waiting.push_back(claimed);
    }

    fn next_batch(&mut self) -> Option<Vec<Claimed>> {
        let key = self.turns.pop_front()?;
        let waiting = self.waiting.get_mut(&key).expect("frames have turns while results of theirs wait");
        let (mut batch, mut bytes) = (Vec::new(), 0);
        while let Some(next) = waiting.front()
            && (batch.is_empty()
                || (batch.len() < BATCH_MAX && bytes + next.partial_exr.len() <= BATCH_BYTES_MAX))
        {
            bytes += next.partial_exr.len();
            batch.extend(waiting.pop_front());
        }
        if waiting.is_empty() {
            self.waiting.remove(&key);
        } else {
            self.turns.push_back(key);
        }
        Some(batch)
    }

    async fn ended(&mut self, Ended { batch, origins, outcome }: Ended) {
        match outcome {
            Ok(()) => {
                self.works();
                self.note_origins(&batch, origins);
                for claimed in batch {
                    self.waiting_bytes.fetch_sub(claimed.partial_exr.len(), Ordering::Relaxed);
                    let _ = self.assembly.send(Task::Add(Box::new(claimed))).await;
                }
            }
            // The program is about to end; the workers keep what they have for whoever comes next.
            Err(StoreError::TurnOver(_)) => {}
            Err(error) => {
                self.fails = true;
                let _ = self.reports.send(Report::Store(StorePart::Partials, Err(error.to_string())));
                batch.into_iter().for_each(|claimed| self.file(claimed));
            }
        }
    }
}

async fn put(store: Arc<Store>, batch: Vec<Claimed>, origins: Vec<(Tile, String)>, pause: Duration) -> Ended {
    tokio::time::sleep(pause).await;
    let (job, frame) = (batch[0].delivery.job, batch[0].delivery.unit.frame);
    let partials: Vec<_> =
        batch.iter().map(|claimed| (&claimed.delivery.unit, claimed.partial_exr.clone())).collect();
    let outcome = async {
        // Nothing is there of which it is not known whose it is.
        if !origins.is_empty() {
            store.put_origins(job, frame, &origins).await?;
        }
        store.put_partials(job, frame, &partials).await
    };
    Ended { outcome: outcome.await, origins, batch }
}
