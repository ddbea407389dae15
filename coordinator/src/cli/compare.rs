//! How far two pictures are apart.

use super::{print, print_json};
use farm_image::{Comparison, Image, compare, difference_png, flip, read_image, write_file};
use farm_worker::cli::Fault;
use serde_json::{Map, Value};
use std::path::{Path, PathBuf};

/// Times as many samples as a picture that a reference should have.
pub const REFERENCE_SAMPLES: u64 = 16;

/// Compare a picture with a reference, pixel by pixel
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
A reference made by coordinator reference states its own error, which is taken off: corrected_rmse, corrected_rel_mse.

Examples:
  coordinator compare scene.exr reference.exr
  coordinator compare scene.exr reference.exr --metrics rmse,flip --json
  coordinator compare scene.exr reference.exr --difference where.png")]
pub struct CompareArgs {
    /// The picture: EXR, HDR, PNG or JPEG
    picture: PathBuf,
    /// What it should be
    reference: PathBuf,
    /// Which measures; all that this program was built with if not given
    #[arg(long, env = "FARM_METRICS", value_name = "NAME,..", value_enum, value_delimiter = ',')]
    metrics: Vec<Metric>,
    /// Write a picture of the relative error of every pixel
    #[arg(long, env = "FARM_DIFFERENCE", value_name = "OUT.png")]
    difference: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long, env = "FARM_JSON")]
    json: bool,
}

/// Measures by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Metric {
    /// Root mean squared error, and mse
    Rmse,
    /// Mean of squared error over r^2 + 0.01, raw and without the 0.1 % of pixels with the largest share
    Relmse,
    /// Mean of |error| over |r| + 0.01
    Mape,
    /// Peak signal to noise ratio in dB
    Psnr,
    /// Difference as people see it, LDR-FLIP at 67 pixels per degree; only in programs built with --features flip, which takes a C++ compiler
    Flip,
}

impl Metric {
    const ALL: [Self; 5] = [Self::Rmse, Self::Relmse, Self::Mape, Self::Psnr, Self::Flip];

    fn names(self) -> &'static [&'static str] {
        match self {
            Self::Rmse => {
                &["mse", "rmse", "corrected_rmse", "reference_mse", "max_abs", "mean", "mean_reference"]
            }
            Self::Relmse => &["rel_mse", "rel_mse_trimmed", "corrected_rel_mse", "reference_rel_mse"],
            Self::Mape => &["mape"],
            Self::Psnr => &["psnr"],
            Self::Flip => &["flip"],
        }
    }
}

/// Reads both and prints what was asked for.
pub fn run(args: &CompareArgs) -> Result<(), Fault> {
    let metrics = if args.metrics.is_empty() { Metric::ALL.to_vec() } else { args.metrics.clone() };
    let read = |path: &Path| read_image(path).map_err(Fault::input);
    let (picture, reference) = (read(&args.picture)?, read(&args.reference)?);
    let mut comparison = compare(&picture, &reference).map_err(Fault::input)?;
    if metrics.contains(&Metric::Flip) {
        comparison.flip = flip(&picture, &reference);
    }
    if args.metrics.contains(&Metric::Flip) && comparison.flip.is_none() {
        return Err(Fault::input(
            "--metrics flip: this program was built without FLIP, whose implementation needs a C++ compiler: \
             build it with --features farm-coordinator/flip, or ask for other metrics",
        ));
    }
    if let Some(warning) = doubt(&picture, &reference) {
        eprintln!("warning: {}: {warning}", args.reference.display());
    }
    if let Some(path) = &args.difference {
        let (bytes, brightest) = difference_png(&picture, &reference).map_err(Fault::input)?;
        write_file(path, &bytes).map_err(Fault::failed)?;
        eprintln!("wrote {}: its brightest colour is a relative error of {brightest:.4}", path.display());
    }
    let shown = shown(&comparison, &metrics);
    if args.json {
        return print_json(&shown);
    }
    let lines: Vec<_> = shown.iter().map(|(name, value)| format!("{name:<18}{}", text(value))).collect();
    print(&lines.join("\n"))
}

/// Why a reference may be none.
fn doubt(picture: &Image, reference: &Image) -> Option<String> {
    let (of_picture, of_reference) = (picture.metadata.as_ref()?, reference.metadata.as_ref()?);
    if of_picture.scene != of_reference.scene {
        return Some("it shows another scene".to_owned());
    }
    if of_picture.seed == of_reference.seed {
        return Some(format!(
            "it has the seed {} of the picture, and so its samples: errors are too small",
            of_picture.seed
        ));
    }
    let enough = of_picture.spp.saturating_mul(REFERENCE_SAMPLES);
    (of_reference.spp < enough).then(|| {
        format!(
            "it has {} samples per pixel, less than {REFERENCE_SAMPLES} times the {} of the picture",
            of_reference.spp, of_picture.spp
        )
    })
}

/// What of a comparison was asked for, by name, with the correction among it.
fn shown(comparison: &Comparison, metrics: &[Metric]) -> Map<String, Value> {
    let Ok(Value::Object(mut all)) = serde_json::to_value(comparison) else { return Map::new() };
    if let Some(corrected) = comparison.corrected {
        all.insert("corrected_rmse".to_owned(), corrected.rmse.into());
        all.insert("corrected_rel_mse".to_owned(), corrected.rel_mse.into());
        all.insert("reference_mse".to_owned(), corrected.reference_mse.into());
        all.insert("reference_rel_mse".to_owned(), corrected.reference_rel_mse.into());
    }
    let names = ["width", "height"]
        .into_iter()
        .chain(metrics.iter().flat_map(|metric| metric.names().iter().copied()));
    names.filter_map(|name| Some((name.to_owned(), all.get(name)?.clone()))).collect()
}

fn text(value: &Value) -> String {
    match value {
        Value::Number(number) if number.is_f64() => format!("{:.6e}", number.as_f64().unwrap_or(f64::NAN)),
        Value::Array(values) => values.iter().map(text).collect::<Vec<_>>().join(" "),
        Value::Null => "-".to_owned(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use farm_film::Resolution;

    #[test]
    fn only_what_was_asked_for_is_shown() {
        let image = |value: f32| Image {
            resolution: Resolution::new(2, 1).unwrap(),
            pixels: vec![[value; 3]; 2],
            metadata: None,
        };
        let comparison = compare(&image(0.5), &image(1.0)).unwrap();
        let shown = shown(&comparison, &[Metric::Mape, Metric::Psnr]);
        assert_eq!(shown.keys().map(String::as_str).collect::<Vec<_>>(), ["height", "mape", "psnr", "width"]);
        assert_eq!(text(&shown["width"]), "2");
        assert_eq!(text(&Value::Null), "-");
        assert_eq!(text(&Value::from(vec![0.5, 0.25])), "5.000000e-1 2.500000e-1");
    }
}
