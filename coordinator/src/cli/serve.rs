//! A coordinator for many jobs.

use super::work::part;
use crate::serve::serve;
use farm_worker::cli::Fault;
use std::net::SocketAddr;
use std::path::PathBuf;

/// Serve jobs that are submitted, and the workers that render them, until stopped
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Everything acknowledged is in the store before it is acknowledged: stop or kill the coordinator at any time, start it again on
the same store, and it goes on where it was; workers find it again by themselves.

Examples:
  coordinator serve --store /srv/tessera
  coordinator serve --listen 127.0.0.1:7878 --store /srv/tessera")]
pub struct ServeArgs {
    /// Where workers and people connect; port 0 takes any free one and says which
    #[arg(long, env = "FARM_LISTEN", value_name = "ADDR", default_value = "127.0.0.1:7878")]
    listen: SocketAddr,
    /// Folder that keeps jobs, scenes, partials and finished frames
    #[arg(long, env = "FARM_STORE", value_name = "DIR")]
    store: PathBuf,
    /// Part of the units that two workers render, to compare the bits: 0.02 or 2%. When they differ a third one tells which is
    /// wrong; that worker gets nothing any more, and what it delivered is rendered again
    #[arg(long, env = "FARM_VERIFY", value_name = "PART", default_value = "0", value_parser = part)]
    verify: f64,
}

/// Serves until a signal comes.
pub fn run(args: &ServeArgs) -> Result<(), Fault> {
    super::block_on(serve(args.listen, &args.store, args.verify))
}
