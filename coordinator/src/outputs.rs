//! Where finished frames go, and how they get there: whole or not at all.

use crate::adaptive::Adaptive;
use crate::checkpoint::Checkpoint;
use crate::forecast::Cause;
use crate::store::frame_path;
use crate::truth::References;
use farm_film::{Counters, ErrorEstimate, Film, FrameIndex, Resolution, Rgb, Tile};
use farm_image::{
    Exposure, Frame, FrameMetadata, ImageError, PartialHeader, Pass, SampleFormat, encode_frame,
    pixels_digest, write_frame, write_preview,
};
use farm_job::{JobId, JobSpec};
use farm_worker::frames::partial_header;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Time to resolve a pixel and to write it, on a machine that renders at the same time.
const WRITING_PER_PIXEL: Duration = Duration::from_nanos(500);

/// A place for frames that cannot be one.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum OutputError {
    /// Another format.
    #[error("{0}: frames are written as OpenEXR: give a name that ends in .exr")]
    NotExr(String),
    /// A folder where a file should be.
    #[error("{0} is a directory: give the name of a file in it")]
    Directory(String),
    /// A folder that is not there.
    #[error("the directory {0} does not exist: create it first")]
    NoDirectory(String),
}

/// Names of the frames of one job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameNames {
    folder: PathBuf,
    before: String,
    digits: usize,
    after: String,
}

impl FrameNames {
    /// Names after `pattern`: the last run of `#` stands for the frame's number; when there is none and several frames are
    /// written, `.####` is put before the extension.
    pub fn new(pattern: &Path, several: bool) -> Result<Self, OutputError> {
        let shown = || pattern.display().to_string();
        if pattern.is_dir() {
            return Err(OutputError::Directory(shown()));
        }
        let is_exr = pattern.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
        let (Some(name), true) = (pattern.file_name().and_then(|name| name.to_str()), is_exr) else {
            return Err(OutputError::NotExr(shown()));
        };
        let folder = match pattern.parent() {
            Some(folder) if folder != Path::new("") => folder.to_owned(),
            _ => PathBuf::from("."),
        };
        if !folder.is_dir() {
            return Err(OutputError::NoDirectory(folder.display().to_string()));
        }
        let (before, digits, after) = match name.rfind('#') {
            Some(last) => {
                let before = name[..=last].trim_end_matches('#');
                (before.to_owned(), last + 1 - before.len(), name[last + 1..].to_owned())
            }
            None => {
                let (stem, extension) = name.split_at(name.len() - ".exr".len());
                if several {
                    (format!("{stem}."), 4, extension.to_owned())
                } else {
                    (stem.to_owned(), 0, extension.to_owned())
                }
            }
        };
        Ok(Self { folder, before, digits, after })
    }

    /// The file of one frame.
    pub fn path(&self, frame: FrameIndex) -> PathBuf {
        let number = if self.digits == 0 {
            String::new()
        } else {
            format!("{:0width$}", frame.0, width = self.digits)
        };
        self.folder.join(format!("{}{number}{}", self.before, self.after))
    }
}

/// What happens to a job's finished frames.
#[derive(Clone, Debug)]
pub struct OutputPlan {
    /// Their names.
    pub names: FrameNames,
    /// Whether a tone-mapped PNG is put beside each.
    pub preview: bool,
    /// Name of the scene, for people.
    pub scene_name: String,
    /// What frames are compared with on their way.
    pub reference: Option<References>,
}

/// Where a job's finished frames go.
#[derive(Clone, Debug)]
pub enum Outputs {
    /// To files.
    Files(OutputPlan),
    /// To the farm's store, from which they can be fetched.
    Store {
        /// Name of the scene, for people.
        scene_name: String,
    },
}

