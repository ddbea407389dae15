//! One accepted connection, and the reasons to hang up.

use super::accept::Place;
use super::guard::Revoked;
use super::policy::{Peer, Refusal, Standing};
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, ready};
use std::time::{Duration, SystemTime};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio_rustls::server::TlsStream;
use tonic::transport::server::Connected;
use tracing::warn;

/// Whoever does not begin to speak HTTP/2 within this is hung up on.
const GREETING_WITHIN: Duration = Duration::from_secs(10);

/// Whoever has no certificate after this, is hung up on: joining takes a second.
const STRANGER_FOR: Duration = Duration::from_secs(30);

/// What every HTTP/2 connection begins with (RFC 9113, section 3.4).
const GREETING: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

/// The bytes underneath.
pub(super) enum Wire {
    /// As they are.
    Open(TcpStream),
    /// Encrypted.
    Tls(Box<TlsStream<TcpStream>>),
}

/// A connection that gRPC is spoken over.
pub(super) struct Line {
    wire: Wire,
    peer: Peer,
    /// Bytes of the greeting that came.
    greeted: usize,
    is_greeted: Arc<AtomicBool>,
    end: Pin<Box<dyn Future<Output = String> + Send>>,
    /// Counted as long as this lives.
    _place: Place,
}

impl Line {
    pub fn new(wire: Wire, peer: Peer, revoked: Revoked, place: Place) -> Self {
        let is_greeted = Arc::new(AtomicBool::new(false));
        let end = Box::pin(end(peer.standing.clone(), revoked, is_greeted.clone()));
        Self { wire, peer, greeted: 0, is_greeted, end, _place: place }
    }

    /// Compares what came with what has to come first.
    fn check_greeting(&mut self, came: &[u8]) -> io::Result<()> {
        let expected = &GREETING[self.greeted..];
        let length = expected.len().min(came.len());
        if came[..length] != expected[..length] {
            return Err(self.hang_up("what it says is no HTTP/2"));
        }
        self.greeted += length;
        self.is_greeted.store(self.greeted == GREETING.len(), Ordering::Relaxed);
        Ok(())
    }

    fn hang_up(&self, reason: &str) -> io::Error {
        warn!(peer = %self.peer.address, reason, "hanging up");
        io::Error::new(io::ErrorKind::ConnectionAborted, reason.to_owned())
    }
}

/// Waits until there is a reason to hang up.
async fn end(standing: Standing, mut revoked: Revoked, is_greeted: Arc<AtomicBool>) -> String {
    let silence = async {
        tokio::time::sleep(GREETING_WITHIN).await;
        if is_greeted.load(Ordering::Relaxed) {
            std::future::pending::<()>().await;
        }
        format!("it said nothing for {} s", GREETING_WITHIN.as_secs())
    };
    let standing = async {
        let holder = match standing {
            Standing::Open => return std::future::pending().await,
            Standing::Stranger => {
                tokio::time::sleep(STRANGER_FOR).await;
                return format!("it has shown no certificate for {} s", STRANGER_FOR.as_secs());
            }
            Standing::Known(holder) => holder,
        };
        let left = holder.expires.duration_since(SystemTime::now()).unwrap_or_default();
        let revocation = async {
            // Calls are refused, with the reason, from the beginning; lines from before have to end.
            let before = revoked.borrow().contains(&holder.token);
            let unheard = revoked.wait_for(|revoked| revoked.contains(&holder.token)).await.is_err();
            if before || unheard {
                std::future::pending::<()>().await;
            }
        };
        tokio::select! {
            () = tokio::time::sleep(left.min(Duration::from_secs(1 << 30))) => Refusal::Expired.to_string(),
            () = revocation => Refusal::Revoked(holder.token).to_string(),
        }
    };
    tokio::select! {
        reason = silence => reason,
        reason = standing => reason,
    }
}

impl AsyncRead for Line {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if let Poll::Ready(reason) = self.end.as_mut().poll(context) {
            self.end = Box::pin(std::future::pending());
            return Poll::Ready(Err(self.hang_up(&reason)));
        }
        let before = buffer.filled().len();
        match &mut self.wire {
            Wire::Open(wire) => ready!(Pin::new(wire).poll_read(context, buffer))?,
            Wire::Tls(wire) => ready!(Pin::new(wire).poll_read(context, buffer))?,
        }
        let greeting = self.greeted < GREETING.len();
        Poll::Ready(if greeting { self.check_greeting(&buffer.filled()[before..]) } else { Ok(()) })
    }
}

impl AsyncWrite for Line {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        match &mut self.wire {
            Wire::Open(wire) => Pin::new(wire).poll_write(context, bytes),
            Wire::Tls(wire) => Pin::new(wire).poll_write(context, bytes),
        }
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        match &mut self.wire {
            Wire::Open(wire) => Pin::new(wire).poll_write_vectored(context, bytes),
            Wire::Tls(wire) => Pin::new(wire).poll_write_vectored(context, bytes),
        }
    }

    fn is_write_vectored(&self) -> bool {
        match &self.wire {
            Wire::Open(wire) => wire.is_write_vectored(),
            Wire::Tls(wire) => wire.is_write_vectored(),
        }
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        match &mut self.wire {
            Wire::Open(wire) => Pin::new(wire).poll_flush(context),
            Wire::Tls(wire) => Pin::new(wire).poll_flush(context),
        }
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        match &mut self.wire {
            Wire::Open(wire) => Pin::new(wire).poll_shutdown(context),
            Wire::Tls(wire) => Pin::new(wire).poll_shutdown(context),
        }
    }
}

impl Connected for Line {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        self.peer.clone()
    }
}
