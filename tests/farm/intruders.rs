//! Whoever has no business here is refused, with a line in the log; those who have are not disturbed.

use crate::closed::Closed;
use crate::harness::{Place, coordinator, render, run};
use bytes::Bytes;
use farm_proto::PROTOCOL_VERSION;
use farm_proto::v1::{
    self, control_client::ControlClient, enrolment_client::EnrolmentClient, farm_client::FarmClient,
    worker_message::Message,
};
use farm_trust::{Authority, Identity, Role, joining_config};
use prost::Message as _;
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tonic::body::Body;
use tonic::codegen::http;
use tonic::transport::Channel;
use tonic::{Code, Status};
use tower::Service;

const PICTURE: [&str; 6] = ["--resolution", "96x64", "--spp", "128", "--tile", "16"];

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
}

fn expect(status: &Status, code: Code, words: &str) {
    assert_eq!(status.code(), code, "{status:?}");
    assert!(status.message().contains(words), "{status:?}");
}

/// An identity put together from parts, as no honest program would.
fn assembled(place: &Place, name: &str, certificate: &str, authority: &str, key: &str) -> Identity {
    let path = place.path(name);
    let mut file = std::fs::OpenOptions::new().write(true).create_new(true).mode(0o600).open(&path).unwrap();
    write!(file, "{certificate}{authority}{key}").unwrap();
    Identity::load(&path).unwrap().unwrap()
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap()
}

/// An admin's certificate of this very farm, that was good some years ago.
fn expired(closed: &Closed) -> Identity {
    let trust = closed.place.path("trust");
    let (authority, authority_key) =
        (text(&trust.join("authority.pem")), text(&trust.join("authority-key.pem")));
    let key = rcgen::KeyPair::generate().unwrap();
    let mut params = rcgen::CertificateParams::default();
    params.subject_alt_names = vec![rcgen::SanType::URI("tessera:admin:000000000000".try_into().unwrap())];
    params.extended_key_usages = vec![rcgen::ExtendedKeyUsagePurpose::ClientAuth];
    (params.not_before, params.not_after) =
        (rcgen::date_time_ymd(2020, 1, 1), rcgen::date_time_ymd(2021, 1, 1));
    let issuer =
        rcgen::Issuer::from_ca_cert_pem(&authority, rcgen::KeyPair::from_pem(&authority_key).unwrap())
            .unwrap();
    let certificate = params.signed_by(&key, &issuer).unwrap();
    assembled(&closed.place, "expired.pem", &certificate.pem(), &authority, &key.serialize_pem())
}

/// An admin of another farm who knows this farm's authority, which is no secret.
fn of_another_farm(closed: &Closed) -> Identity {
    let other = Authority::open(&closed.place.path("other")).unwrap();
    let admin = text(&other.admin_path());
    let (certificate, rest) = admin.split_at(admin.find("-----END CERTIFICATE-----").unwrap() + 27);
    let key = &rest[rest.find("-----BEGIN PRIVATE KEY-----").unwrap()..];
    let authority = text(&closed.place.path("trust").join("authority.pem"));
    assembled(&closed.place, "other.pem", certificate, &authority, key)
}

fn submit(closed: &Closed) -> String {
    let scene = closed.place.scene();
    let mut what = vec!["submit", scene.to_str().unwrap()];
    what.extend(PICTURE);
    closed.ask(Role::Submitter, &what).json()["job"].to_string()
}

/// The job's picture is the one that a single process renders.
fn finished_unharmed(closed: &Closed, job: &str) {
    run(render(&closed.place, "alone.exr", &PICTURE)).json();
    let watched = closed.ask(Role::Submitter, &["watch", job]);
    assert!(watched.status.success(), "{}", watched.stderr);
    let fetched = closed.place.path("fetched.exr");
    closed.ask(Role::Submitter, &["fetch", job, "-o", fetched.to_str().unwrap()]).json();
    let mut compare = coordinator();
    compare.arg("compare").arg(&fetched).arg(closed.place.path("alone.exr")).arg("--json");
    assert_eq!(run(compare).json()["max_abs"], 0.0);
}

