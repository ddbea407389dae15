//! When a frame, and with it a job, will be done.

use crate::open_frame::Outlook;
use farm_job::JobSpec;
use serde::Serialize;

/// How far the speed of the rest may lie from that of what is done: tiles and rounds differ, and machines come and go.
const SPEED_SPREAD: f64 = 1.1;

/// What ends a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// It has all its samples.
    Samples,
    /// Its error is low enough.
    Error,
    /// Its time is over.
    Time,
}

/// When something ends, in seconds since its begin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Forecast {
    /// Why.
    pub cause: Cause,
    /// Samples per pixel at the end.
    pub spp: f64,
    /// Expected end.
    pub seconds: f64,
    /// The end lies hardly before.
    pub seconds_low: f64,
    /// The end lies hardly after.
    pub seconds_high: f64,
}

impl Forecast {
    /// The end of a frame, `seconds` after its begin. None while nothing can be said.
    pub fn of_frame(spec: &JobSpec, outlook: &Outlook, seconds: f64) -> Option<Self> {
        let area = f64::from(spec.settings.width) * f64::from(spec.settings.height);
        let done = outlook.samples as f64 / area;
        if done <= 0.0 || seconds <= 0.0 {
            return None;
        }
        let per_sample = seconds / done;
        let after =
            |spp: f64, spread: f64| seconds + (outlook.mean_spp(spp) - done).max(0.0) * per_sample * spread;
        let at = |cause, spp: f64, band: f64| Self {
            cause,
            spp,
            seconds: after(spp, 1.0),
            seconds_low: after(spp / band, 1.0 / SPEED_SPREAD),
            seconds_high: after(spp * band, SPEED_SPREAD),
        };
        let mut ends = Vec::new();
        if let Some(time) = spec.stop.time {
            let end = time.as_secs_f64().max(seconds);
            let spp = done * end / seconds;
            ends.push(Self { cause: Cause::Time, spp, seconds: end, seconds_low: end, seconds_high: end });
        }
        match spec.stop.error.map(|target| outlook.error.and_then(|error| error.predict_cautious(target))) {
            Some(Some(needed)) => {
                let least = needed.spp.max(spec.stop.spp_min.max(outlook.spp) as f64);
                // An error that wants more samples than there are may still be met early, but it is not what is expected.
                let cause = if least > spec.spp as f64 { Cause::Samples } else { Cause::Error };
                ends.push(at(cause, round_up(spec, least), needed.band));
                ends.push(at(Cause::Samples, spec.spp as f64, 1.0));
            }
            // It may be over any moment.
            Some(None) => ends.iter_mut().for_each(|end| end.seconds_low = seconds),
            None => ends.push(at(Cause::Samples, spec.spp as f64, 1.0)),
        }
        ends.into_iter().reduce(Self::or)
    }

    /// Whichever comes first.
    fn or(self, other: Self) -> Self {
        let first = if other.seconds < self.seconds { other } else { self };
        Self {
            seconds_low: self.seconds_low.min(other.seconds_low),
            seconds_high: self.seconds_high.min(other.seconds_high),
            ..first
        }
    }
}

/// What is left of a job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Left {
    /// Samples over all pixels of all its frames, done or not.
    pub samples: f64,
    /// Seconds until its end.
    pub seconds: f64,
    /// The end lies hardly before.
    pub seconds_low: f64,
    /// The end lies hardly after.
    pub seconds_high: f64,
}

impl Left {
    /// Of a job with `written` finished frames, from how it stands with the first of the others. Later ones are taken to be like
    /// that one. None while nothing can be said.
    pub fn of_job(spec: &JobSpec, written: u64, outlook: &Outlook) -> Option<Self> {
        let seconds = outlook.begun?.elapsed().as_secs_f64();
        let end = Forecast::of_frame(spec, outlook, seconds)?;
        Some(Self::after(&end, outlook.mean_spp(end.spp), spec, written, seconds))
    }

    fn after(end: &Forecast, spp: f64, spec: &JobSpec, written: u64, seconds: f64) -> Self {
        let later = spec.frames.count().saturating_sub(written + 1) as f64;
        let left = |end: f64| (end - seconds).max(0.0) + later * end;
        let area = f64::from(spec.settings.width) * f64::from(spec.settings.height);
        Self {
            samples: area * spp * spec.frames.count() as f64,
            seconds: left(end.seconds),
            seconds_low: left(end.seconds_low),
            seconds_high: left(end.seconds_high),
        }
    }
}

