//! Keys and tokens stay where they are: in files and environments of their owners.

use crate::closed::Closed;
use crate::harness::{Running, coordinator};
use base64::Engine;
use base64::engine::general_purpose::{STANDARD, URL_SAFE_NO_PAD};
use farm_trust::{Role, Token};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::Duration;

/// All ways in which bytes get into a text: as they are sent, and as programs print bytes.
fn ways(secret: &[u8]) -> Vec<String> {
    let list = format!("{secret:?}");
    let hexadecimal = secret.iter().map(|byte| format!("{byte:02x}")).collect();
    vec![
        STANDARD.encode(secret),
        URL_SAFE_NO_PAD.encode(secret),
        list[1..list.len() - 1].to_owned(),
        hexadecimal,
        secret.escape_ascii().to_string(),
    ]
}

fn of_token(token: &Token) -> Vec<String> {
    ways(&URL_SAFE_NO_PAD.decode(&token.text()["tessera-0123456789ab-".len()..]).unwrap())
}

/// Of a file with a P-256 key: its private number (RFC 5915: 32 bytes after the version), and the lines that hold it.
fn of_key(file: &Path) -> Vec<String> {
    let pem = std::fs::read_to_string(file).unwrap();
    let body = pem.split("-----BEGIN PRIVATE KEY-----").nth(1).unwrap().split("-----").next().unwrap();
    let lines: Vec<_> = body.split_whitespace().collect();
    let der = STANDARD.decode(lines.concat()).unwrap();
    let at = der.windows(5).position(|bytes| bytes == [2, 1, 1, 4, 32]).unwrap() + 5;
    let mut texts = ways(&der[at..at + 32]);
    texts.extend(lines.iter().skip(1).map(|&line| line.to_owned()));
    texts
}

#[test]
fn secrets_are_in_no_log_and_no_argument() {
    // Whatever the programs and their libraries may say is said.
    let mut closed = Closed::start_logging("trace", &[]);
    let (token, filed) = (closed.token(Role::Worker, None), closed.token(Role::Worker, None));
    let file = closed.place.path("token");
    let mut options = std::fs::OpenOptions::new();
    std::io::Write::write_all(
        &mut options.write(true).create_new(true).mode(0o600).open(&file).unwrap(),
        filed.text().as_bytes(),
    )
    .unwrap();
    let mut command = closed.worker_command("friend");
    command.env("FARM_TOKEN", token.text()).env("FARM_LOG", "trace");
    let friend = Running::start(command);
    let mut command = closed.worker_command("other");
    command.arg("--token-file").arg(&file).env("FARM_LOG", "trace");
    let other = Running::start(command);
    for name in ["name=friend", "name=other"] {
        closed.logged(name);
    }
    let (_, submitter) = closed.identity_for(Role::Submitter, Duration::from_secs(3600), "artist");
    let mut command = coordinator();
    command.args(["submit", closed.place.scene().to_str().unwrap(), "--resolution", "16x10", "--spp", "16"]);
    command.args(["--to", &closed.address, "--identity"]).arg(&submitter).env("FARM_LOG", "trace");
    let submitting = Running::start(command);
    let mut seen = submitting.arguments();
    let said = submitting.wait();
    assert!(said.status.success(), "{}", said.stderr);
    seen += &(said.stdout + &said.stderr);
    assert!(closed.ask_with(&submitter, &["watch", "1"]).status.success());
    for running in [&closed.running, &friend, &other] {
        seen += &(running.arguments() + &running.stderr());
    }
    let trust = closed.place.path("trust");
    let keys = [trust.join("authority-key.pem"), trust.join("admin.pem"), submitter];
    let names = ["friend.pem", "other.pem"].map(|name| closed.place.path(name));
    let mut secrets = vec![("a token", of_token(&token)), ("a token of a file", of_token(&filed))];
    secrets.extend(keys.iter().chain(&names).map(|file| ("a private key", of_key(file))));
    for (what, texts) in &secrets {
        assert!(texts.iter().all(|text| text.len() >= 16 && !seen.contains(text)), "{what} is to be seen");
    }
    // The test does look where they would be.
    assert!(seen.contains("--token-file") && seen.contains("name=friend") && seen.contains("TRACE"));
    assert!(seen.contains(&token.id.to_string()), "a token is named where it matters");
}
