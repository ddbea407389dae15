//! The certificate that a coordinator answers with.

use crate::TrustError;
use crate::authority::{CLOCKS_APART, HOLDER_LIFETIME, leaf};
use crate::tls::{self, SERVER_NAME};
use rcgen::{ExtendedKeyUsagePurpose, Issuer, KeyPair, SanType};
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::{ClientHello, ResolvesServerCert};
use rustls::sign::CertifiedKey;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

/// Made anew, key and all, when two thirds of its time are over: looked at with each handshake, so that a coordinator may run,
/// or sleep, for longer than any certificate lasts.
pub(crate) struct OwnCertificate {
    issuer: Arc<Issuer<'static, KeyPair>>,
    authority: CertificateDer<'static>,
    held: Mutex<Held>,
}

struct Held {
    key: Arc<CertifiedKey>,
    issued: SystemTime,
}

impl OwnCertificate {
    /// Made at `now`.
    pub fn new(
        issuer: Arc<Issuer<'static, KeyPair>>,
        authority: CertificateDer<'static>,
        now: SystemTime,
    ) -> Result<Self, TrustError> {
        let held = Mutex::new(Held { key: make(&issuer, &authority, now)?, issued: now });
        Ok(Self { issuer, authority, held })
    }

    fn at(&self, now: SystemTime) -> Arc<CertifiedKey> {
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        if now >= held.issued + HOLDER_LIFETIME * 2 / 3
            && let Ok(key) = make(&self.issuer, &self.authority, now)
        {
            *held = Held { key, issued: now };
        }
        held.key.clone()
    }
}

fn make(
    issuer: &Issuer<'static, KeyPair>,
    authority: &CertificateDer<'static>,
    now: SystemTime,
) -> Result<Arc<CertifiedKey>, TrustError> {
    let key = KeyPair::generate().map_err(TrustError::certificate)?;
    let name = SanType::DnsName(SERVER_NAME.try_into().map_err(TrustError::certificate)?);
    let (from, lifetime) = (now - CLOCKS_APART, HOLDER_LIFETIME + CLOCKS_APART);
    let params = leaf("coordinator", name, ExtendedKeyUsagePurpose::ServerAuth, from, lifetime);
    let certificate = params.signed_by(&key, issuer).map_err(TrustError::certificate)?;
    let key = PrivateKeyDer::try_from(key.serialize_der()).map_err(TrustError::certificate)?;
    let chain = vec![certificate.der().clone(), authority.clone()];
    tls::certified_key(chain, key).map(Arc::new).map_err(TrustError::certificate)
}

impl ResolvesServerCert for OwnCertificate {
    fn resolve(&self, _: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        Some(self.at(SystemTime::now()))
    }
}

impl std::fmt::Debug for OwnCertificate {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("OwnCertificate")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, UNIX_EPOCH};
    use x509_parser::prelude::{FromDer, X509Certificate};

    const DAY: Duration = Duration::from_secs(24 * 3600);

    fn validity(key: &CertifiedKey) -> (SystemTime, SystemTime) {
        let (_, certificate) = X509Certificate::from_der(&key.cert[0]).unwrap();
        let time = |seconds: i64| UNIX_EPOCH + Duration::from_secs(seconds as u64);
        let validity = certificate.validity();
        (time(validity.not_before.timestamp()), time(validity.not_after.timestamp()))
    }

    #[test]
    fn a_coordinator_that_runs_for_years_never_shows_a_certificate_that_ran_out() {
        let key = KeyPair::generate().unwrap();
        let authority = rcgen::CertificateParams::default().self_signed(&key).unwrap();
        let issuer = Arc::new(Issuer::from_ca_cert_der(authority.der(), key).unwrap());
        let begun = SystemTime::now();
        let own = OwnCertificate::new(issuer, authority.der().clone(), begun).unwrap();
        let mut shown = vec![own.at(begun)];
        for day in 0..3 * 365 {
            let now = begun + day * DAY;
            let key = own.at(now);
            let (from, until) = validity(&key);
            assert!(from <= now && now + 29 * DAY < until, "day {day}");
            if !Arc::ptr_eq(&key, &shown[shown.len() - 1]) {
                shown.push(key);
            }
        }
        assert_eq!(shown.len(), 1 + (3 * 365 - 1) / 60, "a new one every 60 days");
    }
}
