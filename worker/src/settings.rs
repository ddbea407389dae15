//! The worker's command line.

use crate::by_hand::{RenderArgs, thread_count};
use crate::cli::{Fault, duration};
use crate::driver::Config;
use crate::link::Target;
use crate::scene_cache::SceneCache;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// Renders for a farm: joins a coordinator and takes units until it is told to stop
#[derive(Clone, Debug, clap::Parser)]
#[command(
    version,
    args_conflicts_with_subcommands = true,
    after_help = "\
A first SIGINT or SIGTERM finishes the units that are being rendered and leaves; a second one leaves at once.

Examples:
  worker --connect 127.0.0.1:7878
  worker --connect farm.local:7878 --threads 8 --cache /var/cache/tessera --retry-for 24h
  worker render scene.glb --samples 0..64 -o a.exr"
)]
pub struct Settings {
    #[command(subcommand)]
    pub(crate) command: Option<Command>,
    #[command(flatten)]
    join: JoinArgs,
}

#[derive(Clone, Debug, clap::Subcommand)]
pub(crate) enum Command {
    Render(Box<RenderArgs>),
}

#[derive(Clone, Debug, clap::Args)]
struct JoinArgs {
    /// Address of the coordinator
    #[arg(long, env = "FARM_CONNECT", value_name = "HOST:PORT")]
    connect: Option<String>,

    /// Units rendered at once; one per processor if not given
    #[arg(long, env = "FARM_THREADS", value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    threads: Option<u32>,

    /// Folder that keeps scenes for later
    #[arg(long, env = "FARM_CACHE", value_name = "DIR")]
    cache: Option<PathBuf>,

    /// Name shown in the farm's lists; host and process if not given
    #[arg(long, env = "FARM_NAME", value_name = "NAME")]
    name: Option<String>,

    /// How long to look for a coordinator that is not there, or not any more: 90s, 5m, 24h
    #[arg(long, env = "FARM_RETRY_FOR", value_name = "TIME", default_value = "60s", value_parser = duration)]
    retry_for: Duration,
}

impl Settings {
    /// How to work for a coordinator.
    pub(crate) fn config(self) -> Result<Config, Fault> {
        let address = self.join.connect.ok_or_else(|| {
            Fault::input("nobody to work for: give the coordinator's address with --connect HOST:PORT")
        })?;
        Ok(Config {
            name: self.join.name.unwrap_or_else(default_name),
            threads: thread_count(self.join.threads),
            scenes: Arc::new(SceneCache::new(self.join.cache)),
            target: Target::Tcp(address),
            retry_for: self.join.retry_for,
        })
    }
}

/// Host and process: tells workers of one host apart.
fn default_name() -> String {
    let uname = rustix::system::uname();
    format!("{}-{}", uname.nodename().to_string_lossy(), std::process::id())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{CommandFactory, Parser};

    #[test]
    fn the_command_line_is_consistent() {
        Settings::command().debug_assert();
    }

    #[test]
    fn a_worker_needs_a_coordinator() {
        let fault = Settings::parse_from(["worker", "--threads", "1"]).config().err().unwrap().to_string();
        assert!(fault.contains("--connect"));
        let config = Settings::parse_from(["worker", "--connect", "h:1", "--threads", "3"]).config().unwrap();
        assert_eq!(config.threads, 3);
        assert!(Settings::try_parse_from(["worker", "--connect", "h:1", "--threads", "0"]).is_err());
    }
}
