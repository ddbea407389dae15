//! Stands before all services: a call that its caller may not make is answered before anything of it is read. Whatever is
//! refused, here or behind, has its line in the log.

use super::policy::{Peer, Refusal, permit};
use farm_trust::TokenId;
use std::collections::BTreeSet;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::SystemTime;
use tokio::sync::watch;
use tonic::codegen::http::{Request, Response};
use tonic::{Code, Status};
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
    S::Future: Send + 'static,
    R: Default,
{
    type Response = S::Response;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<S::Response, S::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, request: Request<B>) -> Self::Future {
        let method = shown(request.uri().path());
        let Some(peer) = request.extensions().get::<Peer>() else {
            let status = Status::internal("the connection does not say whose it is");
            return Box::pin(async move { Ok(status.into_http()) });
        };
        let is_revoked = |holder: &farm_trust::Holder| self.revoked.borrow().contains(&holder.token);
        let peer = peer.clone();
        match permit(&peer.standing, request.uri().path(), SystemTime::now(), is_revoked) {
            Ok(()) => {
                let answer = self.inner.call(request);
                Box::pin(async move {
                    let response = answer.await?;
                    if let Some(status) = Status::from_header_map(response.headers()) {
                        note(&peer, &method, &status);
                    }
                    Ok(response)
                })
            }
            Err(refusal) => {
                let status = status(&refusal);
                note(&peer, &method, &status);
                Box::pin(async move { Ok(status.into_http()) })
            }
        }
    }
}

/// One line for each call that is refused.
fn note(peer: &Peer, method: &str, status: &Status) {
    if is_refusal(status.code()) {
        warn!(peer = %peer.address, %method, reason = status.message(), "call refused");
    }
}

/// Whether the caller asked for what it may not have, or in a way that nobody may: other failures are told to the caller only.
pub(super) fn is_refusal(code: Code) -> bool {
    use Code::{
        Internal, InvalidArgument, OutOfRange, PermissionDenied, ResourceExhausted, Unauthenticated,
        Unimplemented,
    };
    matches!(
        code,
        Internal
            | InvalidArgument
            | OutOfRange
            | PermissionDenied
            | ResourceExhausted
            | Unauthenticated
            | Unimplemented
    )
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
