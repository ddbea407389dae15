//! Runs cases, several at a time.

use super::bench::{Bench, Effort, Row};
use super::registry::Case;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Runs one case. A panic is a red row, not the end.
pub fn run_case(case: &Case, effort: Effort) -> Vec<Row> {
    let mut bench = Bench::new(case.id, case.what, effort);
    if let Err(panic) = catch_unwind(AssertUnwindSafe(|| (case.run)(&mut bench))) {
        let said = panic.downcast_ref::<String>().map(String::as_str);
        let said = said.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("panic");
        bench.fell(format!("panic: {said}"));
    }
    bench.into_rows()
}

/// Runs cases on `threads` threads; rows come in the order of the cases. `progress` hears of each case that is done.
pub fn run_cases(
    cases: &[Case],
    effort: Effort,
    threads: usize,
    progress: &(dyn Fn(&Case, &[Row]) + Sync),
) -> Vec<Row> {
    let next = AtomicUsize::new(0);
    let rows = Mutex::new(vec![Vec::new(); cases.len()]);
    let work = || {
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(case) = cases.get(index) else { break };
            let found = run_case(case, effort);
            progress(case, &found);
            rows.lock().expect("no thread panics while it holds the rows")[index] = found;
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(work);
        }
    });
    rows.into_inner().expect("no thread panics while it holds the rows").into_iter().flatten().collect()
}
