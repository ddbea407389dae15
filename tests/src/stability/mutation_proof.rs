//! The suite's own test: the renderer's known bugs, switched on one at a time, must each turn a case red.

use super::bench::Effort;
use super::registry::{CASES, Case};
use super::run;
use farm_render::mutations::{self, Mutation};
use std::fmt::Write;

/// Cases that are asked about every bug: the quick ones, of which each sees something else.
const WITNESSES: [&str; 18] = [
    "T2", "T3", "T11", "T13", "T14", "T16", "T18", "T22", "T25", "T29", "T32", "T34", "T37", "T49", "T52",
    "T60", "T64", "L7",
];

/// One line of the matrix.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// The bug; none for the renderer as it is.
    pub mutation: Option<Mutation>,
    /// Names of the cases that turned red.
    pub caught_by: Vec<&'static str>,
}

impl Verdict {
    /// Whether a bug was seen, or the renderer as it is was not blamed.
    pub fn is_right(&self) -> bool {
        self.caught_by.is_empty() == self.mutation.is_none()
    }
}

/// Runs the witnesses without a bug, and with each one. `progress` hears of each line.
pub fn matrix(threads: usize, progress: &mut dyn FnMut(&Verdict)) -> Vec<Verdict> {
    let witness = |case: &&Case| WITNESSES.contains(&case.id);
    let slow = ["T19", "T20", "T46", "T59"];
    let quick: Vec<Case> = CASES.iter().filter(witness).copied().collect();
    let thorough: Vec<Case> = CASES.iter().filter(|case| slow.contains(&case.id)).copied().collect();
    let mut verdicts = Vec::new();
    for mutation in std::iter::once(None).chain(Mutation::ALL.map(Some)) {
        mutations::select(mutation);
        let mut caught_by = red_cases(&quick, threads);
        if caught_by.is_empty() {
            // Slower cases are asked where the quick ones saw nothing; and of course where there is nothing to see.
            caught_by = red_cases(&thorough, threads);
        }
        let verdict = Verdict { mutation, caught_by };
        progress(&verdict);
        verdicts.push(verdict);
    }
    mutations::select(None);
    verdicts
}

fn red_cases(cases: &[Case], threads: usize) -> Vec<&'static str> {
    let rows = run::run_cases(cases, Effort::Short, threads, &|_, _| {});
    let mut red: Vec<_> = rows.iter().filter(|row| !row.passed()).map(|row| row.id).collect();
    red.dedup();
    red
}

/// The matrix as a table, one bug per line.
pub fn text(verdicts: &[Verdict]) -> String {
    let mut out = String::new();
    for verdict in verdicts {
        let name = verdict.mutation.map_or("none".to_owned(), |mutation| format!("{mutation:?}"));
        let by =
            if verdict.caught_by.is_empty() { "nothing".to_owned() } else { verdict.caught_by.join(" ") };
        let mark = if verdict.is_right() { "ok" } else { "FAILED" };
        let _ = writeln!(out, "{name:24} {mark:7} seen by {by}");
    }
    out
}
