//! Rows for people, for scripts and for the README.

use super::bench::Row;
use std::fmt::Write;

/// Column titles.
const TITLES: [&str; 12] = [
    "id",
    "what",
    "parameters",
    "expected",
    "measured",
    "error",
    "relative",
    "in SE",
    "rule",
    "samples",
    "seconds",
    "verdict",
];

fn cells(row: &Row) -> [String; 12] {
    let optional = |value: Option<f64>, digits: usize| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{value:+.digits$e}"))
    };
    [
        row.id.to_owned(),
        row.what.to_owned(),
        row.parameters.clone(),
        number(row.expected),
        number(row.measured),
        format!("{:+.1e}", row.error()),
        optional(row.relative_error(), 1),
        row.sigmas().map_or_else(|| "-".to_owned(), |sigmas| format!("{sigmas:+.1}")),
        rule(row),
        row.samples.to_string(),
        format!("{:.2}", row.seconds),
        row.fault.as_ref().map_or_else(|| "ok".to_owned(), |fault| format!("FAILED: {fault}")),
    ]
}

fn rule(row: &Row) -> String {
    use super::bench::Rule;
    match row.rule {
        Rule::Exact => "exact".to_owned(),
        Rule::Statistical { relative, .. } if relative.is_finite() => {
            format!("z SE, {}%", relative * 100.0)
        }
        Rule::Statistical { .. } => "z SE".to_owned(),
        Rule::Relative(bound) => format!("rel {bound:e}"),
        Rule::Absolute(bound) => format!("abs {bound:e}"),
        Rule::AtMost => "at most".to_owned(),
        Rule::AtLeast => "at least".to_owned(),
    }
}

fn number(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 || (1e-3..1e7).contains(&size) {
        let text = format!("{value:.7}");
        let short = text.trim_end_matches('0').trim_end_matches('.');
        short.to_owned()
    } else {
        format!("{value:.5e}")
    }
}

/// A table of aligned columns, with a line that sums it up.
pub fn text(rows: &[Row]) -> String {
    let all: Vec<[String; 12]> = rows.iter().map(cells).collect();
    let mut widths = TITLES.map(str::len);
    for row in &all {
        for (width, cell) in widths.iter_mut().zip(row) {
            *width = (*width).max(cell.chars().count());
        }
    }
    let mut out = String::new();
    for row in std::iter::once(&TITLES.map(str::to_owned)).chain(&all) {
        let line: Vec<String> =
            row.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}")).collect();
        out.push_str(line.join("  ").trim_end());
        out.push('\n');
    }
    out.push_str(&summary(rows));
    out
}

/// A Markdown table of one line per case: how many checks it makes, and the one of them that uses most of what its rule allows.
pub fn markdown(rows: &[Row]) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let titles = [
        "case",
        "what",
        "checks",
        "closest of them",
        "expected",
        "measured",
        "in SE",
        "samples",
        "s",
        "verdict",
    ];
    let mut out = line(&titles.map(str::to_owned));
    out.push_str(&line(&titles.map(|_| "---".to_owned())));
    for case in rows.chunk_by(|a, b| a.id == b.id) {
        // The first of those that are alike.
        let closest =
            case.iter().rev().max_by(|a, b| a.strain().total_cmp(&b.strain())).expect("no empty case");
        let red = case.iter().filter(|row| !row.passed()).count();
        let cells = [
            closest.id.to_owned(),
            closest.what.to_owned(),
            case.len().to_string(),
            closest.parameters.clone(),
            number(closest.expected),
            number(closest.measured),
            closest.sigmas().map_or_else(|| "-".to_owned(), |sigmas| format!("{sigmas:+.1}")),
            case.iter().map(|row| row.samples).sum::<u64>().to_string(),
            format!("{:.1}", case.iter().map(|row| row.seconds).sum::<f64>()),
            if red == 0 { "ok".to_owned() } else { format!("{red} FAILED") },
        ];
        out.push_str(&line(&cells.map(|cell| cell.replace('|', "\\|"))));
    }
    let _ = write!(out, "\n{}", summary(rows));
    out
}

/// How many of the rows are green.
pub fn summary(rows: &[Row]) -> String {
    let red = rows.iter().filter(|row| !row.passed()).count();
    let samples: u64 = rows.iter().map(|row| row.samples).sum();
    let seconds: f64 = rows.iter().map(|row| row.seconds).sum();
    format!("{} checks, {red} failed; {samples} samples, {seconds:.1} seconds of one thread\n", rows.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stability::bench::{Bench, Effort};

    #[test]
    fn a_case_is_shown_by_its_closest_check_or_its_failure() {
        let mut bench = Bench::new("T0", "made up | odd", Effort::Short);
        bench.relative("far", 1.0, 1.001, 0.1);
        bench.relative("near", 1.0, 1.09, 0.1);
        let rows = bench.into_rows();
        let line = markdown(&rows).lines().nth(2).unwrap_or_default().to_owned();
        assert!(line.starts_with("| T0 | made up \\| odd | 2 | near | 1 | 1.09 |"), "{line}");
        let mut bench = Bench::new("T1", "made up", Effort::Short);
        bench.relative("near", 1.0, 1.09, 0.1);
        bench.exact("wrong", 1.0, 2.0);
        let text = markdown(&bench.into_rows());
        assert!(text.contains("| wrong | 1 | 2 |") && text.contains("1 FAILED"), "{text}");
    }
}
