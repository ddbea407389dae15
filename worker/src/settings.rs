//! The worker's command line.

use crate::access::AccessArgs;
use crate::by_hand::{RenderArgs, thread_count};
use crate::cli::{Fault, bytes, duration, positive};
use crate::disk_cache::DiskCache;
use crate::driver::Config;
use crate::link::Target;
use crate::program::Availability;
use crate::render_pool::RenderPool;
use crate::scene_cache::SceneCache;
use crate::time_of_day::time_of_day;
use chrono::NaiveTime;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// Renders for a farm: joins a coordinator and takes units until it is told to stop
#[derive(Clone, Debug, clap::Parser)]
#[command(
    version,
    args_conflicts_with_subcommands = true,
    after_help = "\
A first SIGINT or SIGTERM finishes the units that are being rendered, within --grace, and leaves; a second one leaves at once.
A coordinator that is gone for a while is no error: the worker waits for it, and delivers then what it has rendered.

Examples:
  worker --connect 127.0.0.1:7878
  worker --connect farm.local:7878 --ca-fingerprint 1f2e.. --token-file token --threads 8 --cache /var/cache/tessera
  worker --connect farm.local:7878 --idle-only --until 07:00 --nice 19 --memory 8G
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
    /// Address of the coordinator; several, with commas between them, where another one may take over on another host
    #[arg(long, env = "FARM_CONNECT", value_name = "HOST:PORT", value_delimiter = ',')]
    connect: Vec<String>,

    /// Units rendered at once; one per processor if not given
    #[arg(long, env = "FARM_THREADS", value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    threads: Option<u32>,

    /// Folder that keeps scenes for later
    #[arg(long, env = "FARM_CACHE", value_name = "DIR")]
    cache: Option<PathBuf>,

    /// Bytes of that folder; what was not needed for longest goes first: 500M, 20G
    #[arg(long, env = "FARM_CACHE_SIZE", value_name = "SIZE", default_value = "20G", value_parser = bytes)]
    cache_size: u64,

    /// Memory for scenes and what is built from them; what does not fit is refused and left to other workers: 8G
    #[arg(long, env = "FARM_MEMORY", value_name = "SIZE", value_parser = bytes)]
    memory: Option<u64>,

    /// Name shown in the farm's lists; host and process if not given
    #[arg(long, env = "FARM_NAME", value_name = "NAME")]
    name: Option<String>,

    /// How long to look for a coordinator that is not there, or not any more: 90s, 5m, 24h
    #[arg(long, env = "FARM_RETRY_FOR", value_name = "TIME", default_value = "60s", value_parser = duration)]
    retry_for: Duration,

    /// How long to finish what is being rendered when told to leave; what takes longer goes back as far as it is
    #[arg(long, env = "FARM_GRACE", value_name = "TIME", default_value = "60s", value_parser = duration)]
    grace: Duration,

    /// Work only while other programs use less than this many processors of the host, and make way when they need more
    #[arg(long, env = "FARM_MAX_LOAD", value_name = "X", value_parser = positive)]
    max_load: Option<f64>,

    /// Work only while the host is idle: the same as --max-load 0.5
    #[arg(long, env = "FARM_IDLE_ONLY", conflicts_with = "max_load")]
    idle_only: bool,

    /// Be gone at this time of day
    #[arg(long, env = "FARM_UNTIL", value_name = "HH:MM", value_parser = time_of_day)]
    until: Option<NaiveTime>,

    /// Let other programs go first, the more the higher
    #[arg(long, env = "FARM_NICE", value_name = "N", value_parser = clap::value_parser!(i32).range(0..=19))]
    nice: Option<i32>,

    #[command(flatten)]
    access: AccessArgs,
}

/// What a host that nobody uses does by itself, in processors.
const IDLE_LOAD: f64 = 0.5;

impl Settings {
    /// Lowers the priority of this program; threads inherit it, so before there are any.
    pub(crate) fn be_nice(&self) -> Result<(), Fault> {
        let Some(nice) = self.join.nice else { return Ok(()) };
        let lower = rustix::process::nice(nice);
        lower.map(|_| ()).map_err(|err| Fault::failed(format!("--nice {nice} is not possible: {err}")))
    }

    /// When the host may be used.
    pub(crate) fn availability(&self) -> Availability {
        let idle = self.join.idle_only.then_some(IDLE_LOAD);
        Availability { grace: self.join.grace, max_load: self.join.max_load.or(idle), until: self.join.until }
    }

    /// How to work for a coordinator.
    pub(crate) fn config(self) -> Result<Config, Fault> {
        if self.join.connect.is_empty() {
            return Err(Fault::input(
                "nobody to work for: give the coordinator's address with --connect HOST:PORT",
            ));
        }
        let access = self.join.access.access_to_any("worker", &self.join.connect)?;
        Ok(Config {
            name: self.join.name.unwrap_or_else(default_name),
            threads: thread_count(self.join.threads),
            pool: RenderPool::maker(),
            scenes: Arc::new(SceneCache::new(
                self.join.cache.map(|folder| DiskCache::new(folder, self.join.cache_size)),
                self.join.memory,
            )),
            target: Target::Tcp(self.join.connect, access),
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
    fn a_spare_host_has_conditions() {
        let of = |flags: &[&str]| {
            let settings =
                Settings::parse_from(["worker", "--connect", "h:1"].iter().chain(flags)).availability();
            (settings.max_load, settings.until.is_some(), settings.grace.as_secs())
        };
        assert_eq!(of(&[]), (None, false, 60));
        assert_eq!(of(&["--idle-only", "--until", "07:00", "--grace", "5s"]), (Some(0.5), true, 5));
        assert_eq!(of(&["--max-load", "1.5"]), (Some(1.5), false, 60));
        for wrong in [["--until", "7"], ["--nice", "20"], ["--memory", "much"], ["--max-load", "0"]] {
            let all = ["worker", "--connect", "h:1"].into_iter().chain(wrong);
            assert!(Settings::try_parse_from(all).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn a_worker_needs_a_coordinator() {
        let fault = Settings::parse_from(["worker", "--threads", "1"]).config().err().unwrap().to_string();
        assert!(fault.contains("--connect"));
        let config =
            Settings::parse_from(["worker", "--connect", "localhost:1", "--threads", "3"]).config().unwrap();
        assert_eq!(config.threads, 3);
        assert!(Settings::try_parse_from(["worker", "--connect", "h:1", "--threads", "0"]).is_err());
    }
}
