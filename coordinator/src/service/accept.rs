//! Accepts connections, finds out whose they are, and turns away whom it cannot use.

use super::crowd::{CONNECTIONS_MAX, Crowd};
use super::guard::Revoked;
use super::line::{Line, Wire};
use super::policy::{Peer, Standing};
use farm_trust::{Authority, Holder};
use std::collections::BTreeSet;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, watch};
use tokio_rustls::TlsAcceptor;
use tracing::{error, warn};

/// A handshake takes three messages.
const HANDSHAKE_WITHIN: Duration = Duration::from_secs(10);

/// Pause after connections could not be accepted at all, as when there are no more file descriptors.
const PAUSE: Duration = Duration::from_millis(100);

/// How often revoked tokens are looked for.
const REVOKED_EVERY: Duration = Duration::from_secs(1);

/// How often the admin's certificate is looked at.
const ADMIN_EVERY: Duration = Duration::from_secs(3600);

/// Accepted connections that wait to be served.
const WAITING_MAX: usize = 16;

/// Who may connect.
#[derive(Clone, Debug)]
pub enum Security {
    /// Whoever can reach the port.
    Open,
    /// Whoever has a certificate of this authority, or a token to get one.
    Closed(Arc<Authority>),
}

/// A connection that counts.
pub(super) struct Place {
    stranger: Option<(Arc<Mutex<Crowd>>, IpAddr)>,
    _permit: OwnedSemaphorePermit,
}

impl Place {
    /// It is known by now.
    fn known(&mut self) {
        if let Some((crowd, address)) = self.stranger.take() {
            crowd.lock().unwrap_or_else(PoisonError::into_inner).leave(address);
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.known();
    }
}

/// What is needed for each connection.
#[derive(Clone)]
struct Doorman {
    tls: Option<TlsAcceptor>,
    crowd: Arc<Mutex<Crowd>>,
    places: Arc<Semaphore>,
    revoked: Revoked,
    accepted: mpsc::Sender<io::Result<Line>>,
}

/// Begins to accept; gives the connections as they come. Ends when their receiver is dropped.
pub(super) fn accept(
    listener: TcpListener,
    security: &Security,
    revoked: Revoked,
) -> Result<mpsc::Receiver<io::Result<Line>>, farm_trust::TrustError> {
    let tls = match security {
        Security::Open => None,
        Security::Closed(authority) => Some(TlsAcceptor::from(Arc::new(authority.server_config()?))),
    };
    let (accepted, lines) = mpsc::channel(WAITING_MAX);
    let (crowd, places) = (Arc::default(), Arc::new(Semaphore::new(CONNECTIONS_MAX)));
    let doorman = Doorman { tls, crowd, places, revoked, accepted };
    tokio::spawn(async move {
        while !doorman.accepted.is_closed() {
            match listener.accept().await {
                Ok((stream, address)) => doorman.meet(stream, address),
                Err(error) => {
                    error!(%error, "no connection can be accepted at present");
                    tokio::time::sleep(PAUSE).await;
                }
            }
        }
    });
    Ok(lines)
}

impl Doorman {
    /// Looks after one connection without holding up the next.
    fn meet(&self, stream: TcpStream, address: SocketAddr) {
        let place = match self.place(address.ip()) {
            Ok(place) => place,
            Err(reason) => {
                warn!(peer = %address, reason, "connection turned away");
                return;
            }
        };
        // Grants and acknowledgements are small and must not wait for more.
        let _ = stream.set_nodelay(true);
        let doorman = self.clone();
        tokio::spawn(async move {
            match doorman.greet(stream, address, place).await {
                Ok(line) => {
                    // Nobody is served any more.
                    let _ = doorman.accepted.send(Ok(line)).await;
                }
                Err(reason) => warn!(peer = %address, reason, "connection refused"),
            }
        });
    }

    fn place(&self, address: IpAddr) -> Result<Place, String> {
        let permit = self.places.clone().try_acquire_owned().map_err(|_| "there are too many connections")?;
        let mut place = Place { stranger: None, _permit: permit };
        if self.tls.is_some() {
            let mut crowd = self.crowd.lock().unwrap_or_else(PoisonError::into_inner);
            crowd.enter(address, Instant::now()).map_err(|turned| turned.to_string())?;
            place.stranger = Some((self.crowd.clone(), address));
        }
        Ok(place)
    }

    async fn greet(&self, stream: TcpStream, address: SocketAddr, mut place: Place) -> Result<Line, String> {
        let Some(tls) = &self.tls else {
            let peer = Peer { address, standing: Standing::Open };
            return Ok(Line::new(Wire::Open(stream), peer, self.revoked.clone(), place));
        };
        let stream = tokio::time::timeout(HANDSHAKE_WITHIN, tls.accept(stream))
            .await
            .map_err(|_| format!("no handshake within {} s", HANDSHAKE_WITHIN.as_secs()))?
            .map_err(|err| format!("no handshake: {err}"))?;
        let standing = match stream.get_ref().1.peer_certificates() {
            Some([certificate, ..]) => {
                Standing::Known(Holder::of(certificate).map_err(|err| err.to_string())?)
            }
            _ => Standing::Stranger,
        };
        if standing != Standing::Stranger {
            place.known();
        }
        Ok(Line::new(Wire::Tls(Box::new(stream)), Peer { address, standing }, self.revoked.clone(), place))
    }
}

/// Keeps up with the tokens that are revoked, until nobody listens any more.
pub(super) fn watch_revoked(security: &Security) -> Revoked {
    let Security::Closed(authority) = security else { return watch::channel(Arc::default()).1 };
    let tokens = authority.tokens().clone();
    let (sender, revoked) = watch::channel(Arc::new(tokens.revoked().unwrap_or_default()));
    tokio::spawn(async move {
        while !sender.is_closed() {
            tokio::time::sleep(REVOKED_EVERY).await;
            let tokens = tokens.clone();
            match tokio::task::spawn_blocking(move || tokens.revoked()).await {
                Ok(Ok(found)) => keep(&sender, found),
                Ok(Err(error)) => warn!(%error, "revoked tokens cannot be looked up"),
                Err(_) => return,
            }
        }
    });
    revoked
}

/// Keeps the admin's identity in the authority's folder good, however long the coordinator runs.
pub(super) fn look_after_admin(authority: Arc<Authority>) {
    tokio::spawn(async move {
        loop {
            tokio::time::sleep(ADMIN_EVERY).await;
            let authority = authority.clone();
            match tokio::task::spawn_blocking(move || authority.keep_admin()).await {
                Ok(Ok(())) => {}
                Ok(Err(error)) => warn!(%error, "the admin's certificate cannot be renewed"),
                Err(_) => return,
            }
        }
    });
}

fn keep(sender: &watch::Sender<Arc<BTreeSet<farm_trust::TokenId>>>, found: BTreeSet<farm_trust::TokenId>) {
    sender.send_if_modified(|known| {
        let news = **known != found;
        if news {
            *known = Arc::new(found);
        }
        news
    });
}
