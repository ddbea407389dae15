//! How far two pictures are apart.

use super::{print, print_json};
use farm_image::{Comparison, compare, read_image};
use farm_worker::cli::Fault;
use std::path::{Path, PathBuf};

/// Compare a picture with a reference, pixel by pixel
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Examples:
  coordinator compare scene.exr reference.exr
  coordinator compare scene.exr reference.exr --json")]
pub struct CompareArgs {
    /// The picture: EXR, HDR, PNG or JPEG
    picture: PathBuf,
    /// What it should be
    reference: PathBuf,
    /// Print one JSON object
    #[arg(long, env = "FARM_JSON")]
    json: bool,
}

/// Reads both and prints every measure.
pub fn run(args: &CompareArgs) -> Result<(), Fault> {
    let read = |path: &Path| read_image(path).map_err(Fault::input);
    let comparison = compare(&read(&args.picture)?, &read(&args.reference)?).map_err(Fault::input)?;
    if args.json { print_json(&comparison) } else { print(&table(&comparison)) }
}

fn table(comparison: &Comparison) -> String {
    let optional = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.6}"));
    [
        format!("resolution        {}x{}", comparison.width, comparison.height),
        format!("mse               {:.6e}", comparison.mse),
        format!("rmse              {:.6e}", comparison.rmse),
        format!("rel_mse           {:.6e}", comparison.rel_mse),
        format!("rel_mse_trimmed   {:.6e}", comparison.rel_mse_trimmed),
        format!("mape              {:.6e}", comparison.mape),
        format!("psnr              {}", optional(comparison.psnr)),
        format!("flip              {}", optional(comparison.flip)),
        format!("max_abs           {:.6e}", comparison.max_abs),
        format!("mean              {:?}", comparison.mean),
        format!("mean_reference    {:?}", comparison.mean_reference),
    ]
    .join("\n")
}
