//! One job from the command line to its pictures.

use super::judge::JudgeArgs;
use super::listen::{SecurityArgs, announce};
use super::work::{WorkArgs, part};
use crate::driver;
use crate::farm::{Farm, JobEvent, Submission};
use crate::outputs::{FrameNames, FrameSummary, OutputPlan, Outputs};
use crate::progress::Display;
use crate::report::{Folder, RenderReport};
use crate::service::{Listener, serve_memory};
use crate::signals::Signals;
use farm_job::JobId;
use farm_worker::by_hand::thread_count;
use farm_worker::cli::{Fault, Loaded, PictureArgs};
use farm_worker::driver::{Config, Left, Order, WorkerError};
use farm_worker::link::Target;
use farm_worker::render_pool::RenderPool;
use farm_worker::scene_cache::SceneCache;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

/// How often the progress bar moves.
const PROGRESS_EVERY: Duration = Duration::from_millis(200);

/// Time that workers elsewhere have to hear that there is no more work.
const FAREWELL_WITHIN: Duration = Duration::from_millis(300);

/// The only job of this coordinator.
const JOB: JobId = JobId(1);

/// Render a scene on this machine, and on every worker that joins
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
The picture's bits depend on scene, camera, resolution, samples, seed and renderer only: not on threads, tiles, workers or luck.

Examples:
  coordinator render scene.glb -o scene.exr --preview
  coordinator render scene.glb -o scene.exr --resolution 1920x1080 --spp 256 --camera Front
  coordinator render scene.glb -o fox.####.exr --frames 1-24 --fps 24 --shutter 0.5
  coordinator render scene.glb -o scene.exr --error 1e-3 --report out
  coordinator render scene.glb -o scene.exr --time 90s --reference reference.exr
  coordinator render scene.glb -o scene.exr --environment sky.hdr --environment-rotation 90
  coordinator render scene.glb -o scene.exr --listen 127.0.0.1:7878 --no-local-worker")]
pub struct RenderArgs {
    #[command(flatten)]
    pub(super) picture: PictureArgs,

    /// Where to write: OUT.exr, or OUT.####.exr with the frame's number for the signs; the scene's name if not given
    #[arg(short, long, env = "FARM_OUTPUT", value_name = "OUT.exr")]
    pub(super) output: Option<PathBuf>,

    /// Write a tone-mapped PNG beside every EXR
    #[arg(long, env = "FARM_PREVIEW")]
    preview: bool,

    #[command(flatten)]
    pub(super) work: WorkArgs,

    #[command(flatten)]
    judge: JudgeArgs,

    /// Render threads of this machine; one per processor if not given
    #[arg(long, env = "FARM_THREADS", value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096), help_heading = "Farm")]
    threads: Option<u32>,

    /// Let workers join: worker --connect ADDR; port 0 takes any free one and says which
    #[arg(long, env = "FARM_LISTEN", value_name = "ADDR", help_heading = "Farm")]
    listen: Option<SocketAddr>,

    #[command(flatten)]
    security: SecurityArgs,

    /// Leave all rendering to workers that join
    #[arg(
        long,
        env = "FARM_NO_LOCAL_WORKER",
        requires = "listen",
        conflicts_with = "threads",
        help_heading = "Farm"
    )]
    no_local_worker: bool,

    /// Part of the units that two workers render, to compare the bits: 0.02 or 2%. When they differ a third one tells which is
    /// wrong; that worker gets nothing any more, and what it delivered is rendered again
    #[arg(long, env = "FARM_VERIFY", value_name = "PART", default_value = "0", value_parser = part, requires = "listen", help_heading = "Farm")]
    verify: f64,

    /// Print one JSON object on standard output when done
    #[arg(long, env = "FARM_JSON")]
    json: bool,

    /// Show no progress and no summary
    #[arg(long, env = "FARM_QUIET")]
    quiet: bool,
}

/// Renders and writes every frame, then reports.
pub fn run(args: RenderArgs) -> Result<(), Fault> {
    args.work.check(args.picture.resolution)?;
    let folder = args.judge.folder()?;
    let plan = args.plan()?;
    super::block_on(render(args, plan, folder))
}

impl RenderArgs {
    fn plan(&self) -> Result<OutputPlan, Fault> {
        let stem = self.picture.scene.file_stem().unwrap_or_default();
        let scene_name = stem.to_string_lossy().into_owned();
        let output = match &self.output {
            Some(output) => output.clone(),
            None => PathBuf::from(format!("{scene_name}.exr")),
        };
        let frames = self.work.frames();
        let names = FrameNames::new(&output, frames.count() > 1).map_err(Fault::input)?;
        let reference = self.judge.references(frames, self.picture.resolution, self.picture.seed)?;
        Ok(OutputPlan { names, preview: self.preview, scene_name, reference })
    }
}

