//! Stands before all services: a call that its caller may not make is answered before anything of it is read.

use super::policy::{Peer, Refusal, permit};
use farm_trust::TokenId;
use futures::future::{Either, Ready, ready};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::SystemTime;
use tokio::sync::watch;
use tonic::Status;
use tonic::codegen::http::{Request, Response};
use tower::{Layer, Service};
use tracing::warn;

/// Tokens that were taken back, as of late.
pub type Revoked = watch::Receiver<Arc<BTreeSet<TokenId>>>;

/// Puts a guard before services.
#[derive(Clone)]
pub struct GuardLayer {
    /// Whose certificates are good for nothing any more.
    pub revoked: Revoked,
}

impl<S> Layer<S> for GuardLayer {
    type Service = Guard<S>;

    fn layer(&self, inner: S) -> Guard<S> {
        Guard { inner, revoked: self.revoked.clone() }
    }
}

/// Services with a guard before them.
#[derive(Clone)]
pub struct Guard<S> {
    inner: S,
    revoked: Revoked,
}

impl<S, B, R> Service<Request<B>> for Guard<S>
where
    S: Service<Request<B>, Response = Response<R>>,
    R: Default,
{
    type Response = S::Response;
    type Error = S::Error;
    type Future = Either<S::Future, Ready<Result<S::Response, S::Error>>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, request: Request<B>) -> Self::Future {
        let path = request.uri().path();
        let status = match request.extensions().get::<Peer>() {
            Some(peer) => {
                let is_revoked = |holder: &farm_trust::Holder| self.revoked.borrow().contains(&holder.token);
                match permit(&peer.standing, path, SystemTime::now(), is_revoked) {
                    Ok(()) => return Either::Left(self.inner.call(request)),
                    Err(refusal) => {
                        let (method, peer) = (shown(path), peer.address);
                        warn!(%peer, %method, reason = %refusal, "call refused");
                        status(&refusal)
                    }
                }
            }
            None => Status::internal("the connection does not say whose it is"),
        };
        Either::Right(ready(Ok(status.into_http())))
    }
}

/// A path in a log: whoever sent it chose it.
fn shown(path: &str) -> String {
    path.chars().take(80).flat_map(char::escape_default).collect()
}

fn status(refusal: &Refusal) -> Status {
    let reason = refusal.to_string();
    match refusal {
        Refusal::Role { .. } => Status::permission_denied(reason),
        Refusal::Stranger | Refusal::Expired | Refusal::Revoked(_) => Status::unauthenticated(reason),
    }
}
