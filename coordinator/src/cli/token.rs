//! Tokens, by which others join.

use super::{print, print_json};
use farm_trust::{Authority, Role, Token, TokenId, TokenView};
use farm_worker::cli::{Fault, duration};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Where a coordinator's authority is.
#[derive(Clone, Debug, clap::Args)]
pub struct TrustArgs {
    /// Folder of the farm's authority, its key and the tokens it knows; ~/.local/state/tessera/trust if not given
    #[arg(long, env = "FARM_TRUST", value_name = "DIR")]
    trust: Option<PathBuf>,
}

impl TrustArgs {
    /// The folder that was given, or the user's own.
    pub fn folder(&self) -> Result<PathBuf, Fault> {
        let default = || Some(farm_trust::state_folder()?.join("trust"));
        self.trust.clone().or_else(default).ok_or_else(|| {
            Fault::input("there is no home to keep the farm's authority in: give a folder with --trust")
        })
    }

    fn authority(&self) -> Result<Authority, Fault> {
        Authority::open(&self.folder()?).map_err(Fault::failed)
    }
}

/// Make, show or take back the tokens by which workers and people join, on the coordinator's own host
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
A token is printed once and kept nowhere. Whoever joins exchanges it for a certificate of 90 days, which is renewed in use;
revoking the token ends these certificates too.

Examples:
  coordinator token create --role worker
  coordinator token create --role submitter --expires 1h --uses 1
  coordinator token revoke 1f2e3d4c5b6a")]
pub struct TokenArgs {
    #[command(subcommand)]
    command: TokenCommand,
}

#[derive(Clone, Debug, clap::Subcommand)]
enum TokenCommand {
    /// Print a new token, in a line to paste on the host that is to join
    Create(CreateArgs),
    /// Show what there is, without the secrets
    List(ListArgs),
    /// Take a token back, with all certificates that it was exchanged for
    Revoke(RevokeArgs),
}

#[derive(Clone, Debug, clap::Args)]
struct CreateArgs {
    /// What its holder may do: worker, submitter or admin
    #[arg(long, value_name = "ROLE")]
    role: Role,
    /// How long it can be used to join
    #[arg(long, value_name = "TIME", default_value = "24h", value_parser = duration)]
    expires: Duration,
    /// How many may join with it; any number if not given
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    uses: Option<u32>,
    #[command(flatten)]
    trust: TrustArgs,
    /// Print JSON
    #[arg(long, env = "FARM_JSON")]
    json: bool,
}

#[derive(Clone, Debug, clap::Args)]
struct ListArgs {
    #[command(flatten)]
    trust: TrustArgs,
    /// Print JSON
    #[arg(long, env = "FARM_JSON")]
    json: bool,
}

#[derive(Clone, Debug, clap::Args)]
struct RevokeArgs {
    /// Name of the token
    token: TokenId,
    #[command(flatten)]
    trust: TrustArgs,
}

/// Does what was asked.
pub fn run(args: &TokenArgs) -> Result<(), Fault> {
    match &args.command {
        TokenCommand::Create(args) => create(args),
        TokenCommand::List(args) => list(args),
        TokenCommand::Revoke(args) => {
            let known = args.trust.authority()?.tokens().revoke(args.token).map_err(Fault::failed)?;
            if !known {
                return Err(Fault::input(format!("there is no token {}", args.token)));
            }
            print(&format!("revoked {}; its holders are hung up on within seconds", args.token))
        }
    }
}

fn create(args: &CreateArgs) -> Result<(), Fault> {
    let authority = args.trust.authority()?;
    let created = authority.tokens().create(args.role, SystemTime::now(), args.expires, args.uses);
    let token = created.map_err(Fault::failed)?;
    if args.json {
        return print_json(&json!({
            "id": token.id.to_string(),
            "token": token.text(),
            "role": args.role,
            "ca_fingerprint": authority.fingerprint().to_string(),
            "address": authority.address(),
        }));
    }
    print(&invite(args.role, &token, &authority))
}

fn list(args: &ListArgs) -> Result<(), Fault> {
    let tokens = args.trust.authority()?.tokens().list().map_err(Fault::failed)?;
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    if args.json {
        return print_json(&tokens.iter().map(|token| token_json(token, now)).collect::<Vec<_>>());
    }
    tokens.iter().try_for_each(|token| print(&token_line(token, now)))
}

fn state(token: &TokenView, now: u64) -> &'static str {
    let used_up = token.record.uses_max.is_some_and(|max| token.uses >= max);
    match (token.revoked, token.record.expires <= now) {
        (true, _) => "revoked",
        (false, true) => "expired",
        (false, false) if used_up => "used",
        (false, false) => "good",
    }
}

fn token_line(token: &TokenView, now: u64) -> String {
    let uses = match token.record.uses_max {
        Some(max) => format!("{} of {max} uses", token.uses),
        None => "any number of uses".to_owned(),
    };
    let hours = token.record.expires.saturating_sub(now) as f64 / 3600.0;
    format!("token {}  {}  {}  {uses}  {hours:.1} h left", token.id, token.record.role, state(token, now))
}

fn token_json(token: &TokenView, now: u64) -> Value {
    json!({
        "id": token.id.to_string(),
        "role": token.record.role,
        "state": state(token, now),
        "created": token.record.created,
        "expires": token.record.expires,
        "uses": token.uses,
        "uses_max": token.record.uses_max,
    })
}

/// A line for the host that is to join.
pub fn invite(role: Role, token: &Token, authority: &Authority) -> String {
    let address = authority.address().unwrap_or_else(|| "HOST:PORT".to_owned());
    let program = match role {
        Role::Worker => format!("worker --connect {address}"),
        Role::Submitter | Role::Admin => format!("coordinator status --to {address}"),
    };
    format!("FARM_TOKEN={} {program} --ca-fingerprint {}", token.text(), authority.fingerprint())
}