/// A frame with all its samples, on its way to its file.
pub struct FinishedFrame {
    /// Which one.
    pub frame: FrameIndex,
    /// All its samples.
    pub film: Film,
    /// Samples per pixel.
    pub spp: u64,
    /// Why it has no more of them.
    pub ended: Cause,
    /// Where its tiles were to end on their own: how many samples they got.
    pub adaptive: Option<Adaptive>,
    /// Estimated error; none with too few samples to tell.
    pub error: Option<ErrorEstimate>,
    /// What was traced for it.
    pub counters: Counters,
    /// From its first unit to its last.
    pub render: Duration,
    /// How it came about, in order; the last is the frame itself.
    pub checkpoints: Vec<Checkpoint>,
    /// Variance per pixel, where it was asked for.
    pub variance: Option<Vec<Rgb>>,
    /// What else its file says of it, by name.
    pub notes: serde_json::Map<String, serde_json::Value>,
}

/// What became of a frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameSummary {
    /// Which one.
    pub frame: u32,
    /// Files that were written.
    pub outputs: Vec<PathBuf>,
    /// Of width, height and the bits of every pixel.
    pub digest: String,
    /// Samples per pixel.
    pub spp: u64,
    /// Why it has no more of them.
    pub ended: Cause,
    /// Estimated error; none with too few samples to tell.
    pub error: Option<ErrorEstimate>,
    /// Values beyond what a 32-bit float holds, stored as the largest one.
    pub beyond_format: u64,
    /// Share of the frame's light that a limit on samples took, in [0, 1]; 0 without one.
    pub light_clamped: f64,
    /// From its first unit to its last, in seconds.
    pub render_s: f64,
    /// What was traced.
    pub counters: Counters,
    /// How it came about, in order; the last is the frame itself.
    pub checkpoints: Vec<Checkpoint>,
    /// Where its tiles were to end on their own: how many samples they got.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adaptive: Option<Adaptive>,
    /// Samples per pixel of every tile.
    #[serde(skip)]
    pub tile_samples: Vec<(Tile, u64)>,
    /// Estimated error of every tile.
    #[serde(skip)]
    pub tiles: Vec<(Tile, ErrorEstimate)>,
}

/// Time that a frame of a job takes from its last sample to its file.
pub fn writing(spec: &JobSpec) -> Duration {
    let pixels = u64::from(spec.settings.width) * u64::from(spec.settings.height);
    Duration::from_nanos((WRITING_PER_PIXEL.as_nanos() as u64).saturating_mul(pixels))
}

/// Resolves a frame of a job and writes its files.
pub fn write(
    spec: &JobSpec,
    plan: &OutputPlan,
    finished: &FinishedFrame,
) -> Result<FrameSummary, ImageError> {
    let header = partial_header(finished.film.resolution(), spec.scene, &spec.settings, finished.frame);
    write_resolved(&header, plan, finished)
}

/// Takes a frame's files away: something in it is wrong, and it is rendered again.
pub fn withdraw(plan: &OutputPlan, frame: FrameIndex) -> std::io::Result<()> {
    let path = plan.names.path(frame);
    let preview = plan.preview.then(|| path.with_extension("png"));
    for path in std::iter::once(path).chain(preview) {
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
    }
    Ok(())
}

/// Resolves a frame whose partials said `header` of themselves, and writes its files.
pub fn write_resolved(
    header: &PartialHeader,
    plan: &OutputPlan,
    finished: &FinishedFrame,
) -> Result<FrameSummary, ImageError> {
    let resolved = Resolved::new(header, &plan.scene_name, finished);
    let path = plan.names.path(finished.frame);
    let beyond_format = write_frame(&path, &resolved.picture(), &resolved.metadata, SampleFormat::Float)?;
    let mut outputs = vec![path];
    if plan.preview {
        let path = outputs[0].with_extension("png");
        write_preview(&path, resolved.resolution, &resolved.pixels, Exposure::Auto)?;
        outputs.push(path);
    }
    Ok(resolved.summary(finished, outputs, beyond_format))
}

