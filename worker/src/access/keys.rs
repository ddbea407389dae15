//! The certificate of this program: taken from its file, got for a token, renewed in time.

use super::dial::{DialError, secure_channel};
use bytes::Bytes;
use farm_proto::ENROL_BYTES_MAX;
use farm_proto::v1::{self, enrolment_client::EnrolmentClient};
use farm_trust::{Fingerprint, Holder, Identity, Token, joining_config};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Weak};
use std::time::{Duration, SystemTime};
use tokio::sync::Mutex;
use tokio_rustls::rustls::ClientConfig;
use tonic::{Code, Status};
use tracing::{info, warn};

/// Longest pause between looks at the certificate: hosts sleep, and clocks are set.
const LOOK_EVERY: Duration = Duration::from_secs(3600);

/// Shortest pause after a certificate could not be renewed.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// What this program shows to one farm.
pub struct Keys {
    fingerprint: Fingerprint,
    token: Option<Token>,
    path: Option<PathBuf>,
    identity: Mutex<Option<Identity>>,
    is_looked_after: AtomicBool,
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
        Self {
            fingerprint,
            token,
            path,
            identity: Mutex::new(identity),
            is_looked_after: AtomicBool::new(false),
        }
    }

    /// How to connect, after whatever it takes to be known. From then on the certificate is renewed in time, for as long as
    /// the keys are in use.
    pub(super) async fn config(self: &Arc<Self>, address: &str) -> Result<Arc<ClientConfig>, DialError> {
        let config = {
            let mut held = self.identity.lock().await;
            match &*held {
                Some(identity) if !is_expired(identity) => {}
                Some(identity) if self.token.is_none() => return Err(DialError::Refused(ran_out(identity))),
                _ => self.keep(&mut held, self.join(address).await?),
            }
            self.renew_if_due(&mut held, address).await;
            let identity = held.as_ref().expect("there is one now");
            identity.client_config().map_err(|err| DialError::Refused(err.to_string()))?
        };
        if !self.is_looked_after.swap(true, Ordering::Relaxed) {
            tokio::spawn(look_after(Arc::downgrade(self), address.to_owned()));
        }
        Ok(Arc::new(config))
    }

    /// Renews the certificate when it is time to; how long there is nothing more to do.
    async fn renew_if_due(&self, held: &mut Option<Identity>, address: &str) -> Duration {
        let Some(identity) = held else { return LOOK_EVERY };
        let wait = until(identity, Holder::renew_at);
        if !wait.is_zero() {
            return wait.min(LOOK_EVERY);
        }
        match renew(identity, address).await {
            Ok(fresh) => {
                let wait = until(&fresh, Holder::renew_at);
                self.keep(held, fresh);
                wait.clamp(RETRY_AFTER, LOOK_EVERY)
            }
            Err(error) => {
                warn!(%error, "the certificate could not be renewed; trying again before it runs out");
                (until(identity, |holder| holder.expires) / 8).clamp(RETRY_AFTER, LOOK_EVERY)
            }
        }
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

    /// A certificate that cannot be kept on disk is good as long as this program runs.
    fn keep(&self, held: &mut Option<Identity>, fresh: Identity) {
        if let Some(path) = &self.path
            && let Err(error) = fresh.save(path)
        {
            warn!(%error, "the certificate cannot be kept: after a restart it takes the token again");
        }
        *held = Some(fresh);
    }
}

/// Renews the certificate in time, connected or not.
async fn look_after(keys: Weak<Keys>, address: String) {
    let mut wait = Duration::ZERO;
    loop {
        tokio::time::sleep(wait).await;
        let Some(keys) = keys.upgrade() else { return };
        let mut held = keys.identity.lock().await;
        if held.as_ref().is_some_and(is_expired) {
            // The next connection says what to do.
            return keys.is_looked_after.store(false, Ordering::Relaxed);
        }
        wait = keys.renew_if_due(&mut held, &address).await;
    }
}

fn until(identity: &Identity, time: impl Fn(&Holder) -> SystemTime) -> Duration {
    let time = identity.holder().map_or(SystemTime::UNIX_EPOCH, |holder| time(&holder));
    time.duration_since(SystemTime::now()).unwrap_or_default()
}

pub(super) fn is_expired(identity: &Identity) -> bool {
    until(identity, |holder| holder.expires).is_zero()
}

/// What to do about a certificate that has expired.
pub(super) fn ran_out(identity: &Identity) -> String {
    let role = identity.holder().map_or("worker", |holder| holder.role.name());
    format!(
        "the certificate has expired: run coordinator token create --role {role} on the coordinator's host, and join again with what it prints"
    )
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
