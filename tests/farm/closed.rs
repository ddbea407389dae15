//! A coordinator that is closed to strangers, and ways to knock at it.

use crate::harness::{Place, Running, Said, coordinator, run, worker};
use farm_trust::{Authority, Fingerprint, Identity, Role, SERVER_NAME, Token};
use hyper_util::rt::TokioIo;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use tokio::net::TcpStream;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::ClientConfig;
use tokio_rustls::rustls::pki_types::ServerName;
use tonic::transport::{Channel, Endpoint};

const HOUR: Duration = Duration::from_secs(3600);

/// A coordinator that serves over TLS, with its store and its authority in the test's folder.
pub struct Closed {
    pub place: Place,
    pub running: Running,
    pub address: String,
}

impl Closed {
    pub fn start() -> Self {
        Self::start_with(&[])
    }

    pub fn start_with(flags: &[&str]) -> Self {
        Self::start_logging("info", flags)
    }

    /// With log lines of `level` and above.
    pub fn start_logging(level: &str, flags: &[&str]) -> Self {
        let place = Place::new();
        let (running, address) = serve(&place, "127.0.0.1:0", flags, level);
        Self { place, running, address }
    }

    /// Kills the coordinator and starts it again at the same address.
    pub fn restart(&mut self) {
        self.running.kill();
        self.running = serve(&self.place, &self.address, &[], "info").0;
    }

    /// The authority in its folder, as an administrator of the host sees it.
    pub fn authority(&self) -> Authority {
        Authority::open(&self.place.path("trust")).unwrap()
    }

    pub fn fingerprint(&self) -> Fingerprint {
        self.authority().fingerprint()
    }

    pub fn token(&self, role: Role, uses: Option<u32>) -> Token {
        self.authority().tokens().create(role, SystemTime::now(), HOUR, uses).unwrap()
    }

    /// An identity with a certificate of the role, and the file that it is in; always the same one.
    pub fn identity(&self, role: Role) -> (Identity, PathBuf) {
        self.identity_of(role, role.name())
    }

    /// Somebody's identity, made when it is first needed.
    fn identity_of(&self, role: Role, name: &str) -> (Identity, PathBuf) {
        let path = self.place.path(&format!("{name}.pem"));
        match Identity::load(&path).unwrap() {
            Some(identity) => (identity, path),
            None => self.identity_for(role, HOUR, name),
        }
    }

    /// A new identity in `NAME.pem`, with a certificate that does not last longer than `lifetime`.
    pub fn identity_for(&self, role: Role, lifetime: Duration, name: &str) -> (Identity, PathBuf) {
        let authority = self.authority();
        let request = Identity::request().unwrap();
        let certificate =
            authority.certify(request.der(), role, self.token(role, None).id, lifetime).unwrap();
        let identity = request.answered(certificate, authority.certificate().clone());
        let path = self.place.path(&format!("{name}.pem"));
        identity.save(&path).unwrap();
        (identity, path)
    }

    /// The coordinator's own program as a client with an identity of the role.
    pub fn ask(&self, role: Role, what: &[&str]) -> Said {
        self.ask_as(role, role.name(), what)
    }

    /// The same for one of several with the role.
    pub fn ask_as(&self, role: Role, name: &str, what: &[&str]) -> Said {
        self.ask_with(&self.identity_of(role, name).1, what)
    }

    /// The same with the identity in a file.
    pub fn ask_with(&self, identity: &Path, what: &[&str]) -> Said {
        let mut command = coordinator();
        command.args(what).args(["--to", &self.address, "--json", "--identity"]).arg(identity);
        run(command)
    }

    /// A worker of one thread that joins with a token and keeps its certificate in the test's folder.
    pub fn worker(&self, token: &Token, name: &str) -> Running {
        let mut command = self.worker_command(name);
        command.env("FARM_TOKEN", token.text());
        Running::start(command)
    }

    /// A worker of one thread whose identity is in `NAME.pem`, or will be.
    pub fn worker_command(&self, name: &str) -> Command {
        let mut command = worker();
        command.args(["--connect", &self.address, "--threads", "1", "--name", name, "--retry-for", "20s"]);
        command.args(["--ca-fingerprint", &self.fingerprint().to_string()]);
        command.arg("--identity").arg(self.place.path(&format!("{name}.pem")));
        command
    }

    /// Waits for words in the coordinator's log.
    pub fn logged(&mut self, words: &str) {
        self.logged_line(&[words]);
    }

    /// Waits for a line with all these words in the coordinator's log.
    pub fn logged_line(&mut self, words: &[&str]) {
        let has_all = |line: &str| words.iter().all(|words| line.contains(words));
        self.running.wait_for(&format!("{words:?}"), |said| said.lines().any(has_all).then_some(()));
    }

    /// A gRPC channel with whatever the handshake shows.
    pub async fn channel(&self, config: ClientConfig) -> Result<Channel, tonic::transport::Error> {
        let (address, config) = (self.address.clone(), Arc::new(config));
        let connect = tower::service_fn(move |_| {
            let (address, config) = (address.clone(), config.clone());
            async move { Ok::<_, std::io::Error>(TokioIo::new(handshake(&address, config).await?)) }
        });
        Endpoint::from_static("http://closed").connect_with_connector(connect).await
    }

    /// A TLS connection over which nothing was said yet.
    pub async fn line(&self, config: ClientConfig) -> std::io::Result<TlsStream<TcpStream>> {
        handshake(&self.address, Arc::new(config)).await
    }
}

/// A coordinator over TLS in the test's folder, and its address.
fn serve(place: &Place, listen: &str, flags: &[&str], level: &str) -> (Running, String) {
    let mut command = coordinator();
    command.args(["serve", "--listen", listen, "--tls", "--store"]).arg(place.path("store"));
    command.arg("--trust").arg(place.path("trust")).args(flags).env("FARM_LOG", level);
    let mut running = Running::start(command);
    let address = running.wait_for("an address", |said| {
        let line = said.lines().find(|line| line.starts_with("listening on "))?;
        Some(line["listening on ".len()..].to_owned())
    });
    // What follows is written once the port is known.
    running.wait_for("the authority", |said| said.contains("coordinator token create").then_some(()));
    (running, address)
}

async fn handshake(address: &str, config: Arc<ClientConfig>) -> std::io::Result<TlsStream<TcpStream>> {
    let name = ServerName::try_from(SERVER_NAME).unwrap();
    tokio_rustls::TlsConnector::from(config).connect(name, TcpStream::connect(address).await?).await
}
