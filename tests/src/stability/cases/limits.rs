//! Lights in other trouble, filters, limits on samples, and pixels far apart: cases beyond the list.

use crate::stability::bench::{Bench, POWER};
use crate::stability::measure::{self, Measurement};
use crate::stability::stage::{self, Stage};
use farm_scene::{Filter, LightKind, Mesh, Projection};
use glam::{DVec3, Vec3};
use std::f64::consts::{FRAC_1_SQRT_2, PI};

fn floor() -> Stage {
    let mut stage = Stage::new();
    stage.place(stage::floor(0.0, 50.0), stage::grey(0.5));
    stage.eye_on(DVec3::ZERO, DVec3::Y);
    stage
}

/// A crowd of emitters that face away, and one that does not.
pub fn crowd(bench: &mut Bench) {
    let count = bench.pick(20_000u32, 1_000_000);
    let mut stage = floor().size(measure::REPLICATES as u32, 1);
    let mut mesh = Mesh::default();
    for i in 0..count {
        let (x, z) = ((i % 1000) as f32 * 0.01 - 5.0, (i / 1000) as f32 * 0.01 - 5.0);
        let corners = [Vec3::new(x, 2.0, z), Vec3::new(x, 2.0, z + 0.009), Vec3::new(x + 0.009, 2.0, z)];
        let base = mesh.positions.len() as u32;
        mesh.positions.extend(corners);
        mesh.triangles.push([base, base + 1, base + 2]);
    }
    stage.place(mesh, stage::glow(1.0));
    stage.place(stage::ceiling(Vec3::Y, 0.5), stage::glow(1.0));
    let picture = measure::picture(&stage, bench.pick(4096, 16_384));
    let values: Vec<f64> = picture.greys().map(|value| value * 2.0 * PI).collect();
    // A square of side 1 seen from below its middle at height 1 is four squares of side 1/2.
    let (a, root) = (0.5f64, 1.25f64.sqrt());
    let expected = 4.0 * (a / root) * (a / root).atan();
    let found = Measurement::of(&values, picture.counters);
    bench.direct(format!("one of {} that faces the floor: E", count + 2), expected, found);
}

/// A light of 1e12 and a square micrometre, two lights in one place, a point light on the surface itself.
pub fn odd_lights(bench: &mut Bench) {
    let down = stage::look(DVec3::Y, DVec3::ZERO);
    let mut tiny = floor();
    tiny.light(LightKind::Rectangle { radiance: Vec3::splat(1e12), width: 1e-6, height: 1e-6 }, down);
    bench.direct("radiance 1e12 on 1e-12 m^2 at 1 m: E", 1.0, measure::irradiance(&tiny, 64));
    let corner = FRAC_1_SQRT_2 * FRAC_1_SQRT_2.atan();
    let square = LightKind::Rectangle { radiance: Vec3::ONE, width: 2.0, height: 2.0 };
    let mut twins = floor();
    twins.light(square, down);
    twins.light(square, down);
    let found = measure::irradiance(&twins, 1024);
    // Which of two surfaces in one place is in front is nobody's to say: one of them, or both.
    bench.at_least("two rectangles in one place: E of at least one", 4.0 * corner * 0.999, found);
    bench.at_most("two rectangles in one place: E of at most both", 8.0 * corner * 1.001, found);
    let mut points = floor();
    let point = LightKind::Point { intensity: Vec3::ONE };
    points.light(point, down);
    points.light(point, down);
    bench.direct("two point lights in one place: E", 2.0, measure::irradiance(&points, 64));
    let mut touching = floor();
    touching.light(LightKind::Point { intensity: Vec3::ONE }, stage::at(DVec3::ZERO));
    bench.exact("point light in the surface: L", 0.0, measure::radiance(&touching, 64));
}

/// An emitter that is seen in a mirror only.
pub fn mirrored_emitter(bench: &mut Bench) {
    let mut stage = Stage::new().depth(3);
    stage.place(stage::floor(0.0, 50.0), stage::white_metal(0.0));
    stage.place(stage::ceiling(Vec3::Y * 2.0, 0.1), stage::glow(7.0));
    stage.eye_on(DVec3::ZERO, DVec3::Y);
    bench.exact("radiance 7 in a mirror", 7.0, measure::radiance(&stage, 64));
    // And by what it lights: it faces the mirroring floor, so a wall above sees only its image, as far below the floor as it is above;
    // and stands far enough aside not to hide that.
    let mut lit = Stage::new().depth(3);
    lit.place(stage::floor(0.0, 500.0), stage::white_metal(0.0));
    lit.place(stage::ceiling(Vec3::Y * 3.0, 5.0), stage::grey(0.5));
    lit.place(stage::ceiling(Vec3::new(6.0, 1.0, 0.0), 1.5), stage::glow(1.0));
    lit.camera(DVec3::Y * 2.9, DVec3::Y * 3.0, Projection::Orthographic { ymag: 1e-4 });
    let found = measure::irradiance(&lit, bench.pick(16_384, 131_072));
    // Only chance finds it, with a spread of several times its value: half a percent is what the samples can tell.
    bench.coarse("what its image gives to a wall: E", parallel_square(6.0, 1.5, 4.0), found, 5e-3);
}

