//! A small farm for stories, and a large one for accidents.

mod farm;
mod simulation;
mod stories;

use farm_job::{JobSpec, Stop};
use farm_scene::{Filter, Integrator, SceneId, Settings};

/// A job of `width x height` pixels in tiles of `side`, with `spp` samples, for `frames`.
pub(crate) fn spec(width: u32, height: u32, side: u32, spp: u64, frames: &str) -> JobSpec {
    let settings = Settings {
        camera: 0,
        width,
        height,
        integrator: Integrator::Path,
        filter: Filter::Box,
        max_depth: 8,
        seed: 0,
        fps: 24.0,
    };
    JobSpec {
        name: "test".to_owned(),
        scene: SceneId([0; 32]),
        settings,
        frames: frames.parse().expect("a frame range"),
        spp,
        stop: Stop::default(),
        variance: false,
        tile_side: side,
        priority: 0,
    }
}
