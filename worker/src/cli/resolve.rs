//! From flags to a scene and settings: what the command line says overrides what the file says.

use super::Fault;
use super::picture::{FilterArg, IntegratorArg, PictureArgs, ShutterPosition};
use super::scene_file;
use farm_import::{ImportReport, is_lit, studio_environment};
use farm_scene::{Camera, Filter, Integrator, Lens, Scene, SceneId, Settings, Shutter, encode};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A scene as it will be rendered.
pub struct Loaded {
    /// With every override applied.
    pub scene: Arc<Scene>,
    /// Its bytes, for workers elsewhere.
    pub snapshot: Vec<u8>,
    /// Its name.
    pub id: SceneId,
    /// How to render it.
    pub settings: Settings,
    /// What was read and left out.
    pub report: ImportReport,
    /// To read and decode.
    pub load: Duration,
}

impl PictureArgs {
    /// Reads the scene and applies every override.
    pub fn load(&self) -> Result<Loaded, Fault> {
        let begun = Instant::now();
        let (mut scene, mut report) = scene_file::read(&self.scene, self.animation.as_deref())?;
        let camera = self.camera_index(&scene)?;
        self.override_lens(&mut scene.cameras[camera])?;
        self.override_shutter(&mut scene.cameras[camera]);
        self.override_environment(&mut scene, &mut report)?;
        if !is_lit(&scene) {
            scene.environment = Some(studio_environment());
            report.warnings.push(
                "the scene has no light of its own and is lit by a studio; --environment FILE gives it another"
                    .to_owned(),
            );
        }
        scene.validate().map_err(Fault::input)?;
        let settings = Settings {
            camera: u32::try_from(camera).expect("scenes have fewer cameras than that"),
            width: self.resolution.width(),
            height: self.resolution.height(),
            integrator: match self.integrator {
                IntegratorArg::Path => Integrator::Path,
                IntegratorArg::Distribution => Integrator::Distribution,
            },
            filter: match self.filter {
                FilterArg::Box => Filter::Box,
                FilterArg::Gaussian => Filter::Gaussian,
                FilterArg::BlackmanHarris => Filter::BlackmanHarris,
            },
            max_depth: self.max_depth,
            seed: self.seed,
            fps: self.fps,
            clamp: self.clamp,
        };
        let snapshot = encode(&scene);
        let id = SceneId::of(&snapshot);
        Ok(Loaded { scene: Arc::new(scene), snapshot, id, settings, report, load: begun.elapsed() })
    }

    fn camera_index(&self, scene: &Scene) -> Result<usize, Fault> {
        let Some(wanted) = &self.camera else { return Ok(0) };
        scene.cameras.iter().position(|camera| camera.name == *wanted).ok_or_else(|| {
            let names: Vec<_> = scene.cameras.iter().map(|camera| format!("{:?}", camera.name)).collect();
            Fault::input(format!(
                "{} has no camera {wanted:?}; it has {}",
                self.scene.display(),
                names.join(", ")
            ))
        })
    }

    fn override_lens(&self, camera: &mut Camera) -> Result<(), Fault> {
        let radius = self.aperture_radius.map(|radius| radius as f32);
        if radius == Some(0.0) {
            camera.lens = None;
            return Ok(());
        }
        match (&mut camera.lens, radius, self.focus_distance) {
            (_, None, None) => {}
            (Some(lens), radius, focus) => {
                lens.aperture_radius = radius.unwrap_or(lens.aperture_radius);
                lens.focus_distance = focus.unwrap_or(lens.focus_distance);
            }
            (lens @ None, Some(aperture_radius), Some(focus_distance)) => {
                *lens = Some(Lens {
                    aperture_radius,
                    focus_distance,
                    blades: 0,
                    rotation: 0.0,
                    anamorphic_ratio: 1.0,
                });
            }
            (None, Some(_), None) => {
                return Err(Fault::input(format!(
                    "camera {:?} has no focus distance: give one with --focus-distance",
                    camera.name
                )));
            }
            (None, None, Some(_)) => {
                return Err(Fault::input(format!(
                    "camera {:?} has no lens, so everything is in focus: give one with --aperture-radius",
                    camera.name
                )));
            }
        }
        Ok(())
    }

    fn override_shutter(&self, camera: &mut Camera) {
        if let Some(part) = self.shutter {
            camera.shutter = shutter(part / self.fps, self.shutter_position);
        }
    }

