//! Whole farms on a simulated network, by seed: the real coordinator, store logic, scheduler, workers, gRPC and HTTP/2; only
//! cables, clocks, disks and processor time are played. Hosts die and come back, lines break in one direction or both, in the
//! middle of messages, are slow, or hold everything back and let it go at once; the store is full, slow, or does what it says it
//! did not; a coordinator's disk hangs until another coordinator has taken its place; workers lie, fail, and send garbage. When
//! the accidents stop, the job completes with the bits of a single process.
//!
//! `cargo test -p farm-tests --test simulation` runs 500 farms; `cargo test -p farm-tests --test simulation -- --seeds 10000`
//! as many as asked for, and `-- --seed 17` one of them, with its log.

mod coordinator;
mod faults;
mod network;
mod picture;
mod store;
mod witness;
mod worker;
mod world;

use indicatif::{ProgressBar, ProgressStyle};
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// Farms per ordinary run of the tests.
const SEEDS: u64 = 500;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |flag: &str| {
        let place = arguments.iter().position(|argument| argument == flag)?;
        arguments.get(place + 1)?.parse::<u64>().ok()
    };
    // `cargo test NAME` asks every target for the tests of that name.
    let others = arguments
        .first()
        .is_some_and(|first| !first.starts_with('-') && !"simulation".contains(first.as_str()));
    if others || arguments.iter().any(|argument| argument == "--list") {
        return ExitCode::SUCCESS;
    }
    world::note_panics();
    match number("--seed") {
        Some(seed) => alone(seed),
        None => many(number("--from").unwrap_or(0), number("--seeds").unwrap_or(SEEDS)),
    }
}

/// One farm, with its log.
fn alone(seed: u64) -> ExitCode {
    tracing_subscriber::fmt().with_max_level(tracing::Level::DEBUG).with_writer(std::io::stderr).init();
    match world::attempt(seed) {
        Ok(story) => {
            println!("seed {seed}: {story:?}");
            ExitCode::SUCCESS
        }
        Err(fault) => {
            println!("seed {seed} failed: {fault}");
            ExitCode::FAILURE
        }
    }
}

fn many(from: u64, count: u64) -> ExitCode {
    let (next, begun) = (AtomicU64::new(from), Instant::now());
    let threads = std::thread::available_parallelism().map_or(1, |threads| threads.get());
    let style = "{bar:32} {pos} of {len} farms, {eta} left";
    let bar =
        ProgressBar::new(count).with_style(ProgressStyle::with_template(style).expect("a template in order"));
    let run = || -> Result<world::Story, (u64, String)> {
        let mut sum = world::Story::default();
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= from + count {
                return Ok(sum);
            }
            let story = world::attempt(seed);
            if story.is_err() {
                next.store(from + count, Ordering::Relaxed);
            }
            sum += story.map_err(|fault| (seed, fault))?;
            bar.inc(1);
        }
    };
    let stories: Vec<_> = std::thread::scope(|scope| {
        let runs: Vec<_> = (0..threads).map(|_| scope.spawn(run)).collect();
        runs.into_iter().map(|run| run.join().expect("faults are returned, not thrown")).collect()
    });
    bar.finish_and_clear();
    let mut sum = world::Story::default();
    for story in stories {
        match story {
            Ok(story) => sum += story,
            Err((seed, fault)) => {
                println!("seed {seed} failed: {fault}");
                println!("see it alone: cargo test -p farm-tests --test simulation -- --seed {seed}");
                return ExitCode::FAILURE;
            }
        }
    }
    println!("{count} farms in {:.1?}: {sum:?}", begun.elapsed());
    ExitCode::SUCCESS
}
