//! Error over time, drawn.

use super::RenderReport;
use crate::checkpoint::Checkpoint;
use farm_film::Resolution;
use farm_image::rgb_png;
use plotters::coord::Shift;
use plotters::coord::combinators::BindKeyPoints;
use plotters::prelude::*;
use plotters::style::{FontStyle, register_font};
use std::sync::LazyLock;

/// Pixels of a chart.
pub(super) const SIZE: (u32, u32) = (1000, 640);

/// A font that is there on every machine; the reason where it cannot be used.
static FONT: LazyLock<Result<(), String>> = LazyLock::new(|| {
    register_font("sans-serif", FontStyle::Normal, dejavu::sans::regular())
        .map_err(|_| "the font of charts cannot be used".to_owned())
});

/// What was rendered.
pub fn title(report: &RenderReport) -> String {
    format!("Error against run time: {}", report.scene)
}

/// How and where.
pub fn subtitle(report: &RenderReport) -> String {
    let settings = &report.settings;
    let plural = |count: usize, what: &str| format!("{count} {what}{}", if count == 1 { "" } else { "s" });
    format!(
        "{}x{}, {}, {:?} integrator, {:?} filter, depth {}, seed {}; {} on {} ({})",
        settings.width,
        settings.height,
        format_args!("{} spp", report.spp),
        settings.integrator,
        settings.filter,
        settings.max_depth,
        settings.seed,
        plural(report.workers, "worker"),
        report.host,
        plural(report.host_threads, "thread"),
    )
}

/// The chart as SVG.
pub fn svg(report: &RenderReport) -> Result<String, String> {
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
    draw(report, &area)?;
    drop(area);
    Ok(text)
}

/// The chart as PNG.
pub fn png(report: &RenderReport) -> Result<Vec<u8>, String> {
    bitmap(|area| draw(report, area))
}

type Area<'a> = DrawingArea<BitMapBackend<'a>, Shift>;

/// A drawing as PNG.
pub(super) fn bitmap(draw: impl Fn(&Area<'_>) -> Result<(), String>) -> Result<Vec<u8>, String> {
    let mut pixels = vec![0; SIZE.0 as usize * SIZE.1 as usize * 3];
    let area = BitMapBackend::with_buffer(&mut pixels, SIZE).into_drawing_area();
    draw(&area)?;
    drop(area);
    let resolution = Resolution::new(SIZE.0, SIZE.1).map_err(|err| err.to_string())?;
    Ok(rgb_png(resolution, &pixels))
}

/// Fills an area with white and puts a title above what is left of it.
pub(super) fn titled<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    subtitle: &str,
) -> Result<DrawingArea<B, Shift>, String> {
    FONT.clone()?;
    let fault = |err: DrawingAreaErrorKind<B::ErrorType>| err.to_string();
    area.fill(&WHITE).map_err(fault)?;
    let (head, body) = area.split_vertically(64);
    let line = |text: &str, y: i32, size: i32| {
        head.draw(&Text::new(text.to_owned(), (20, y), ("sans-serif", size))).map_err(fault)
    };
    line(title, 12, 24)?;
    line(subtitle, 42, 15)?;
    Ok(body)
}

/// Points of one curve.
type Curve = Vec<(f64, f64)>;

struct Curves {
    /// Of every frame.
    estimates: Vec<Curve>,
    /// Around the only frame's: along its lower edge and back along the upper one.
    band: Curve,
    truths: Vec<Curve>,
    guide: Curve,
}

impl Curves {
    fn new(report: &RenderReport) -> Self {
        let curve = |value: &dyn Fn(&Checkpoint) -> Option<f64>| -> Vec<Curve> {
            let of_frame = |checkpoints: &[Checkpoint]| -> Curve {
                let points = checkpoints.iter().filter_map(|at| Some((at.seconds, value(at)?)));
                points.filter(|(seconds, error)| *seconds > 0.0 && *error > 0.0).collect()
            };
            report
                .frames
                .iter()
                .map(|frame| of_frame(&frame.checkpoints))
                .filter(|curve| !curve.is_empty())
                .collect()
        };
        let estimates = curve(&|at| at.estimate.map(|error| error.rmse));
        let truths = curve(&|at| {
            let truth = at.truth.as_ref()?;
            Some(truth.corrected.map_or(truth.rmse, |corrected| corrected.rmse))
        });
        let mut band = Curve::new();
        if report.frames.len() == 1 {
            let lower = curve(&|at| at.estimate.map(|error| error.rmse / error.rmse_band));
            let upper = curve(&|at| at.estimate.map(|error| error.rmse * error.rmse_band));
            band.extend(lower.into_iter().flatten());
            band.extend(upper.into_iter().flatten().rev());
        }
        let guide = estimates.first().map_or(Curve::new(), |curve| {
            let (first, last) = (curve[0], curve[curve.len() - 1].0.max(curve[0].0 * 2.0));
            vec![first, (last, first.1 * (last / first.0).powf(-0.5))]
        });
        Self { estimates, band, truths, guide }
    }

