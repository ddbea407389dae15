//! What the worker program does once it knows its settings.

use crate::by_hand;
use crate::cli::Fault;
use crate::driver::{self, Config, Left, Order, WorkerError};
use crate::link::LinkError;
use crate::settings::{Command, Settings};
use crate::spare::Load;
use crate::time_of_day;
use chrono::NaiveTime;
use std::time::Duration;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::mpsc;
use tracing::{info, warn};

/// A host that others need is given back within this, whatever is being rendered.
const MAKE_WAY_WITHIN: Duration = Duration::from_secs(3);

/// When a worker may use its host.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Availability {
    /// Time for leaving after the first signal.
    pub grace: Duration,
    /// Processors that others may use beside it.
    pub max_load: Option<f64>,
    /// To be gone by then.
    pub until: Option<NaiveTime>,
}

/// Runs the program to its end.
pub fn run(mut settings: Settings) -> Result<(), Fault> {
    match settings.command.take() {
        Some(Command::Render(args)) => by_hand::run(&args),
        None => {
            settings.be_nice()?;
            let availability = settings.availability();
            let config = settings.config()?;
            let runtime = tokio::runtime::Builder::new_multi_thread()
                // Rendering has its own threads; messages need few.
                .worker_threads(2)
                .enable_all()
                .build()
                .map_err(|err| Fault::failed(format!("cannot start: {err}")))?;
            let outcome = runtime.block_on(work(config, availability));
            // Units that were left behind are not waited for.
            runtime.shutdown_background();
            outcome
        }
    }
}

/// Works whenever the host may be used, until told to leave.
async fn work(config: Config, availability: Availability) -> Result<(), Fault> {
    let mut signals = Signals::listen()?;
    let mut load = availability.max_load.map(|_| Load::new()).transpose()?;
    info!(name = %config.name, threads = config.threads, coordinator = %config.target, "worker starts");
    loop {
        if let (Some(load), Some(limit)) = (&mut load, availability.max_load) {
            info!(limit, "waiting for others to leave this host alone");
            tokio::select! {
                () = load.quiet(limit) => {}
                () = signals.next() => return Ok(()),
                () = time_of_day::reached(availability.until, Duration::ZERO) => return Ok(()),
            }
        }
        let (outcome, why) = work_while_allowed(config.clone(), availability, &mut signals, &mut load).await;
        if why != Some(Why::Busy) || !matches!(outcome, Ok(Left::Drained | Left::Late)) {
            return end(outcome);
        }
    }
}

/// Why a worker was told to leave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Why {
    Signal,
    TimeOfDay,
    Busy,
}

async fn work_while_allowed(
    config: Config,
    Availability { grace, max_load, until }: Availability,
    signals: &mut Signals,
    load: &mut Option<Load>,
) -> (Result<Left, WorkerError>, Option<Why>) {
    let (orders, receiver) = mpsc::channel(4);
    let mut worker = std::pin::pin!(driver::run(config, receiver));
    let mut why = None;
    loop {
        let told = tokio::select! {
            outcome = &mut worker => return (outcome, why),
            () = signals.next() => Why::Signal,
            () = time_of_day::reached(until, grace), if why.is_none() => Why::TimeOfDay,
            () = busy(load, max_load), if why.is_none() => Why::Busy,
        };
        let order = match (told, why) {
            (Why::Signal, Some(Why::Signal)) => Order::Leave,
            (Why::Busy, _) => Order::Drain(MAKE_WAY_WITHIN),
            (Why::Signal | Why::TimeOfDay, _) => {
                info!(?grace, "finishing what is being rendered; a second signal leaves at once");
                Order::Drain(grace)
            }
        };
        // A signal while the worker makes way for others ends the program as well.
        why = Some(told);
        // A full channel holds orders enough.
        let _ = orders.try_send(order);
    }
}

async fn busy(load: &mut Option<Load>, limit: Option<f64>) {
    match (load, limit) {
        (Some(load), Some(limit)) => {
            load.busy(limit).await;
        }
        _ => std::future::pending().await,
    }
}

fn end(outcome: Result<Left, WorkerError>) -> Result<(), Fault> {
    match outcome {
        Ok(Left::Farewell(reason)) => info!(%reason, "the coordinator has no more work; leaving"),
        Ok(Left::Drained) => info!("drained; leaving"),
        Ok(Left::Late) => warn!("time is up; what was not acknowledged is rendered again elsewhere"),
        Ok(Left::AtOnce) => {
            return Err(Fault::failed("left at once; units that were being rendered are lost"));
        }
        Err(WorkerError::Link(error @ LinkError::Address { .. })) => return Err(Fault::input(error)),
        Err(error) => return Err(Fault::failed(error)),
    }
    Ok(())
}

/// SIGINT and SIGTERM.
struct Signals {
    interrupt: Signal,
    terminate: Signal,
}

impl Signals {
    fn listen() -> Result<Self, Fault> {
        let failed = |err| Fault::failed(format!("cannot listen to signals: {err}"));
        let interrupt = signal(SignalKind::interrupt()).map_err(failed)?;
        let terminate = signal(SignalKind::terminate()).map_err(failed)?;
        Ok(Self { interrupt, terminate })
    }

    async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}
