//! Feeds damaged input to every decoder that sees what others wrote: `fuzz_decoders [--seconds N] [--seed N] [--only NAME,..]`.

use clap::Parser;
use farm_tests::fuzz::{TARGETS, Until, meter::Meter, run};
use std::process::ExitCode;
use std::time::Duration;

#[global_allocator]
static METER: Meter = Meter;

/// Feeds damaged input to every decoder that sees what others wrote, and stops at the first that panics, stalls or bloats.
#[derive(Parser)]
struct Arguments {
    /// How long each decoder is fed.
    #[arg(long, default_value_t = 60)]
    seconds: u64,
    /// How many inputs each decoder is fed, instead of a time.
    #[arg(long)]
    inputs: Option<u64>,
    /// First seed; a failure names its own.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Which decoders; all if not given.
    #[arg(long, value_delimiter = ',')]
    only: Vec<String>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let until = match arguments.inputs {
        Some(inputs) => Until::Inputs(inputs),
        None => Until::Time(Duration::from_secs(arguments.seconds)),
    };
    let wanted = |name: &str| arguments.only.is_empty() || arguments.only.iter().any(|only| only == name);
    if let Some(unknown) =
        arguments.only.iter().find(|only| TARGETS.iter().all(|target| target.name != **only))
    {
        let known: Vec<_> = TARGETS.iter().map(|target| target.name).collect();
        eprintln!("error: --only {unknown}: there are {}", known.join(", "));
        return ExitCode::from(2);
    }
    let mut outcome = ExitCode::SUCCESS;
    println!(
        "{:<12} {:>10} {:>10} {:>12} {:>12}",
        "decoder", "inputs", "accepted", "longest ms", "largest KB"
    );
    for target in TARGETS.iter().filter(|target| wanted(target.name)) {
        match run(target, arguments.seed, until) {
            Ok(tally) => println!(
                "{:<12} {:>10} {:>10} {:>12.1} {:>12}",
                target.name,
                tally.inputs,
                tally.accepted,
                tally.longest.as_secs_f64() * 1e3,
                tally.largest >> 10
            ),
            Err(harm) => {
                let (name, seed) = (target.name, harm.seed);
                println!(
                    "{name:<12} seed {seed}: {}; see it again with --only {name} --seed {seed} --inputs 1",
                    harm.what
                );
                outcome = ExitCode::FAILURE;
            }
        }
    }
    outcome
}
