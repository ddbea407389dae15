use super::*;
use crate::{Holder, SERVER_NAME, joining_config};
use rustls::pki_types::{PrivateKeyDer, ServerName};
use rustls::sign::SingleCertAndKey;
use rustls::{ClientConfig, ClientConnection, ServerConnection};
use std::sync::Arc;

fn authority() -> (tempfile::TempDir, Authority) {
    let folder = tempfile::tempdir().unwrap();
    let authority = Authority::open(&folder.path().join("trust")).unwrap();
    (folder, authority)
}

fn identity(
    authority: &Authority,
    role: Role,
    token: TokenId,
    from: SystemTime,
    lifetime: Duration,
) -> Identity {
    let request = Identity::request().unwrap();
    let certificate = authority.certify_from(request.der(), role, token, from, lifetime).unwrap();
    request.answered(certificate, authority.certificate().clone())
}

fn worker(authority: &Authority) -> Identity {
    identity(authority, Role::Worker, TokenId::random(), SystemTime::now() - DAY, DAY * 2)
}

/// Both sides in memory; what the server learns of the client, or the first fault of either side.
fn handshake(server: ServerConfig, client: ClientConfig) -> Result<Option<Holder>, rustls::Error> {
    let name = ServerName::try_from(SERVER_NAME).unwrap();
    let mut client = ClientConnection::new(Arc::new(client), name)?;
    let mut server = ServerConnection::new(Arc::new(server))?;
    while client.is_handshaking() || server.is_handshaking() {
        let mut wire = Vec::new();
        client.write_tls(&mut wire).unwrap();
        server.read_tls(&mut wire.as_slice()).unwrap();
        server.process_new_packets()?;
        let mut wire = Vec::new();
        server.write_tls(&mut wire).unwrap();
        client.read_tls(&mut wire.as_slice()).unwrap();
        client.process_new_packets()?;
    }
    Ok(server.peer_certificates().map(|chain| Holder::of(&chain[0]).unwrap()))
}

#[test]
fn a_certificate_names_role_and_token() {
    let (_folder, authority) = authority();
    let token = TokenId::random();
    let identity = identity(&authority, Role::Submitter, token, SystemTime::now(), DAY);
    let holder =
        handshake(authority.server_config().unwrap(), identity.client_config().unwrap()).unwrap().unwrap();
    assert_eq!((holder.role, holder.token), (Role::Submitter, token));
    assert!(holder.expires > SystemTime::now() && holder.expires < SystemTime::now() + DAY);
}

#[test]
fn a_certificate_is_renewed_after_two_thirds_of_its_time() {
    let (_folder, authority) = authority();
    let request = Identity::request().unwrap();
    let lifetime = Duration::from_secs(90);
    let certificate = authority.certify(request.der(), Role::Worker, TokenId::LOCAL, lifetime).unwrap();
    let holder = Holder::of(&certificate).unwrap();
    assert_eq!(holder.expires, holder.issued + lifetime);
    assert_eq!(holder.renew_at(), holder.issued + lifetime * 2 / 3);
    let age = SystemTime::now().duration_since(holder.issued).unwrap();
    assert!(age < Duration::from_secs(60), "{age:?}");
}

#[test]
fn the_admins_identity_is_renewed_in_time() {
    let (_folder, authority) = authority();
    let expires = || Identity::load(&authority.admin_path()).unwrap().unwrap().holder().unwrap().expires;
    let first = expires();
    authority.keep_admin().unwrap();
    assert_eq!(expires(), first, "there is no hurry");
    let from = SystemTime::now() - HOLDER_LIFETIME * 2 / 3 - CLOCKS_APART;
    let old = identity(&authority, Role::Admin, TokenId::LOCAL, from, HOLDER_LIFETIME + CLOCKS_APART);
    old.save(&authority.admin_path()).unwrap();
    authority.keep_admin().unwrap();
    assert!(expires() >= first);
}

#[test]
fn a_newcomer_recognises_the_farm_by_its_fingerprint() {
    let (_folder, authority) = authority();
    let client = joining_config(authority.fingerprint()).unwrap();
    assert_eq!(handshake(authority.server_config().unwrap(), client).unwrap(), None);
    let (_other_folder, other) = self::authority();
    let fault = handshake(other.server_config().unwrap(), joining_config(authority.fingerprint()).unwrap());
    assert!(fault.unwrap_err().to_string().contains("another fingerprint"));
}