#[test]
fn whoever_has_no_good_certificate_is_refused_and_the_job_goes_on() {
    let mut closed = Closed::start();
    let job = submit(&closed);
    let mut friend = closed.worker(&closed.token(Role::Worker, None), "friend");
    closed.logged("name=friend");
    let status = v1::StatusRequest { job: None };
    runtime().block_on(async {
        // Without a certificate.
        let channel = closed.channel(joining_config(closed.fingerprint()).unwrap()).await.unwrap();
        let refused = ControlClient::new(channel.clone()).status(status).await.unwrap_err();
        expect(&refused, Code::Unauthenticated, "without a certificate");
        let refused = FarmClient::new(channel.clone()).work(tokio_stream::empty()).await.unwrap_err();
        expect(&refused, Code::Unauthenticated, "without a certificate");
        // With one that has expired, and with one of another farm.
        for identity in [expired(&closed), of_another_farm(&closed)] {
            let outcome = match closed.channel(identity.client_config().unwrap()).await {
                Ok(channel) => ControlClient::new(channel).status(status).await.map(drop).map_err(drop),
                Err(_) => Err(()),
            };
            assert_eq!(outcome, Err(()));
        }
        // With one for something else.
        let config = |role| closed.identity(role).0.client_config().unwrap();
        let worker = closed.channel(config(Role::Worker)).await.unwrap();
        let request = v1::JobRequest { job: job.parse().unwrap() };
        let refused = ControlClient::new(worker).cancel(request).await.unwrap_err();
        expect(&refused, Code::PermissionDenied, "for workers does not allow");
        let submitter = closed.channel(config(Role::Submitter)).await.unwrap();
        let refused = FarmClient::new(submitter.clone()).work(tokio_stream::empty()).await.unwrap_err();
        expect(&refused, Code::PermissionDenied, "for submitters does not allow");
        let refused = ControlClient::new(submitter).drain(v1::DrainRequest { worker: 1 }).await.unwrap_err();
        expect(&refused, Code::PermissionDenied, "takes one for admins");
    });
    for words in ["certificate expired", "BadSignature"] {
        closed.logged(words);
    }
    for words in [
        ["method=/farm.v1.Control/Status", "without a certificate"],
        ["method=/farm.v1.Farm/Work", "without a certificate"],
        ["method=/farm.v1.Control/Cancel", "for workers does not allow"],
        ["method=/farm.v1.Farm/Work", "for submitters does not allow"],
        ["method=/farm.v1.Control/Drain", "takes one for admins"],
    ] {
        closed.logged_line(&words);
    }
    // The programs say it too.
    let said = closed.ask(Role::Worker, &["cancel", &job]);
    assert_eq!(said.status.code(), Some(1));
    assert!(said.stderr.contains("for workers does not allow"), "{}", said.stderr);
    finished_unharmed(&closed, &job);
    assert!(friend.is_running() && closed.running.is_running());
}

/// What a stranger gets for a token and a signing request.
fn enrol(closed: &Closed, token: String, signing_request: Vec<u8>) -> Result<v1::EnrolResponse, Status> {
    let request = v1::EnrolRequest { token, signing_request: Bytes::from(signing_request) };
    runtime().block_on(async {
        let channel = closed.channel(joining_config(closed.fingerprint()).unwrap()).await.unwrap();
        EnrolmentClient::new(channel).enrol(request).await.map(tonic::Response::into_inner)
    })
}

#[test]
fn tokens_that_were_used_revoked_or_made_up_are_refused() {
    let mut closed = Closed::start();
    let (once, lasting) = (closed.token(Role::Worker, Some(1)), closed.token(Role::Worker, None));
    let made_up = Authority::open(&closed.place.path("other")).unwrap();
    let made_up =
        made_up.tokens().create(Role::Admin, std::time::SystemTime::now(), Duration::from_secs(60), None);
    let newcomer = || Identity::request().unwrap().der().to_vec();
    assert!(enrol(&closed, once.text(), newcomer()).is_ok());
    expect(&enrol(&closed, once.text(), newcomer()).unwrap_err(), Code::Unauthenticated, "was used before");
    expect(
        &enrol(&closed, made_up.unwrap().text(), newcomer()).unwrap_err(),
        Code::Unauthenticated,
        "not known here",
    );
    expect(
        &enrol(&closed, "password1".into(), newcomer()).unwrap_err(),
        Code::Unauthenticated,
        "not known here",
    );
    // Without a token there has to be a certificate.
    expect(&enrol(&closed, String::new(), newcomer()).unwrap_err(), Code::Unauthenticated, "not known here");
    expect(
        &enrol(&closed, lasting.text(), b"no request".to_vec()).unwrap_err(),
        Code::InvalidArgument,
        "certificate",
    );

    let victim = closed.worker(&lasting, "victim");
    closed.logged("name=victim");
    let mut revoke = coordinator();
    revoke.args(["token", "revoke", &lasting.id.to_string(), "--trust"]).arg(closed.place.path("trust"));
    assert!(run(revoke).status.success());
    let said = victim.wait();
    assert_eq!(said.status.code(), Some(1));
    assert!(said.stderr.contains(&format!("token {} was revoked", lasting.id)), "{}", said.stderr);
    expect(&enrol(&closed, lasting.text(), newcomer()).unwrap_err(), Code::Unauthenticated, "was revoked");
    for reason in ["was used before", "not known here", "was revoked", "no certificate can be made"] {
        closed.logged_line(&["method=/farm.v1.Enrolment/Enrol", reason]);
    }
    closed.logged_line(&["hanging up", "was revoked"]);
    assert!(closed.running.is_running());
}

