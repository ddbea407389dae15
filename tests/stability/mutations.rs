//! The proof that the stability suite sees bugs: `cargo test -p farm-tests --features mutations --test mutations`.

use farm_tests::stability::mutation_proof::{Verdict, matrix, text};

#[test]
fn every_known_bug_is_seen() {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let verdicts = matrix(threads, &mut |_| {});
    assert!(verdicts.iter().all(Verdict::is_right), "\n{}", text(&verdicts));
}
