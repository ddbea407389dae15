//! The farm's own certificate authority.

use crate::files::{self, TrustError};
use crate::holder;
use crate::own_certificate::OwnCertificate;
use crate::tls;
use crate::{Fingerprint, Identity, Role, TokenBook, TokenId};
use rcgen::{
    BasicConstraints, CertificateParams, CertificateSigningRequestParams, DnType, ExtendedKeyUsagePurpose,
    IsCa, Issuer, KeyPair, KeyUsagePurpose, SanType, SerialNumber,
};
use rustls::ServerConfig;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, CertificateSigningRequestDer};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

const DAY: Duration = Duration::from_secs(24 * 3600);

/// Clocks of a farm's hosts may be apart by this much.
pub(crate) const CLOCKS_APART: Duration = DAY;

/// A farm outlives its hosts.
const AUTHORITY_LIFETIME: Duration = DAY.saturating_mul(3650);

/// How long a certificate is good; it is renewed long before, by whoever still uses it.
pub const HOLDER_LIFETIME: Duration = DAY.saturating_mul(90);

/// Longest request that is looked at: a key and a signature take a few hundred bytes.
const REQUEST_BYTES_MAX: usize = 16 << 10;

/// Signs certificates for a farm.
pub struct Authority {
    folder: PathBuf,
    certificate: CertificateDer<'static>,
    issuer: Arc<Issuer<'static, KeyPair>>,
    tokens: TokenBook,
}

impl Authority {
    /// The authority that lives in `folder`; makes one at first.
    pub fn open(folder: &Path) -> Result<Self, TrustError> {
        files::make_folder(folder)?;
        let (key_path, certificate_path) = (folder.join("authority-key.pem"), folder.join("authority.pem"));
        let (key, certificate) = match (files::read_secret(&key_path)?, files::read(&certificate_path)?) {
            (Some(key), Some(certificate)) => {
                let key = String::from_utf8(key).map_err(|err| TrustError::damaged(&key_path, err))?;
                let key = KeyPair::from_pem(&key).map_err(|err| TrustError::damaged(&key_path, err))?;
                let certificate = CertificateDer::from_pem_slice(&certificate)
                    .map_err(|err| TrustError::damaged(&certificate_path, err))?;
                (key, certificate)
            }
            (None, None) => {
                let (key, certificate) = make_authority().map_err(TrustError::certificate)?;
                files::write(&key_path, key.serialize_pem().as_bytes())?;
                files::write(&certificate_path, certificate.pem().as_bytes())?;
                (key, certificate.der().clone())
            }
            (Some(_), None) => {
                return Err(TrustError::damaged(&certificate_path, "it is missing beside its key"));
            }
            (None, Some(_)) => {
                return Err(TrustError::damaged(&key_path, "it is missing beside its certificate"));
            }
        };
        let issuer = Issuer::from_ca_cert_der(&certificate, key)
            .map_err(|err| TrustError::damaged(&certificate_path, err))?;
        let tokens = TokenBook::open(&folder.join("tokens"))?;
        let authority = Self { folder: folder.to_owned(), certificate, issuer: Arc::new(issuer), tokens };
        authority.keep_admin()?;
        Ok(authority)
    }

    /// By which a newcomer recognises the farm.
    pub fn fingerprint(&self) -> Fingerprint {
        Fingerprint::of(&self.certificate)
    }

