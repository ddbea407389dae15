//! Where a coordinator listens, and to whom.

use super::token::{TrustArgs, invite};
use crate::service::Security;
use farm_trust::{Authority, Role};
use farm_worker::cli::Fault;
use std::io::IsTerminal;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

/// A token that is printed at the first start is good for this long.
const FIRST_TOKEN_FOR: Duration = Duration::from_secs(24 * 3600);

/// To whom a coordinator listens
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Who may connect")]
pub struct SecurityArgs {
    /// Speak TLS and know everybody by certificate on loopback too; beyond loopback that is always so
    #[arg(long, env = "FARM_TLS")]
    tls: bool,

    #[command(flatten)]
    trust: TrustArgs,

    /// Listen beyond loopback without encryption and to whoever connects; on an address that the whole internet may reach
    /// only as --insecure=public
    #[arg(
        long,
        env = "FARM_LISTEN_INSECURE",
        value_name = "WHERE",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "private",
        conflicts_with = "tls"
    )]
    insecure: Option<Reach>,
}

/// From where an address can be reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Reach {
    /// Within a site
    Private,
    /// From anywhere
    Public,
}

/// Where a coordinator listens, and to whom.
#[derive(Clone, Debug)]
pub struct Doors {
    /// Where; port 0 takes any.
    pub address: SocketAddr,
    /// To whom.
    pub security: Security,
}

impl SecurityArgs {
    /// To whom to listen at `address`.
    pub fn doors(&self, address: SocketAddr) -> Result<Doors, Fault> {
        let open = Ok(Doors { address, security: Security::Open });
        let ip = address.ip();
        if let Some(allowed) = self.insecure {
            if is_public(ip) && allowed == Reach::Private {
                return Err(Fault::input(format!(
                    "--insecure: {ip} may be reached from anywhere; leave the flag out, or say --insecure=public if you mean it"
                )));
            }
            if !ip.is_loopback() {
                eprintln!(
                    "warning: INSECURE: anyone who reaches {address} may read scenes and pictures, submit and cancel jobs, and deliver results"
                );
            }
            return open;
        }
        if ip.is_loopback() && !self.tls {
            return open;
        }
        let authority = Authority::open(&self.trust.folder()?).map_err(Fault::failed)?;
        Ok(Doors { address, security: Security::Closed(Arc::new(authority)) })
    }
}

/// Says how others join, once it is known where. A token is shown to people only: what is no terminal may be a log.
pub fn announce(security: &Security, address: SocketAddr) -> Result<(), Fault> {
    let Security::Closed(authority) = security else { return Ok(()) };
    let address = reachable(address);
    authority.note_address(&address).map_err(Fault::failed)?;
    eprintln!("authority {}", authority.fingerprint());
    let tokens = authority.tokens();
    let is_first = tokens.list().map_err(Fault::failed)?.is_empty();
    if is_first && std::io::stderr().is_terminal() {
        let token =
            tokens.create(Role::Worker, SystemTime::now(), FIRST_TOKEN_FOR, None).map_err(Fault::failed)?;
        eprintln!("on a spare host, within 24 hours:\n{}", invite(Role::Worker, &token, authority));
    } else {
        eprintln!("others join with what is printed by: coordinator token create --role worker");
    }
    Ok(())
}

/// What others connect to: the address, or this host's name where it is all addresses.
fn reachable(address: SocketAddr) -> String {
    match address.ip().is_unspecified() {
        true => format!("{}:{}", rustix::system::uname().nodename().to_string_lossy(), address.port()),
        false => address.to_string(),
    }
}

/// Whether an address may be reached from other sites.
fn is_public(ip: IpAddr) -> bool {
    match ip {
        IpAddr::V4(ip) => !(ip.is_private() || ip.is_link_local() || ip.is_loopback()),
        IpAddr::V6(ip) => match ip.to_ipv4_mapped() {
            Some(ip) => is_public(IpAddr::V4(ip)),
            None => !(ip.is_unique_local() || ip.is_unicast_link_local() || ip.is_loopback()),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        security: SecurityArgs,
    }

    fn doors(address: &str, flags: &[&str]) -> Result<Security, String> {
        let folder = tempfile::tempdir().unwrap();
        let trust = folder.path().join("trust").display().to_string();
        let line = Line::parse_from(["x", "--trust", &trust].iter().chain(flags));
        let doors = line.security.doors(address.parse().unwrap());
        doors.map(|doors| doors.security).map_err(|err| err.to_string())
    }

    #[test]
    fn beyond_loopback_it_is_tls_unless_spelled_out() {
        assert!(matches!(doors("127.0.0.1:0", &[]), Ok(Security::Open)));
        assert!(matches!(doors("[::1]:0", &[]), Ok(Security::Open)));
        assert!(matches!(doors("127.0.0.1:0", &["--tls"]), Ok(Security::Closed(_))));
        for address in ["192.168.7.1:0", "0.0.0.0:0", "8.8.8.8:0", "[::]:0", "[2001:db8::1]:0"] {
            assert!(matches!(doors(address, &[]), Ok(Security::Closed(_))), "{address}");
            assert!(matches!(doors(address, &["--insecure=public"]), Ok(Security::Open)), "{address}");
            let is_private = address.starts_with("192");
            assert_eq!(doors(address, &["--insecure"]).is_ok(), is_private, "{address}");
        }
        assert!(doors("0.0.0.0:0", &["--insecure"]).unwrap_err().contains("--insecure=public"));
    }
}
