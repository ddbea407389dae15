//! How far pictures are from references.

use crate::outputs::{FinishedFrame, FrameNames, OutputPlan};
use farm_film::{FrameIndex, Resolution, Rgb};
use farm_image::{Comparison, Image, ImageError, compare, flip, read_image};
use farm_job::JobId;
use std::collections::BTreeMap;
use std::path::PathBuf;
use tracing::warn;

/// Pictures that frames should converge to.
#[derive(Clone, Debug)]
pub struct References {
    /// Their files.
    pub names: FrameNames,
    /// Seed of the frames: a reference of the same one has their own samples in it.
    pub seed: u64,
}

impl References {
    /// Refuses a reference that frames of `resolution` cannot be compared with; why its errors will look too small, if so.
    pub fn check(&self, frame: FrameIndex, resolution: Resolution) -> Result<Option<String>, ImageError> {
        let path = self.names.path(frame);
        let reference = read_image(&path)?;
        let nothing = Image { resolution, pixels: vec![[0.0; 3]; resolution.area()], metadata: None };
        compare(&nothing, &reference)
            .map_err(|err| ImageError::Read { path: path.clone(), fault: err.to_string() })?;
        let is_own = reference.metadata.is_some_and(|metadata| metadata.seed == self.seed);
        Ok(is_own.then(|| {
            format!(
                "{} was rendered with the same seed {} as the picture, whose samples are among its own: errors against it \
                 are too small; make a reference with coordinator reference",
                path.display(),
                self.seed
            )
        }))
    }
}

/// Looks at pictures on their way, and keeps what it saw until they are finished.
#[derive(Default)]
pub struct Truths {
    seen: BTreeMap<(JobId, FrameIndex), BTreeMap<u64, Comparison>>,
    /// The reference at hand.
    reference: Option<(PathBuf, Image)>,
}

impl Truths {
    /// Looks at the picture of a frame that has `spp` samples per pixel.
    pub fn look(&mut self, job: JobId, frame: FrameIndex, plan: &OutputPlan, spp: u64, pixels: Vec<Rgb>) {
        if let Some(comparison) = self.compared(plan, frame, pixels, false) {
            self.seen.entry((job, frame)).or_default().insert(spp, comparison);
        }
    }

    /// Tells the checkpoints of a finished frame what was seen of them.
    pub fn tell(&mut self, job: JobId, plan: &OutputPlan, finished: &mut FinishedFrame) {
        let seen = self.seen.remove(&(job, finished.frame)).unwrap_or_default();
        for checkpoint in &mut finished.checkpoints {
            checkpoint.truth = seen.get(&checkpoint.spp).cloned();
        }
        let last = self.compared(plan, finished.frame, finished.film.pixels(), true);
        if let Some(checkpoint) = finished.checkpoints.last_mut() {
            checkpoint.truth = last;
        }
        // Frames come in order: the next one has another.
        self.reference = None;
    }

    fn compared(
        &mut self,
        plan: &OutputPlan,
        frame: FrameIndex,
        pixels: Vec<Rgb>,
        is_last: bool,
    ) -> Option<Comparison> {
        let references = plan.reference.as_ref()?;
        let outcome = self.reference(references.names.path(frame)).and_then(|reference| {
            let picture = Image { resolution: reference.resolution, pixels, metadata: None };
            let mut comparison = compare(&picture, reference)?;
            if is_last {
                comparison.flip = flip(&picture, reference);
            }
            if reference.metadata.as_ref().is_some_and(|metadata| metadata.seed == references.seed) {
                comparison.corrected = None;
            }
            Ok(comparison)
        });
        outcome.inspect_err(|error| warn!(%frame, %error, "picture cannot be compared")).ok()
    }

    fn reference(&mut self, path: PathBuf) -> Result<&Image, ImageError> {
        if self.reference.as_ref().is_none_or(|(at_hand, _)| *at_hand != path) {
            let image = read_image(&path)?;
            self.reference = Some((path, image));
        }
        Ok(&self.reference.as_ref().expect("it was just read").1)
    }
}
