//! What the command line says about it.

use super::Access;
use super::keys::{Keys, is_expired, ran_out};
use crate::cli::Fault;
use farm_trust::{Fingerprint, Identity, Token};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A token in the environment; there is no flag for it, since other users see the flags of programs.
const TOKEN_VARIABLE: &str = "FARM_TOKEN";

/// Longest token file that is read.
const TOKEN_BYTES_MAX: u64 = 4096;

/// Who one is to a coordinator on another host.
#[derive(Clone, Debug, Default, clap::Args)]
#[command(next_help_heading = "Access to a coordinator on another host")]
pub struct AccessArgs {
    /// Recognise the coordinator by this fingerprint of its authority, and join with the token in FARM_TOKEN or --token-file
    #[arg(long, env = "FARM_CA_FINGERPRINT", value_name = "SHA256")]
    ca_fingerprint: Option<Fingerprint>,

    /// File with the token to join with
    #[arg(long, env = "FARM_TOKEN_FILE", value_name = "FILE")]
    token_file: Option<PathBuf>,

    /// Where the certificate and its key are kept, once joined; below ~/.local/state/tessera if not given
    #[arg(long, env = "FARM_IDENTITY", value_name = "FILE")]
    identity: Option<PathBuf>,

    /// Speak to another host without encryption and without knowing who answers
    #[arg(long, env = "FARM_INSECURE")]
    insecure: bool,
}

impl AccessArgs {
    /// How `program` speaks to the coordinator at `address`.
    ///
    /// # Errors
    /// When nothing is there to be recognised by, and the coordinator is on another host.
    pub fn access(&self, program: &str, address: &str) -> Result<Access, Fault> {
        let token = self.token()?;
        let path = self.identity.clone().or_else(|| default_path(program, address));
        let identity = match &path {
            Some(path) => Identity::load(path).map_err(Fault::input)?,
            None => None,
        };
        if self.identity.is_some() && identity.is_none() && token.is_none() {
            let path = path.unwrap_or_default();
            return Err(Fault::input(format!(
                "there is no identity in {}: join with a token first",
                path.display()
            )));
        }
        let identity = identity.filter(|identity| self.is_wanted(identity, token.as_ref()));
        match (identity, token, self.ca_fingerprint) {
            (Some(identity), token, _) => {
                if is_expired(&identity) && token.is_none() {
                    return Err(Fault::input(format!("{address}: {}", ran_out(&identity))));
                }
                let fingerprint = identity.fingerprint();
                Ok(Access::Secure(Arc::new(Keys::new(fingerprint, Some(identity), token, path))))
            }
            (None, Some(token), Some(fingerprint)) => {
                Ok(Access::Secure(Arc::new(Keys::new(fingerprint, None, Some(token), path))))
            }
            (None, Some(_), None) => Err(Fault::input(
                "a token is only given to a coordinator that is recognised: give --ca-fingerprint, which coordinator token create prints beside the token",
            )),
            (None, None, Some(_)) => Err(Fault::input(format!(
                "nothing to join with: put the token that coordinator token create printed into {TOKEN_VARIABLE} or --token-file"
            ))),
            (None, None, None) => self.plain(address),
        }
    }

    /// The same to any of the coordinators of one farm, at one address at least. Who one is, is kept under the first.
    ///
    /// # Errors
    /// The same for any of them.
    pub fn access_to_any(&self, program: &str, addresses: &[String]) -> Result<Access, Fault> {
        let access = self.access(program, &addresses[0])?;
        if matches!(access, Access::Plain) {
            addresses[1..].iter().try_for_each(|address| self.plain(address).map(drop))?;
        }
        Ok(access)
    }

    /// An identity of another farm than the one that is asked for, or from another token, is not used.
    fn is_wanted(&self, identity: &Identity, token: Option<&Token>) -> bool {
        let holder = identity.holder();
        let same_token = |token: &Token| holder.as_ref().is_ok_and(|holder| holder.token == token.id);
        self.ca_fingerprint.is_none_or(|wanted| wanted == identity.fingerprint())
            && token.is_none_or(|token| same_token(token) && !is_expired(identity))
    }

    fn plain(&self, address: &str) -> Result<Access, Fault> {
        if is_this_host(address) {
            return Ok(Access::Plain);
        }
        if self.insecure {
            tracing::warn!(%address, "nothing is encrypted, and anyone could answer there or listen");
            return Ok(Access::Plain);
        }
        Err(Fault::input(format!(
            "{address} is on another host: join with a token and --ca-fingerprint, as coordinator token create prints them there; or say --insecure"
        )))
    }

    fn token(&self) -> Result<Option<Token>, Fault> {
        let (text, origin) = match (&self.token_file, std::env::var(TOKEN_VARIABLE)) {
            (Some(path), _) => (read_token(path)?, path.display().to_string()),
            (None, Ok(text)) if !text.is_empty() => (text, TOKEN_VARIABLE.to_owned()),
            (None, Ok(_) | Err(_)) => return Ok(None),
        };
        text.parse().map(Some).map_err(|err| Fault::input(format!("{origin}: {err}")))
    }
}

fn read_token(path: &Path) -> Result<String, Fault> {
    use std::io::Read;
    let mut text = String::new();
    std::fs::File::open(path)
        .and_then(|file| file.take(TOKEN_BYTES_MAX).read_to_string(&mut text))
        .map_err(|err| Fault::input(format!("--token-file {}: {err}", path.display())))?;
    Ok(text)
}

/// One file per program and coordinator; none where there is no home.
fn default_path(program: &str, address: &str) -> Option<PathBuf> {
    let name: String =
        address.chars().map(|c| if c.is_ascii_alphanumeric() || c == '.' { c } else { '_' }).collect();
    Some(farm_trust::state_folder()?.join("identities").join(format!("{program}-{name}.pem")))
}

/// Whether `HOST:PORT` is certainly this host.
fn is_this_host(address: &str) -> bool {
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_this_host_is_spoken_to_in_the_open() {
        for here in ["127.0.0.1:7878", "localhost:1", "[::1]:7878", "127.9.9.9:5"] {
            assert!(is_this_host(here), "{here}");
        }
        for elsewhere in
            ["192.168.7.1:7878", "farm:7878", "127.0.0.1.example:1", "0.0.0.0:1", "[2001:db8::1]:1", ""]
        {
            assert!(!is_this_host(elsewhere), "{elsewhere}");
        }
        let folder = tempfile::tempdir().unwrap();
        let nowhere = AccessArgs { identity: None, ..AccessArgs::default() };
        let fault = nowhere.plain("farm.example:7878").unwrap_err().to_string();
        assert!(fault.contains("another host") && fault.contains("--ca-fingerprint"), "{fault}");
        assert!(matches!(
            AccessArgs { insecure: true, ..nowhere }.plain("farm.example:7878"),
            Ok(Access::Plain)
        ));
        let missing = AccessArgs { identity: Some(folder.path().join("none.pem")), ..AccessArgs::default() };
        assert!(missing.access("worker", "127.0.0.1:7878").unwrap_err().to_string().contains("no identity"));
        let garbage = folder.path().join("token");
        std::fs::write(&garbage, "hunter2").unwrap();
        let args = AccessArgs { token_file: Some(garbage), ..AccessArgs::default() };
        let fault = args.access("worker", "127.0.0.1:7878").unwrap_err().to_string();
        assert!(fault.contains("no token") && !fault.contains("hunter2"), "{fault}");
    }
}
