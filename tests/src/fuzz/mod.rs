//! Damaged input for every decoder that sees what others wrote: whatever the bytes are, the answer comes soon, takes little
//! memory, and is a value or a sentence; never a panic.
//!
//! Inputs are mutations of valid ones, made by a seed: a failure prints the seed, and the same seed makes the same input. The
//! valid ones are generated, so that no corpus has to be kept.

mod images;
mod messages;
pub mod meter;
mod mutate;
mod scenes;
mod trust;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};

/// Far beyond what any of these small inputs takes, also on a busy machine.
const INPUT_TIME_MAX: Duration = Duration::from_secs(10);

/// Bytes that decoding a small input may take at once: a picture of moderate size may unpack from next to nothing.
const INPUT_MEMORY_MAX: usize = 1 << 30;

/// One decoder.
pub struct Target {
    /// What it is called.
    pub name: &'static str,
    /// Valid inputs.
    pub corpus: fn() -> Vec<Vec<u8>>,
    /// Decodes; whether the input was accepted. May write to the file at the path.
    pub decode: fn(&[u8], &Path) -> bool,
}

/// All of them.
pub const TARGETS: [Target; 9] = [
    Target { name: "messages", corpus: messages::corpus, decode: messages::decode },
    Target { name: "partial", corpus: images::partials, decode: images::decode_partial },
    Target { name: "snapshot", corpus: scenes::snapshots, decode: scenes::decode_snapshot },
    Target { name: "gltf", corpus: scenes::documents, decode: scenes::decode_document },
    Target { name: "glb", corpus: scenes::containers, decode: scenes::decode_container },
    Target { name: "picture", corpus: images::pictures, decode: images::decode_picture },
    Target { name: "texture", corpus: images::textures, decode: images::decode_texture },
    Target { name: "environment", corpus: images::environments, decode: images::decode_environment },
    Target { name: "trust", corpus: trust::corpus, decode: trust::decode },
];

/// How far a run went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Inputs that were decoded.
    pub inputs: u64,
    /// Those that were accepted.
    pub accepted: u64,
    /// Longest time of one.
    pub longest: Duration,
    /// Most bytes that one had allocated at once; 0 where nobody measures.
    pub largest: usize,
}

/// An input that did harm.
#[derive(Debug)]
pub struct Harm {
    /// Which one.
    pub seed: u64,
    /// What it did.
    pub what: String,
}

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub enum Until {
    /// After so many inputs.
    Inputs(u64),
    /// After so long.
    Time(Duration),
}

/// Decodes inputs from `seed` on. Stops at the first that does harm.
pub fn run(target: &Target, seed: u64, until: Until) -> Result<Tally, Harm> {
    let corpus = (target.corpus)();
    let folder = tempfile::tempdir().expect("a folder for temporary files");
    let file = folder.path().join("input");
    for (index, valid) in corpus.iter().enumerate() {
        assert!((target.decode)(valid, &file), "valid input {index} of {} is not accepted", target.name);
    }
    let (mut tally, begun) = (Tally::default(), Instant::now());
    loop {
        let done = match until {
            Until::Inputs(inputs) => tally.inputs >= inputs,
            Until::Time(time) => begun.elapsed() >= time,
        };
        if done {
            return Ok(tally);
        }
        let seed = seed.wrapping_add(tally.inputs);
        let input = mutate::input(&corpus, seed);
        let started = Instant::now();
        let before = meter::begin();
        let outcome = catch_unwind(AssertUnwindSafe(|| (target.decode)(&input, &file)));
        let (memory, time) = (meter::peak_since(before), started.elapsed());
        let harm = |what: String| Harm { seed, what };
        let accepted = outcome.map_err(|_| harm("it panicked".to_owned()))?;
        if time > INPUT_TIME_MAX {
            return Err(harm(format!("it took {time:?}")));
        }
        if memory > INPUT_MEMORY_MAX {
            return Err(harm(format!("it took {memory} bytes of memory for {} bytes", input.len())));
        }
        tally.inputs += 1;
        tally.accepted += u64::from(accepted);
        tally.longest = tally.longest.max(time);
        tally.largest = tally.largest.max(memory);
    }
}
