//! Pipes of a farm over simulated cables: whatever goes into one end inside a host travels as TCP to the other host.

use crate::faults::Dice;
use futures::future::{select_ok, try_join};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use tokio::io::{
    AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, DuplexStream, copy_bidirectional, duplex, split,
};
use tokio::sync::mpsc;
use turmoil::net::{TcpListener, TcpStream};

/// Where coordinators are: the first, and one that may stand by. They share an address that moves: whoever calls it reaches
/// one that answers.
pub const COORDINATORS: [&str; 2] = ["coordinator", "standby"];
const PORT: u16 = 7878;

/// Bytes in flight within a host.
const PIPE_BYTES: usize = 1 << 16;

/// What a worker's cable does to what passes.
#[derive(Debug)]
pub struct Cable {
    /// Connections break in the middle of a message, as when a bit turns over in one that is authenticated.
    pub loose: AtomicBool,
    dice: Mutex<Dice>,
}

/// Percent of pieces that do not arrive whole over a loose cable.
const BREAKS: u64 = 4;

impl Cable {
    pub fn new(seed: u64) -> Self {
        Self { loose: AtomicBool::new(false), dice: Mutex::new(Dice::new(seed)) }
    }

    /// How much of a piece arrives.
    fn arrives(&self, piece: usize) -> usize {
        let mut dice = self.dice.lock().expect("nothing panics in here");
        let breaks = self.loose.load(Ordering::Relaxed) && dice.percent(BREAKS);
        if breaks { dice.roll(piece as u64) as usize } else { piece }
    }

    async fn carry(
        &self,
        mut from: impl AsyncRead + Unpin,
        mut to: impl AsyncWrite + Unpin,
    ) -> std::io::Result<()> {
        let mut bytes = [0; 4096];
        loop {
            let count = from.read(&mut bytes).await?;
            if count == 0 {
                return to.shutdown().await;
            }
            let whole = self.arrives(count);
            to.write_all(&bytes[..whole]).await?;
            if whole < count {
                return Err(std::io::ErrorKind::ConnectionReset.into());
            }
        }
    }
}

/// The worker's side: takes far ends of pipes and connects each to a coordinator.
pub fn dialer(cable: Arc<Cable>) -> mpsc::Sender<DuplexStream> {
    let (sender, mut pipes) = mpsc::channel::<DuplexStream>(1);
    tokio::spawn(async move {
        while let Some(pipe) = pipes.recv().await {
            let cable = cable.clone();
            tokio::spawn(async move {
                let calls = COORDINATORS.map(|name| Box::pin(TcpStream::connect((name, PORT))));
                // A line that breaks ends the pipe, which is all there is to say.
                if let Ok((line, _)) = select_ok(calls).await {
                    let ((near_in, near_out), (far_in, far_out)) = (split(pipe), line.into_split());
                    let _ = try_join(cable.carry(near_in, far_out), cable.carry(far_in, near_out)).await;
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
