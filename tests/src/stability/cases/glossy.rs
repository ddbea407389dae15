//! Mirrors, glass and microfacets.

use crate::stability::bench::Bench;
use crate::stability::cases::{furnaces::metal_floor, quadrature};
use crate::stability::measure::{self, Measurement};
use crate::stability::stage::{self, Stage};
use farm_render::bsdf::{Bsdf, Conductor, Lambert, Schlick, dielectric_reflectance};
use farm_render::sampler::{Sampler, Sequence};
use farm_render::sampling::power_heuristic;
use farm_scene::{Dielectric, LightKind, Material, Projection, Surface, Textured, Volume};
use glam::{DVec3, Vec3, Vec4};
use std::f64::consts::{PI, TAU};

/// A sky of `width` x `height` texels, each of another value.
fn patterned_sky(stage: &mut Stage, width: u32, height: u32) -> Vec<f32> {
    let values: Vec<f32> = (0..width * height).map(|i| 0.1 + (i * 37 % 64) as f32 * 0.17).collect();
    stage.environment(width, &values);
    values
}

fn texel(values: &[f32], width: u32, direction: DVec3) -> f32 {
    let height = values.len() as u32 / width;
    let u = 0.5 + direction.z.atan2(direction.x) / TAU;
    let v = 0.5 - direction.y.asin() / PI;
    let pick = |at: f64, n: u32| ((at * f64::from(n)) as u32).min(n - 1);
    values[(pick(v, height) * width + pick(u, width)) as usize]
}

/// T22: a mirror shows the sky as it is.
pub fn mirror(bench: &mut Bench) {
    let mut different = 0.0;
    let mut largest: f64 = 0.0;
    let mut samples = Measurement::from(0.0).counters;
    for step in 0..24u32 {
        // Views of the floor from all around, into the middles of an 8x4 sky's texels.
        let (phi, theta) =
            (TAU * (f64::from(step % 8) + 0.5) / 8.0, PI * if step < 8 { 0.125 } else { 0.375 });
        let mirrored = DVec3::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin());
        let from = DVec3::new(-mirrored.x, mirrored.y, -mirrored.z);
        for alpha in [0.0, 1e-4] {
            let mut stage = Stage::new();
            stage.place(stage::floor(0.0, 1e3), stage::white_metal(alpha));
            stage.camera(from, DVec3::ZERO, Projection::Orthographic { ymag: 1e-4 });
            let sky = patterned_sky(&mut stage, 8, 4);
            // One sample in 10^4 of the narrow lobe is taken from a light instead and weighs as much as thousands of others.
            let picture = measure::picture(&stage, if alpha == 0.0 { 64 } else { 16_384 });
            samples = samples.plus(picture.counters);
            let expected = texel(&sky, 8, mirrored);
            if alpha == 0.0 {
                different += f64::from(u8::from(picture.pixels[0] != [expected; 3]));
            } else {
                largest = largest.max((picture.mean() / f64::from(expected) - 1.0).abs());
            }
        }
    }
    let found = |mean| Measurement { mean, standard_error: None, counters: samples };
    bench.exact("alpha=0: views of 24 that are not the texel bit for bit", 0.0, found(different));
    bench.at_most("alpha=1e-4: largest relative difference", 1e-3, found(largest));
}

/// A black dielectric: what it shows is its interface.
fn black_dielectric(ior: f32) -> Material {
    let surface = Surface::MetallicRoughness {
        metallic: Textured::constant(0.0),
        roughness: Textured::constant(0.0),
        dielectric: Dielectric { ior, specular: None, transmission: None },
    };
    Material { base_color: Textured::constant(Vec4::new(0.0, 0.0, 0.0, 1.0)), surface, ..stage::grey(0.0) }
}

