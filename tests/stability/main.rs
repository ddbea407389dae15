//! The short form of the stability suite: every case, with fixed seeds, in minutes.

use farm_tests::stability::bench::{Effort, FAMILY, Rule};
use farm_tests::stability::registry::{CASES, Case, KNOWN_RED};
use farm_tests::stability::{run, table};

#[test]
fn every_case_has_its_answer() {
    let known = |case: &&Case| !KNOWN_RED.iter().any(|(id, _)| *id == case.id);
    let cases: Vec<Case> = CASES.iter().filter(known).copied().collect();
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let rows = run::run_cases(&cases, Effort::Short, threads, &|_, _| {});
    let statistical = rows.iter().filter(|row| matches!(row.rule, Rule::Statistical { .. })).count();
    assert!(statistical <= FAMILY as usize, "{statistical} checks share the error of {FAMILY}");
    let red: Vec<_> = rows.iter().filter(|row| !row.passed()).cloned().collect();
    assert!(red.is_empty(), "\n{}", table::text(&red));
}
