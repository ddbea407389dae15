//! A coordinator for many jobs.

use super::listen::SecurityArgs;
use super::work::part;
use crate::serve::serve;
use crate::service::UploadLimits;
use crate::store::{Patience, StoreLocation};
use farm_worker::cli::{Fault, bytes, duration};
use std::net::SocketAddr;
use std::time::Duration;

/// Serve jobs that are submitted, and the workers that render them, until stopped
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Everything acknowledged is in the store before it is acknowledged: stop or kill the coordinator at any time, start it again on
the same store, and it goes on where it was; workers find it again by themselves. Of several coordinators on one store one
serves; those with --standby wait until it is gone.

A bucket's endpoint, region and keys come from the environment: AWS_ENDPOINT_URL, AWS_REGION, AWS_ACCESS_KEY_ID,
AWS_SECRET_ACCESS_KEY; AWS_ALLOW_HTTP=true for an endpoint without TLS.

Examples:
  coordinator serve --store /srv/tessera
  coordinator serve --listen 127.0.0.1:7878 --store /srv/tessera --standby
  coordinator serve --listen 0.0.0.0:7878 --store /srv/tessera     (TLS; coordinator token create lets others join)
  coordinator serve --store s3://farm/tessera")]
pub struct ServeArgs {
    /// Where workers and people connect; port 0 takes any free one and says which
    #[arg(long, env = "FARM_LISTEN", value_name = "ADDR", default_value = "127.0.0.1:7878")]
    listen: SocketAddr,
    /// Folder or bucket that keeps jobs, scenes, partials and finished frames
    #[arg(long, env = "FARM_STORE", value_name = "DIR|s3://BUCKET/PREFIX")]
    store: StoreLocation,
    /// Wait until no other coordinator has the store
    #[arg(long, env = "FARM_STANDBY")]
    standby: bool,
    /// Part of the units that two workers render, to compare the bits: 0.02 or 2%. When they differ a third one tells which is
    /// wrong; that worker gets nothing any more, and what it delivered is rendered again
    #[arg(long, env = "FARM_VERIFY", value_name = "PART", default_value = "0", value_parser = part)]
    verify: f64,
    /// Bytes of scenes that a submitter may bring within an hour; admins may bring more: 500M, 64G
    #[arg(long, env = "FARM_UPLOAD_QUOTA", value_name = "SIZE", default_value = "64G", value_parser = bytes)]
    upload_quota: u64,
    /// Scenes that no job refers to, and what was brought of unfinished ones, are forgotten when nobody has asked for them for
    /// this long
    #[arg(long, env = "FARM_KEEP_UPLOADS", value_name = "TIME", default_value = "1h", value_parser = duration)]
    keep_uploads: Duration,
    #[command(flatten)]
    security: SecurityArgs,
}

/// Serves until a signal comes.
pub fn run(args: &ServeArgs) -> Result<(), Fault> {
    let patience = if args.standby { Patience::StandBy } else { Patience::Leave };
    let doors = args.security.doors(args.listen)?;
    let uploads = UploadLimits { quota: args.upload_quota, keep: args.keep_uploads };
    super::block_on(serve(&doors, &args.store, patience, args.verify, uploads))
}
