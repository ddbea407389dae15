//! How well a farm uses its workers: a real `coordinator serve`, and real workers of one thread each that speak gRPC with it.
//! Only rendering is replaced, by waiting, so that two cores are enough for sixteen workers. Tiles differ by a factor of four
//! in what they cost, as those of pictures do, and each unit by up to a tenth more or less, as no two blocks cost the same.
//!
//! `cargo bench -p farm-tests --bench farm_scaling [SECONDS]` prints a line per farm; a frame takes about so many seconds.

use farm_film::{FilmTile, WorkUnit};
use farm_image::encode_partial;
use farm_job::Digest;
use farm_proto::convert::UnitResult;
use farm_proto::v1::{self, control_client::ControlClient};
use farm_tests::programs::{Served, release_coordinator};
use farm_worker::access::Access;
use farm_worker::driver::{Config, run};
use farm_worker::link::Target;
use farm_worker::render_pool::{Assignment, Ended, MakePool, Pool};
use farm_worker::scene_cache::SceneCache;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, mpsc};
use std::time::{Duration, Instant};

const WORKERS: [usize; 4] = [2, 4, 8, 16];
const WIDTH: u32 = 320;
const HEIGHT: u32 = 192;
const TILE: u32 = 32;
const SPP: u64 = 1024;

/// Speeds of unequal workers, over and over: a laptop beside a workstation.
const UNEQUAL: [f64; 4] = [1.0, 4.0, 2.0, 0.5];

/// What tiles cost, one is the mean.
const COSTS: [f64; 6] = [0.5, 1.0, 2.0, 0.75, 1.25, 0.5];

fn main() {
    let seconds = std::env::args().skip(1).find_map(|argument| argument.parse().ok()).unwrap_or(60.0);
    let program = release_coordinator();
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("threads");
    for (name, speeds) in [("equal", &[1.0][..]), ("unequal", &UNEQUAL)] {
        // All farms at the same time: they hardly do anything.
        let farms = WORKERS.map(|workers| {
            let speeds = speeds.iter().copied().cycle().take(workers).collect();
            runtime.spawn(farm(program.clone(), speeds, seconds))
        });
        for (workers, farm) in WORKERS.into_iter().zip(farms) {
            let found = runtime.block_on(farm).expect("the farm finishes its frame");
            println!("{workers:2} {name} workers: {found}");
        }
    }
    runtime.shutdown_background();
}

/// What a worker did, or does.
struct Turn {
    worker: usize,
    unit: WorkUnit,
    begun: Instant,
    ended: Option<Instant>,
    /// False while it is under way, and where it was told to stop.
    is_whole: bool,
}

type Diary = Arc<Mutex<Vec<Turn>>>;

async fn farm(program: PathBuf, speeds: Vec<f64>, seconds: f64) -> String {
    let folder = tempfile::tempdir().expect("a place for the store");
    let served = Served::start(&program, &folder.path().join("store"));
    let job = submit(&served);
    let capacity: f64 = speeds.iter().sum();
    let tiles = (0..WIDTH / TILE).flat_map(|x| (0..HEIGHT / TILE).map(move |y| cost(x * TILE, y * TILE)));
    let work = tiles.sum::<f64>() * f64::from(TILE * TILE) * SPP as f64;
    let pace = seconds * capacity / work;
    let diary = Diary::default();
    let mut orders = Vec::new();
    for (index, speed) in speeds.iter().enumerate() {
        let config = Config {
            name: format!("worker-{index}"),
            threads: 1,
            pool: waiting(index, pace / speed, diary.clone()),
            scenes: Arc::new(SceneCache::new(None, None)),
            target: Target::Tcp(vec![served.address().to_owned()], Access::Plain),
            retry_for: Duration::from_secs(10),
        };
        let (sender, receiver) = tokio::sync::mpsc::channel(1);
        orders.push(sender);
        tokio::spawn(run(config, receiver));
    }
    watch(&served, job).await;
    let diary = diary.lock().expect("nothing panics in here");
    report(&diary, &speeds, pace)
}

fn submit(served: &Served) -> u64 {
    let resolution = format!("{WIDTH}x{HEIGHT}");
    let (tile, spp) = (TILE.to_string(), SPP.to_string());
    served.submit("cornell.gltf", &["--resolution", &resolution, "--spp", &spp, "--tile", &tile])
}

/// Waits until the job has ended.
async fn watch(served: &Served, job: u64) {
    let address = format!("http://{}", served.address());
    let mut client = ControlClient::connect(address).await.expect("the coordinator listens");
    let mut updates = client.watch(v1::WatchRequest { job }).await.expect("the job is there").into_inner();
    let mut last = None;
    while let Some(update) = updates.message().await.expect("the coordinator lives") {
        last = update.job;
    }
    assert_eq!(last.map(|job| job.state), Some(v1::JobState::Done.into()));
}