/// Smooth clear glass; `solid` has an inside below its front.
fn glass(ior: f32, solid: bool) -> Material {
    let surface = Surface::MetallicRoughness {
        metallic: Textured::constant(0.0),
        roughness: Textured::constant(0.0),
        dielectric: Dielectric { ior, specular: None, transmission: Some(Textured::constant(1.0)) },
    };
    let volume =
        solid.then_some(Volume { attenuation_distance: f32::INFINITY, attenuation_color: Vec3::ONE });
    Material { surface, volume, ..stage::grey(1.0) }
}

/// Share of light that an interface between air and glass reflects, seen from above or from within.
fn rendered_reflectance(degrees: f64, above: bool) -> Measurement {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let mut stage = Stage::new().depth(4);
    stage.place(stage::floor(0.0, 1e3), glass(1.5, true));
    let side = if above { 1.0 } else { -1.0 };
    stage.camera(DVec3::new(sin, side * cos, 0.0), DVec3::ZERO, Projection::Orthographic { ymag: 1e-5 });
    // Only the half of the sky shines that a reflected ray sees.
    let sky = if above { [1.0, 0.0] } else { [0.0, 1.0] };
    stage.environment(1, &sky);
    measure::radiance(&stage, 4096)
}

/// Fresnel's reflectance of unpolarised light from index 1 into `n`, at an angle in radians.
fn fresnel(angle: f64, n: f64) -> f64 {
    let (sin, cos) = angle.sin_cos();
    if sin >= n {
        return 1.0;
    }
    let cos_t = (1.0 - (sin / n).powi(2)).sqrt();
    let s = (cos - n * cos_t) / (cos + n * cos_t);
    let p = (n * cos - cos_t) / (n * cos + cos_t);
    0.5 * (s * s + p * p)
}

/// T23: what interfaces reflect.
pub fn fresnel_terms(bench: &mut Bench) {
    // Cosines are rounded to single precision: at these angles reflectance moves by less than 1e-6 of itself.
    let brewster = 1.5f64.atan();
    for (degrees, listed) in [(0.0, 0.04), (60.0, 0.089_186_7), (brewster.to_degrees(), 0.073_964_5)] {
        let exact = fresnel(f64::to_radians(degrees), 1.5);
        bench.absolute(format!("n=1.5, {degrees:.4} degrees: formula"), listed, exact, 5e-8);
        let cosine = degrees.to_radians().cos() as f32;
        let found = f64::from(dielectric_reflectance(cosine, 1.5));
        bench.relative(format!("n=1.5, {degrees:.4} degrees: exact"), exact, found, 1e-5);
        let schlick = Schlick { f0: Vec3::splat(0.04), f90: 1.0 }.at(cosine).x;
        let expected = 0.04 + 0.96 * (1.0 - degrees.to_radians().cos()).powi(5);
        bench.relative(format!("n=1.5, {degrees:.4} degrees: Schlick"), expected, f64::from(schlick), 1e-5);
        bench.statistical(
            format!("n=1.5, {degrees:.4} degrees: rendered"),
            exact,
            rendered_reflectance(degrees, true),
        );
    }
    let inside = fresnel(40f64.to_radians(), 1.0 / 1.5);
    bench.statistical("from within, 40 degrees: rendered", inside, rendered_reflectance(40.0, false));
    for degrees in [41.82, 60.0] {
        let found = rendered_reflectance(degrees, false);
        bench.exact(format!("from within, {degrees} degrees: everything is reflected"), 1.0, found);
    }
    for (ior, listed) in [(1.0f32, 0.0), (1.0001, 2.499_75e-9), (2.42, 0.172_395), (100.0, 0.960_788)] {
        let n = f64::from(ior);
        let expected = ((n - 1.0) / (n + 1.0)).powi(2);
        // 1.0001 has a rounding of 6e-8 next to the 1e-4 that counts, so the listed value holds to 1e-3 of itself there.
        bench.relative(format!("n={ior}: F0 of the index in single precision"), listed, expected, 1e-3);
        let found = measure::radiance(&metal_floor(black_dielectric(ior), 1.0), 16);
        bench.relative(format!("n={ior}: F0 rendered"), expected, found, 1e-5);
    }
}

