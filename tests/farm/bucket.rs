//! The store in a bucket: of a real S3 server, s3s-fs, which this test starts. It honours `If-None-Match: *`, though it looks and
//! then writes; between two coordinators that come seconds apart that is enough.

use crate::harness::{Place, Running, joining, run};
use crate::server::{PICTURE, Server};
use hyper_util::rt::{TokioExecutor, TokioIo};
use s3s::auth::SimpleAuth;
use s3s::service::S3ServiceBuilder;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tokio::net::TcpListener;

const ACCESS_KEY: &str = "tessera";
const SECRET_KEY: &str = "not-a-secret";
const STORE: &str = "s3://farm/pictures/tessera";

/// An S3 server over a folder of the test.
struct Bucket {
    address: String,
    /// While this is so, nobody is answered.
    silent: Arc<AtomicBool>,
    _runtime: tokio::runtime::Runtime,
}

impl Bucket {
    fn start(place: &Place) -> Self {
        let root = place.path("buckets");
        std::fs::create_dir_all(root.join("farm")).unwrap();
        let mut service = S3ServiceBuilder::new(s3s_fs::FileSystem::new(root).unwrap());
        service.set_auth(SimpleAuth::from_single(ACCESS_KEY, SECRET_KEY));
        let service = service.build();
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let listener = runtime.block_on(TcpListener::bind("127.0.0.1:0")).unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let silent = Arc::new(AtomicBool::new(false));
        let mute = silent.clone();
        runtime.spawn(async move {
            while let Ok((socket, _)) = listener.accept().await {
                if mute.load(Ordering::Relaxed) {
                    continue;
                }
                let (service, mute) = (service.clone(), mute.clone());
                tokio::spawn(async move {
                    let mut builder = hyper_util::server::conn::auto::Builder::new(TokioExecutor::new());
                    // A new connection for every request, each of which can be refused.
                    builder.http1().keep_alive(false);
                    let answer = builder.serve_connection(TokioIo::new(socket), service);
                    if !mute.load(Ordering::Relaxed) {
                        let _ = answer.await;
                    }
                });
            }
        });
        Self { address, silent, _runtime: runtime }
    }

    fn command(&self, listen: &str) -> Command {
        let mut command = Server::command(listen, STORE);
        command
            .env("AWS_ENDPOINT_URL", format!("http://{}", self.address))
            .env("AWS_ALLOW_HTTP", "true")
            .env("AWS_REGION", "us-east-1")
            .env("AWS_ACCESS_KEY_ID", ACCESS_KEY)
            .env("AWS_SECRET_ACCESS_KEY", SECRET_KEY);
        command
    }
}

/// How many objects there are in folders of a name, wherever they are.
fn objects(within: &Path, folder: &str) -> usize {
    let entries = std::fs::read_dir(within).into_iter().flatten().flatten().map(|entry| entry.path());
    let one = |path: PathBuf| match (path.is_dir(), path.ends_with(folder)) {
        (true, true) => files(&path),
        (true, false) => objects(&path, folder),
        (false, _) => 0,
    };
    entries.map(one).sum()
}

/// How many files there are in a folder and below.
fn files(folder: &Path) -> usize {
    let paths = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    paths.map(|path| if path.is_dir() { files(&path) } else { 1 }).sum()
}

#[test]
fn a_bucket_keeps_a_farm() {
    let place = Place::new();
    let bucket = Bucket::start(&place);
    let mut first = Server::from_command(bucket.command("127.0.0.1:0"));
    let address = first.address.clone();
    let job = first.submit(&place, &PICTURE);

    // One at a time.
    let said = run(bucket.command("127.0.0.1:0"));
    assert_eq!(said.status.code(), Some(1));
    assert!(said.stderr.contains("in use by another coordinator"), "{}", said.stderr);

    // The worker joins only now, so that most of the job is still ahead when the bucket goes away.
    let mut worker = joining(&address, "loyal");
    let done = first.wait_for_more(&job, 0);

    // Killed, and waited for: of a bucket's coordinator nobody but its silence tells that it is dead.
    first.running.kill();
    let second = Server::from_command(bucket.command(&address));
    assert!(second.running.stderr().contains("no sign of life"));
    let done = second.wait_for_more(&job, done);

    // Gone for a while.
    bucket.silent.store(true, Ordering::Relaxed);
    let held = second.wait_until(&job, "a pause", |status| status["state"] == "paused");
    assert!(held["reason"].as_str().unwrap().contains("waits for the store"), "{held}");
    assert!(held["samples_done"].as_u64().unwrap() >= done);
    bucket.silent.store(false, Ordering::Relaxed);
    assert_eq!(second.difference(&place, &job), 0.0);
    assert!(worker.is_running());

    // One that leaves of its own accord need not be waited for.
    second.running.terminate();
    assert!(second.running.wait().status.success());
    let mut command = bucket.command(&address);
    command.args(["--keep-uploads", "1s"]);
    let mut third = Server::once_it_listens(Running::start(command));
    assert!(third.running.stderr().contains("it has ended"), "{}", third.running.stderr());
    assert_eq!(third.status(&job)["state"], "done");

    // What nobody needs any more goes from a bucket, too.
    let objects = |kind: &str| objects(&place.path("buckets"), kind);
    assert_eq!((objects("partials"), objects("frames"), objects("scenes")), (0, 1, 1));
    assert!(third.ask(&["forget", &job]).status.success());
    assert_eq!((objects("frames"), objects("state")), (0, 0));
    third.running.wait_for("a line in the log", |said| said.contains("no job refers to them").then_some(()));
    assert_eq!((objects("scenes"), objects("pieces")), (0, 0));
}
