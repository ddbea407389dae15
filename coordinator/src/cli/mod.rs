//! The coordinator's command line.

mod compare;
mod inspect;
mod jobs;
mod judge;
mod listen;
mod merge;
mod reference;
mod render;
mod serve;
mod submit;
mod token;
mod watch;
mod work;

use farm_worker::cli::Fault;
use jobs::Decision;

pub(crate) use listen::{Doors, announce};
pub(crate) use work::check_tile;

/// Renders scenes on one machine or many: splits frames into tiles and sample ranges, hands them to workers over gRPC,
/// and merges what comes back into the same bits whoever rendered it
#[derive(Debug, clap::Parser)]
#[command(
    version,
    after_help = "\
Examples:
  coordinator render scene.glb -o scene.exr --preview
  coordinator render scene.glb -o fox.####.exr --frames 1-24 --shutter 0.5
  coordinator render scene.glb -o scene.exr --listen 127.0.0.1:7878     (and elsewhere: worker --connect 127.0.0.1:7878)
  coordinator merge a.exr b.exr -o scene.exr
  coordinator compare scene.exr reference.exr --json
  coordinator inspect scene.glb"
)]
pub struct Settings {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    Render(Box<render::RenderArgs>),
    Merge(merge::MergeArgs),
    Compare(compare::CompareArgs),
    Reference(Box<reference::ReferenceArgs>),
    Inspect(Box<inspect::InspectArgs>),
    Serve(serve::ServeArgs),
    Submit(Box<submit::SubmitArgs>),
    Status(jobs::StatusArgs),
    /// Show a job's progress until it ends
    Watch(jobs::JobArgs),
    /// Give a job up
    Cancel(jobs::JobArgs),
    /// Give out nothing more of a job for now
    Pause(jobs::JobArgs),
    /// Go on with a paused job, or try a failed one again
    #[command(visible_alias = "requeue")]
    Resume(jobs::JobArgs),
    Priority(jobs::PriorityArgs),
    Forget(jobs::ForgetArgs),
    /// Show who is connected
    Workers(jobs::ConnectArgs),
    Drain(jobs::DrainArgs),
    Forgive(jobs::ForgiveArgs),
    Fetch(jobs::FetchArgs),
    Token(token::TokenArgs),
}

impl Settings {
    /// Log lines that are shown unless `FARM_LOG` says otherwise.
    pub fn log_level(&self) -> &'static str {
        match self.command {
            Command::Serve(_) => "info",
            _ => "warn",
        }
    }

    /// Does what was asked.
    pub fn run(self) -> Result<(), Fault> {
        match self.command {
            Command::Render(args) => render::run(*args),
            Command::Merge(args) => merge::run(&args),
            Command::Compare(args) => compare::run(&args),
            Command::Reference(args) => reference::run(*args),
            Command::Inspect(args) => inspect::run(&args),
            Command::Serve(args) => serve::run(&args),
            Command::Submit(args) => submit::run(&args),
            Command::Status(args) => jobs::status(&args),
            Command::Watch(args) => jobs::watch_job(&args),
            Command::Cancel(args) => jobs::decide(&args, Decision::Cancel),
            Command::Pause(args) => jobs::decide(&args, Decision::Pause),
            Command::Resume(args) => jobs::decide(&args, Decision::Resume),
            Command::Priority(args) => jobs::priority(&args),
            Command::Forget(args) => jobs::forget(&args),
            Command::Workers(args) => jobs::workers(&args),
            Command::Drain(args) => jobs::drain(&args),
            Command::Forgive(args) => jobs::forgive(&args),
            Command::Fetch(args) => jobs::fetch(&args),
            Command::Token(args) => token::run(&args),
        }
    }
}

/// Runs what waits for messages. Rendering and merging have threads of their own; messages need few.
fn block_on(work: impl Future<Output = Result<(), Fault>>) -> Result<(), Fault> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(|err| Fault::failed(format!("cannot start: {err}")))?;
    let outcome = runtime.block_on(work);
    // What is still being rendered or sent is not needed.
    runtime.shutdown_background();
    outcome
}

/// One JSON value on standard output.
fn print_json(value: &impl serde::Serialize) -> Result<(), Fault> {
    let text = serde_json::to_string(value).map_err(Fault::failed)?;
    print(&text)
}

/// A line on standard output. A reader that has left is not our fault.
fn print(text: &str) -> Result<(), Fault> {
    use std::io::Write;
    match writeln!(std::io::stdout(), "{text}") {
        Err(err) if err.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Fault::failed(format!("cannot write to standard output: {err}")))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        super::Settings::command().debug_assert();
    }
}