/// The first moment at which a frame of `spp` samples per pixel can end.
fn round_up(spec: &JobSpec, spp: f64) -> f64 {
    let rounds = spec.rounds().unwrap_or_default();
    let end = rounds.iter().map(|round| round.end() as f64).find(|end| *end >= spp);
    end.unwrap_or(spec.spp as f64)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use farm_film::ErrorEstimate;
    use farm_job::{FrameRange, Stop};
    use farm_scene::{Filter, Integrator, SceneId, Settings};
    use std::time::Duration;

    /// A job of 10 x 10 pixels in one tile.
    pub(crate) fn spec(spp: u64, stop: Stop) -> JobSpec {
        let settings = Settings {
            camera: 0,
            width: 10,
            height: 10,
            integrator: Integrator::Path,
            filter: Filter::Box,
            max_depth: 4,
            seed: 0,
            fps: 24.0,
            clamp: None,
        };
        JobSpec {
            name: String::new(),
            scene: SceneId([0; 32]),
            settings,
            frames: FrameRange::single(0),
            spp,
            stop,
            variance: false,
            tile_side: 10,
            priority: 0,
        }
    }

    /// After 64 samples per pixel of an error that falls with their number.
    fn outlook() -> Outlook {
        let error = ErrorEstimate {
            spp: 64,
            rmse: 0.1,
            rel_mse: 0.04,
            rmse_band: 1.05,
            rel_mse_band: 1.21,
            rate: 1.0,
            rel_rate: 1.0,
            rel_parts: [0.04, 0.0, 0.0],
        };
        Outlook {
            spp: 64,
            samples: 6400,
            open: 1.0,
            ended_spp: 0.0,
            begun: None,
            error: Some(error),
            slope: None,
        }
    }

    #[test]
    fn whatever_comes_first_ends_a_frame() {
        let end = |spp, stop| Forecast::of_frame(&spec(spp, stop), &outlook(), 8.0).unwrap();
        let all = end(256, Stop::default());
        assert_eq!((all.cause, all.seconds), (Cause::Samples, 32.0));
        let error = Stop { error: Some(0.0129), ..Stop::default() };
        let good = end(1 << 20, error);
        assert_eq!((good.cause, good.seconds, good.spp), (Cause::Error, 32.0, 256.0));
        assert_eq!(outlook().error.unwrap().cautious(), 0.04 * 1.21f64.sqrt());
        assert!(good.seconds_low < 30.0 && good.seconds_high > 35.0, "{good:?}");
        assert_eq!(end(128, error).cause, Cause::Samples);
        let late = end(1 << 20, Stop { time: Some(Duration::from_secs(20)), ..error });
        assert_eq!((late.cause, late.seconds, late.spp), (Cause::Time, 20.0, 160.0));
        let animation = JobSpec { frames: FrameRange::new(1, 4, 1).unwrap(), ..spec(160, Stop::default()) };
        assert_eq!(
            Left::after(&late, late.spp, &animation, 1, 8.0).seconds,
            12.0 + 40.0,
            "two more like this one"
        );
    }

    #[test]
    fn tiles_that_have_ended_take_no_more_time() {
        let stop = Stop { error: Some(0.0129), adaptive: true, ..Stop::default() };
        // Half of the tiles have ended with these 64 samples: 6400 are done, and 9600 are left.
        let outlook = Outlook { open: 0.5, ended_spp: 32.0, ..outlook() };
        let end = Forecast::of_frame(&spec(1 << 20, stop), &outlook, 8.0).unwrap();
        assert_eq!((end.spp, end.seconds), (256.0, 20.0));
        assert_eq!(
            Left::after(&end, outlook.mean_spp(end.spp), &spec(1 << 20, stop), 0, 8.0).samples,
            16_000.0
        );
    }

    #[test]
    fn nothing_is_said_of_an_error_that_is_not_known() {
        let stop = Stop { error: Some(0.01), ..Stop::default() };
        let unknown = Outlook { error: None, ..outlook() };
        assert_eq!(Forecast::of_frame(&spec(1 << 20, stop), &unknown, 8.0), None);
        let stop = Stop { time: Some(Duration::from_secs(20)), ..stop };
        let end = Forecast::of_frame(&spec(1 << 20, stop), &unknown, 8.0).unwrap();
        assert_eq!((end.seconds_low, end.seconds, end.seconds_high), (8.0, 20.0, 20.0));
    }
}