/// A worker of speed one takes `pace` seconds per sample of a tile that costs one.
fn report(diary: &[Turn], speeds: &[f64], pace: f64) -> String {
    // The first result of a unit counts.
    let mut useful: BTreeMap<WorkUnit, Instant> = BTreeMap::new();
    for turn in diary.iter().filter(|turn| turn.is_whole) {
        let ended = turn.ended.expect("what is whole has ended");
        useful.entry(turn.unit).and_modify(|first| *first = ended.min(*first)).or_insert(ended);
    }
    let begun = diary.iter().map(|turn| turn.begun).min().expect("somebody worked");
    let end = *useful.values().max().expect("somebody worked");
    // The tail begins when the first worker runs out of work. Who works at the end works until the end.
    let busy_until = |worker| {
        let turns = diary.iter().filter(|turn| turn.worker == worker);
        turns.map(|turn| turn.ended.map_or(end, |ended| ended.min(end))).max()
    };
    let first_idle = (0..speeds.len()).filter_map(busy_until).min().expect("somebody worked");
    let (wall, tail) = ((end - begun).as_secs_f64(), end.saturating_duration_since(first_idle).as_secs_f64());
    // So long it would have taken if everybody were busy with something useful from the first moment to the last.
    let ideal = useful.keys().map(work_of).sum::<f64>() * pace / speeds.iter().sum::<f64>();
    let (units, in_vain) = (useful.len(), diary.len() - useful.len());
    format!(
        "{wall:.2} s, {units} units, {in_vain} in vain; efficiency {:.2} % (target 95), tail {tail:.2} s: {:.2} % of the frame (target 2)",
        ideal / wall * 100.0,
        tail / wall * 100.0
    )
}

fn cost(x0: u32, y0: u32) -> f64 {
    COSTS[(x0 / TILE * 5 + y0 / TILE * 3) as usize % COSTS.len()]
}

/// A unit as pixel samples of a tile that costs one.
fn work_of(unit: &WorkUnit) -> f64 {
    let samples = unit.tile.area() as f64 * unit.block.samples() as f64;
    let chance = blake3::hash(unit.to_string().as_bytes()).as_bytes()[0];
    samples * cost(unit.tile.x0(), unit.tile.y0()) * (0.9 + 0.2 * f64::from(chance) / 255.0)
}

/// A pool of one slot that waits `pace` seconds per sample of a tile that costs one.
fn waiting(worker: usize, pace: f64, diary: Diary) -> MakePool {
    Arc::new(move |_, ended| {
        let (queue, assignments) = mpsc::channel::<Assignment>();
        let diary = diary.clone();
        std::thread::spawn(move || {
            for assignment in assignments {
                let (unit, begun) = (assignment.grant.unit, Instant::now());
                let turn = Turn { worker, unit, begun, ended: None, is_whole: false };
                let number = {
                    let mut diary = diary.lock().expect("nothing panics in here");
                    diary.push(turn);
                    diary.len() - 1
                };
                let end = wait(&assignment, pace);
                let turn = &mut diary.lock().expect("nothing panics in here")[number];
                turn.ended = Some(Instant::now());
                turn.is_whole = matches!(end, Ended::Rendered(_));
                if ended.send(end).is_err() {
                    return;
                }
            }
        });
        Ok(Box::new(Waiting(Mutex::new(queue))))
    })
}

struct Waiting(Mutex<mpsc::Sender<Assignment>>);

impl Pool for Waiting {
    fn push(&self, assignment: Assignment) {
        let _ = self.0.lock().expect("nothing panics in here").send(assignment);
    }
}

/// A white tile, after as long as it would take to render.
fn wait(assignment: &Assignment, pace: f64) -> Ended {
    let (grant, unit) = (&assignment.grant, assignment.grant.unit);
    let begun = Instant::now();
    let time = Duration::from_secs_f64(work_of(&unit) * pace);
    while begun.elapsed() < time {
        if assignment.stop.is_set() {
            return Ended::Stopped(grant.lease);
        }
        std::thread::sleep(time.saturating_sub(begun.elapsed()).min(Duration::from_millis(20)));
    }
    let tile = FilmTile::new(unit.tile, unit.block, vec![[1.0; 3]; unit.tile.area()]);
    let partial_exr = bytes::Bytes::from(encode_partial(&tile, &assignment.frame.header));
    Ended::Rendered(Box::new(UnitResult {
        lease: grant.lease,
        job: grant.job,
        unit,
        digest: Digest(*blake3::hash(&partial_exr).as_bytes()),
        partial_exr,
        render: begun.elapsed(),
        cpu: Duration::ZERO,
        counters: assignment.frame.header.counters,
    }))
}
