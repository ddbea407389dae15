//! How much a coordinator bears: simulated workers, each with a connection of its own, against a real `coordinator serve` that
//! acknowledges only what is durable. The renderer is replaced by a timer and a black tile.
//!
//! `cargo bench -p farm-tests --bench farm_load [WORKERS [UNITS_PER_SECOND [SECONDS [STORE_FOLDER]]]]`; 0 units per second: as
//! many as go through.

use farm_film::{Counters, FilmTile, Resolution};
use farm_image::{PartialHeader, encode_partial};
use farm_job::{Digest, JobSpec};
use farm_proto::PROTOCOL_VERSION;
use farm_proto::convert::{Grant, ToWorker};
use farm_proto::v1::worker_message::Message as Said;
use farm_proto::v1::{self, farm_client::FarmClient};
use farm_tests::programs::{Served, release_coordinator};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::Endpoint;

/// Side of a tile, so that units are small and many, and of the picture, in pixels.
const TILE: u64 = 16;
const PICTURE: u64 = 1024;

/// What workers say a unit took: so long that the scheduler makes units no larger.
const RENDER_SECONDS: f64 = 1.5;

/// Before anything is measured.
const WARM_UP: Duration = Duration::from_secs(5);

fn main() {
    let arguments: Vec<String> =
        std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let number = |index: usize, default: u64| {
        arguments.get(index).map_or(default, |text| text.parse().expect("a number"))
    };
    let (workers, rate, seconds) = (number(0, 1000), number(1, 0), number(2, 20));
    let folder = tempfile::tempdir().expect("a place for the store");
    let store = arguments.get(3).map_or_else(|| folder.path().join("store"), PathBuf::from);
    allow_connections();
    let coordinator = Served::start(&release_coordinator(), &store);
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("threads");
    runtime.block_on(measure(&coordinator, &store, workers, rate, Duration::from_secs(seconds)));
    runtime.shutdown_background();
}

/// Every worker is a connection, on both sides.
fn allow_connections() {
    let mut limit = rustix::process::getrlimit(rustix::process::Resource::Nofile);
    limit.current = limit.maximum;
    rustix::process::setrlimit(rustix::process::Resource::Nofile, limit).expect("the limit may be raised");
}

/// Seconds of processor time so far.
fn processor_seconds(process: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).expect("it lives");
    let fields: Vec<&str> = stat.rsplit(')').next().expect("a name").split_whitespace().collect();
    let ticks: u64 = fields[11..13].iter().map(|ticks| ticks.parse::<u64>().expect("a number")).sum();
    ticks as f64 / rustix::param::clock_ticks_per_second() as f64
}

/// Bytes of memory at present.
fn memory_bytes(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).expect("it lives");
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).expect("its memory");
    line.split_whitespace().nth(1).expect("a number").parse::<u64>().expect("a number") * 1024
}

/// Objects in the folder of a job's partials, and their bytes.
fn partials(store: &Path, job: u64) -> (usize, u64) {
    let folder = store.join(format!("jobs/{job}/partials/0"));
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    // Some of them may be gone by now.
    let sizes: Vec<u64> =
        entries.filter_map(|entry| entry.metadata().ok()).map(|about| about.len()).collect();
    (sizes.len(), sizes.iter().sum())
}

/// What all workers see together.
#[derive(Default)]
struct Seen {
    joined: AtomicU64,
    acknowledged: AtomicU64,
    rejected: AtomicU64,
    measuring: AtomicBool,
    /// From "result sent" to "next unit in hand", in microseconds.
    waits: Mutex<Vec<u32>>,
    /// From "result sent" to "acknowledged", in microseconds.
    acknowledgements: Mutex<Vec<u32>>,
}

