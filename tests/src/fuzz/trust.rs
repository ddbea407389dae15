//! What strangers show: tokens, signing requests, certificates, and files of them.

use farm_trust::{Authority, Fingerprint, Holder, Identity, Role, Token, TokenId};
use std::path::Path;
use std::sync::LazyLock;
use std::time::Duration;

const LIFETIME: Duration = Duration::from_secs(3600);

/// One for all inputs; its folder goes with the program.
static AUTHORITY: LazyLock<(tempfile::TempDir, Authority)> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("a folder for temporary files");
    let authority = Authority::open(folder.path()).expect("an authority");
    (folder, authority)
});

pub(super) fn corpus() -> Vec<Vec<u8>> {
    let authority = &AUTHORITY.1;
    let request = Identity::request().expect("a request");
    let certificate =
        authority.certify(request.der(), Role::Worker, TokenId::LOCAL, LIFETIME).expect("a certificate");
    let token = "tessera-0123456789ab-AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA";
    let identity = std::fs::read(authority.admin_path()).expect("an identity");
    vec![
        request.der().to_vec(),
        certificate.to_vec(),
        identity,
        token.as_bytes().to_vec(),
        authority.fingerprint().to_string().into_bytes(),
    ]
}

pub(super) fn decode(bytes: &[u8], file: &Path) -> bool {
    let text = std::str::from_utf8(bytes).unwrap_or_default();
    let certified = AUTHORITY.1.certify(bytes, Role::Worker, TokenId::LOCAL, LIFETIME).is_ok();
    let held = Holder::of(&bytes.to_vec().into()).is_ok();
    let read = text.parse::<Token>().is_ok() || text.parse::<Fingerprint>().is_ok();
    write_private(file, bytes);
    certified || held || read || Identity::load(file).is_ok_and(|identity| identity.is_some())
}

fn write_private(file: &Path, bytes: &[u8]) {
    use std::os::unix::fs::PermissionsExt;
    std::fs::write(file, bytes).expect("a temporary file");
    std::fs::set_permissions(file, std::fs::Permissions::from_mode(0o600)).expect("its permissions");
}
