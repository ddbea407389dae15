//! What one asks and tells a coordinator that serves.

use super::watch::watch;
use super::{print, print_json};
use crate::client::Client;
use crate::outputs::FrameNames;
use crate::progress::{metric, range};
use farm_film::FrameIndex;
use farm_image::write_file;
use farm_job::{FrameRange, JobId, WorkerId};
use farm_proto::convert::{JobView, WorkerView};
use farm_worker::access::AccessArgs;
use farm_worker::cli::Fault;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Which coordinator, and how its answers are shown.
#[derive(Clone, Debug, clap::Args)]
pub struct ConnectArgs {
    /// Address of the coordinator
    #[arg(long, env = "FARM_COORDINATOR", value_name = "HOST:PORT", default_value = "127.0.0.1:7878")]
    pub to: String,
    /// Print JSON
    #[arg(long, env = "FARM_JSON")]
    pub json: bool,
    #[command(flatten)]
    pub access: AccessArgs,
}

impl ConnectArgs {
    /// Connects.
    pub async fn client(&self) -> Result<Client, Fault> {
        Client::connect(&self.to, &self.access.access("coordinator", &self.to)?).await
    }
}

/// A job, by its number.
#[derive(Clone, Debug, clap::Args)]
pub struct JobArgs {
    /// Number of the job
    job: u64,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Show one job or all
#[derive(Clone, Debug, clap::Args)]
pub struct StatusArgs {
    /// Number of the job; all if not given
    job: Option<u64>,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Let a job go before those of lower priority
#[derive(Clone, Debug, clap::Args)]
pub struct PriorityArgs {
    /// Number of the job
    job: u64,
    /// Its new priority
    #[arg(allow_negative_numbers = true)]
    priority: i32,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Remove jobs that have ended, with their frames
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Their numbers are not used again. Scenes that no other job refers to go as well, some time later (serve --keep-uploads).

Examples:
  coordinator fetch 3 -o fox.####.exr && coordinator forget 3")]
pub struct ForgetArgs {
    /// Numbers of the jobs
    #[arg(required = true)]
    jobs: Vec<u64>,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Let a worker finish what it holds and leave
#[derive(Clone, Debug, clap::Args)]
pub struct DrainArgs {
    /// Number of the worker
    worker: u64,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Trust a worker again that delivered wrong results or is in quarantine, once its machine is repaired
#[derive(Clone, Debug, clap::Args)]
pub struct ForgiveArgs {
    /// What the worker calls itself
    name: String,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Fetch finished frames
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Examples:
  coordinator fetch 3 -o fox.####.exr
  coordinator fetch 3 -o fox.exr --frames 12")]
pub struct FetchArgs {
    /// Number of the job
    job: u64,
    /// Where to write: OUT.exr, or OUT.####.exr with the frame's number for the signs
    #[arg(short, long, env = "FARM_OUTPUT", value_name = "OUT.exr")]
    output: PathBuf,
    /// Which frames; all of the job if not given
    #[arg(long, env = "FARM_FRAMES", value_name = "A-BxSTEP")]
    frames: Option<FrameRange>,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// What can be decided about a job.
#[derive(Clone, Copy, Debug)]
pub enum Decision {
    /// Give it up.
    Cancel,
    /// Hold it.
    Pause,
    /// Go on.
    Resume,
}

/// Prints one job or all.
pub fn status(args: &StatusArgs) -> Result<(), Fault> {
    super::block_on(async {
        let jobs = args.connect.client().await?.status(args.job.map(JobId)).await?;
        if args.connect.json {
            return print_json(&jobs.iter().map(job_json).collect::<Vec<_>>());
        }
        jobs.iter().try_for_each(|job| print(&job_line(job)))
    })
}

/// Shows every change of a job until its end.
pub fn watch_job(args: &JobArgs) -> Result<(), Fault> {
    super::block_on(async {
        let mut client = args.connect.client().await?;
        watch(&mut client, JobId(args.job), args.connect.json).await
    })
}

/// Tells a coordinator what was decided about a job.
pub fn decide(args: &JobArgs, decision: Decision) -> Result<(), Fault> {
    super::block_on(async {
        let mut client = args.connect.client().await?;
        let job = JobId(args.job);
        let view = match decision {
            Decision::Cancel => client.cancel(job).await?,
            Decision::Pause => client.pause(job).await?,
            Decision::Resume => client.resume(job).await?,
        };
        show(&view, args.connect.json)
    })
}

/// Changes a job's priority.
pub fn priority(args: &PriorityArgs) -> Result<(), Fault> {
    super::block_on(async {
        let mut client = args.connect.client().await?;
        show(&client.set_priority(JobId(args.job), args.priority).await?, args.connect.json)
    })
}

/// Removes jobs, one after the other.
pub fn forget(args: &ForgetArgs) -> Result<(), Fault> {
    super::block_on(async {
        let mut client = args.connect.client().await?;
        for job in &args.jobs {
            client.forget(JobId(*job)).await?;
        }
        Ok(())
    })
}

/// Prints everybody who is connected.
pub fn workers(args: &ConnectArgs) -> Result<(), Fault> {
    super::block_on(async {
        let workers = args.client().await?.workers().await?;
        if args.json {
            return print_json(&workers.iter().map(worker_json).collect::<Vec<_>>());
        }
        workers.iter().try_for_each(|worker| print(&worker_line(worker)))
    })
}

/// Sends a worker home.
pub fn drain(args: &DrainArgs) -> Result<(), Fault> {
    super::block_on(async { args.connect.client().await?.drain(WorkerId(args.worker)).await })
}

/// Trusts a worker again.
pub fn forgive(args: &ForgiveArgs) -> Result<(), Fault> {
    super::block_on(async { args.connect.client().await?.forgive(args.name.clone()).await })
}

/// Writes finished frames to files of one's own.
pub fn fetch(args: &FetchArgs) -> Result<(), Fault> {
    super::block_on(async {
        let mut client = args.connect.client().await?;
        let job = JobId(args.job);
        let all = client.status(Some(job)).await?.first().map(|view| view.spec.frames);
        let frames = args.frames.or(all).ok_or_else(|| Fault::input(format!("there is no job {job}")))?;
        let names = FrameNames::new(&args.output, frames.count() > 1).map_err(Fault::input)?;
        let mut written = Vec::new();
        for frame in frames.iter() {
            written.push(fetch_frame(&mut client, job, frame, &names).await?);
        }
        if args.connect.json {
            return print_json(&json!({ "outputs": written }));
        }
        written.iter().try_for_each(|path| print(&format!("wrote {}", path.display())))
    })
}

async fn fetch_frame(
    client: &mut Client,
    job: JobId,
    frame: FrameIndex,
    names: &FrameNames,
) -> Result<PathBuf, Fault> {
    let path = names.path(frame);
    write_file(&path, &client.fetch(job, frame).await?).map_err(Fault::failed)?;
    Ok(path)
}

fn show(view: &JobView, json: bool) -> Result<(), Fault> {
    if json { print_json(&job_json(view)) } else { print(&job_line(view)) }
}

/// For people.
pub fn job_line(view: &JobView) -> String {
    let part = view.samples_done as f64 / view.samples_total.max(1) as f64;
    let mut line = format!(
        "job {}  {}  {}  {:.1} %  {}/{} frames",
        view.job,
        view.spec.name,
        view.state,
        part * 100.0,
        view.frames_done,
        view.frames_total
    );
    if let (Some(eta), Some(low), Some(high)) = (view.eta, view.eta_low, view.eta_high) {
        line += &format!("  eta {}", range(eta.as_secs_f64(), low.as_secs_f64(), high.as_secs_f64()));
    }
    if let (Some(error), Some(rel_mse)) = (view.error, view.rel_mse) {
        line += &format!("  error {error:.4} (relMSE {rel_mse:.2e}) at {} spp", view.spp);
    }
    if let Some(slope) = view.slope {
        line += &format!(", slope {slope:.2}");
    }
    if !view.reason.is_empty() {
        line += &format!("  {}", view.reason);
    }
    line
}

/// For scripts.
pub fn job_json(view: &JobView) -> Value {
    let counts = view.counts;
    json!({
        "job": view.job,
        "spec": view.spec,
        "owner": view.owner,
        "state": view.state,
        "reason": view.reason,
        "samples_done": view.samples_done,
        "samples_total": view.samples_total,
        "frames_done": view.frames_done,
        "frames_total": view.frames_total,
        "error": view.error,
        "rel_mse": view.rel_mse,
        "slope": view.slope,
        "spp": view.spp,
        "eta_s": view.eta.map(|eta| eta.as_secs_f64()),
        "eta_low_s": view.eta_low.map(|eta| eta.as_secs_f64()),
        "eta_high_s": view.eta_high.map(|eta| eta.as_secs_f64()),
        "counts": {
            "duplicates": counts.duplicates,
            "failures": counts.failures,
            "expired": counts.expired,
            "verified": counts.verified,
            "unverified": counts.unverified,
        },
    })
}

fn worker_line(view: &WorkerView) -> String {
    format!(
        "worker {}  {}  {}  {} slots  {} units held  {} done  {}samples/s",
        view.worker,
        view.name,
        view.state,
        view.slots,
        view.held,
        view.units_done,
        metric(view.samples_per_s)
    )
}

/// For scripts.
pub fn worker_json(view: &WorkerView) -> Value {
    json!({
        "worker": view.worker,
        "name": view.name,
        "state": view.state,
        "slots": view.slots,
        "held": view.held,
        "units_done": view.units_done,
        "samples_per_s": view.samples_per_s,
    })
}