#[test]
fn the_silent_and_the_slow_are_hung_up_on() {
    let mut closed = Closed::start();
    let job = submit(&closed);
    let mut friend = closed.worker(&closed.token(Role::Worker, None), "friend");
    let address = closed.address.clone();
    let begun = Instant::now();
    runtime().block_on(async {
        let mut silent = tokio::net::TcpStream::connect(&address).await.unwrap();
        let mut slow = tokio::net::TcpStream::connect(&address).await.unwrap();
        // TLS, but then nothing; and TLS, but then something else than HTTP/2.
        let mut mute = closed.line(joining_config(closed.fingerprint()).unwrap()).await.unwrap();
        let mut other = closed.line(joining_config(closed.fingerprint()).unwrap()).await.unwrap();
        other.write_all(b"GET / HTTP/1.1\r\n\r\n").await.unwrap();
        let dribble = async {
            // The beginning of a handshake, a byte a second.
            for byte in [22u8, 3, 1, 2, 0, 1, 0, 1, 252, 3, 3, 7, 7, 7, 7, 7, 7, 7, 7, 7] {
                if slow.write_all(&[byte]).await.is_err() {
                    break;
                }
                tokio::time::sleep(Duration::from_secs(1)).await;
            }
            hung_up(&mut slow).await;
        };
        tokio::join!(dribble, hung_up(&mut silent), hung_up(&mut mute), hung_up(&mut other));
    });
    assert!(begun.elapsed() < Duration::from_secs(60), "{:?}", begun.elapsed());
    for words in ["no handshake within 10 s", "it said nothing for 10 s", "what it says is no HTTP/2"] {
        closed.logged(words);
    }
    finished_unharmed(&closed, &job);
    assert!(friend.is_running() && closed.running.is_running());
}

/// Reads until the other side has had enough.
async fn hung_up(line: &mut (impl AsyncReadExt + Unpin)) {
    let mut buffer = [0; 1024];
    while !matches!(line.read(&mut buffer).await, Ok(0) | Err(_)) {}
}

/// A worker that introduces itself, and then begins a message that is larger than any can be.
async fn announce_two_gigabytes(mut line: Channel) {
    let hello = v1::Hello {
        protocol: PROTOCOL_VERSION,
        name: "liar".into(),
        slots: 1,
        fingerprint: farm_render::FINGERPRINT.to_owned(),
    };
    let hello = v1::WorkerMessage { message: Some(Message::Hello(hello)) }.encode_to_vec();
    // Before each message stand a flag and its length (gRPC over HTTP/2, "Length-Prefixed-Message").
    let mut body = vec![0];
    body.extend((hello.len() as u32).to_be_bytes());
    body.extend(hello);
    body.extend([0, 0x7f, 0x7f, 0x7f, 0x7f, 0x7f]);
    let request = http::Request::post("http://closed/farm.v1.Farm/Work")
        .header("content-type", "application/grpc")
        .header("te", "trailers")
        .body(Body::new(String::from_utf8(body).unwrap()))
        .unwrap();
    let answer = ready(&mut line).await.call(request).await.unwrap();
    assert!(answer.status().is_success());
}

async fn ready(line: &mut Channel) -> &mut Channel {
    std::future::poll_fn(|context| line.poll_ready(context)).await.unwrap();
    line
}

