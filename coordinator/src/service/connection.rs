//! One worker's incoming messages.

use super::guard::is_refusal;
use crate::check::check;
use crate::farm::{Arrived, Ending, Farm, Input};
use farm_job::WorkerId;
use farm_proto::convert::{FromWorker, UnitResult};
use farm_proto::v1;
use farm_worker::blocking;
use tokio::time::Instant;
use tonic::Streaming;
use tracing::{debug, warn};

/// Passes on what a worker says until its stream ends.
pub(super) async fn listen(worker: WorkerId, mut incoming: Streaming<v1::WorkerMessage>, farm: Farm) {
    loop {
        let message = match incoming.message().await {
            Ok(Some(message)) => message,
            Ok(None) => break,
            Err(status) if is_refusal(status.code()) => {
                warn!(%worker, reason = status.message(), "worker talks nonsense; disconnecting it");
                break;
            }
            Err(status) => {
                debug!(%worker, reason = status.message(), "connection lost");
                break;
            }
        };
        let passed = match FromWorker::try_from(message) {
            Ok(FromWorker::Result(result)) => take(worker, result, &farm).await,
            Ok(FromWorker::Hello(_)) => Ok(()),
            Ok(message) => farm.tell(Input::Said { worker, message }).await,
            Err(error) => {
                warn!(%worker, %error, "worker talks nonsense; disconnecting it");
                break;
            }
        };
        if passed.is_err() {
            return;
        }
    }
    let _ = farm.tell(Input::Left { worker }).await;
}

/// Looks at a result away from the threads that answer messages.
async fn take(worker: WorkerId, result: UnitResult, farm: &Farm) -> Result<(), Ending> {
    let at = Instant::now().into_std();
    let spec = farm.registry.job(result.job);
    let arrived = blocking(move || {
        let outcome = spec.map(|spec| check(&result, &spec));
        Arrived { worker, result, outcome, at }
    });
    farm.tell(Input::Arrived(Box::new(arrived.await))).await
}
