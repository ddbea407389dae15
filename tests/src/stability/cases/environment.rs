//! Light from infinitely far.

use crate::stability::bench::Bench;
use crate::stability::measure;
use crate::stability::stage::{self, Stage};
use farm_render::light::{EmitterGeometry, EmitterTriangle, LightsBuilder, Placement};
use glam::{DVec3, Vec3};
use std::f64::consts::{PI, TAU};

fn floor_under(width: u32, values: &[f32], albedo: f32) -> Stage {
    let mut stage = Stage::new();
    stage.place(stage::floor(0.0, 50.0), stage::grey(albedo));
    stage.eye_on(DVec3::ZERO, DVec3::Y);
    stage.environment(width, values);
    stage
}

/// T13: under an even sky a convex body shines with its albedo, whatever its shape and wherever it is looked at.
pub fn even_sky(bench: &mut Bench) {
    for albedo in [0.5f32, 1.0] {
        let flat = floor_under(1, &[1.0], albedo);
        let expected = f64::from(albedo);
        bench.direct(format!("plane, albedo {albedo}"), expected, measure::radiance(&flat, 1024));
        let bumpy = floor_under(2, &[1.0; 2], albedo);
        bench.direct(
            format!("plane, sky of equal texels, albedo {albedo}"),
            expected,
            measure::radiance(&bumpy, 1024),
        );
        let mut round = Stage::new().size(4, 4).depth(8);
        round.place(stage::globe(Vec3::ZERO, 1.0, 16), stage::grey(albedo));
        // Sees the globe's inner part only: 0.5 of its radius of 1.
        round.camera(
            DVec3::new(1.0, 2.0, 3.0),
            DVec3::ZERO,
            farm_scene::Projection::Orthographic { ymag: 0.5 },
        );
        round.environment(1, &[1.0]);
        bench.direct(format!("globe, albedo {albedo}"), expected, measure::radiance(&round, 64));
    }
}

/// T14: a single texel holds all the light.
pub fn one_texel(bench: &mut Bench) {
    let (width, height, row) = (4096u32, 2048u32, 512u32);
    let mut values = vec![0.0; (width * height) as usize];
    values[(row * width + 1000) as usize] = 1e6;
    let stage = floor_under(width, &values, 0.5);
    drop(values);
    let y = |row: u32| (PI * f64::from(row) / f64::from(height)).cos();
    // The texel's integral of the cosine: dphi (y0^2 - y1^2) / 2.
    let irradiance = 1e6 * TAU / f64::from(width) * 0.5 * (y(row).powi(2) - y(row + 1).powi(2));
    // The tables of a sky are the same for every seed, so the replicates are the pixels of one picture.
    let mut stage = stage.size(measure::REPLICATES as u32, 1);
    stage.settings.seed = 5;
    let picture = measure::picture(&stage, 16);
    let values: Vec<f64> = picture.greys().collect();
    let found = measure::Measurement::of(&values, picture.counters);
    bench.direct("4096x2048, one texel of 1e6, 16 spp: L", 0.5 * irradiance / PI, found);
}

/// T15: a black sky is no light, and no division by its total.
pub fn black_sky(bench: &mut Bench) {
    let stage = floor_under(16, &[0.0; 128], 0.5).depth(4);
    bench.exact("16x8 texels of 0", 0.0, measure::radiance(&stage, 64));
    bench.exact("1x1 texel of 0", 0.0, measure::radiance(&floor_under(1, &[0.0], 0.5), 64));
}

/// T16: texels that are no radiance count as black, and are counted.
pub fn broken_texels(bench: &mut Bench) {
    let (width, height) = (16usize, 8usize);
    let mut values = vec![1.0; width * height];
    let mut expected = PI;
    for (row, column, bad) in [(1usize, 3usize, f32::NAN), (2, 9, f32::INFINITY)] {
        values[row * width + column] = bad;
        let y = |row: usize| (PI * row as f64 / height as f64).cos();
        expected -= TAU / width as f64 * 0.5 * (y(row).powi(2) - y(row + 1).powi(2));
    }
    let stage = floor_under(width as u32, &values, 0.5);
    bench.direct("16x8 of 1 with a NaN and an infinity: E", expected, measure::irradiance(&stage, 2048));
    bench.exact("texels counted as repaired", 2.0, repaired(&stage));
}

/// Texels that the table of lights had to repair.
fn repaired(stage: &Stage) -> f64 {
    /// Nothing but a sky.
    struct Empty;
    impl EmitterGeometry for Empty {
        fn triangle(&self, _: u32, _: u32, _: f32) -> EmitterTriangle {
            unreachable!("a sky has no triangles")
        }

        fn placement(&self, _: u32, _: f32) -> Placement {
            Placement::at(Vec3::ZERO)
        }
    }
    let mut builder = LightsBuilder::new(0.0, 1.0);
    builder.environment(stage.scene.environment.clone().expect("a sky"));
    builder.build(&Empty).report().environment_pixels_repaired as f64
}
