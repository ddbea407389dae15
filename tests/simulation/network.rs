//! Pipes of a farm over simulated cables: whatever goes into one end inside a host travels as TCP to the other host.

use tokio::io::{DuplexStream, copy_bidirectional, duplex};
use tokio::sync::mpsc;
use turmoil::net::{TcpListener, TcpStream};

/// Where the coordinator is.
pub const COORDINATOR: &str = "coordinator";
const PORT: u16 = 7878;

/// Bytes in flight within a host.
const PIPE_BYTES: usize = 1 << 16;

/// The worker's side: takes far ends of pipes and connects each to the coordinator.
pub fn dialer() -> mpsc::Sender<DuplexStream> {
    let (sender, mut pipes) = mpsc::channel::<DuplexStream>(1);
    tokio::spawn(async move {
        while let Some(mut pipe) = pipes.recv().await {
            tokio::spawn(async move {
                // A line that breaks ends the pipe, which is all there is to say.
                if let Ok(mut line) = TcpStream::connect((COORDINATOR, PORT)).await {
                    let _ = copy_bidirectional(&mut pipe, &mut line).await;
                }
            });
        }
    });
    sender
}

/// The coordinator's side: gives out the far end of a pipe for each line that comes in.
pub async fn accept(pipes: mpsc::Sender<DuplexStream>) -> std::io::Result<()> {
    let listener = TcpListener::bind(("0.0.0.0", PORT)).await?;
    loop {
        let (mut line, _) = listener.accept().await?;
        let (mut near, far) = duplex(PIPE_BYTES);
        if pipes.send(far).await.is_err() {
            return Ok(());
        }
        tokio::spawn(async move {
            let _ = copy_bidirectional(&mut near, &mut line).await;
        });
    }
}
