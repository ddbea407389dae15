//! The certificate of this program: taken from its file, got for a token, renewed in time.

use super::dial::{DialError, secure_channel};
use bytes::Bytes;
use farm_proto::ENROL_BYTES_MAX;
use farm_proto::v1::{self, enrolment_client::EnrolmentClient};
use farm_trust::{Fingerprint, Identity, Token, joining_config};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use tokio::sync::Mutex;
use tokio_rustls::rustls::ClientConfig;
use tonic::{Code, Status};
use tracing::{info, warn};

/// A certificate that lasts less than this is renewed.
const RENEW_BEFORE: Duration = Duration::from_secs(30 * 24 * 3600);

/// What this program shows to one farm.
pub struct Keys {
    fingerprint: Fingerprint,
    token: Option<Token>,
    path: Option<PathBuf>,
    identity: Mutex<Option<Identity>>,
}

impl std::fmt::Debug for Keys {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Keys({}, ..)", self.fingerprint)
    }
}

impl Keys {
    /// With an identity, or a token to get one.
    pub(super) fn new(
        fingerprint: Fingerprint,
        identity: Option<Identity>,
        token: Option<Token>,
        path: Option<PathBuf>,
    ) -> Self {
        Self { fingerprint, token, path, identity: Mutex::new(identity) }
    }

    /// How to connect, after whatever it takes to be known.
    pub(super) async fn config(&self, address: &str) -> Result<Arc<ClientConfig>, DialError> {
        let mut held = self.identity.lock().await;
        let fresh = match &*held {
            None => Some(self.join(address).await?),
            Some(identity) if lasts(identity) < RENEW_BEFORE => match renew(identity, address).await {
                Ok(fresh) => Some(fresh),
                Err(error) => {
                    warn!(%error, "the certificate could not be renewed; trying again with the next connection");
                    None
                }
            },
            Some(_) => None,
        };
        if let Some(fresh) = fresh {
            self.keep(&fresh);
            *held = Some(fresh);
        }
        let identity = held.as_ref().expect("there is one now");
        identity.client_config().map(Arc::new).map_err(|err| DialError::Refused(err.to_string()))
    }

    /// Exchanges the token for a certificate.
    async fn join(&self, address: &str) -> Result<Identity, DialError> {
        let config = joining_config(self.fingerprint).map_err(|err| DialError::Refused(err.to_string()))?;
        let token = self.token.as_ref().map(Token::text).unwrap_or_default();
        let identity = enrol(config, token, address).await?;
        if identity.fingerprint() != self.fingerprint {
            return Err(DialError::Refused("it answers for another farm".to_owned()));
        }
        info!(coordinator = %address, "joined the farm");
        Ok(identity)
    }

    /// A certificate that cannot be kept is good as long as this program runs.
    fn keep(&self, identity: &Identity) {
        let Some(path) = &self.path else { return };
        if let Err(error) = identity.save(path) {
            warn!(%error, "the certificate cannot be kept: after a restart it takes the token again");
        }
    }
}

fn lasts(identity: &Identity) -> Duration {
    let expires = identity.holder().map_or(SystemTime::UNIX_EPOCH, |holder| holder.expires);
    expires.duration_since(SystemTime::now()).unwrap_or_default()
}

/// Shows the certificate and asks for a fresh one.
async fn renew(identity: &Identity, address: &str) -> Result<Identity, DialError> {
    let config = identity.client_config().map_err(|err| DialError::Refused(err.to_string()))?;
    let fresh = enrol(config, String::new(), address).await?;
    info!("the certificate was renewed");
    Ok(fresh)
}

async fn enrol(config: ClientConfig, token: String, address: &str) -> Result<Identity, DialError> {
    let request = Identity::request().map_err(|err| DialError::Failed(err.to_string()))?;
    let channel = secure_channel(address, Arc::new(config)).await?;
    let signing_request = Bytes::copy_from_slice(request.der());
    let answer = EnrolmentClient::new(channel)
        .max_decoding_message_size(ENROL_BYTES_MAX)
        .enrol(v1::EnrolRequest { token, signing_request })
        .await
        .map_err(|status| refusal(&status))?
        .into_inner();
    Ok(request.answered(answer.certificate.to_vec().into(), answer.authority.to_vec().into()))
}

fn refusal(status: &Status) -> DialError {
    match status.code() {
        Code::Unauthenticated | Code::PermissionDenied | Code::InvalidArgument | Code::Unimplemented => {
            DialError::Refused(status.message().to_owned())
        }
        _ => DialError::Failed(super::dial::sentence(status)),
    }
}
