//! A job for a coordinator that serves.

use super::jobs::ConnectArgs;
use super::watch::watch;
use super::work::WorkArgs;
use super::{print, print_json};
use farm_worker::cli::{Fault, PictureArgs};

/// Submit a job to a coordinator that serves
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Prints the job's number. Of the scene only what the coordinator lacks is sent, whatever the number of jobs and frames.

Examples:
  coordinator submit scene.glb --spp 256
  coordinator submit fox.glb --frames 1-24 --shutter 0.5 --priority 10 --watch")]
pub struct SubmitArgs {
    #[command(flatten)]
    picture: PictureArgs,
    #[command(flatten)]
    work: WorkArgs,
    #[command(flatten)]
    connect: ConnectArgs,
    /// Name of the job; the scene's if not given
    #[arg(long, env = "FARM_JOB_NAME", value_name = "NAME")]
    name: Option<String>,
    /// Jobs of higher priority go first
    #[arg(long, env = "FARM_PRIORITY", value_name = "N", default_value_t = 0, allow_negative_numbers = true)]
    priority: i32,
    /// Show progress until the job ends
    #[arg(long)]
    watch: bool,
}

/// Reads the scene, brings it, submits the job.
pub fn run(args: &SubmitArgs) -> Result<(), Fault> {
    args.work.check(args.picture.resolution)?;
    let loaded = args.picture.load()?;
    for warning in &loaded.report.warnings {
        eprintln!("warning: {warning}");
    }
    let stem = args.picture.scene.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let spec = args.work.spec(&loaded, args.name.as_ref().unwrap_or(&stem), args.priority)?;
    super::block_on(async {
        let mut client = args.connect.client().await?;
        let scene_bytes = loaded.snapshot.len();
        let sent_bytes = client.bring(loaded.id, loaded.snapshot).await?;
        let job = client.submit(spec).await?;
        match args.connect.json {
            true => print_json(&serde_json::json!({
                "job": job,
                "scene_id": loaded.id.to_string(),
                "scene_bytes": scene_bytes,
                "sent_bytes": sent_bytes,
            }))?,
            false => print(&job.to_string())?,
        }
        if args.watch { watch(&mut client, job, false).await } else { Ok(()) }
    })
}
