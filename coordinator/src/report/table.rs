//! A report as text: numbers for programs, a page for people.

use super::RenderReport;
use crate::checkpoint::Checkpoint;
use crate::outputs::FrameSummary;
use crate::progress::metric;

const COLUMNS: &str = "frame,spp,samples,seconds,cpu_seconds,workers,rays_camera,rays_extension,rays_shadow,\
    estimated_rmse,estimated_rmse_low,estimated_rmse_high,estimated_rel_mse,estimated_rel_mse_low,estimated_rel_mse_high,\
    true_rmse,true_rel_mse,true_rel_mse_trimmed,true_mape,true_psnr,true_flip,true_rmse_corrected,true_rel_mse_corrected,\
    efficiency,slope";

/// One line per checkpoint of a single frame; of several frames one line each, and their total.
pub fn csv(report: &RenderReport) -> String {
    let mut lines = vec![COLUMNS.to_owned()];
    match &report.frames[..] {
        [frame] => lines
            .extend(frame.checkpoints.iter().map(|checkpoint| line(&frame.frame.to_string(), checkpoint))),
        frames => {
            lines.extend(lasts(frames).map(|(frame, last)| line(&frame.frame.to_string(), last)));
            lines.push(total(report));
        }
    }
    lines.join("\n") + "\n"
}

fn lasts(frames: &[FrameSummary]) -> impl Iterator<Item = (&FrameSummary, &Checkpoint)> {
    frames.iter().filter_map(|frame| Some((frame, frame.checkpoints.last()?)))
}

fn number(value: Option<f64>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

fn line(frame: &str, at: &Checkpoint) -> String {
    let (error, truth) = (at.estimate.as_ref(), at.truth.as_ref());
    let corrected = truth.and_then(|truth| truth.corrected);
    let numbers = [
        error.map(|error| error.rmse),
        error.map(|error| error.rmse / error.rmse_band),
        error.map(|error| error.rmse * error.rmse_band),
        error.map(|error| error.rel_mse),
        error.map(|error| error.rel_mse / error.rel_mse_band),
        error.map(|error| error.rel_mse * error.rel_mse_band),
        truth.map(|truth| truth.rmse),
        truth.map(|truth| truth.rel_mse),
        truth.map(|truth| truth.rel_mse_trimmed),
        truth.map(|truth| truth.mape),
        truth.and_then(|truth| truth.psnr),
        truth.and_then(|truth| truth.flip),
        corrected.map(|corrected| corrected.rmse),
        corrected.map(|corrected| corrected.rel_mse),
        at.efficiency,
        at.slope,
    ];
    let counts = format!(
        "{frame},{},{},{},{},{},{},{},{}",
        at.spp,
        at.samples,
        at.seconds,
        at.cpu_seconds,
        at.workers,
        at.rays_camera,
        at.rays_extension,
        at.rays_shadow
    );
    [counts].into_iter().chain(numbers.map(number)).collect::<Vec<_>>().join(",")
}

/// All frames together; their errors are roots and means of the mean squares.
fn total(report: &RenderReport) -> String {
    let mean = |value: &dyn Fn(&Checkpoint) -> Option<f64>| {
        let values: Vec<f64> = lasts(&report.frames).filter_map(|(_, last)| value(last)).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let rmse = mean(&|last| last.estimate.map(|error| error.rmse * error.rmse)).map(f64::sqrt);
    let rel_mse = mean(&|last| last.estimate.map(|error| error.rel_mse));
    let true_rmse = mean(&|last| last.truth.as_ref().map(|truth| truth.mse)).map(f64::sqrt);
    let true_rel_mse = mean(&|last| last.truth.as_ref().map(|truth| truth.rel_mse));
    let counters = &report.counters;
    let efficiency = rmse.map(|rmse| (rmse * rmse * report.cpu_s).recip()).filter(|value| value.is_finite());
    format!(
        "total,{},{},{},{},{},{},{},{},{},,,{},,,{},{},,,,,,,{},",
        report.spp,
        report.samples,
        report.render_s,
        report.cpu_s,
        report.workers,
        counters.rays_camera,
        counters.rays_extension,
        counters.rays_shadow,
        number(rmse),
        number(rel_mse),
        number(true_rmse),
        number(true_rel_mse),
        number(efficiency),
    )
}

/// A page for people.
pub fn markdown(report: &RenderReport) -> String {
    let mut page = format!("# {}\n\n{}\n\n", super::chart::title(report), super::chart::subtitle(report));
    page += &format!(
        "{} frame(s), {} spp, {:.2} s from the first unit to the last, {:.2} s of processor time, {} worker(s), {} unit(s).\n\
         Digest `{}`.\n\n",
        report.frames.len(),
        report.spp,
        report.render_s,
        report.cpu_s,
        report.workers,
        report.units,
        report.digest
    );
    let endings: String =
        report.frames.iter().filter_map(|frame| Some(format!("- {}\n", report.ending(frame)?))).collect();
    if !endings.is_empty() {
        page += &format!("{endings}\n");
    }
    page += "| frame | spp | seconds | CPU s | rays | estimated RMSE | estimated relMSE | true RMSE | true relMSE | 1/(MSE x CPU s) | slope |\n\
             | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n";
    for frame in &report.frames {
        let shown = if report.frames.len() == 1 { 0 } else { frame.checkpoints.len().saturating_sub(1) };
        for at in &frame.checkpoints[shown..] {
            page += &row(&frame.frame.to_string(), at);
        }
    }
    if report.frames.len() > 1 {
        page += &format!(
            "| total | {} | {:.2} | {:.2} | {} | {} | {} | | | | |\n",
            report.spp,
            report.render_s,
            report.cpu_s,
            metric(report.rays as f64),
            report.error.map_or("-".to_owned(), |error| format!("{error:.3e} (worst)")),
            report.rel_mse.map_or("-".to_owned(), |error| format!("{error:.3e} (worst)")),
        );
    }
    page += "\nEstimates have bounds within which 95 % of the true errors lie. True errors are against the reference, without its own \
             error where it states that. The slope is that of log(RMSE) over log(seconds) over the last four rows; -0.5 is that of \
             independent samples.\n\n![error over time](convergence.png)\n\n![estimated error per tile](error.png)\n";
    if report.stop.adaptive {
        page += "\n![samples per tile](samples.png)\n";
    }
    page
}

fn row(frame: &str, at: &Checkpoint) -> String {
    let short = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.3e}"));
    let banded = |value: f64, band: f64| format!("{value:.3e} ({:.2e}-{:.2e})", value / band, value * band);
    let truth = at.truth.as_ref();
    let corrected = |raw: fn(&farm_image::Comparison) -> f64, own: fn(&farm_image::Corrected) -> f64| {
        truth.map(|truth| truth.corrected.as_ref().map_or_else(|| raw(truth), own))
    };
    format!(
        "| {frame} | {} | {:.2} | {:.2} | {} | {} | {} | {} | {} | {} | {} |\n",
        at.spp,
        at.seconds,
        at.cpu_seconds,
        metric((at.rays_camera + at.rays_extension + at.rays_shadow) as f64),
        at.estimate.map_or("-".to_owned(), |error| banded(error.rmse, error.rmse_band)),
        at.estimate.map_or("-".to_owned(), |error| banded(error.rel_mse, error.rel_mse_band)),
        short(corrected(|truth| truth.rmse, |own| own.rmse)),
        short(corrected(|truth| truth.rel_mse, |own| own.rel_mse)),
        short(at.efficiency),
        at.slope.map_or("-".to_owned(), |slope| format!("{slope:.2}")),
    )
}
