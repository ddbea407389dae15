//! What the worker program does once it knows its settings.

use crate::by_hand;
use crate::cli::Fault;
use crate::driver::{self, Config, Left, Order, WorkerError};
use crate::link::LinkError;
use crate::settings::{Command, Settings};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;
use tracing::info;

/// Runs the program to its end.
pub fn run(mut settings: Settings) -> Result<(), Fault> {
    match settings.command.take() {
        Some(Command::Render(args)) => by_hand::run(&args),
        None => {
            let config = settings.config()?;
            let runtime = tokio::runtime::Builder::new_multi_thread()
                // Rendering has its own threads; messages need few.
                .worker_threads(2)
                .enable_all()
                .build()
                .map_err(|err| Fault::failed(format!("cannot start: {err}")))?;
            let outcome = runtime.block_on(work(config));
            // Units that were left behind are not waited for.
            runtime.shutdown_background();
            outcome
        }
    }
}

async fn work(config: Config) -> Result<(), Fault> {
    let (sender, orders) = mpsc::channel(2);
    let signals = tokio::spawn(pass_signals_on(sender));
    info!(name = %config.name, threads = config.threads, coordinator = %config.target, "worker starts");
    let left = driver::run(config, orders).await;
    signals.abort();
    match left {
        Ok(Left::Farewell(reason)) => info!(%reason, "the coordinator has no more work; leaving"),
        Ok(Left::Drained) => info!("drained; leaving"),
        Ok(Left::AtOnce) => {
            return Err(Fault::failed("left at once; units that were being rendered are lost"));
        }
        Err(WorkerError::Link(error @ LinkError::Address { .. })) => return Err(Fault::input(error)),
        Err(error) => return Err(Fault::failed(error)),
    }
    Ok(())
}

/// The first signal drains, the second one leaves at once.
async fn pass_signals_on(orders: mpsc::Sender<Order>) -> std::io::Result<()> {
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    for order in [Order::Drain, Order::Leave] {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
        if orders.send(order).await.is_err() {
            break;
        }
        info!("finishing what is being rendered; a second signal leaves at once");
    }
    // Keep the channel open: a closed one would mean to leave.
    std::future::pending().await
}
