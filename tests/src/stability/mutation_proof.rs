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

/// Slower cases, asked where the quick ones saw nothing; and of course where there is nothing to see.
const SLOW_WITNESSES: [&str; 4] = ["T19", "T20", "T46", "T59"];

/// One line of the matrix.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// The bug; none for the renderer as it is.
    pub mutation: Option<Mutation>,
    /// Whether the slower cases were asked too.
    pub asked_all: bool,
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
    let mut verdicts = Vec::new();
    for mutation in std::iter::once(None).chain(Mutation::ALL.map(Some)) {
        mutations::select(mutation);
        let mut caught_by = red_cases(&WITNESSES, threads);
        let asked_all = caught_by.is_empty();
        if asked_all {
            caught_by = red_cases(&SLOW_WITNESSES, threads);
        }
        let verdict = Verdict { mutation, asked_all, caught_by };
        progress(&verdict);
        verdicts.push(verdict);
    }
    mutations::select(None);
    verdicts
}

fn red_cases(ids: &[&str], threads: usize) -> Vec<&'static str> {
    let cases: Vec<Case> = CASES.iter().filter(|case| ids.contains(&case.id)).copied().collect();
    assert_eq!(cases.len(), ids.len(), "every witness is a case");
    let rows = run::run_cases(&cases, Effort::Short, threads, &|_, _| {});
    let mut red: Vec<_> = rows.iter().filter(|row| !row.passed()).map(|row| row.id).collect();
    red.dedup();
    red
}

/// Titles of the matrix' columns: the bug, the verdict, and the cases.
pub fn titles() -> String {
    let cases = WITNESSES.iter().chain(&SLOW_WITNESSES);
    cases.fold(format!("{:24} {:7}", "bug", "verdict"), |line, id| format!("{line} {id:>3}")) + "\n"
}

/// A line of the matrix: `x` where a case turned red, `.` where it stayed green, blank where it was not asked.
pub fn line(verdict: &Verdict) -> String {
    let name = verdict.mutation.map_or("none".to_owned(), |mutation| format!("{mutation:?}"));
    let mut line = format!("{name:24} {:7}", if verdict.is_right() { "ok" } else { "FAILED" });
    for (ids, asked) in [(&WITNESSES[..], true), (&SLOW_WITNESSES[..], verdict.asked_all)] {
        for id in ids {
            let mark = match (asked, verdict.caught_by.contains(id)) {
                (false, _) => "",
                (true, true) => "x",
                (true, false) => ".",
            };
            let _ = write!(line, " {mark:>3}");
        }
    }
    line.trim_end().to_owned() + "\n"
}

/// The matrix, one bug per line.
pub fn text(verdicts: &[Verdict]) -> String {
    verdicts.iter().fold(titles(), |text, verdict| text + &line(verdict))
}
