//! A small farm for stories, and a large one for accidents.

mod farm;
mod scaling;
mod simulation;
mod stories;
mod verification;

use farm_film::WorkUnit;
use farm_job::{Digest, JobSpec, Stop};
use farm_scene::{Filter, Integrator, SceneId, Settings};

/// Stands for the digest of what an honest worker renders: units differ in it, workers do not.
pub(crate) fn honest(unit: &WorkUnit) -> Digest {
    let mut digest = [0; 32];
    let facts =
        [unit.frame.0, unit.tile.x0(), unit.tile.y0(), unit.block.start() as u32, unit.block.end() as u32];
    for (chunk, fact) in digest.chunks_exact_mut(4).zip(facts) {
        chunk.copy_from_slice(&fact.to_le_bytes());
    }
    Digest(digest)
}

/// Stands for the digest of what a worker renders that is broken or lies in its own way.
pub(crate) fn wrong(unit: &WorkUnit, way: u8) -> Digest {
    let mut digest = honest(unit);
    digest.0[31] = way;
    digest
}

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
        clamp: None,
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
