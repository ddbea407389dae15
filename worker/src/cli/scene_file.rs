//! Scenes and environments from files.

use super::Fault;
use farm_image::read_image;
use farm_import::{
    EnvironmentReport, ExrEnvironment, ImportOptions, ImportReport, environment_from_pixels, import,
    load_environment,
};
use farm_scene::{Environment, Image, Scene};
use glam::Quat;
use std::path::Path;

/// The scene in a file, and what was read and left out.
pub(super) fn read(path: &Path, animation: Option<&str>) -> Result<(Scene, ImportReport), Fault> {
    let options = ImportOptions { animation: animation.map(str::to_owned) };
    let mut imported = import(path, &options).map_err(Fault::input)?;
    if let Some(named) = imported.exr_environment {
        let ExrEnvironment { path, intensity, rotation, visible_to_camera } = named;
        let image = environment_image(&path, &mut imported.report)?;
        imported.scene.environment = Some(Environment { image, intensity, rotation, visible_to_camera });
    }
    Ok((imported.scene, imported.report))
}

/// The environment in a file.
pub(super) fn environment(path: &Path, report: &mut ImportReport) -> Result<Environment, Fault> {
    let image = environment_image(path, report)?;
    Ok(Environment { image, intensity: 1.0, rotation: Quat::IDENTITY, visible_to_camera: true })
}

fn environment_image(path: &Path, report: &mut ImportReport) -> Result<Image, Fault> {
    let is_exr = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
    let (image, EnvironmentReport { pixels_repaired }) = if is_exr {
        let picture = read_image(path).map_err(Fault::input)?;
        let (width, height) = (picture.resolution.width(), picture.resolution.height());
        environment_from_pixels(&path.display().to_string(), width, height, picture.pixels)
    } else {
        load_environment(path)
    }
    .map_err(Fault::input)?;
    if pixels_repaired > 0 {
        let name = path.display();
        report
            .warnings
            .push(format!("{name}: {pixels_repaired} pixels held no radiance and were made black"));
    }
    Ok(image)
}

/// A turn about +Y.
pub(super) fn about_y(degrees: f64) -> Quat {
    let half = degrees.to_radians() / 2.0;
    Quat::from_xyzw(0.0, libm::sin(half) as f32, 0.0, libm::cos(half) as f32)
}
