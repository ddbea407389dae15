//! Where in the picture the error lies, and where its samples went, drawn.

use super::{RenderReport, chart};
use crate::outputs::FrameSummary;
use farm_film::Tile;
use farm_image::heat_color;
use plotters::coord::Shift;
use plotters::prelude::*;

/// Pixels that the scale of colours takes.
const SCALE_WIDTH: i32 = 130;

/// Steps of the scale of colours.
const STEPS: usize = 128;

/// A number for every tile.
struct Map<'a> {
    title: String,
    /// What the colours stand for.
    unit: &'a str,
    values: Vec<(Tile, f64)>,
    shown: fn(f64) -> String,
}

/// The estimated relative error of every tile of the frame in which it is largest, as PNG; none where nothing is known.
pub fn errors(report: &RenderReport) -> Result<Option<Vec<u8>>, String> {
    let known = report.frames.iter().filter(|frame| !frame.tiles.is_empty());
    let Some(worst) = worst(known) else { return Ok(None) };
    let map = Map {
        title: format!("Estimated relative error per tile: {}, frame {}", report.scene, worst.frame),
        unit: "relative RMSE",
        values: worst.tiles.iter().map(|(tile, error)| (*tile, error.rel_mse.sqrt())).collect(),
        shown: |value| format!("{:.2} %", value * 100.0),
    };
    chart::bitmap(|area| draw(report, &map, area)).map(Some)
}

/// The samples per pixel of every tile of that frame, as PNG; none where all tiles were to have the same.
pub fn samples(report: &RenderReport) -> Result<Option<Vec<u8>>, String> {
    let Some(worst) = worst(report.frames.iter().filter(|frame| frame.adaptive.is_some())) else {
        return Ok(None);
    };
    let map = Map {
        title: format!("Samples per tile: {}, frame {}", report.scene, worst.frame),
        unit: "samples per pixel",
        values: worst.tile_samples.iter().map(|(tile, spp)| (*tile, *spp as f64)).collect(),
        shown: |value| format!("{value:.0}"),
    };
    chart::bitmap(|area| draw(report, &map, area)).map(Some)
}

fn worst<'a>(frames: impl Iterator<Item = &'a FrameSummary>) -> Option<&'a FrameSummary> {
    let error = |frame: &FrameSummary| frame.error.map_or(0.0, |error| error.rel_mse);
    frames.max_by(|a, b| error(a).total_cmp(&error(b)))
}

fn draw<B: DrawingBackend>(
    report: &RenderReport,
    map_of: &Map,
    area: &DrawingArea<B, Shift>,
) -> Result<(), String> {
    let body = chart::titled(area, &map_of.title, &chart::subtitle(report))?;
    let fault = |err: DrawingAreaErrorKind<B::ErrorType>| err.to_string();
    let largest = map_of.values.iter().map(|(_, value)| *value).fold(0.0, f64::max);
    let color = |share: f64| {
        let [r, g, b] = heat_color(share);
        RGBColor(r, g, b).filled()
    };
    let (width, height) = body.dim_in_pixel();
    let map = body.clone().shrink((16, 8), (width - SCALE_WIDTH as u32 - 24, height - 24));
    let (room_x, room_y) = map.dim_in_pixel();
    let (x_side, y_side) = (f64::from(report.settings.width), f64::from(report.settings.height));
    let scale = (f64::from(room_x) / x_side).min(f64::from(room_y) / y_side);
    let place =
        |x: u32, y: u32| ((f64::from(x) * scale).round() as i32, (f64::from(y) * scale).round() as i32);
    for (tile, value) in &map_of.values {
        let corners = [place(tile.x0(), tile.y0()), place(tile.x1(), tile.y1())];
        map.draw(&Rectangle::new(corners, color(value / largest))).map_err(fault)?;
    }
    // The scale: what the colours stand for.
    let (left, bottom) = (width as i32 - SCALE_WIDTH, height as i32 - 40);
    let level = |share: f64| bottom - (f64::from(bottom - 40) * share) as i32;
    body.draw(&Text::new(map_of.unit, (left, 8), ("sans-serif", 16))).map_err(fault)?;
    for step in 0..STEPS {
        let (from, to) = (step as f64 / STEPS as f64, (step + 1) as f64 / STEPS as f64);
        let corners = [(left, level(to)), (left + 28, level(from))];
        body.draw(&Rectangle::new(corners, color((from + to) / 2.0))).map_err(fault)?;
    }
    for share in [0.0, 0.25, 0.5, 0.75, 1.0] {
        let text = (map_of.shown)(share * largest);
        body.draw(&Text::new(text, (left + 36, level(share) - 8), ("sans-serif", 15))).map_err(fault)?;
    }
    body.present().map_err(fault)
}