/// T24: a slab of index 1 is not there.
pub fn invisible_slab(bench: &mut Bench) {
    let stage = |slab: Option<bool>| {
        let mut stage = Stage::new().size(16, 16).depth(6);
        stage.place(stage::floor(-1.0, 5.0), stage::grey(0.5));
        stage.place(stage::ceiling(Vec3::new(0.5, 2.0, -1.0), 0.3), stage::glow(4.0));
        patterned_sky(&mut stage, 8, 4);
        let projection = Projection::Perspective { yfov: 1.2 };
        stage.camera(DVec3::new(0.0, 0.3, 3.0), DVec3::ZERO, projection);
        if let Some(solid) = slab {
            let (low, high) = (Vec3::new(-3.0, -2.0, 1.9), Vec3::new(3.0, 2.0, 2.1));
            stage.place(stage::cuboid(low, high), glass(1.0, solid));
        }
        stage
    };
    let without = measure::picture(&stage(None), 64);
    bench.at_least("mean radiance without it", 0.1, without.mean());
    // Behind the slab a path is two vertices further along its random numbers; so only what a camera ray sees directly, sky and
    // emitter, can be the same to rounding. The floor is left out.
    for solid in [true, false] {
        let with = measure::picture(&stage(Some(solid)), 64);
        let sky = |picture: &measure::Picture| {
            picture.tile.pixels().zip(picture.pixels.clone()).filter(|((_, y), _)| *y < 5).collect::<Vec<_>>()
        };
        let difference = sky(&with)
            .iter()
            .zip(sky(&without))
            .map(|((_, a), (_, b))| f64::from((a[0] - b[0]).abs() / b[0]))
            .fold(0.0, f64::max);
        let name = if solid { "solid" } else { "thin" };
        let found = Measurement { mean: difference, standard_error: None, counters: with.counters };
        bench.at_most(format!("{name}: largest relative difference of the sky"), 1e-6, found);
        let (floor, behind) =
            (measure::radiance(&stage(None), 64), measure::radiance(&stage(Some(solid)), 64));
        bench.statistical(
            format!("{name}: mean of the whole picture"),
            floor.mean,
            behind.minus(floor, floor.mean),
        );
    }
}

/// T26: light goes both ways alike, and directions come as often as their density says.
pub fn reciprocity(bench: &mut Bench) {
    let numbers = |index: u64| Sampler::with_sequence(Sequence::Independent, 3, 0, 0, 0, index).set(0);
    let mut largest: f64 = 0.0;
    let roughnesses = [0.05f32, 0.3, 0.7, 1.0];
    for index in 0..200_000u64 {
        let [a, b, c, d] = numbers(index);
        let direction = |u: f32, v: f32| farm_render::sampling::cosine_hemisphere([u, v]);
        let (wo, wi) = (direction(a, b), direction(c, d));
        let bsdf = metal(roughnesses[index as usize % 4]);
        let (there, back) = (bsdf.eval(wo, wi).x, bsdf.eval(wi, wo).x);
        if there.max(back) > 0.0 {
            largest = largest.max(f64::from((there - back).abs() / there.max(back)));
        }
    }
    bench.at_most("metal, 200,000 pairs: largest relative difference", 1e-5, largest);
    for (name, bsdf) in [
        ("lambert", Bsdf::Lambert(Lambert::new(Vec3::ONE))),
        ("metal .3", metal(0.3)),
        ("metal 1", metal(1.0)),
    ] {
        for mu in [1.0f32, 0.4] {
            let wo = Vec3::new((1.0 - mu * mu).sqrt(), 0.0, mu);
            // 64 cells make 64 degrees of freedom (the 65th cell is what sampling gave up); quantile at 1e-4/256: 136.
            bench.at_most(format!("{name}, cosine {mu}: chi-squared of 64 cells"), 136.0, chi2(&bsdf, wo));
        }
    }
}

