//! What one shows to be recognised: a certificate, its key, and the authority that vouches for the other side.

use crate::files::{self, TrustError};
use crate::{Fingerprint, Holder, HolderError, tls};
use pem::Pem;
use rcgen::{CertificateParams, DnType, KeyPair};
use rustls::ClientConfig;
use rustls::pki_types::pem::{PemObject, SectionKind};
use rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer};
use std::path::Path;

/// A certificate with all that goes with it.
pub struct Identity {
    authority: CertificateDer<'static>,
    certificate: CertificateDer<'static>,
    key: PrivatePkcs8KeyDer<'static>,
}

/// A key pair that waits for its certificate.
pub struct Request {
    key: PrivatePkcs8KeyDer<'static>,
    der: Vec<u8>,
}

impl Identity {
    /// Makes a key pair, and a request to certify it. The key never leaves this host.
    pub fn request() -> Result<Request, TrustError> {
        let key = KeyPair::generate().map_err(TrustError::certificate)?;
        let mut params = CertificateParams::default();
        // The authority decides what it certifies; a name is only there because the form asks for one.
        params.distinguished_name.push(DnType::CommonName, "newcomer");
        let request = params.serialize_request(&key).map_err(TrustError::certificate)?;
        Ok(Request { key: PrivatePkcs8KeyDer::from(key.serialize_der()), der: request.der().to_vec() })
    }

    /// Reads an identity from its file; none when there is no such file.
    pub fn load(path: &Path) -> Result<Option<Self>, TrustError> {
        let Some(bytes) = files::read_secret(path)? else { return Ok(None) };
        Self::from_pem(&bytes).map(Some).map_err(|fault| TrustError::damaged(path, fault))
    }

    fn from_pem(bytes: &[u8]) -> Result<Self, String> {
        let (mut certificates, mut keys) = (Vec::new(), Vec::new());
        for section in <(SectionKind, Vec<u8>)>::pem_slice_iter(bytes) {
            match section.map_err(|err| format!("it is no PEM file: {err:?}"))? {
                (SectionKind::Certificate, der) => certificates.push(CertificateDer::from(der)),
                (SectionKind::PrivateKey, der) => keys.push(PrivatePkcs8KeyDer::from(der)),
                _ => {}
            }
        }
        let [certificate, authority] = <[_; 2]>::try_from(certificates)
            .map_err(|found| format!("it holds {} certificates instead of 2", found.len()))?;
        let [key] = <[_; 1]>::try_from(keys).map_err(|_| "it holds not exactly one key".to_owned())?;
        Ok(Self { authority, certificate, key })
    }

    /// Writes the identity to a file that only its owner may read; makes the folder if it is not there.
    pub fn save(&self, path: &Path) -> Result<(), TrustError> {
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            files::make_folder(folder)?;
        }
        let parts = [
            Pem::new("CERTIFICATE", self.certificate.to_vec()),
            Pem::new("CERTIFICATE", self.authority.to_vec()),
            Pem::new("PRIVATE KEY", self.key.secret_pkcs8_der()),
        ];
        files::write(path, pem::encode_many(&parts).as_bytes())
    }

    /// Of the authority that signed it.
    pub fn fingerprint(&self) -> Fingerprint {
        Fingerprint::of(&self.authority)
    }

    /// The certificate of the authority that signed it.
    pub fn authority(&self) -> &CertificateDer<'static> {
        &self.authority
    }

    /// What its certificate says.
    pub fn holder(&self) -> Result<Holder, HolderError> {
        Holder::of(&self.certificate)
    }

    /// How to connect to a coordinator of the same authority.
    pub fn client_config(&self) -> Result<ClientConfig, TrustError> {
        let key = PrivateKeyDer::Pkcs8(self.key.clone_key());
        tls::client_config(&self.authority, self.certificate.clone(), key).map_err(TrustError::certificate)
    }
}

impl std::fmt::Debug for Identity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Identity({:?}, ..)", self.holder())
    }
}

impl Request {
    /// As it is sent.
    pub fn der(&self) -> &[u8] {
        &self.der
    }

    /// With the authority's answer, an identity.
    pub fn answered(
        self,
        certificate: CertificateDer<'static>,
        authority: CertificateDer<'static>,
    ) -> Identity {
        Identity { authority, certificate, key: self.key }
    }
}
