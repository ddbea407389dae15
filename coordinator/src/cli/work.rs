//! Flags that say how much is rendered, and in which pieces.

use farm_film::Resolution;
use farm_job::{FrameRange, JobSpec, Stop};
use farm_proto::PARTIAL_BYTES_MAX;
use farm_worker::cli::{Fault, Loaded, duration};
use std::time::Duration;

/// Bytes of a partial beside its pixels.
const PARTIAL_OVERHEAD: usize = 2 << 20;

/// Samples per pixel where none are asked for.
const SPP: u64 = 64;

/// Samples per pixel after which a frame ends whatever its error: weeks of work for any picture worth looking at.
const SPP_MAX: u64 = 1 << 20;

/// A layer beside the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Layer {
    /// Estimated variance of every pixel: channels variance.R, variance.G, variance.B
    Variance,
}

/// How much is rendered, and in which pieces.
#[derive(Clone, Debug, clap::Args)]
pub struct WorkArgs {
    /// Samples per pixel; at most, with --error or --time [default: 64, and without a limit that matters with those]
    #[arg(long, env = "FARM_SPP", allow_negative_numbers = true, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1 << 40))]
    spp: Option<u64>,

    /// End a frame once its estimated relative mean squared error, and one standard deviation of that on top, is at most this
    #[arg(long, env = "FARM_ERROR", allow_negative_numbers = true, value_name = "E", value_parser = error_target)]
    pub error: Option<f64>,

    /// End a frame this long after its first unit was begun: 90s, 5m, 2h
    #[arg(long, env = "FARM_TIME", allow_negative_numbers = true, value_name = "TIME", value_parser = some_time)]
    time: Option<Duration>,

    /// Let tiles end on their own at powers of two from 64 spp on, so that the samples go where --error needs them. The picture
    /// then depends on --tile as well, but still on no worker
    #[arg(long, env = "FARM_ADAPTIVE")]
    adaptive: bool,

    /// Samples per pixel before which no frame ends for its error.
    #[arg(skip)]
    pub spp_min: u64,

    /// Layers to write beside the picture
    #[arg(long, env = "FARM_AOV", value_name = "NAME", value_enum)]
    aov: Option<Layer>,

    /// Frames to render: 5, 1-24 or 1-24x2
    #[arg(long, env = "FARM_FRAMES", value_name = "A-BxSTEP")]
    frames: Option<FrameRange>,

    /// Side of a tile in pixels; does not change the picture, but with --adaptive
    #[arg(long, env = "FARM_TILE", value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=65536), help_heading = "Farm")]
    tile: u32,
}

impl WorkArgs {
    /// Frame 0 when none was asked for.
    pub fn frames(&self) -> FrameRange {
        self.frames.unwrap_or(FrameRange::single(0))
    }

    /// Refuses what cannot be done, before anything is read.
    pub fn check(&self, resolution: Resolution) -> Result<(), Fault> {
        check_tile(resolution, self.tile).map_err(Fault::Input)
    }

    fn spp(&self) -> u64 {
        self.spp.unwrap_or(if self.stop().is_never() { SPP } else { SPP_MAX })
    }

    fn stop(&self) -> Stop {
        Stop { error: self.error, time: self.time, spp_min: self.spp_min, adaptive: self.adaptive }
    }

    /// The job.
    pub fn spec(&self, loaded: &Loaded, name: &str, priority: i32) -> Result<JobSpec, Fault> {
        let spec = JobSpec {
            name: name.to_owned(),
            scene: loaded.id,
            settings: loaded.settings,
            frames: self.frames(),
            spp: self.spp(),
            stop: self.stop(),
            variance: self.aov == Some(Layer::Variance),
            tile_side: self.tile,
            priority,
        };
        spec.validate().map_err(Fault::input)?;
        Ok(spec)
    }
}

/// A part of the whole: 0.02, 2%.
pub fn part(text: &str) -> Result<f64, String> {
    let (number, scale) = match text.strip_suffix('%') {
        Some(number) => (number, 0.01),
        None => (text, 1.0),
    };
    let part = number.trim().parse::<f64>().map(|number| number * scale).ok();
    part.filter(|part| (0.0..=1.0).contains(part))
        .ok_or_else(|| format!("{text:?} is no part of a whole: write 0.02 or 2%, at most 1"))
}

/// An error that can be reached.
fn error_target(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        Ok(value) => {
            Err(format!("no picture has an error of {value}: write a number above 0, for example 0.001"))
        }
        Err(_) => Err("write a number, for example 0.001".to_owned()),
    }
}

fn some_time(text: &str) -> Result<Duration, String> {
    match duration(text)? {
        Duration::ZERO => Err("no picture is rendered in no time: write a time such as 90s or 5m".to_owned()),
        time => Ok(time),
    }
}

/// A tile travels in one message.
pub fn check_tile(resolution: Resolution, side: u32) -> Result<(), String> {
    let width = u64::from(side.min(resolution.width()));
    let bytes = width * u64::from(side.min(resolution.height())) * 12;
    let allowed = (PARTIAL_BYTES_MAX - PARTIAL_OVERHEAD) as u64;
    if bytes <= allowed {
        return Ok(());
    }
    Err(format!(
        "--tile {side} makes tiles of {} MB, and at most {} MB travel at once: use --tile 4096 or less",
        bytes / 1_000_000,
        allowed / 1_000_000
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_within_a_whole() {
        assert_eq!(
            ["0", "0.02", "2%", "1", "100 %"].map(|text| part(text).unwrap()),
            [0.0, 0.02, 0.02, 1.0, 1.0]
        );
        assert!(["", "-0.1", "1.5", "nan", "120%", "all"].iter().all(|text| part(text).is_err()));
    }

    #[test]
    fn tiles_that_do_not_fit_a_message_are_refused() {
        let resolution = |width, height| Resolution::new(width, height).unwrap();
        assert!(check_tile(resolution(960, 540), 65536).is_ok());
        assert!(check_tile(resolution(5120, 2880), 65536).is_ok());
        let fault = check_tile(resolution(16384, 16384), 65536).unwrap_err();
        assert!(fault.contains("--tile 4096"), "{fault}");
        assert!(check_tile(resolution(65536, 65536), 4096).is_ok());
    }
}