fn metal(roughness: f32) -> Bsdf {
    Bsdf::Conductor(Conductor::new(Vec3::ONE, roughness))
}

/// Chi-squared of 2^20 sampled directions against the density integrated over 8 x 8 cells of (azimuth, cosine).
fn chi2(bsdf: &Bsdf, wo: Vec3) -> f64 {
    const CELLS: usize = 8;
    let draws = 1u64 << 20;
    let mut counts = [0u64; CELLS * CELLS];
    let cell = |at: f64| ((at * CELLS as f64) as usize).min(CELLS - 1);
    for index in 0..draws {
        let [a, b, c, _] = Sampler::with_sequence(Sequence::Independent, 11, 0, 0, 0, index).set(0);
        if let Some(sample) = bsdf.sample(wo, [a, b, c])
            && sample.wi.z > 0.0
        {
            let wi = sample.wi.as_dvec3();
            let turn = wi.y.atan2(wi.x) / TAU + 0.5;
            counts[cell(wi.z) * CELLS + cell(turn)] += 1;
        }
    }
    // Solid angle is d(phi) d(cos). Each cell by the midpoint rule, 256 x 256 points.
    let steps = 256;
    let mut chi2 = 0.0;
    for (index, &count) in counts.iter().enumerate() {
        let mut share = 0.0;
        for i in 0..steps {
            for j in 0..steps {
                let at = |cell: usize, i: u32| {
                    (cell as f64 + (f64::from(i) + 0.5) / f64::from(steps)) / CELLS as f64
                };
                let (cos, phi) = (at(index / CELLS, i), (at(index % CELLS, j) - 0.5) * TAU);
                let sin = (1.0 - cos * cos).sqrt();
                let wi = DVec3::new(sin * phi.cos(), sin * phi.sin(), cos).as_vec3();
                share += f64::from(bsdf.pdf(wo, wi));
            }
        }
        let expected = share * TAU / (CELLS * CELLS * (steps * steps) as usize) as f64 * draws as f64;
        if expected > 5.0 {
            chi2 += (count as f64 - expected).powi(2) / expected;
        }
    }
    chi2
}

/// The scene of Veach's plates, one of them: a metal floor that mirrors a rectangle.
fn plate(alpha: f64, half: f32, emitter: Option<Material>) -> Stage {
    let mut stage = Stage::new();
    stage.place(stage::floor(0.0, 50.0), stage::white_metal(alpha));
    let mu: f64 = 0.6;
    let from = DVec3::new((1.0 - mu * mu).sqrt(), mu, 0.0) * 0.1;
    stage.camera(from, DVec3::ZERO, Projection::Orthographic { ymag: 1e-5 });
    match emitter {
        // Facing +x, towards the floor's mirrored view.
        Some(material) => {
            let (y, z) = (Vec3::Y * half, Vec3::Z * half);
            stage.place(stage::quad(Vec3::new(-1.5, 1.125, 0.0), y, z), material);
        }
        None => {
            let light = LightKind::Rectangle { radiance: Vec3::ONE, width: 2.0 * half, height: 2.0 * half };
            let at = DVec3::new(-1.5, 1.125, 0.0);
            stage.light(light, stage::look(at, at + DVec3::X));
        }
    }
    stage
}

