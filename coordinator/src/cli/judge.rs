//! Flags that say what frames are held against, and where it is reported.

use crate::outputs::FrameNames;
use crate::report::Folder;
use crate::truth::References;
use farm_film::Resolution;
use farm_job::FrameRange;
use farm_worker::cli::Fault;
use std::path::PathBuf;

/// What frames are held against, and where it is reported.
#[derive(Clone, Debug, clap::Args)]
pub struct JudgeArgs {
    /// What the picture converges to, as made by coordinator reference: its true error is measured at every doubling of samples;
    /// of an animation REF.####.exr
    #[arg(long, env = "FARM_REFERENCE", value_name = "REF.exr", help_heading = "Error")]
    reference: Option<PathBuf>,

    /// Report error against run time there: report.json, convergence.csv, .svg and .png, error.png, summary.md;
    /// with --adaptive samples.png
    #[arg(long, env = "FARM_REPORT", value_name = "DIR", help_heading = "Error")]
    report: Option<PathBuf>,
}

impl JudgeArgs {
    /// The references, each of which can be compared with its frame.
    pub fn references(
        &self,
        frames: FrameRange,
        resolution: Resolution,
        seed: u64,
    ) -> Result<Option<References>, Fault> {
        let Some(path) = &self.reference else { return Ok(None) };
        let names = FrameNames::new(path, frames.count() > 1).map_err(Fault::input)?;
        let references = References { names, seed };
        for frame in frames.iter() {
            if let Some(warning) = references.check(frame, resolution).map_err(Fault::input)? {
                eprintln!("warning: {warning}");
            }
        }
        Ok(Some(references))
    }

    /// Where to report, made and tried.
    pub fn folder(&self) -> Result<Option<Folder>, Fault> {
        self.report.as_deref().map(Folder::open).transpose().map_err(Fault::input)
    }
}
