//! What the farm costs beside rendering: `coordinator render` with one local worker against a bare loop over the same units,
//! and how long the worker's thread waits between two units.
//!
//! `cargo bench -p farm-tests --bench farm_overhead [SCENE [SPP]]`

use farm_film::{Film, FrameIndex, SampleRange};
use farm_render::{PreparedScene, render};
use farm_scene::{Filter, Integrator, Settings};
use farm_tests::programs::{release_coordinator, root};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

const WIDTH: u32 = 480;
const HEIGHT: u32 = 270;
const TILE: u32 = 64;

/// Interleaved, so that a busy machine disturbs both alike.
const ROUNDS: usize = 5;

fn main() {
    let mut arguments = std::env::args().skip(1).filter(|argument| !argument.starts_with("--"));
    let scene = arguments.next().map_or_else(|| root().join("tests/scenes/cornell.gltf"), PathBuf::from);
    let spp: u64 = arguments.next().map_or(64, |spp| spp.parse().expect("samples per pixel"));
    let programs = release_coordinator();
    let (mut bare, mut farm, mut idle) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        bare.push(bare_loop(&scene, spp));
        let (seconds, waits) = farm_render(&programs, &scene, spp);
        farm.push(seconds);
        idle.extend(waits);
    }
    let (bare, farm) = (fastest(&bare), fastest(&farm));
    idle.sort();
    let p99 = idle.get(idle.len() * 99 / 100).copied().unwrap_or_default();
    println!("bare loop   {bare:.3} s");
    println!("farm        {farm:.3} s");
    println!("overhead    {:.4}  (target 1.02)", farm / bare);
    println!("idle p99    {:.3} ms over {} units  (target 50)", p99.as_secs_f64() * 1e3, idle.len());
}

fn fastest(seconds: &[f64]) -> f64 {
    seconds.iter().copied().fold(f64::INFINITY, f64::min)
}

/// Every unit of the frame on one thread, merged; seconds from the first unit to the last.
fn bare_loop(scene: &Path, spp: u64) -> f64 {
    let imported =
        farm_import::import(scene, &farm_import::ImportOptions::default()).expect("the scene imports");
    let settings = Settings {
        camera: 0,
        width: WIDTH,
        height: HEIGHT,
        integrator: Integrator::Path,
        filter: Filter::BlackmanHarris,
        max_depth: 8,
        seed: 0,
        fps: 24.0,
        clamp: None,
    };
    let prepared =
        PreparedScene::new(&Arc::new(imported.scene), &settings, FrameIndex(0)).expect("it is fit to render");
    let mut film = Film::new(prepared.resolution(), TILE, spp).expect("samples");
    let begun = Instant::now();
    for block in SampleRange::new(0..spp).and_then(SampleRange::blocks).expect("blocks") {
        for tile in prepared.resolution().tiles(TILE) {
            let rendered = render(&prepared, tile, block, &|| false).expect("nobody stops it");
            film.add(rendered.tile).expect("it belongs to the frame");
        }
    }
    assert!(film.is_complete());
    begun.elapsed().as_secs_f64()
}

fn farm_render(coordinator: &Path, scene: &Path, spp: u64) -> (f64, Vec<Duration>) {
    let folder = tempfile::tempdir().expect("a place for the picture");
    let output = Command::new(coordinator)
        .arg("render")
        .arg(scene)
        .args(["--threads", "1", "--json", "--spp", &spp.to_string(), "--tile", &TILE.to_string()])
        .args(["--resolution", &format!("{WIDTH}x{HEIGHT}"), "-o"])
        .arg(folder.path().join("out.exr"))
        .env("FARM_LOG", "farm_worker=debug")
        .output()
        .expect("the coordinator runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    let report: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    // The first unit waits for the scene.
    let waits = said.lines().filter_map(idle_of).skip(1).collect();
    (report["render_s"].as_f64().expect("a time"), waits)
}

/// The `idle=1.5ms` of a log line.
fn idle_of(line: &str) -> Option<Duration> {
    let text = line.split("idle=").nth(1)?.split_whitespace().next()?;
    let units = [("ns", 1e-9), ("\u{b5}s", 1e-6), ("ms", 1e-3), ("s", 1.0)];
    let (number, unit) = units.iter().find_map(|(unit, size)| Some((text.strip_suffix(unit)?, size)))?;
    Some(Duration::from_secs_f64(number.parse::<f64>().ok()? * unit))
}
