//! Tables for people and for the README.

use super::summary::{Outcome, Point, RATIO_FROM, Spread};
use std::fmt::Write;

/// Every point of an outcome.
pub fn text(outcome: &Outcome) -> String {
    let mut out = format!(
        "{}, {} filter: slope {:.2}, reference off by {:.1e}{}\n",
        outcome.scene,
        outcome.filter,
        outcome.slope,
        outcome.reference_rmse,
        outcome.prediction.map_or(String::new(), |ratio| format!(", predicted/real time {}", around(ratio))),
    );
    out.push_str("    spp   seconds  RMSE (least..most)           estimated/true     of relMSE  in band  of tiles (90 %)    independent/Owen\n");
    for point in &outcome.points {
        let optional = |spread: Option<Spread>| spread.map_or_else(|| "-".to_owned(), around);
        let gain = point
            .independent
            .map_or_else(|| "-".to_owned(), |other| format!("{:.2}", other.median / point.rmse.median));
        let _ = writeln!(
            out,
            "{:7} {:9.4}  {:.3e} ({:.1e}..{:.1e})  {:18} {:>9} {:>7}  {:18} {:>5}",
            point.spp,
            point.seconds,
            point.rmse.median,
            point.rmse.low,
            point.rmse.high,
            optional(point.ratio),
            point.rel_ratio.map_or_else(|| "-".to_owned(), |ratio| format!("{:.2}", ratio.median)),
            point.in_band.map_or_else(|| "-".to_owned(), |share| format!("{:.0} %", share * 100.0)),
            optional(point.tile_ratio),
            gain,
        );
    }
    out
}

fn around(spread: Spread) -> String {
    format!("{:.2} ({:.2}..{:.2})", spread.median, spread.low, spread.high)
}

/// One line per scene, both filters together.
pub fn markdown(outcomes: &[Outcome]) -> String {
    let mut out = String::from(
        "| scene | RMSE at 16, 64 and most spp | CPU s | slope | estimated / true RMSE from 64 spp | the same, roots of relMSE | independent / Owen-Sobol RMSE from 16 spp | predicted / real time |\n|---|---|---|---|---|---|---|---|\n",
    );
    for outcome in outcomes.iter().filter(|outcome| outcome.filter == "box") {
        let all: Vec<_> = outcomes.iter().filter(|other| other.scene == outcome.scene).collect();
        let last = outcome.points.last().expect("at least one point");
        let at = |spp: u64| outcome.points.iter().find(|point| point.spp == spp);
        let shown = [at(16), at(64), Some(last)].into_iter().flatten();
        let rmse: Vec<_> = shown.map(|point| format!("{:.2e}", point.rmse.median)).collect();
        let judged =
            || all.iter().flat_map(|outcome| &outcome.points).filter(|point| point.spp >= RATIO_FROM);
        let medians =
            |ratio: fn(&Point) -> Option<Spread>| range(judged().filter_map(ratio).map(|ratio| ratio.median));
        let gain = |point: &Point| Some(point.independent?.median / point.rmse.median);
        let gains = outcome.points.iter().filter(|point| point.spp >= 16).filter_map(gain);
        let predictions = all.iter().filter_map(|outcome| outcome.prediction).map(|ratio| ratio.median);
        let _ = writeln!(
            out,
            "| {} | {} | {:.2} | {:.2} | {} | {} | {} | {} |",
            outcome.scene,
            rmse.join(", "),
            last.seconds,
            outcome.slope,
            medians(|point| point.ratio),
            medians(|point| point.rel_ratio),
            range(gains),
            range(predictions),
        );
    }
    out
}

fn range(values: impl Iterator<Item = f64>) -> String {
    Spread::of(values)
        .map_or_else(|| "-".to_owned(), |spread| format!("{:.2}..{:.2}", spread.low, spread.high))
}
