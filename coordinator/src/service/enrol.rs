//! Takes newcomers in.

use super::guard::Revoked;
use super::policy::{Peer, Standing};
use bytes::Bytes;
use farm_proto::v1::{self, enrolment_server::Enrolment};
use farm_trust::{Authority, HOLDER_LIFETIME, Role, Token, TokenError, TokenId};
use std::sync::Arc;
use std::time::SystemTime;
use tonic::{Request, Response, Status};
use tracing::{error, info};

/// Exchanges tokens for certificates.
pub(super) struct EnrolmentService {
    pub authority: Arc<Authority>,
    pub revoked: Revoked,
}

#[tonic::async_trait]
impl Enrolment for EnrolmentService {
    async fn enrol(&self, request: Request<v1::EnrolRequest>) -> Result<Response<v1::EnrolResponse>, Status> {
        let peer = Peer::of(&request)?;
        let v1::EnrolRequest { token, signing_request } = request.into_inner();
        let authority = self.authority.clone();
        let renewed = match (&peer.standing, token.is_empty()) {
            (Standing::Known(holder), true) => Some((holder.role, holder.token)),
            _ => None,
        };
        let outcome = tokio::task::spawn_blocking(move || {
            let (role, token) = match renewed {
                Some(renewed) => renewed,
                None => redeem(&authority, &token)?,
            };
            let certificate = authority.certify(&signing_request, role, token, HOLDER_LIFETIME);
            let certificate = certificate.map_err(|err| Status::invalid_argument(err.to_string()))?;
            Ok::<_, Status>((role, token, certificate))
        });
        let outcome = outcome.await.map_err(|_| Status::unavailable("the coordinator is ending"))?;
        let (role, token, certificate) = outcome?;
        if self.revoked.borrow().contains(&token) {
            return Err(Status::unauthenticated(TokenError::Revoked(token).to_string()));
        }
        info!(peer = %peer.address, %role, %token, "certificate issued");
        Ok(Response::new(v1::EnrolResponse {
            certificate: Bytes::copy_from_slice(&certificate),
            authority: Bytes::copy_from_slice(self.authority.certificate()),
        }))
    }
}

fn redeem(authority: &Authority, text: &str) -> Result<(Role, TokenId), Status> {
    // What is no token is shown to nobody: it may be some other secret.
    let token: Token = text.parse().map_err(|_| Status::unauthenticated(TokenError::Unknown.to_string()))?;
    let role = authority.tokens().redeem(&token, SystemTime::now()).map_err(|error| match error {
        TokenError::Files(error) => {
            error!(%error, "tokens cannot be looked up");
            Status::unavailable("tokens cannot be looked up at present")
        }
        refused => Status::unauthenticated(refused.to_string()),
    })?;
    Ok((role, token.id))
}
