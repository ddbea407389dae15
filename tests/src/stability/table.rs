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

/// A Markdown table.
pub fn markdown(rows: &[Row]) -> String {
    let mut out = String::new();
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    out.push_str(&line(&TITLES.map(str::to_owned)));
    out.push_str(&line(&TITLES.map(|_| "---".to_owned())));
    for row in rows {
        out.push_str(&line(&cells(row).map(|cell| cell.replace('|', "\\|"))));
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