async fn render(args: RenderArgs, plan: OutputPlan, folder: Option<Folder>) -> Result<(), Fault> {
    let doors = args.listen.map(|address| args.security.doors(address)).transpose()?;
    let listener = match &doors {
        Some(doors) => Some(Listener::bind(doors).await?),
        None => None,
    };
    let picture = args.picture.clone();
    let mut loaded = tokio::task::spawn_blocking(move || picture.load()).await.map_err(Fault::failed)??;
    let spec = args.work.spec(&loaded, &plan.scene_name, 0)?;

    let farm =
        driver::start(None, args.verify).map_err(|err| Fault::failed(format!("cannot start: {err}")))?;
    let listening = listener.as_ref().map(Listener::address);
    if let (Some(listener), Some(doors)) = (listener, &doors) {
        farm.registry.put_scene(loaded.id, std::mem::take(&mut loaded.snapshot));
        eprintln!("listening on {}", listener.address());
        announce(&doors.security, listener.address())?;
        listener.serve(farm.clone(), None)?;
    }
    loaded.snapshot = Vec::new();
    // A few small events per frame.
    let (listener, events) = mpsc::unbounded_channel();
    let submission =
        Submission { listener: Some(listener), ..Submission::new(JOB, spec.clone(), Outputs::Files(plan)) };
    farm.submit(submission).await.map_err(Fault::failed)?;
    let (_orders, local) = match args.no_local_worker {
        true => (None, None),
        false => {
            let (orders, local) = local_worker(&farm, &loaded, args.threads);
            (Some(orders), Some(local))
        }
    };
    let display = Display::new(&spec, args.quiet);
    let mut run = Run {
        farm: farm.clone(),
        events,
        local,
        display,
        frames: Vec::new(),
        build: Duration::ZERO,
        signals: Signals::listen()?,
    };
    let outcome = run.finish(spec.frames.count()).await;
    run.display.end();
    if listening.is_some() {
        let reason = if outcome.is_ok() { "all frames are done" } else { "the job was given up" };
        farm.farewell(reason).await;
        tokio::time::sleep(FAREWELL_WITHIN).await;
    }
    outcome?;
    let progress = farm.progress(JOB).await.map_err(Fault::failed)?;
    let report = RenderReport::new(&spec, &loaded, run.build, run.frames, &progress.tally);
    if !args.quiet {
        report.summarise();
    }
    if args.json {
        super::print_json(&report)?;
    }
    // Whatever becomes of the report, the frames are there.
    folder.map_or(Ok(()), |folder| folder.write(&report)).map_err(Fault::failed)
}

type LocalWorker = JoinHandle<Result<Left, WorkerError>>;

/// The worker in this process: the same as any other, but the scene is at hand.
fn local_worker(farm: &Farm, loaded: &Loaded, threads: Option<u32>) -> (mpsc::Sender<Order>, LocalWorker) {
    let scenes = SceneCache::new(None, None);
    scenes.put(loaded.id, loaded.scene.clone());
    let config = Config {
        name: "local".to_owned(),
        threads: thread_count(threads),
        pool: RenderPool::maker(),
        scenes: Arc::new(scenes),
        target: Target::Memory(serve_memory(farm.clone())),
        retry_for: Duration::from_secs(10),
    };
    let (orders, receiver) = mpsc::channel(1);
    (orders, tokio::spawn(farm_worker::driver::run(config, receiver)))
}

/// A job under way.
struct Run {
    farm: Farm,
    events: mpsc::UnboundedReceiver<JobEvent>,
    local: Option<LocalWorker>,
    display: Display,
    frames: Vec<FrameSummary>,
    /// Longest build of a frame.
    build: Duration,
    signals: Signals,
}

impl Run {
    async fn finish(&mut self, frames: u64) -> Result<(), Fault> {
        let mut ticks = tokio::time::interval(PROGRESS_EVERY);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        while (self.frames.len() as u64) < frames {
            tokio::select! {
                Some(event) = self.events.recv() => self.take(event)?,
                _ = ticks.tick() => {
                    let progress = self.farm.progress(JOB).await.map_err(Fault::failed)?;
                    self.display.show(&progress);
                }
                end = ended(&mut self.local) => {
                    self.local = None;
                    return Err(Fault::failed(format!("the worker in this process has ended: {end}")));
                }
                () = self.signals.next() => return Err(self.interrupted()),
            }
        }
        self.frames.sort_by_key(|frame| frame.frame);
        Ok(())
    }

    fn take(&mut self, event: JobEvent) -> Result<(), Fault> {
        match event {
            JobEvent::Prepared { build } => self.build = self.build.max(build),
            JobEvent::Frame(frame) => self.frames.push(*frame),
            JobEvent::Withdrawn(frame) => self.frames.retain(|written| written.frame != frame.0),
            JobEvent::Failed(reason) => return Err(Fault::failed(reason)),
        }
        Ok(())
    }

    fn interrupted(&self) -> Fault {
        Fault::failed(match self.frames.len() {
            0 => "interrupted; nothing was written".to_owned(),
            written => format!("interrupted; {written} frames are complete and were kept"),
        })
    }
}

/// Waits for the end of a worker that should not end; forever when there is none.
async fn ended(local: &mut Option<LocalWorker>) -> String {
    match local {
        Some(worker) => match worker.await {
            Ok(Ok(left)) => format!("{left:?}"),
            Ok(Err(error)) => error.to_string(),
            Err(error) => error.to_string(),
        },
        None => std::future::pending().await,
    }
}