/// T27: an emitter found by light sampling, by chance, or by both is as bright; and weighing both costs no variance.
pub fn mis(bench: &mut Bench) {
    // The emitter is about as wide as the lobe: a strategy that is right by itself cannot be improved by sharing with another.
    for (alpha, half) in [(0.01, 0.03f32), (0.1, 0.4), (0.5, 0.4)] {
        let side = f64::from(half);
        let expected = quadrature::ggx_of_rectangle(
            alpha,
            0.6,
            [-1.5, 1.125, 0.0],
            [0.0, side, 0.0],
            [0.0, 0.0, side],
            2000,
        );
        // An unlit surface shows its colour and is not sampled as a light: it is found by chance only.
        let unlit = Material { surface: Surface::Unlit, ..stage::grey(1.0) };
        let spp = bench.pick(4096, 16_384);
        let both = measure::radiance(&plate(alpha, half, Some(stage::glow(1.0))), spp);
        let shape = measure::radiance(&plate(alpha, half, None), spp);
        let chance = measure::radiance(&plate(alpha, half, Some(unlit.clone())), spp);
        bench.statistical(format!("alpha={alpha}, mesh, both strategies"), expected, both);
        bench.statistical(format!("alpha={alpha}, light, both strategies"), expected, shape);
        // What the renderer does not do by itself, so a fraction of a percent is enough.
        bench.coarse(format!("alpha={alpha}, chance only"), expected, chance, 3e-3);
        let (lights, variance_lights) = light_sampling(alpha, half, spp * measure::REPLICATES);
        // A narrow lobe is what light sampling is bad at: its samples scatter by twenty times their mean.
        bench.coarse(format!("alpha={alpha}, light sampling only"), expected, lights, 0.1);
        // Both sides have a spread of their own, which 1.2 of the bound covers for independent numbers: relative errors of a
        // variance from 10^5 samples are below 2 %.
        let variance = |stage: &Stage| independent_variance(stage, 1 << 17);
        let joined = variance(&plate(alpha, half, Some(stage::glow(1.0))));
        let bound = 1.2 * variance_lights.min(variance(&plate(alpha, half, Some(unlit))));
        bench.at_most(
            format!("alpha={alpha}: variance of a sample, against 1.2 of the better"),
            bound,
            joined,
        );
    }
}

/// Mean and variance of the estimate by light sampling alone, made of the renderer's parts.
fn light_sampling(alpha: f64, half: f32, n: u64) -> (Measurement, f64) {
    let bsdf = metal((alpha as f32).sqrt());
    // The shading frame: x, y span the floor, z is its normal.
    let wo = Vec3::new(0.8, 0.0, 0.6);
    let (mut sum, mut squares) = (0.0, 0.0);
    for index in 0..n {
        let [a, b, ..] = Sampler::with_sequence(Sequence::Independent, 5, 0, 0, 0, index).set(0);
        let p = Vec3::new(-1.5, (2.0 * b - 1.0) * half, 1.125 + (2.0 * a - 1.0) * half);
        let square = p.length_squared();
        let wi = p / square.sqrt();
        let value = f64::from(bsdf.eval(wo, wi).x * wi.z * -wi.x / square * 4.0 * half * half);
        sum += value;
        squares += value * value;
    }
    let mean = sum / n as f64;
    let variance = squares / n as f64 - mean * mean;
    let standard_error = Some((variance / n as f64).sqrt());
    (Measurement { standard_error, ..Measurement::from(mean) }, variance)
}

/// Variance of single samples drawn from independent numbers.
fn independent_variance(stage: &Stage, n: u64) -> f64 {
    let scene = measure::prepared(stage, 2).with_sequence(Sequence::Independent);
    let (mut sum, mut squares) = (0.0, 0.0);
    for index in 0..n {
        let value = f64::from(farm_render::render_sample(&scene, 0, 0, index)[0]);
        sum += value;
        squares += value * value;
    }
    let mean = sum / n as f64;
    squares / n as f64 - mean * mean
}

/// T28: equal densities share equally, however extreme.
pub fn heuristic(bench: &mut Bench) {
    for density in [1e-45f32, 1e-30, 1.0, 1e20, 1e38, f32::MAX] {
        let found = f64::from(power_heuristic(density, density));
        bench.exact(format!("f=g={density:e}"), 0.5, found);
    }
    bench.exact("f=1e38, g=1e-38", 1.0, f64::from(power_heuristic(1e38, 1e-38)));
    bench.relative("f=3e30, g=1e30", 0.9, f64::from(power_heuristic(3e30, 1e30)), 1e-6);
}
