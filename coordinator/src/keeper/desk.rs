//! What waits is put together and put; what must go is removed when nothing is on its way.

use super::merging::{LeftBehind, Merging};
use super::{Key, Order, Reopened};
use crate::assembly::{Claimed, Report, StorePart, Task};
use crate::store::{Holding, OBJECT_BYTES_MAX, OBJECT_PARTIALS_MAX, Store, StoreError};
use farm_job::JobId;
use farm_scheduler::Origin;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::task::JoinSet;

/// Pause before a store that failed is tried again.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// Where results wait to be kept.
pub(super) struct Desk {
    store: Arc<Store>,
    assembly: mpsc::Sender<Task>,
    reports: mpsc::UnboundedSender<Report>,
    waiting: BTreeMap<Key, VecDeque<Claimed>>,
    /// Frames of which results wait, the longest waiting first.
    turns: VecDeque<Key>,
    waiting_bytes: Arc<AtomicUsize>,
    merging: Merging,
    /// Results that nobody needs any more are being removed.
    removals: JoinSet<()>,
    /// Whether it is kept who delivered what.
    origins: bool,
    fails: bool,
}

/// A put that has ended.
struct Ended {
    batch: Vec<Claimed>,
    outcome: Result<Holding, StoreError>,
}

impl Desk {
    pub fn new(
        store: Arc<Store>,
        origins: bool,
        assembly: mpsc::Sender<Task>,
        reports: mpsc::UnboundedSender<Report>,
        waiting_bytes: Arc<AtomicUsize>,
    ) -> Self {
        Self {
            store,
            assembly,
            reports,
            waiting: BTreeMap::new(),
            turns: VecDeque::new(),
            waiting_bytes,
            merging: Merging::default(),
            removals: JoinSet::new(),
            origins,
            fails: false,
        }
    }

    pub async fn run(mut self, mut orders: mpsc::UnboundedReceiver<Order>) {
        let mut puts = JoinSet::new();
        loop {
            tokio::select! {
                biased;
                order = orders.recv() => match order {
                    Some(order) => self.obey(order, &mut puts).await,
                    None => return,
                },
                Some(Ok(ended)) = puts.join_next() => self.ended(ended).await,
                left_behind = self.merging.step() => self.tidy(left_behind),
                Some(_) = self.removals.join_next() => {}
            }
            while let Ok(order) = orders.try_recv() {
                self.obey(order, &mut puts).await;
            }
            self.begin_puts(&mut puts);
            if !self.fails {
                self.merging.begin(&self.store, !puts.is_empty());
            }
        }
    }

    async fn obey(&mut self, order: Order, puts: &mut JoinSet<Ended>) {
        match order {
            // Whose they are is known of what was delivered, not of what was merged.
            Order::Open(..) if self.origins => {}
            Order::Open(job, spec, durable) => {
                self.merging.open(job, spec.rounds().unwrap_or_default());
                for (frame, holdings) in durable {
                    let superfluous = self.merging.recall((job, frame), holdings);
                    let store = self.store.clone();
                    self.removals.spawn(async move { store.remove_superfluous(superfluous).await });
                }
            }
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
            Order::Finished(job, frame) => {
                let key = (job, frame);
                self.merging.forget(key);
                if self.origins {
                    // What is left after a failure is read like what it would have become.
                    let _ = self.store.settle_origins(job, frame).await;
                }
                // Otherwise some of them are on their way.
                if !self.merging.is_at(key) {
                    self.tidy(Some(LeftBehind(key)));
                }
            }
            Order::Discard(job, done) => {
                self.drop_waiting(job);
                self.catch_up(puts).await;
                self.store.remove_all_partials(job).await;
                self.merging.close(job);
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
        let left_behind = self.merging.finish().await;
        self.tidy(left_behind);
        while self.removals.join_next().await.is_some() {}
    }

    /// Removes partials that nobody needs any more.
    fn tidy(&mut self, left_behind: Option<LeftBehind>) {
        if let Some(LeftBehind((job, frame))) = left_behind {
            let store = self.store.clone();
            self.removals.spawn(async move { store.remove_partials(job, frame).await });
        }
    }

    fn begin_puts(&mut self, puts: &mut JoinSet<Ended>) {
        // A store that fails is tried with one put at a time.
        let puts_max = if self.fails { 1 } else { self.store.puts() };
        while puts.len() < puts_max
            && let Some(batch) = self.next_batch()
        {
            let pause = if self.fails { RETRY_AFTER } else { Duration::ZERO };
            puts.spawn(put(self.store.clone(), batch, self.origins, pause));
        }
    }

    /// What is left behind would be merged again, or taken for good, after a restart; so it must go. Who delivered it is
    /// forgotten last.
    async fn reopen(&mut self, Reopened { job, frame, tiles, finished }: Reopened) {
        let store = self.store.clone();
        self.merging.forget((job, frame));
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
                || (batch.len() < OBJECT_PARTIALS_MAX && bytes + next.partial_exr.len() <= OBJECT_BYTES_MAX))
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

    async fn ended(&mut self, Ended { batch, outcome }: Ended) {
        match outcome {
            Ok(holding) => {
                self.works();
                self.merging.put((batch[0].delivery.job, batch[0].delivery.unit.frame), holding);
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

async fn put(store: Arc<Store>, batch: Vec<Claimed>, with_origins: bool, pause: Duration) -> Ended {
    tokio::time::sleep(pause).await;
    let (job, frame) = (batch[0].delivery.job, batch[0].delivery.unit.frame);
    let partials: Vec<_> =
        batch.iter().map(|claimed| (&claimed.delivery.unit, claimed.partial_exr.clone())).collect();
    let outcome = async {
        // Nothing is there of which it is not known whose it is.
        if with_origins {
            store.put_origins(job, frame, &batch.iter().map(origin).collect::<Vec<_>>()).await?;
        }
        store.put_partials(job, frame, &partials).await
    };
    Ended { outcome: outcome.await, batch }
}

fn origin(Claimed { delivery, worker, .. }: &Claimed) -> Origin {
    let (frame, name) = (delivery.unit.frame, worker.clone());
    Origin { frame, name, part: Some((delivery.unit, delivery.digest)) }
}