async fn measure(coordinator: &Served, store: &Path, workers: u64, rate: u64, span: Duration) {
    let process = coordinator.id();
    // More units than can be done.
    let (resolution, tile) = (format!("{PICTURE}x{PICTURE}"), TILE.to_string());
    let size = ["--resolution", &resolution, "--spp", "1048576", "--tile", &tile];
    let job = coordinator.submit("cornell.gltf", &size);
    coordinator.ask(&["pause", &job.to_string()]);
    let empty = memory_bytes(process);
    let seen = Arc::new(Seen::default());
    let pause = (rate > 0).then(|| Duration::from_secs_f64(workers as f64 / rate as f64));
    for number in 0..workers {
        tokio::spawn(work(coordinator.address().to_owned(), number, job, pause, seen.clone()));
    }
    while seen.joined.load(Ordering::Relaxed) < workers {
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    tokio::time::sleep(WARM_UP).await;
    let idle = memory_bytes(process);
    coordinator.ask(&["resume", &job.to_string()]);
    tokio::time::sleep(WARM_UP).await;
    let (cpu, acknowledged, begun) =
        (processor_seconds(process), seen.acknowledged.load(Ordering::Relaxed), Instant::now());
    seen.measuring.store(true, Ordering::Relaxed);
    tokio::time::sleep(span).await;
    seen.measuring.store(false, Ordering::Relaxed);
    let units = seen.acknowledged.load(Ordering::Relaxed) - acknowledged;
    let (seconds, cpu) = (begun.elapsed().as_secs_f64(), processor_seconds(process) - cpu);
    println!("workers                  {workers}");
    println!("acknowledged             {:.0} units/s", units as f64 / seconds);
    println!("turned away              {}", seen.rejected.load(Ordering::Relaxed));
    println!(
        "processor time           {:.0} us per unit, {:.2} cores",
        cpu / units as f64 * 1e6,
        cpu / seconds
    );
    let (now, tiles) = (memory_bytes(process), (PICTURE / TILE).pow(2));
    let each = |more: u64, count: u64| more as f64 / 1024.0 / count as f64;
    println!("memory                   {} MB, {} MB before the workers came", now >> 20, empty >> 20);
    println!("memory per idle worker   {:.1} KB", each(idle.saturating_sub(empty), workers));
    println!(
        "memory per open tile     {:.1} KB, with all that is on its way",
        each(now - idle.min(now), tiles)
    );
    let (units, (objects, bytes)) = (seen.acknowledged.load(Ordering::Relaxed), partials(store, job));
    println!("partials in the store    {units} units in {objects} objects, {} MB", bytes >> 20);
    show("sent to next unit        ", &seen.waits);
    show("sent to acknowledged     ", &seen.acknowledgements);
}

fn show(what: &str, times: &Mutex<Vec<u32>>) {
    let mut times = times.lock().expect("nobody panics").clone();
    times.sort();
    let at = |part: f64| f64::from(times[((times.len() - 1) as f64 * part) as usize]) / 1e3;
    if !times.is_empty() {
        println!("{what}{:.2} ms median, {:.2} ms p99, {:.2} ms at most", at(0.5), at(0.99), at(1.0));
    }
}

/// One worker with one slot.
async fn work(address: String, number: u64, job: u64, pause: Option<Duration>, seen: Arc<Seen>) {
    // Not all in the same moment.
    tokio::time::sleep(Duration::from_millis(number)).await;
    let endpoint = Endpoint::from_shared(format!("http://{address}")).expect("an address").tcp_nodelay(true);
    let mut client = FarmClient::new(endpoint.connect().await.expect("the coordinator listens"));
    let spec = client.get_job(v1::GetJobRequest { job }).await.expect("the job is there").into_inner();
    let spec = JobSpec::try_from(spec).expect("it is a job");
    let (outgoing, messages) = mpsc::channel(64);
    let hello = v1::Hello {
        protocol: PROTOCOL_VERSION,
        name: format!("simulated-{number}"),
        slots: 1,
        fingerprint: farm_render::FINGERPRINT.to_owned(),
    };
    outgoing.send(v1::WorkerMessage { message: Some(Said::Hello(hello)) }).await.expect("there is room");
    let mut heard = client.work(ReceiverStream::new(messages)).await.expect("welcome").into_inner();
    let (granted, grants) = mpsc::unbounded_channel();
    let sent: Arc<Mutex<BTreeMap<u64, Option<Instant>>>> = Arc::default();
    tokio::spawn(render(spec, grants, outgoing, pause, sent.clone(), seen.clone()));
    while let Some(Ok(message)) = heard.next().await {
        match ToWorker::try_from(message).expect("the coordinator makes sense") {
            ToWorker::Welcome { worker, .. } => {
                seen.joined.fetch_add(1, Ordering::Relaxed);
                tokio::spawn(beat(client.clone(), worker.0, sent.clone()));
            }
            ToWorker::Grant(grant) => {
                sent.lock().expect("nobody panics").insert(grant.lease.0, None);
                let _ = granted.send(grant);
            }
            ToWorker::Ack(lease) => {
                seen.acknowledged.fetch_add(1, Ordering::Relaxed);
                let since = sent.lock().expect("nobody panics").remove(&lease.0).flatten();
                if let (Some(since), true) = (since, seen.measuring.load(Ordering::Relaxed)) {
                    note(&seen.acknowledgements, since.elapsed());
                }
            }
            ToWorker::Reject { lease, .. } => {
                seen.rejected.fetch_add(1, Ordering::Relaxed);
                sent.lock().expect("nobody panics").remove(&lease.0);
            }
            ToWorker::Revoke(lease) => drop(sent.lock().expect("nobody panics").remove(&lease.0)),
            ToWorker::Drained | ToWorker::Farewell(_) => return,
        }
    }
}

fn note(times: &Mutex<Vec<u32>>, time: Duration) {
    times.lock().expect("nobody panics").push(time.as_micros() as u32);
}

async fn beat(
    mut client: FarmClient<tonic::transport::Channel>,
    worker: u64,
    held: Arc<Mutex<BTreeMap<u64, Option<Instant>>>>,
) {
    loop {
        tokio::time::sleep(Duration::from_secs(1)).await;
        let leases = held.lock().expect("nobody panics").keys().copied().collect();
        if client.beat(v1::Heartbeat { worker, leases, round_trip_us: Some(1000) }).await.is_err() {
            return;
        }
    }
}

/// Delivers a black tile for every grant.
async fn render(
    spec: JobSpec,
    mut grants: mpsc::UnboundedReceiver<Grant>,
    outgoing: mpsc::Sender<v1::WorkerMessage>,
    pause: Option<Duration>,
    sent: Arc<Mutex<BTreeMap<u64, Option<Instant>>>>,
    seen: Arc<Seen>,
) {
    let mut last = None;
    while let Some(grant) = grants.recv().await {
        if let (Some(last), true) = (last, seen.measuring.load(Ordering::Relaxed)) {
            note(&seen.waits, Instant::duration_since(&Instant::now(), last));
        }
        if let Some(pause) = pause {
            tokio::time::sleep(pause).await;
        }
        let result = result(&spec, &grant);
        sent.lock().expect("nobody panics").insert(grant.lease.0, Some(Instant::now()));
        if outgoing.send(v1::WorkerMessage { message: Some(Said::Result(result)) }).await.is_err() {
            return;
        }
        last = Some(Instant::now());
    }
}

fn result(spec: &JobSpec, grant: &Grant) -> v1::Result {
    let unit = grant.unit;
    let samples = unit.tile.area() as u64 * unit.block.samples();
    let header = PartialHeader {
        resolution: Resolution::new(spec.settings.width, spec.settings.height).expect("a resolution"),
        frame: unit.frame,
        scene: spec.scene.0,
        settings: farm_scene::settings_digest(&spec.settings),
        seed: spec.settings.seed,
        renderer: farm_render::FINGERPRINT.to_owned(),
        counters: Counters { samples, ..Counters::default() },
    };
    let tile = FilmTile::new(unit.tile, unit.block, vec![[0.0; 3]; unit.tile.area()]);
    let partial_exr = encode_partial(&tile, &header);
    v1::Result {
        lease: grant.lease.0,
        job: grant.job.0,
        unit: Some(unit.into()),
        digest: Some(Digest(*blake3::hash(&partial_exr).as_bytes()).into()),
        partial_exr: partial_exr.into(),
        render_seconds: RENDER_SECONDS,
        cpu_seconds: RENDER_SECONDS,
        counters: Some(header.counters.into()),
    }
}
