//! Error over CPU time as a picture, one panel per scene.

use super::summary::{Outcome, Point};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::{FontStyle, register_font};
use std::path::Path;

/// Pixels of one panel.
const PANEL: (u32, u32) = (360, 300);

/// Pixels above the panels, for the legend.
const HEAD: i32 = 34;

const SOBOL: RGBColor = RGBColor(31, 119, 180);
const ESTIMATE: RGBColor = RGBColor(214, 99, 20);
const INDEPENDENT: RGBColor = RGBColor(120, 120, 120);
const GUIDE: RGBColor = RGBColor(120, 170, 120);

/// Draws the outcomes through the box filter as a PNG.
pub fn draw(path: &Path, outcomes: &[Outcome]) -> Result<(), String> {
    register_font("sans-serif", FontStyle::Normal, dejavu::sans::regular())
        .map_err(|_| "the font of charts cannot be used".to_owned())?;
    let shown: Vec<_> = outcomes.iter().filter(|outcome| outcome.filter == "box").collect();
    let columns = shown.len().min(4);
    let rows = shown.len().div_ceil(columns.max(1));
    let (width, height) = (PANEL.0 * columns as u32, HEAD as u32 + PANEL.1 * rows as u32);
    let mut pixels = vec![0; 3 * width as usize * height as usize];
    {
        let root = BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area();
        root.fill(&WHITE).map_err(|err| err.to_string())?;
        let (head, body) = root.split_vertically(HEAD);
        legend(&head)?;
        for (outcome, area) in shown.iter().zip(body.split_evenly((rows, columns))) {
            panel(&area, outcome)?;
        }
        root.present().map_err(|err| err.to_string())?;
    }
    let picture = image::RgbImage::from_raw(width, height, pixels).expect("three bytes per pixel");
    picture.save(path).map_err(|err| format!("cannot write {}: {err}", path.display()))
}

type Area<'a> = DrawingArea<BitMapBackend<'a>, Shift>;

fn legend(area: &Area<'_>) -> Result<(), String> {
    let entries = [
        ("true error, Owen-Sobol", SOBOL),
        ("its estimate", ESTIMATE),
        ("true error, independent samples", INDEPENDENT),
        ("slope -1/2, guide", GUIDE),
    ];
    let mut x = 16;
    for (name, color) in entries {
        let line = PathElement::new(vec![(x, 17), (x + 28, 17)], color.stroke_width(3));
        area.draw(&line).map_err(|err| err.to_string())?;
        let text = Text::new(name, (x + 36, 9), ("sans-serif", 16));
        area.draw(&text).map_err(|err| err.to_string())?;
        x += 60 + 9 * name.len() as i32;
    }
    Ok(())
}

/// Without an exponent where few zeros do; labels have one digit that is not zero.
fn label(value: f64) -> String {
    let decimals = -(value.log10() + 1e-9).floor() as i32;
    if decimals > 4 { format!("{value:.0e}") } else { format!("{value:.*}", decimals.max(0) as usize) }
}

fn panel(area: &Area<'_>, outcome: &Outcome) -> Result<(), String> {
    let points = &outcome.points;
    let line = |value: &dyn Fn(&Point) -> Option<f64>| -> Vec<(f64, f64)> {
        points.iter().filter_map(|point| Some((point.seconds, value(point)?))).collect()
    };
    let truth = line(&|point| Some(point.rmse.median));
    let estimate = line(&|point| Some(point.rmse.median * point.ratio?.median));
    let independent = line(&|point| Some(point.independent?.median));
    let all = || truth.iter().chain(&estimate).chain(&independent);
    let bounds = |values: &mut dyn Iterator<Item = f64>| {
        values.fold((f64::INFINITY, 0.0f64), |(low, high), value| (low.min(value), high.max(value)))
    };
    let (x0, x1) = bounds(&mut all().map(|point| point.0));
    let (y0, y1) = bounds(&mut all().map(|point| point.1));
    let mut chart = ChartBuilder::on(area)
        .caption(outcome.scene, ("sans-serif", 17))
        .margin(8)
        .x_label_area_size(38)
        .y_label_area_size(62)
        .build_cartesian_2d((x0 / 1.3..x1 * 1.3).log_scale(), (y0 / 1.5..y1 * 1.5).log_scale())
        .map_err(|err| err.to_string())?;
    chart
        .configure_mesh()
        .x_desc("CPU seconds")
        .y_desc("RMSE (radiance)")
        .x_labels(5)
        .y_labels(5)
        .x_label_formatter(&|x| label(*x))
        .y_label_formatter(&|y| label(*y))
        .label_style(("sans-serif", 14))
        .bold_line_style(RGBColor(200, 200, 200))
        .light_line_style(RGBColor(238, 238, 238))
        .draw()
        .map_err(|err| err.to_string())?;
    let start = independent.first().or(truth.first()).copied().unwrap_or((x0, y1));
    let guide = vec![start, (x1, start.1 * (start.0 / x1).sqrt())];
    for (points, color, width) in
        [(&guide, GUIDE, 1), (&independent, INDEPENDENT, 2), (&truth, SOBOL, 2), (&estimate, ESTIMATE, 1)]
    {
        let series = LineSeries::new(points.iter().copied(), color.stroke_width(width));
        chart.draw_series(series).map_err(|err| err.to_string())?;
    }
    for (points, color) in [(&truth, SOBOL), (&estimate, ESTIMATE)] {
        let marks = points.iter().map(|point| Circle::new(*point, 3, color.filled()));
        chart.draw_series(marks).map_err(|err| err.to_string())?;
    }
    Ok(())
}