#[test]
fn certificates_of_another_farm_or_time_are_refused() {
    let (_folder, authority) = authority();
    let (_other_folder, other) = self::authority();
    // A client of another farm does not even accept the server; one that does, is not accepted.
    let stranger = worker(&other);
    assert!(handshake(authority.server_config().unwrap(), stranger.client_config().unwrap()).is_err());
    let forged = Identity::request().unwrap();
    let certificate = other.certify(forged.der(), Role::Admin, TokenId::LOCAL, DAY).unwrap();
    let forged = forged.answered(certificate, authority.certificate().clone());
    let fault = handshake(authority.server_config().unwrap(), forged.client_config().unwrap()).unwrap_err();
    assert!(matches!(fault, rustls::Error::InvalidCertificate(_)), "{fault}");
    for from in [SystemTime::now() - 2 * DAY, SystemTime::now() + DAY / 2] {
        let badly_timed = identity(&authority, Role::Worker, TokenId::random(), from, DAY);
        let fault = handshake(authority.server_config().unwrap(), badly_timed.client_config().unwrap());
        assert!(matches!(fault, Err(rustls::Error::InvalidCertificate(_))), "{fault:?}");
    }
}

#[test]
fn the_certificate_of_a_client_makes_no_server() {
    let (_folder, authority) = authority();
    let worker = worker(&authority);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("worker.pem");
    worker.save(&path).unwrap();
    let pem = std::fs::read(&path).unwrap();
    let chain: Vec<_> = CertificateDer::pem_slice_iter(&pem).map(Result::unwrap).collect();
    let shown = tls::certified_key(chain, PrivateKeyDer::from_pem_slice(&pem).unwrap()).unwrap();
    let impostor =
        tls::server_config(authority.certificate(), Arc::new(SingleCertAndKey::from(shown))).unwrap();
    assert!(handshake(impostor, joining_config(authority.fingerprint()).unwrap()).is_err());
}

#[test]
fn a_request_gets_what_the_authority_says_and_not_what_it_asks_for() {
    let (_folder, authority) = authority();
    let key = KeyPair::generate().unwrap();
    let mut params = CertificateParams::default();
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
    params.subject_alt_names =
        vec![SanType::URI(holder::name(Role::Admin, TokenId::LOCAL).as_str().try_into().unwrap())];
    let request = params.serialize_request(&key).unwrap();
    let token = TokenId::random();
    let certificate = authority.certify(request.der(), Role::Worker, token, DAY).unwrap();
    let holder = Holder::of(&certificate).unwrap();
    assert_eq!((holder.role, holder.token), (Role::Worker, token));
    // Signed with another key than it is for, cut, or nonsense.
    let mut forged = request.der().to_vec();
    let last = forged.len() - 1;
    forged[last] ^= 1;
    for wrong in [&forged[..], &request.der()[..40], b"", &[0x30; 20_000]] {
        assert!(authority.certify(wrong, Role::Worker, token, DAY).is_err());
    }
}

#[test]
fn an_authority_is_found_again_and_its_key_is_nobodys_business() {
    use std::os::unix::fs::PermissionsExt;
    let (folder, first) = authority();
    let trust = folder.path().join("trust");
    for name in ["authority-key.pem", "admin.pem"] {
        assert_eq!(
            std::fs::metadata(trust.join(name)).unwrap().permissions().mode() & 0o777,
            0o600,
            "{name}"
        );
    }
    let worker = worker(&first);
    let again = Authority::open(&trust).unwrap();
    assert_eq!(again.fingerprint(), first.fingerprint());
    assert!(handshake(again.server_config().unwrap(), worker.client_config().unwrap()).unwrap().is_some());
    let admin = Identity::load(&again.admin_path()).unwrap().unwrap();
    let holder = handshake(again.server_config().unwrap(), admin.client_config().unwrap()).unwrap().unwrap();
    assert_eq!(holder.role, Role::Admin);
    std::fs::set_permissions(trust.join("authority-key.pem"), std::fs::Permissions::from_mode(0o644))
        .unwrap();
    assert!(Authority::open(&trust).unwrap_err().to_string().contains("chmod 600"));
    std::fs::remove_file(trust.join("authority-key.pem")).unwrap();
    assert!(Authority::open(&trust).unwrap_err().to_string().contains("is missing"));
}

#[test]
fn damaged_certificates_and_identities_are_sentences() {
    let (folder, authority) = authority();
    let whole =
        authority.certify(Identity::request().unwrap().der(), Role::Worker, TokenId::LOCAL, DAY).unwrap();
    for cut in 0..whole.len() {
        let _ = Holder::of(&CertificateDer::from(whole[..cut].to_vec()));
        let mut changed = whole.to_vec();
        changed[cut] ^= 0x55;
        let _ = Holder::of(&CertificateDer::from(changed));
    }
    let path = folder.path().join("identity.pem");
    files::write(&path, b"no identity").unwrap();
    assert!(Identity::load(&path).unwrap_err().to_string().contains("0 certificates"));
    assert!(Identity::load(&folder.path().join("none")).unwrap().is_none());
}
