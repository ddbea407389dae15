//! A folder that says how the error of each frame fell with time.

use super::{RenderReport, chart, heat_map, table};
use farm_image::{ImageError, write_file};
use std::path::{Path, PathBuf};

/// A folder that reports can be written to.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
}

impl Folder {
    /// Makes the folder if it is not there, and tries to write to it. What a former report left there is removed: it must not be
    /// taken for that of a render that fails.
    pub fn open(path: &Path) -> Result<Self, ImageError> {
        let fault = |fault: &dyn std::fmt::Display| ImageError::Write {
            path: path.to_owned(),
            fault: format!("{fault}; --report needs a folder that can be written to"),
        };
        std::fs::create_dir_all(path).map_err(|err| fault(&err))?;
        let folder = Self { path: path.to_owned() };
        write_file(&path.join(FILES[0]), b"").map_err(|err| fault(&err))?;
        for file in FILES {
            match std::fs::remove_file(path.join(file)) {
                Err(err) if err.kind() != std::io::ErrorKind::NotFound => return Err(fault(&err)),
                _ => {}
            }
        }
        Ok(folder)
    }

    /// Writes the report of a finished job.
    pub fn write(&self, report: &RenderReport) -> Result<(), String> {
        let write = |file: &str, bytes: &[u8]| {
            write_file(&self.path.join(file), bytes)
                .map_err(|err| format!("the frames are written, but not their report: {err}"))
        };
        let json = serde_json::to_vec_pretty(report).map_err(|err| err.to_string())?;
        let [json_file, csv_file, svg_file, png_file, tiles_file, summary_file, samples_file] = FILES;
        write(json_file, &json)?;
        write(csv_file, table::csv(report).as_bytes())?;
        write(svg_file, chart::svg(report)?.as_bytes())?;
        write(png_file, &chart::png(report)?)?;
        if let Some(map) = heat_map::errors(report)? {
            write(tiles_file, &map)?;
        }
        if let Some(map) = heat_map::samples(report)? {
            write(samples_file, &map)?;
        }
        write(summary_file, table::markdown(report).as_bytes())
    }
}

/// Names of the files of a report.
const FILES: [&str; 7] = [
    "report.json",
    "convergence.csv",
    "convergence.svg",
    "convergence.png",
    "error.png",
    "summary.md",
    "samples.png",
];
