//! What a render leaves behind beside its pictures: a summary for people, an object for scripts.

mod chart;
mod folder;
mod heat_map;
mod table;

pub use folder::Folder;

use crate::forecast::Cause;
use crate::outputs::FrameSummary;
use crate::progress::{clock, metric};
use crate::tally::Tally;
use farm_film::{Counters, ErrorEstimate};
use farm_job::{JobSpec, Stop};
use farm_scene::Settings;
use farm_worker::cli::Loaded;
use farm_worker::renderer::FINGERPRINT;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Duration;

/// Everything worth knowing about a finished job. Times are in seconds.
#[derive(Debug, Serialize)]
pub struct RenderReport {
    /// Name of the scene.
    pub scene: String,
    /// Digest of the scene's snapshot.
    pub scene_id: String,
    /// How it was rendered.
    pub settings: Settings,
    /// When frames were to end before they had all samples.
    pub stop: Stop,
    /// Version and arithmetic of the renderer.
    pub renderer: &'static str,
    /// Where the coordinator ran.
    pub host: String,
    /// Threads of that machine.
    pub host_threads: usize,
    /// To read and decode the scene.
    pub load_s: f64,
    /// Longest time a worker needed to make a frame ready to trace.
    pub build_s: f64,
    /// From the first unit begun to the last finished.
    pub render_s: f64,
    /// Time that units took on their slots, summed.
    pub busy_s: f64,
    /// Processor time of them, as the workers measured it.
    pub cpu_s: f64,
    /// Samples per pixel; the most, where frames ended with different ones.
    pub spp: u64,
    /// Samples over all pixels and frames.
    pub samples: u64,
    /// Rays of all kinds.
    pub rays: u64,
    /// What was traced, and what went wrong.
    pub counters: Counters,
    /// Largest value that a sample may have; none unless asked for.
    pub clamp: Option<f32>,
    /// Of the frame's pixels; of several frames, of their digests in order.
    pub digest: String,
    /// Estimated root mean squared error in radiance, the worst frame's.
    pub error: Option<f64>,
    /// Estimated relative mean squared error, the worst frame's.
    pub rel_mse: Option<f64>,
    /// Files that were written.
    pub outputs: Vec<PathBuf>,
    /// Each frame.
    pub frames: Vec<FrameSummary>,
    /// Workers that delivered something.
    pub workers: usize,
    /// Units that were accepted.
    pub units: u64,
    /// What was odd about the scene.
    pub warnings: Vec<String>,
}

impl RenderReport {
    /// Sums everything up.
    pub fn new(
        spec: &JobSpec,
        loaded: &Loaded,
        build: Duration,
        frames: Vec<FrameSummary>,
        tally: &Tally,
    ) -> Self {
        let worst = |error: fn(&ErrorEstimate) -> f64| {
            frames.iter().filter_map(|frame| frame.error.as_ref().map(error)).reduce(f64::max)
        };
        Self {
            scene: spec.name.clone(),
            scene_id: spec.scene.to_string(),
            settings: spec.settings,
            stop: spec.stop,
            renderer: FINGERPRINT,
            host: rustix::system::uname().nodename().to_string_lossy().into_owned(),
            host_threads: std::thread::available_parallelism().map_or(1, usize::from),
            load_s: loaded.load.as_secs_f64(),
            build_s: build.as_secs_f64(),
            render_s: tally.span().as_secs_f64(),
            busy_s: tally.spent.busy.as_secs_f64(),
            cpu_s: tally.spent.cpu.as_secs_f64(),
            spp: frames.iter().map(|frame| frame.spp).max().unwrap_or(spec.spp),
            samples: tally.spent.counters.samples,
            rays: tally.spent.counters.rays(),
            counters: tally.spent.counters,
            clamp: spec.settings.clamp,
            digest: joint_digest(&frames),
            error: worst(|error| error.rmse),
            rel_mse: worst(|error| error.rel_mse),
            outputs: frames.iter().flat_map(|frame| frame.outputs.iter().cloned()).collect(),
            workers: tally.workers.len(),
            units: tally.units,
            warnings: loaded.report.warnings.clone(),
            frames,
        }
    }

