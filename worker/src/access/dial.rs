//! One connection, with or without TLS.

use super::Access;
use farm_trust::SERVER_NAME;
use hyper_util::rt::TokioIo;
use std::error::Error;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::pki_types::ServerName;
use tokio_rustls::rustls::{self, ClientConfig};
use tonic::Status;
use tonic::transport::{Channel, Endpoint};

/// Bytes that may be on their way within one stream: a few large results, so that a slow answer never stalls a fast line.
const STREAM_WINDOW: u32 = 8 << 20;

/// Bytes that may be on their way within one connection: scenes beside results.
const CONNECTION_WINDOW: u32 = 32 << 20;

/// A host that does not answer at all for this long is tried again.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// Why there is no connection.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DialError {
    /// What was given is no address.
    #[error("{0:?} is no address of a coordinator: write HOST:PORT")]
    Address(String),
    /// One side does not want the other; trying again is of no use.
    #[error("{0}")]
    Refused(String),
    /// It may work later.
    #[error("{0}")]
    Failed(String),
}

/// Connects to `HOST:PORT`.
pub async fn dial(address: &str, access: &Access) -> Result<Channel, DialError> {
    match access {
        Access::Plain => {
            let endpoint = endpoint(address)?;
            tuned(endpoint).connect().await.map_err(|err| failure(&err))
        }
        Access::Secure(keys) => secure_channel(address, keys.config(address).await?).await,
    }
}

/// Connects over TLS.
pub(super) async fn secure_channel(address: &str, config: Arc<ClientConfig>) -> Result<Channel, DialError> {
    let endpoint = endpoint(address)?;
    let (host, connector) = (address.to_owned(), TlsConnector::from(config));
    let connect = tower::service_fn(move |_| {
        let (host, connector) = (host.clone(), connector.clone());
        async move {
            let name = ServerName::try_from(SERVER_NAME).expect("our own name is one");
            let line = TcpStream::connect(&host).await?;
            line.set_nodelay(true)?;
            Ok::<_, std::io::Error>(TokioIo::new(connector.connect(name, line).await?))
        }
    });
    tuned(endpoint).connect_with_connector(connect).await.map_err(|err| failure(&err))
}

fn endpoint(address: &str) -> Result<Endpoint, DialError> {
    Endpoint::from_shared(format!("http://{address}")).map_err(|_| DialError::Address(address.to_owned()))
}

/// What all connections of the farm have in common.
pub(crate) fn tuned(endpoint: Endpoint) -> Endpoint {
    endpoint
        .connect_timeout(CONNECT_TIMEOUT)
        .tcp_nodelay(true)
        .initial_stream_window_size(STREAM_WINDOW)
        .initial_connection_window_size(CONNECTION_WINDOW)
        .http2_keep_alive_interval(Duration::from_secs(5))
        .keep_alive_timeout(Duration::from_secs(10))
        .keep_alive_while_idle(true)
}

/// Tells whether another attempt is of use.
fn failure(error: &(dyn Error + 'static)) -> DialError {
    match refused_by_tls(error) {
        Some(reason) => DialError::Refused(reason),
        None => DialError::Failed(root_cause(error)),
    }
}

/// What went wrong in the handshake, when that is why there is no connection.
pub fn refused_by_tls(error: &(dyn Error + 'static)) -> Option<String> {
    let mut cause = error;
    let found = loop {
        match (tls_error(cause), cause.source()) {
            (Some(found), _) => break found,
            (None, Some(source)) => cause = source,
            (None, None) => return None,
        }
    };
    Some(match found {
        rustls::Error::AlertReceived(alert) => {
            format!("it does not accept this certificate ({alert:?}): join again, with a new token")
        }
        rustls::Error::General(reason) => reason.clone(),
        rustls::Error::InvalidMessage(_) => "it does not speak TLS".to_owned(),
        other => format!("it is not the right one: {other}"),
    })
}

/// An I/O error hides what it carries from `source`.
fn tls_error<'a>(error: &'a (dyn Error + 'static)) -> Option<&'a rustls::Error> {
    let inner = error.downcast_ref::<std::io::Error>().and_then(std::io::Error::get_ref);
    error.downcast_ref().or_else(|| inner?.downcast_ref())
}

/// The innermost error: "connection refused" rather than "transport error".
pub(crate) fn root_cause(error: &dyn Error) -> String {
    let mut cause = error;
    while let Some(source) = cause.source() {
        cause = source;
    }
    cause.to_string()
}

/// A status in words.
pub(crate) fn sentence(status: &Status) -> String {
    match status.source() {
        Some(source) => root_cause(source),
        None if status.message().is_empty() => status.code().to_string(),
        None => status.message().to_owned(),
    }
}