    fn override_environment(&self, scene: &mut Scene, report: &mut ImportReport) -> Result<(), Fault> {
        if let Some(path) = &self.environment {
            scene.environment = Some(scene_file::environment(path, report)?);
        }
        if self.environment_rotation.is_none() && self.environment_intensity.is_none() {
            return Ok(());
        }
        let Some(environment) = &mut scene.environment else {
            return Err(Fault::input(
                "there is no environment to turn or scale: give one with --environment",
            ));
        };
        if let Some(degrees) = self.environment_rotation {
            environment.rotation = scene_file::about_y(degrees);
        }
        if let Some(intensity) = self.environment_intensity {
            environment.intensity = intensity as f32;
        }
        Ok(())
    }
}

/// A shutter that is open for `seconds`.
fn shutter(seconds: f64, position: ShutterPosition) -> Shutter {
    let open = match position {
        ShutterPosition::Start => 0.0,
        ShutterPosition::Center => -seconds / 2.0,
        ShutterPosition::End => -seconds,
    };
    Shutter { open, close: open + seconds }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use farm_scene::Projection;

    #[derive(clap::Parser)]
    struct Cli {
        #[command(flatten)]
        picture: PictureArgs,
    }

    fn picture(flags: &[&str]) -> PictureArgs {
        Cli::parse_from(["program", "scene.gltf"].iter().chain(flags)).picture
    }

    fn camera(lens: Option<Lens>) -> Camera {
        Camera {
            name: "eye".to_owned(),
            node: 0,
            projection: Projection::Perspective { yfov: 1.0 },
            lens,
            shutter: Shutter::default(),
        }
    }

    const LENS: Lens =
        Lens { aperture_radius: 0.01, focus_distance: 2.0, blades: 6, rotation: 0.1, anamorphic_ratio: 1.0 };

    #[test]
    fn lens_flags_override_the_camera() {
        let lens = |flags: &[&str], lens| {
            let mut camera = camera(lens);
            picture(flags).override_lens(&mut camera).map(|()| camera.lens)
        };
        assert_eq!(lens(&[], Some(LENS)).unwrap(), Some(LENS));
        assert_eq!(lens(&["--aperture-radius", "0"], Some(LENS)).unwrap(), None);
        let wider = lens(&["--aperture-radius", "0.5"], Some(LENS)).unwrap();
        assert_eq!(wider, Some(Lens { aperture_radius: 0.5, ..LENS }));
        let made = lens(&["--aperture-radius", "0.5", "--focus-distance", "3"], None).unwrap().unwrap();
        assert_eq!((made.aperture_radius, made.focus_distance, made.blades), (0.5, 3.0, 0));
        assert!(
            lens(&["--aperture-radius", "0.5"], None).unwrap_err().to_string().contains("--focus-distance")
        );
        assert!(
            lens(&["--focus-distance", "3"], None).unwrap_err().to_string().contains("--aperture-radius")
        );
    }

    #[test]
    fn the_shutter_lies_where_it_is_told() {
        let of = |flags: &[&str]| {
            let mut camera = camera(None);
            picture(flags).override_shutter(&mut camera);
            (camera.shutter.open, camera.shutter.close)
        };
        assert_eq!(of(&[]), (0.0, 0.0));
        assert_eq!(of(&["--fps", "10", "--shutter", "0.5"]), (-0.025, 0.025));
        assert_eq!(of(&["--fps", "10", "--shutter", "0.5", "--shutter-position", "start"]), (0.0, 0.05));
        assert_eq!(of(&["--fps", "10", "--shutter", "0.5", "--shutter-position", "end"]), (-0.05, 0.0));
    }

    #[test]
    fn a_camera_that_does_not_exist_lists_those_that_do() {
        let scene = Scene { cameras: vec![camera(None)], ..Scene::default() };
        assert_eq!(picture(&[]).camera_index(&scene).unwrap(), 0);
        let fault = picture(&["--camera", "door"]).camera_index(&scene).unwrap_err().to_string();
        assert!(fault.contains("\"door\"") && fault.contains("\"eye\""), "{fault}");
    }

    #[test]
    fn an_environment_cannot_be_turned_without_one() {
        let fault = picture(&["--environment-rotation", "-90"])
            .override_environment(&mut Scene::default(), &mut ImportReport::default());
        assert!(fault.unwrap_err().to_string().contains("--environment"));
    }
}