    /// A few lines on standard error.
    pub fn summarise(&self) {
        for warning in &self.warnings {
            eprintln!("warning: {warning}");
        }
        for warning in self.counters.warnings() {
            eprintln!("warning: {warning}");
        }
        if let (Some(limit), Counters { clamped, samples, .. }) = (self.clamp, self.counters) {
            let share = self.frames.iter().map(|frame| frame.light_clamped).fold(0.0, f64::max);
            eprintln!(
                "samples limited to {limit}: {clamped} of {samples} were brighter, which took {:.3} % of the light",
                share * 100.0
            );
        }
        let beyond: u64 = self.frames.iter().map(|frame| frame.beyond_format).sum();
        if beyond > 0 {
            eprintln!(
                "warning: {beyond} values are beyond what the file holds and were stored as its largest"
            );
        }
        for ending in self.frames.iter().filter_map(|frame| self.ending(frame)) {
            eprintln!("{ending}");
        }
        let per_second = |count: u64| metric(count as f64 / self.render_s.max(1e-9));
        let plural = |count: usize| if count == 1 { "" } else { "s" };
        eprintln!(
            "{} frame{} of {} spp in {:.2} s ({}samples/s, {}rays/s), after {:.2} s to load and {:.2} s to build; {} unit{} by {} worker{}",
            self.frames.len(),
            plural(self.frames.len()),
            self.spp,
            self.render_s,
            per_second(self.samples),
            per_second(self.rays),
            self.load_s,
            self.build_s,
            self.units,
            plural(self.units as usize),
            self.workers,
            plural(self.workers),
        );
        if let (Some(error), Some(rel_mse)) = (self.error, self.rel_mse) {
            eprintln!("estimated error {error:.5} (relMSE {rel_mse:.3e})");
        }
        eprintln!("digest {}", self.digest);
        for output in &self.outputs {
            eprintln!("wrote {}", output.display());
        }
    }
}

impl RenderReport {
    /// Why a frame ended, where there was more than one reason why it might, and what it lacks of the error that was asked for.
    fn ending(&self, frame: &FrameSummary) -> Option<String> {
        if self.stop.is_never() {
            return None;
        }
        let why = match (frame.ended, self.stop) {
            (Cause::Error, Stop { error: Some(target), .. }) => {
                format!("its estimated relative mean squared error is at most {target}")
            }
            (Cause::Time, Stop { time: Some(time), .. }) => {
                format!("its time of {} s was over", time.as_secs_f64())
            }
            _ => "it has all its samples".to_owned(),
        };
        let mut text =
            format!("frame {} ended at {} spp after {:.2} s: {why}", frame.frame, frame.spp, frame.render_s);
        if frame.ended != Cause::Error
            && let Some((target, error)) = self.stop.error.zip(frame.error)
        {
            text += &format!(
                ", and not because of its estimated relative mean squared error, which is {:.3e} where {target} was asked for",
                error.rel_mse
            );
            if let Some(needed) = error.predict_cautious(target) {
                let seconds = needed.spp / frame.spp as f64 * frame.render_s;
                text +=
                    &format!("; that takes about {:.0} spp, {} at this speed", needed.spp, clock(seconds));
            }
        }
        if let Some(adaptive) = &frame.adaptive {
            text += &format!("; {adaptive}");
        }
        Some(text)
    }
}

fn joint_digest(frames: &[FrameSummary]) -> String {
    match frames {
        [frame] => frame.digest.clone(),
        frames => {
            let mut hasher = blake3::Hasher::new();
            for frame in frames {
                hasher.update(frame.digest.as_bytes());
            }
            hasher.finalize().to_string()
        }
    }
}
