//! Jobs and their settings.

use super::{ConvertError, seconds, text};
use crate::v1;
use farm_job::{Digest, FrameRange, JobSpec, Stop};
use farm_scene::{Filter, Integrator, SceneId, Settings};

impl From<Settings> for v1::Settings {
    fn from(settings: Settings) -> Self {
        let integrator = match settings.integrator {
            Integrator::Path => v1::Integrator::Path,
            Integrator::Distribution => v1::Integrator::Distribution,
        };
        let filter = match settings.filter {
            Filter::Box => v1::Filter::Box,
            Filter::Gaussian => v1::Filter::Gaussian,
            Filter::BlackmanHarris => v1::Filter::BlackmanHarris,
        };
        Self {
            camera: settings.camera,
            width: settings.width,
            height: settings.height,
            integrator: integrator.into(),
            filter: filter.into(),
            max_depth: settings.max_depth,
            seed: settings.seed,
            fps: settings.fps,
            clamp: settings.clamp,
        }
    }
}

impl TryFrom<v1::Settings> for Settings {
    type Error = ConvertError;

    fn try_from(settings: v1::Settings) -> Result<Self, ConvertError> {
        let integrator = match settings.integrator() {
            v1::Integrator::Path => Integrator::Path,
            v1::Integrator::Distribution => Integrator::Distribution,
            v1::Integrator::Unspecified => {
                return Err(ConvertError::Unknown { family: "integrator", value: settings.integrator });
            }
        };
        let filter = match settings.filter() {
            v1::Filter::Box => Filter::Box,
            v1::Filter::Gaussian => Filter::Gaussian,
            v1::Filter::BlackmanHarris => Filter::BlackmanHarris,
            v1::Filter::Unspecified => {
                return Err(ConvertError::Unknown { family: "filter", value: settings.filter });
            }
        };
        if let Some(clamp) = settings.clamp.filter(|clamp| !(clamp.is_finite() && *clamp > 0.0)) {
            return Err(ConvertError::Number { what: "the limit on samples", value: f64::from(clamp) });
        }
        Ok(Self {
            camera: settings.camera,
            width: settings.width,
            height: settings.height,
            integrator,
            filter,
            max_depth: settings.max_depth,
            seed: settings.seed,
            fps: settings.fps,
            clamp: settings.clamp,
        })
    }
}

impl From<FrameRange> for v1::FrameRange {
    fn from(frames: FrameRange) -> Self {
        Self { first: frames.first(), last: frames.last(), step: frames.step() }
    }
}

impl From<SceneId> for v1::Digest {
    fn from(scene: SceneId) -> Self {
        Digest(scene.0).into()
    }
}

impl TryFrom<v1::Digest> for SceneId {
    type Error = ConvertError;

    fn try_from(digest: v1::Digest) -> Result<Self, ConvertError> {
        Ok(Self(Digest::try_from(digest)?.0))
    }
}

impl From<JobSpec> for v1::JobSpec {
    fn from(spec: JobSpec) -> Self {
        Self {
            name: spec.name,
            scene: Some(spec.scene.into()),
            settings: Some(spec.settings.into()),
            frames: Some(spec.frames.into()),
            spp: spec.spp,
            tile_side: spec.tile_side,
            priority: spec.priority,
            stop: (!spec.stop.is_never()).then(|| spec.stop.into()),
            variance: spec.variance,
        }
    }
}

impl From<Stop> for v1::Stop {
    fn from(stop: Stop) -> Self {
        Self {
            error: stop.error,
            seconds: stop.time.map(|time| time.as_secs_f64()),
            spp_min: stop.spp_min,
            adaptive: stop.adaptive,
        }
    }
}

impl TryFrom<v1::Stop> for Stop {
    type Error = ConvertError;

    fn try_from(stop: v1::Stop) -> Result<Self, ConvertError> {
        Ok(Self {
            error: stop.error,
            time: stop.seconds.map(|time| seconds("time to stop after", time)).transpose()?,
            spp_min: stop.spp_min,
            adaptive: stop.adaptive,
        })
    }
}

impl TryFrom<v1::JobSpec> for JobSpec {
    type Error = ConvertError;

    fn try_from(spec: v1::JobSpec) -> Result<Self, ConvertError> {
        let frames = spec.frames.ok_or(ConvertError::Missing("frame range"))?;
        let spec = Self {
            name: text("job name", spec.name)?,
            scene: spec.scene.ok_or(ConvertError::Missing("scene"))?.try_into()?,
            settings: spec.settings.ok_or(ConvertError::Missing("settings"))?.try_into()?,
            frames: FrameRange::new(frames.first, frames.last, frames.step)?,
            spp: spec.spp,
            stop: spec.stop.map(Stop::try_from).transpose()?.unwrap_or_default(),
            variance: spec.variance,
            tile_side: spec.tile_side,
            priority: spec.priority,
        };
        spec.validate()?;
        Ok(spec)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec() -> JobSpec {
        JobSpec {
            name: "box".to_owned(),
            scene: SceneId([3; 32]),
            settings: Settings {
                camera: 1,
                width: 640,
                height: 360,
                integrator: Integrator::Distribution,
                filter: Filter::BlackmanHarris,
                max_depth: 8,
                seed: u64::MAX,
                fps: 23.976,
                clamp: Some(12.5),
            },
            frames: FrameRange::new(1, 24, 2).unwrap(),
            spp: 100,
            stop: Stop {
                error: Some(1e-3),
                time: Some(std::time::Duration::from_millis(2500)),
                spp_min: 32,
                adaptive: true,
            },
            variance: true,
            tile_side: 64,
            priority: -3,
        }
    }

    #[test]
    fn a_job_survives_the_journey() {
        assert_eq!(JobSpec::try_from(v1::JobSpec::from(spec())).unwrap(), spec());
    }

    #[test]
    fn impossible_jobs_are_refused_with_a_sentence() {
        let refused = |change: fn(&mut v1::JobSpec)| {
            let mut wire = v1::JobSpec::from(spec());
            change(&mut wire);
            JobSpec::try_from(wire).unwrap_err().to_string()
        };
        assert_eq!(refused(|job| job.scene = None), "message has no scene");
        assert!(refused(|job| job.spp = 0).contains("0..0"));
        assert!(refused(|job| job.tile_side = 0).contains("tile of 0 pixels"));
        assert!(refused(|job| job.frames.as_mut().unwrap().step = 0).contains("hold no frame"));
        assert!(refused(|job| job.settings.as_mut().unwrap().width = 0).contains("0x360"));
        assert!(refused(|job| job.settings.as_mut().unwrap().fps = f64::NAN).contains("frame rate"));
        assert!(refused(|job| job.settings.as_mut().unwrap().filter = 99).contains("99 is no known filter"));
        assert!(refused(|job| job.stop.as_mut().unwrap().error = Some(0.0)).contains("error of 0"));
        assert!(refused(|job| job.stop.as_mut().unwrap().error = None).contains("none is given"));
        assert!(refused(|job| job.stop.as_mut().unwrap().seconds = Some(-1.0)).contains("time to stop"));
        assert!(refused(|job| job.name = "x".repeat(5000)).contains("5000 bytes"));
    }
}