#[test]
fn garbage_floods_and_oversize_messages_harm_nobody() {
    let mut closed = Closed::start();
    let job = submit(&closed);
    let mut friend = closed.worker(&closed.token(Role::Worker, None), "friend");
    closed.logged("name=friend");
    runtime().block_on(async {
        let stranger = closed.channel(joining_config(closed.fingerprint()).unwrap()).await.unwrap();
        let request = v1::EnrolRequest { token: "x".repeat(1 << 20), signing_request: Bytes::new() };
        let refused = EnrolmentClient::new(stranger).enrol(request).await.unwrap_err();
        assert!(matches!(refused.code(), Code::OutOfRange | Code::ResourceExhausted), "{refused:?}");
        let submitter =
            closed.channel(closed.identity(Role::Submitter).0.client_config().unwrap()).await.unwrap();
        let spec = v1::JobSpec { name: "x".repeat(64 << 20), ..v1::JobSpec::default() };
        let refused = ControlClient::new(submitter).submit(v1::SubmitRequest { spec: Some(spec) }).await;
        assert!(matches!(
            refused.unwrap_err().code(),
            Code::OutOfRange | Code::ResourceExhausted | Code::Internal
        ));
        let liar = closed.channel(closed.identity(Role::Worker).0.client_config().unwrap()).await.unwrap();
        announce_two_gigabytes(liar).await;
    });
    for who in ["method=/farm.v1.Enrolment/Enrol", "method=/farm.v1.Control/Submit", "worker talks nonsense"]
    {
        closed.logged_line(&[who, "message length too large"]);
    }
    // Far more than one address may have; each says something that is no handshake.
    let mut lines: Vec<_> =
        (0..400).filter_map(|_| std::net::TcpStream::connect(&closed.address).ok()).collect();
    for (index, line) in lines.iter_mut().enumerate() {
        let garbage: Vec<u8> = (0..2_000u32).map(|byte| (byte * 31 + index as u32 * 7) as u8).collect();
        // The coordinator may hang up in between.
        let _ = line.write_all(&garbage);
    }
    closed.logged("no handshake");
    closed.logged("too many connections");
    drop(lines);
    // After some seconds, others from this address get in again.
    std::thread::sleep(Duration::from_secs(2));
    finished_unharmed(&closed, &job);
    assert!(friend.is_running() && closed.running.is_running());
}

#[test]
fn names_that_lead_elsewhere_lead_nowhere() {
    let mut closed = Closed::start();
    let (outside, scene) = (closed.place.path("secret.bin"), closed.place.path("deep/scene.gltf"));
    std::fs::write(&outside, [0; 64]).unwrap();
    std::fs::create_dir(closed.place.path("deep")).unwrap();
    for uri in ["../secret.bin", "%2e%2e/secret.bin", outside.to_str().unwrap(), "file:///etc/passwd"] {
        let json = serde_json::json!({
            "asset": {"version": "2.0"}, "buffers": [{"uri": uri, "byteLength": 64}], "nodes": [{}]
        });
        std::fs::write(&scene, json.to_string()).unwrap();
        let said = closed.ask(Role::Submitter, &["submit", scene.to_str().unwrap()]);
        assert_eq!(said.status.code(), Some(2));
        assert!(said.stderr.contains("only files in the scene's folder are read"), "{}", said.stderr);
    }
    // A job's name is shown and never a path; a scene's name is a digest and nothing else.
    let honest = closed.place.scene();
    let flags = ["--name", "../../../../escape", "--resolution", "8x8", "--spp", "16"];
    let mut what = vec!["submit", honest.to_str().unwrap()];
    what.extend(flags);
    let job = closed.ask(Role::Submitter, &what).json()["job"].to_string();
    let _friend = closed.worker(&closed.token(Role::Worker, None), "friend");
    assert!(closed.ask(Role::Submitter, &["watch", &job]).status.success());
    let fetched = closed.place.path("fetched.exr");
    closed.ask(Role::Submitter, &["fetch", &job, "-o", fetched.to_str().unwrap()]).json();
    assert!(!closed.place.files().iter().any(|name| name.contains("escape")));
    runtime().block_on(async {
        let submitter =
            closed.channel(closed.identity(Role::Submitter).0.client_config().unwrap()).await.unwrap();
        let digest = v1::Digest { blake3: Bytes::from_static(b"../../../../../../etc/passwd") };
        let request = v1::MissingScenesRequest { scenes: vec![digest] };
        let refused = ControlClient::new(submitter).missing_scenes(request).await.unwrap_err();
        expect(&refused, Code::InvalidArgument, "instead of 32");
    });
    closed.logged_line(&["method=/farm.v1.Control/MissingScenes", "instead of 32"]);
    assert!(closed.running.is_running());
}