    /// The certificate that all others are signed with.
    pub fn certificate(&self) -> &CertificateDer<'static> {
        &self.certificate
    }

    /// The tokens that it knows.
    pub fn tokens(&self) -> &TokenBook {
        &self.tokens
    }

    /// An identity for whoever may read the authority's folder: may do everything.
    pub fn admin_path(&self) -> PathBuf {
        self.folder.join("admin.pem")
    }

    /// Remembers where its coordinator is reached.
    pub fn note_address(&self, address: &str) -> Result<(), TrustError> {
        files::write(&self.folder.join("address"), address.as_bytes())
    }

    /// Where its coordinator was reached last.
    pub fn address(&self) -> Option<String> {
        String::from_utf8(files::read(&self.folder.join("address")).ok()??).ok()
    }

    /// Certifies the key of a signing request for `lifetime` from now on, and nothing else of what the request asks for.
    ///
    /// # Errors
    /// When it is no request, or not signed with the key that it is for.
    pub fn certify(
        &self,
        request: &[u8],
        role: Role,
        token: TokenId,
        lifetime: Duration,
    ) -> Result<CertificateDer<'static>, TrustError> {
        self.certify_from(request, role, token, SystemTime::now() - CLOCKS_APART, lifetime + CLOCKS_APART)
    }

    fn certify_from(
        &self,
        request: &[u8],
        role: Role,
        token: TokenId,
        from: SystemTime,
        lifetime: Duration,
    ) -> Result<CertificateDer<'static>, TrustError> {
        if request.len() > REQUEST_BYTES_MAX {
            return Err(TrustError::certificate("the signing request is too long"));
        }
        let request = CertificateSigningRequestDer::from(request);
        let mut request =
            CertificateSigningRequestParams::from_der(&request).map_err(TrustError::certificate)?;
        let name = holder::name(role, token);
        let uri = SanType::URI(name.as_str().try_into().map_err(TrustError::certificate)?);
        request.params = leaf(role.name(), uri, ExtendedKeyUsagePurpose::ClientAuth, from, lifetime);
        let certificate = request.signed_by(self.issuer.as_ref()).map_err(TrustError::certificate)?;
        Ok(certificate.der().clone())
    }

    /// How a coordinator answers, however long it runs. Newcomers without a certificate get through the handshake; what they
    /// may ask is for the coordinator to say.
    pub fn server_config(&self) -> Result<ServerConfig, TrustError> {
        let own = OwnCertificate::new(self.issuer.clone(), self.certificate.clone(), SystemTime::now())?;
        tls::server_config(&self.certificate, Arc::new(own)).map_err(TrustError::certificate)
    }

    /// Sees to it that the identity of [`Authority::admin_path`] is there, and good for a while.
    pub fn keep_admin(&self) -> Result<(), TrustError> {
        let path = self.admin_path();
        let good = Identity::load(&path)?.is_some_and(|identity| {
            identity.holder().is_ok_and(|holder| SystemTime::now() < holder.renew_at())
                && identity.authority() == &self.certificate
        });
        if good {
            return Ok(());
        }
        let request = Identity::request()?;
        let certificate = self.certify(request.der(), Role::Admin, TokenId::LOCAL, HOLDER_LIFETIME)?;
        request.answered(certificate, self.certificate.clone()).save(&path)
    }
}

impl std::fmt::Debug for Authority {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Authority({})", self.fingerprint())
    }
}

fn make_authority() -> Result<(KeyPair, rcgen::Certificate), rcgen::Error> {
    let key = KeyPair::generate()?;
    let mut params = CertificateParams::default();
    params.distinguished_name.push(DnType::CommonName, "Tessera farm");
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    let from = SystemTime::now() - CLOCKS_APART;
    params.not_before = from.into();
    params.not_after = (from + AUTHORITY_LIFETIME).into();
    let certificate = params.self_signed(&key)?;
    Ok((key, certificate))
}

/// What is certified of anybody but the authority itself.
pub(crate) fn leaf(
    common_name: &str,
    name: SanType,
    purpose: ExtendedKeyUsagePurpose,
    from: SystemTime,
    lifetime: Duration,
) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name.push(DnType::CommonName, common_name);
    params.subject_alt_names = vec![name];
    params.is_ca = IsCa::ExplicitNoCa;
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![purpose];
    params.serial_number = Some(SerialNumber::from_slice(&crate::token::random::<16>()));
    params.not_before = from.into();
    params.not_after = (from + lifetime).into();
    params
}

#[cfg(test)]
#[path = "authority_tests.rs"]
mod tests;