/// Resolves a frame of a job and gives its file, for the store.
pub fn encode(
    job: JobId,
    spec: &JobSpec,
    scene_name: &str,
    finished: &FinishedFrame,
) -> (Vec<u8>, FrameSummary) {
    let header = partial_header(finished.film.resolution(), spec.scene, &spec.settings, finished.frame);
    let resolved = Resolved::new(&header, scene_name, finished);
    let (exr, beyond_format) = encode_frame(&resolved.picture(), &resolved.metadata, SampleFormat::Float);
    let output = PathBuf::from(frame_path(job, finished.frame).to_string());
    (exr, resolved.summary(finished, vec![output], beyond_format))
}

/// A frame's pixels, and what is said of them.
struct Resolved<'a> {
    resolution: Resolution,
    pixels: Vec<Rgb>,
    variance: Option<Pass<'a>>,
    metadata: FrameMetadata,
}

impl<'a> Resolved<'a> {
    fn new(header: &PartialHeader, scene_name: &str, finished: &'a FinishedFrame) -> Self {
        let film = &finished.film;
        let metadata = FrameMetadata {
            scene_name: scene_name.to_owned(),
            scene: header.scene,
            settings: header.settings,
            frame: finished.frame,
            spp: finished.spp,
            seed: header.seed,
            renderer: header.renderer.clone(),
            counters: finished.counters,
            error: finished.error,
            seconds: finished.render.as_secs_f64(),
            extra: finished.notes.clone(),
        };
        let variance = finished.variance.as_ref().map(|variance| Pass::Rgb("variance", variance));
        Self { resolution: film.resolution(), pixels: film.pixels(), variance, metadata }
    }

    fn picture(&self) -> Frame<'_> {
        Frame { resolution: self.resolution, pixels: &self.pixels, passes: self.variance.as_slice() }
    }

    fn summary(self, finished: &FinishedFrame, outputs: Vec<PathBuf>, beyond_format: u64) -> FrameSummary {
        FrameSummary {
            frame: self.metadata.frame.0,
            outputs,
            digest: blake3::Hash::from_bytes(pixels_digest(self.resolution, &self.pixels)).to_string(),
            spp: self.metadata.spp,
            ended: finished.ended,
            error: self.metadata.error,
            beyond_format,
            light_clamped: light_clamped(&self.metadata.counters, &self.pixels),
            render_s: self.metadata.seconds,
            counters: self.metadata.counters,
            checkpoints: finished.checkpoints.clone(),
            adaptive: finished.adaptive,
            tile_samples: finished.film.tile_samples().collect(),
            tiles: finished.film.tile_errors().collect(),
        }
    }
}

/// What clamping took, of what there was before.
fn light_clamped(counters: &Counters, pixels: &[Rgb]) -> f64 {
    let mean = |pixel: &Rgb| pixel.iter().map(|&value| f64::from(value)).sum::<f64>() / 3.0;
    let kept = pixels.iter().map(mean).sum::<f64>() / pixels.len() as f64;
    let taken = counters.clamped_radiance / counters.samples.max(1) as f64;
    if taken > 0.0 { taken / (taken + kept) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_numbered_where_it_says_so() {
        let name = |pattern: &str, several| {
            FrameNames::new(Path::new(pattern), several).unwrap().path(FrameIndex(7)).display().to_string()
        };
        assert_eq!(name("fox.exr", false), "./fox.exr");
        assert_eq!(name("fox.exr", true), "./fox.0007.exr");
        assert_eq!(name("fox.##.exr", true), "./fox.07.exr");
        assert_eq!(name("fox#.EXR", false), "./fox7.EXR");
        assert_eq!(name("/tmp/a#b_###.exr", true), "/tmp/a#b_007.exr");
    }

    #[test]
    fn places_that_are_none_get_a_sentence() {
        let refusal = |pattern: &str| FrameNames::new(Path::new(pattern), false).unwrap_err().to_string();
        assert!(refusal("fox.png").contains(".exr"));
        assert!(refusal("fox").contains(".exr"));
        assert!(refusal("/tmp").contains("is a directory"));
        assert!(refusal("/no/such/place/fox.exr").contains("does not exist"));
    }
}
