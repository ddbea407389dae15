//! The short form of `fuzz_decoders`.

use farm_tests::fuzz::{TARGETS, Until, meter::Meter, run};

#[global_allocator]
static METER: Meter = Meter;

/// Inputs per decoder: a second or two each.
const INPUTS: u64 = 2_000;

// One test: the memory that is measured is that of the whole program.
#[test]
fn damaged_input_does_no_harm_to_any_decoder() {
    for target in &TARGETS {
        match run(target, 1, Until::Inputs(INPUTS)) {
            Ok(tally) => assert!(tally.accepted < tally.inputs, "{}: nothing is refused", target.name),
            Err(harm) => panic!("{}: seed {}: {}", target.name, harm.seed, harm.what),
        }
    }
}
