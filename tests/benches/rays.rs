//! Samples and rays per second of the kernel, single thread: `cargo bench -p farm-tests --bench rays`.
//!
//! Scenes are imported and prepared once; only `render` is timed. The median of several passes is printed: compare figures
//! of one run with each other only.

use farm_film::{FrameIndex, SampleBlock};
use farm_render::{PreparedScene, render};
use farm_scene::{Filter, Integrator, Settings};
use farm_tests::scenes::{Named, Scale};
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// Timed passes over a frame.
const PASSES: usize = 5;

fn main() {
    println!("| scene | triangles | Msamples/s | Mrays/s | min..max |");
    println!("|---|---|---|---|---|");
    for name in ["cornell-diffuse", "cornell", "million-triangles"] {
        measure(name);
    }
}

fn measure(name: &str) {
    let bytes = Named::find(name).expect("one of the project's scenes").glb(Scale(0));
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.glb");
    std::fs::write(&path, bytes).expect("the scene is written");
    let scene = prepared(&path);
    let tile = scene.resolution().full();
    let block = SampleBlock::new(0..16).expect("a leaf");
    let mut rates: Vec<(f64, f64)> = (0..PASSES)
        .map(|_| {
            let start = Instant::now();
            let rendered = render(&scene, tile, block, &|| false).expect("nobody stops it");
            let seconds = start.elapsed().as_secs_f64() * 1e6;
            (rendered.counters.rays() as f64 / seconds, rendered.counters.samples as f64 / seconds)
        })
        .collect();
    rates.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (rays, samples) = rates[PASSES / 2];
    let triangles = scene.report().triangles;
    println!(
        "| {name} | {triangles} | {samples:.3} | {rays:.3} | {:.3}..{:.3} |",
        rates[0].0,
        rates[PASSES - 1].0
    );
}

fn prepared(path: &Path) -> PreparedScene {
    let imported = farm_import::import(path, &Default::default()).expect("the scene imports");
    let settings = Settings {
        camera: 0,
        width: 320,
        height: 180,
        integrator: Integrator::Path,
        filter: Filter::Box,
        max_depth: 8,
        seed: 0,
        fps: 24.0,
        clamp: None,
    };
    PreparedScene::new(&Arc::new(imported.scene), &settings, FrameIndex(0))
        .expect("the scene can be rendered")
}
