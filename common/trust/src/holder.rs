//! What a certificate says of whoever shows it.

use crate::authority::CLOCKS_APART;
use crate::{Role, TokenId};
use rustls::pki_types::CertificateDer;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use x509_parser::prelude::{FromDer, GeneralName, X509Certificate};

/// The holder of a certificate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// What it is there for.
    pub role: Role,
    /// The token that its certificate goes back to.
    pub token: TokenId,
    /// When its certificate was made.
    pub issued: SystemTime,
    /// When its certificate ceases to be good.
    pub expires: SystemTime,
}

/// A certificate that is none of a farm's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the certificate does not say which role its holder has")]
pub struct HolderError;

/// Where a certificate says so: its only alternative name.
pub(crate) fn name(role: Role, token: TokenId) -> String {
    format!("tessera:{role}:{token}")
}

impl Holder {
    /// Reads a certificate. Whether it is genuine is for the handshake to find out.
    pub fn of(certificate: &CertificateDer<'_>) -> Result<Self, HolderError> {
        let (_, certificate) = X509Certificate::from_der(certificate).map_err(|_| HolderError)?;
        let names = certificate.subject_alternative_name().ok().flatten().ok_or(HolderError)?;
        let [GeneralName::URI(uri)] = names.value.general_names[..] else { return Err(HolderError) };
        let (role, token) =
            uri.strip_prefix("tessera:").and_then(|rest| rest.split_once(':')).ok_or(HolderError)?;
        let time = |seconds: i64| {
            let since = Duration::from_secs(u64::try_from(seconds).map_err(|_| HolderError)?);
            UNIX_EPOCH.checked_add(since).ok_or(HolderError)
        };
        let validity = certificate.validity();
        Ok(Self {
            role: role.parse().map_err(|_| HolderError)?,
            token: token.parse().map_err(|_| HolderError)?,
            issued: time(validity.not_before.timestamp())? + CLOCKS_APART,
            expires: time(validity.not_after.timestamp())?,
        })
    }

    /// When to ask for the next certificate: two thirds of this one's time are over.
    pub fn renew_at(&self) -> SystemTime {
        self.expires - self.expires.duration_since(self.issued).unwrap_or_default() / 3
    }
}

impl std::fmt::Display for Holder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} of token {}", self.role, self.token)
    }
}