/// Irradiance from a square of radiance 1 and half side `a` in a parallel plane `h` away, whose middle is `x` aside: the integral of
/// h^2 / r^4 over it, by the midpoint rule.
fn parallel_square(x: f64, a: f64, h: f64) -> f64 {
    let n = 1000;
    let at = |i: i32| a * (2.0 * (f64::from(i) + 0.5) / f64::from(n) - 1.0);
    let value = |i: i32| {
        let row = (0..n).map(|j| (x + at(i)).powi(2) + at(j).powi(2) + h * h);
        row.map(|square| h * h / (square * square)).sum::<f64>()
    };
    (0..n).map(value).sum::<f64>() * (2.0 * a / f64::from(n)).powi(2)
}

/// A pixel of 1e-30 beside one of 1e30.
pub fn far_apart(bench: &mut Bench) {
    let mut stage = Stage::new().size(2, 1);
    for (x, radiance) in [(-1.0, 1e-30f32), (1.0, 1e30)] {
        stage.place(stage::quad(Vec3::new(x, 0.0, 0.0), Vec3::X, Vec3::Y), stage::glow(radiance));
    }
    stage.camera(DVec3::Z, DVec3::ZERO, Projection::Orthographic { ymag: 1.0 });
    let picture = measure::picture(&stage, 1024);
    for (x, radiance) in [(0u32, 1e-30f32), (1, 1e30)] {
        let mean = f64::from(picture.pixels[x as usize][0]);
        let found = Measurement { mean, standard_error: None, counters: picture.counters };
        bench.exact(format!("pixel {x}"), f64::from(radiance), found);
    }
}

/// Share of a symmetric filter that lies left of `x` pixels.
fn filter_below(filter: Filter, x: f64) -> f64 {
    let x = x.clamp(-1.5, 1.5);
    match filter {
        Filter::Box => (x + 0.5).clamp(0.0, 1.0),
        Filter::Gaussian => {
            // Of standard deviation 1/2, cut at 3/2.
            let root = std::f64::consts::SQRT_2;
            0.5 + 0.5 * libm::erf(x * root) / libm::erf(1.5 * root)
        }
        Filter::BlackmanHarris => {
            let angle = PI * x / 1.5;
            let waves = 0.48829 * angle.sin()
                + 0.14128 / 2.0 * (2.0 * angle).sin()
                + 0.01168 / 3.0 * (3.0 * angle).sin();
            0.5 + (angle + waves / 0.35875) / std::f64::consts::TAU
        }
    }
}

/// An edge as each pixel filter shows it: the filter's integral.
pub fn filters(bench: &mut Bench) {
    for filter in [Filter::Box, Filter::Gaussian, Filter::BlackmanHarris] {
        let mut stage = Stage::new().size(16, 1);
        stage.settings.filter = filter;
        // The edge is a quarter of a pixel right of the middle between columns 7 and 8.
        stage.place(
            stage::quad(Vec3::new(-49.75, 0.0, 0.0), Vec3::X * 50.0, Vec3::Y * 50.0),
            stage::glow(1.0),
        );
        stage.camera(DVec3::Z, DVec3::ZERO, Projection::Orthographic { ymag: 0.5 });
        let spp = bench.pick(4096, 16_384);
        let pictures = measure::pictures_of(&stage, measure::tile(7, 0, 10, 1), spp);
        for column in [7u32, 8, 9] {
            let expected = filter_below(filter, 0.25 - (f64::from(column) + 0.5 - 8.0));
            let found = measure::over(&pictures, |picture| picture.at(column, 0)).of_steps(spp);
            let name = format!("{filter:?}, column {column}");
            if expected == 0.0 {
                bench.exact(name, expected, found);
            } else {
                // Known to a thousandth of the edge's height, of which the outer columns have a part.
                bench.coarse(name, expected, found, POWER / expected);
            }
        }
    }
}

/// A limit on samples is off unless asked for, takes what it says, and says what it took.
pub fn limited(bench: &mut Bench) {
    let build = |clamp| {
        let mut stage = Stage::new().size(2, 1);
        stage.settings.clamp = clamp;
        for (x, radiance) in [(-1.0, 10.0f32), (1.0, 0.5)] {
            stage.place(stage::quad(Vec3::new(x, 0.0, 0.0), Vec3::X, Vec3::Y), stage::glow(radiance));
        }
        stage.camera(DVec3::Z, DVec3::ZERO, Projection::Orthographic { ymag: 1.0 });
        measure::picture(&stage, 64)
    };
    let (free, limited) = (build(None), build(Some(4.0)));
    let of = |picture: &measure::Picture, mean: f64| Measurement {
        mean,
        standard_error: None,
        counters: picture.counters,
    };
    bench.exact("no limit: a pixel of 10", 10.0, of(&free, free.at(0, 0)));
    bench.exact("no limit: samples darkened", 0.0, of(&free, free.counters.clamped as f64));
    bench.exact("limit 4: a pixel of 10", 4.0, of(&limited, limited.at(0, 0)));
    bench.exact("limit 4: a pixel of .5", 0.5, of(&limited, limited.at(1, 0)));
    bench.exact("limit 4: samples darkened", 64.0, of(&limited, limited.counters.clamped as f64));
    bench.exact("limit 4: radiance taken", 64.0 * 6.0, of(&limited, limited.counters.clamped_radiance));
}