    /// Bounds of everything, with room around them.
    fn bounds(&self) -> [(f64, f64); 2] {
        let all = self.estimates.iter().chain(&self.truths).chain([&self.band, &self.guide]);
        let points: Vec<_> = all.flatten().collect();
        let bounds = |value: fn(&(f64, f64)) -> f64| {
            let values = || points.iter().map(|point| value(point));
            let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(0.0, f64::max));
            if low < high { (low / 1.25, high * 1.25) } else { (low / 2.0, low * 2.0) }
        };
        [bounds(|point| point.0), bounds(|point| point.1)]
    }
}

fn draw<B: DrawingBackend>(report: &RenderReport, area: &DrawingArea<B, Shift>) -> Result<(), String> {
    let body = titled(area, &title(report), &subtitle(report))?;
    let fault = |err: DrawingAreaErrorKind<B::ErrorType>| err.to_string();
    let curves = Curves::new(report);
    if curves.estimates.is_empty() {
        let text = "no error above zero was measured";
        return body.draw(&Text::new(text, (60, 60), ("sans-serif", 20))).map_err(fault);
    }
    let [(left, right), (low, high)] = curves.bounds();
    let mut chart = ChartBuilder::on(&body)
        .margin(16)
        .x_label_area_size(52)
        .y_label_area_size(84)
        .build_cartesian_2d(
            (left..right).log_scale().with_key_points(ticks(left, right)),
            (low..high).log_scale().with_key_points(ticks(low, high)),
        )
        .map_err(fault)?;
    let label = |value: &f64| short(*value);
    chart
        .configure_mesh()
        .x_desc("seconds since the first unit")
        .y_desc("root mean squared error (radiance)")
        .max_light_lines(0)
        .x_label_formatter(&label)
        .y_label_formatter(&label)
        .label_style(("sans-serif", 15))
        .axis_desc_style(("sans-serif", 17))
        .bold_line_style(RGBColor(220, 220, 220))
        .draw()
        .map_err(fault)?;
    if !curves.band.is_empty() {
        chart
            .draw_series([Polygon::new(curves.band, BLUE.mix(0.2))])
            .map_err(fault)?
            .label("95 % band of the estimate")
            .legend(|(x, y)| Rectangle::new([(x, y - 5), (x + 24, y + 5)], BLUE.mix(0.2).filled()));
    }
    let mut lines = |curves: Vec<Curve>, color: RGBColor, name: &'static str| -> Result<(), String> {
        for (index, curve) in curves.into_iter().enumerate() {
            let series = LineSeries::new(curve.iter().copied(), color.stroke_width(2));
            let drawn = chart.draw_series(series).map_err(fault)?;
            if index == 0 {
                drawn
                    .label(name)
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 24, y)], color.stroke_width(2)));
            }
            chart
                .draw_series(curve.into_iter().map(|point| Circle::new(point, 4, color.filled())))
                .map_err(fault)?;
        }
        Ok(())
    };
    lines(curves.estimates, BLUE, "estimated error")?;
    lines(curves.truths, RED, "true error, against the reference")?;
    let grey = RGBColor(110, 110, 110);
    chart
        .draw_series(DashedLineSeries::new(curves.guide, 8, 6, grey.stroke_width(1)))
        .map_err(fault)?
        .label("N^-1/2: independent samples")
        .legend(move |(x, y)| PathElement::new([(x, y), (x + 24, y)], grey.stroke_width(1)));
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .legend_area_size(36)
        .margin(10)
        .background_style(WHITE.mix(0.9))
        .border_style(BLACK)
        .label_font(("sans-serif", 16))
        .draw()
        .map_err(fault)?;
    body.present().map_err(fault)
}

/// Round numbers within bounds: 1, 2 and 5 times powers of ten, and the other digits where bounds are narrow.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let digits: &[f64] =
        if high / low > 20.0 { &[1.0, 2.0, 5.0] } else { &[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0] };
    let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
    let all = decades.flat_map(|decade| digits.iter().map(move |digit| digit * 10f64.powi(decade)));
    all.filter(|tick| (low..=high).contains(tick)).collect()
}

/// A number without needless digits.
fn short(value: f64) -> String {
    if (0.001..10_000.0).contains(&value) {
        let text = format!("{value:.4}");
        return text.trim_end_matches('0').trim_end_matches('.').to_owned();
    }
    format!("{value:.0e}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within_bounds() {
        assert_eq!(ticks(0.9, 60.0), [1.0, 2.0, 5.0, 10.0, 20.0, 50.0]);
        assert_eq!(ticks(2.5, 7.0), [3.0, 4.0, 5.0, 6.0]);
        assert_eq!([0.05, 12.0, 0.0002].map(short), ["0.05", "12", "2e-4"]);
    }
}
