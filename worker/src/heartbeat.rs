//! Says regularly that the worker lives and what it holds. In calls of their own, so that a large result on a slow line does not
//! make the worker look dead, and in a task of their own, so that nothing the worker does holds them up.

use crate::client::Client;
use farm_job::{LeaseId, WorkerId};
use farm_proto::convert::Heartbeat;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::task::JoinHandle;
use tokio::time::{Instant, MissedTickBehavior};
use tracing::debug;

/// Heartbeats of one connection; they end when this is dropped.
pub(crate) struct Heartbeats {
    leases: Arc<Mutex<Vec<LeaseId>>>,
    task: JoinHandle<()>,
}

impl Heartbeats {
    /// The first one at once, then every so often.
    pub(crate) fn start(client: Client, worker: WorkerId, every: Duration) -> Self {
        let leases = Arc::new(Mutex::new(Vec::new()));
        let task = tokio::spawn(beat(client, worker, every, leases.clone()));
        Self { leases, task }
    }

    /// What the worker holds from now on.
    pub(crate) fn hold(&self, leases: Vec<LeaseId>) {
        *self.leases.lock().unwrap_or_else(PoisonError::into_inner) = leases;
    }
}

impl Drop for Heartbeats {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn beat(client: Client, worker: WorkerId, every: Duration, leases: Arc<Mutex<Vec<LeaseId>>>) {
    let mut ticks = tokio::time::interval(every);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut round_trip = None;
    loop {
        ticks.tick().await;
        let leases = leases.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let sent = Instant::now();
        match client.beat(Heartbeat { worker, leases, round_trip }).await {
            Ok(()) => round_trip = Some(sent.elapsed()),
            // The work stream says what there is to say about a lost connection.
            Err(error) => debug!(%error, "heartbeat was not heard"),
        }
    }
}
