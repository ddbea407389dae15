//! Direct light from one light of every kind, against closed forms. `E` is irradiance, floors have albedo 1/2.
//!
//! Formulas: Howell, "A Catalog of Radiation Heat Transfer Configuration Factors" (B-4, B-5, B-12, B-13, B-34, B-40).

use crate::stability::bench::Bench;
use crate::stability::measure::{self, Picture};
use crate::stability::stage::{self, Stage};
use farm_scene::{LightKind, Transform};
use glam::{DMat4, DVec3, DVec4, Vec3};
use std::f64::consts::{FRAC_1_SQRT_2, PI};

const SPP: u64 = 1024;

/// An empty floor of albedo 1/2 that is looked at in `(x, 0, z)`.
fn floor_seen_at(x: f64, z: f64) -> Stage {
    let mut stage = Stage::new();
    stage.place(stage::floor(0.0, 50.0), stage::grey(0.5));
    stage.eye_on(DVec3::new(x, 0.0, z), DVec3::Y);
    stage
}

fn lit_by(light: LightKind, from: DVec3, towards: DVec3) -> Stage {
    let mut stage = floor_seen_at(0.0, 0.0);
    stage.light(light, stage::look(from, from + towards));
    stage
}

fn disk(radiance: f32, radius: f32) -> LightKind {
    LightKind::Disk { radiance: Vec3::splat(radiance), radius }
}

fn rectangle(radiance: f32, width: f32, height: f32) -> LightKind {
    LightKind::Rectangle { radiance: Vec3::splat(radiance), width, height }
}

fn sphere(radiance: f32, radius: f32) -> LightKind {
    LightKind::Sphere { radiance: Vec3::splat(radiance), radius }
}

/// T1: a point light follows the inverse square and the cosine.
pub fn point_light(bench: &mut Bench) {
    for (x, expected) in [(0.0, 25.0), (2.0, 100.0 / 8.0 * FRAC_1_SQRT_2)] {
        let mut stage = floor_seen_at(x, 0.0);
        stage.light(
            LightKind::Point { intensity: Vec3::splat(100.0) },
            stage::look(DVec3::Y * 2.0, DVec3::ZERO),
        );
        let name = format!("I=100 h=2, {x} beside: L=E/2pi");
        bench.direct(name, expected / (2.0 * PI), measure::radiance(&stage, 16));
    }
}

/// T2: the sun has no variance, and no sign of a zero in its direction lets it through a roof.
pub fn sun(bench: &mut Bench) {
    let sun = LightKind::Directional { irradiance: Vec3::splat(3.0) };
    let stage = lit_by(sun, DVec3::ZERO, -DVec3::new(60f64.to_radians().sin(), 0.5, 0.0));
    let found = measure::radiance(&stage, 16);
    bench.direct("E=3, 60 degrees off the normal", 0.5 * 1.5 / PI, found);
    bench.exact("its standard error", 0.0, found.standard_error.unwrap_or(f64::NAN));
    for zero in [0.0, -0.0] {
        // The node's -Z is (-zero, -1, -zero), so that both signs of zero reach the light's direction.
        let axes = [
            DVec4::new(1.0, zero, zero, 0.0),
            DVec4::new(zero, zero, -1.0, 0.0),
            DVec4::new(zero, 1.0, zero, 0.0),
            DVec4::W,
        ];
        let straight_down = Transform::Matrix(DMat4::from_cols(axes[0], axes[1], axes[2], axes[3]));
        let mut stage = floor_seen_at(0.0, 0.0);
        stage.light(sun, straight_down);
        bench.direct(format!("straight down, zeros {zero:+}"), 1.5 / PI, measure::radiance(&stage, 16));
        stage.place(stage::floor(1.0, 5.0), stage::grey(0.5));
        bench.exact(format!("the same under a roof, zeros {zero:+}"), 0.0, measure::radiance(&stage, 16));
    }
}

/// T3: a disk parallel to the floor, on its axis and beside it.
pub fn parallel_disk(bench: &mut Bench) {
    for a in [0.0f64, 1.0, 3.0] {
        let mut stage = floor_seen_at(a, 0.0);
        stage.light(disk(1.0, 1.0), stage::look(DVec3::Y, DVec3::ZERO));
        let (h2, r2, a2) = (1.0, 1.0, a * a);
        let root: f64 = (h2 + a2 + r2) * (h2 + a2 + r2) - 4.0 * r2 * a2;
        let expected = PI / 2.0 * (1.0 - (h2 + a2 - r2) / root.sqrt());
        bench.direct(format!("R=1 h=1 L=1, {a} off axis: E"), expected, measure::irradiance(&stage, SPP));
    }
}

/// T4: a rectangle parallel to the floor; as a light, and as a mesh that emits.
pub fn parallel_rectangle(bench: &mut Bench) {
    // Of a corner of a square of side 1 at height 1 (Howell B-4): F = atan(1/sqrt 2)/(pi sqrt 2) x 2 / 2.
    let corner = FRAC_1_SQRT_2 * FRAC_1_SQRT_2.atan();
    for (name, x, half, expected) in
        [("a corner of 1x1", 0.5, 0.5, corner), ("the centre of 2x2", 0.0, 1.0, 4.0 * corner)]
    {
        let mut light = floor_seen_at(x, x);
        light.light(rectangle(1.0, 2.0 * half, 2.0 * half), stage::look(DVec3::Y, DVec3::ZERO));
        bench.direct(format!("{name} at h=1, light: E"), expected, measure::irradiance(&light, SPP));
        let mut mesh = floor_seen_at(x, x);
        mesh.place(stage::ceiling(Vec3::Y, half), stage::glow(1.0));
        bench.direct(format!("{name} at h=1, mesh: E"), expected, measure::irradiance(&mesh, SPP));
    }
}

/// T5: a rectangle that stands on the floor.
pub fn perpendicular_rectangle(bench: &mut Bench) {
    let expected = 0.5 * (PI / 4.0 - FRAC_1_SQRT_2 * FRAC_1_SQRT_2.atan());
    let centre = DVec3::new(1.0, 0.5, 0.5);
    let light = lit_by(rectangle(1.0, 1.0, 1.0), centre, -DVec3::X);
    bench.direct("1x1 at distance 1, light: E", expected, measure::irradiance(&light, SPP));
    let mut mesh = floor_seen_at(0.0, 0.0);
    mesh.place(stage::quad(centre.as_vec3(), Vec3::Z * 0.5, Vec3::Y * 0.5), stage::glow(1.0));
    bench.direct("1x1 at distance 1, mesh: E", expected, measure::irradiance(&mesh, SPP));
}

/// T6: a sphere that is wholly above the horizon.
pub fn sphere_light(bench: &mut Bench) {
    for degrees in [0.0f64, 60.0] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let stage = lit_by(sphere(1.0, 1.0), 10.0 * DVec3::new(sin, cos, 0.0), -DVec3::Y);
        let name = format!("R=1 d=10, {degrees} degrees off the normal: E");
        bench.direct(name, PI / 100.0 * cos, measure::irradiance(&stage, SPP));
    }
}

/// T7: lights far smaller than a pixel's footprint, and accordingly bright.
pub fn tiny_and_bright(bench: &mut Bench) {
    for (radius, radiance) in [(1e-4, 1e8), (1e-6, 1e12)] {
        for (name, light) in [("sphere", sphere(radiance, radius)), ("disk", disk(radiance, radius))] {
            let found = measure::irradiance(&lit_by(light, DVec3::Y, -DVec3::Y), 16);
            // Radii and radiances are rounded to single precision by 6e-8, far below the page's 1e-3.
            bench.relative(format!("{name} R={radius:e} L={radiance:e} d=1, 16 spp: E"), PI, found, 1e-3);
        }
    }
}

/// T8: a light that fills the sky as seen from everywhere.
pub fn huge(bench: &mut Bench) {
    let stage = lit_by(rectangle(1.0, 2e9, 2e9), DVec3::Y, -DVec3::Y);
    bench.direct("rectangle 2e9 x 2e9 at h=1, light: E", PI, measure::irradiance(&stage, SPP));
    let mut mesh = floor_seen_at(0.0, 0.0);
    mesh.place(stage::ceiling(Vec3::Y, 1e9), stage::glow(1.0));
    bench.direct("rectangle 2e9 x 2e9 at h=1, mesh: E", PI, measure::irradiance(&mesh, SPP));
}

/// T9: light from within the surface's own plane is none.
pub fn edge_on(bench: &mut Bench) {
    let aside = DVec3::new(3.0, 0.0, 0.0);
    for (name, towards) in [("facing up", DVec3::Y), ("facing down", -DVec3::Y)] {
        let square = lit_by(rectangle(1.0, 1.0, 1.0), aside, towards);
        bench.exact(format!("rectangle in the plane, {name}"), 0.0, measure::radiance(&square, 64));
        let round = lit_by(disk(1.0, 0.5), aside, towards);
        bench.exact(format!("disk in the plane, {name}"), 0.0, measure::radiance(&round, 64));
        let mut mesh = floor_seen_at(0.0, 0.0);
        let side = Vec3::Z * 0.5 * towards.y as f32;
        mesh.place(stage::quad(aside.as_vec3(), side, Vec3::X * 0.5), stage::glow(1.0));
        bench.exact(format!("mesh in the plane, {name}"), 0.0, measure::radiance(&mesh, 64));
    }
}

/// T10: emitters without area change nothing, not even the choice among the others.
pub fn without_area(bench: &mut Bench) {
    let room = || {
        let mut stage = Stage::new().size(8, 8).depth(2);
        stage.place(stage::floor(0.0, 5.0), stage::grey(0.5));
        stage.camera(
            DVec3::new(0.0, 2.0, 4.0),
            DVec3::ZERO,
            farm_scene::Projection::Perspective { yfov: 0.8 },
        );
        stage.place(stage::ceiling(Vec3::new(0.0, 2.0, 0.0), 0.5), stage::glow(3.0));
        stage.light(disk(1.0, 0.3), stage::look(DVec3::new(1.0, 2.0, 0.0), DVec3::ZERO));
        stage
    };
    let without = measure::picture(&room(), 64);
    let mut stage = room();
    let point = Vec3::new(0.3, 1.0, 0.2);
    let line = [point, point + Vec3::X, point + Vec3::X * 3.0];
    stage.place(stage::triangles(&[[point; 3], line]), stage::glow(1e6));
    for light in [rectangle(1e6, 0.0, 1.0), rectangle(1e6, 0.0, 0.0), disk(1e6, 0.0), sphere(1e6, 0.0)] {
        stage.light(light, stage::look(DVec3::new(0.5, 1.5, 0.5), DVec3::ZERO));
    }
    let with = measure::picture(&stage, 64);
    bench.at_least("mean radiance without them", 0.01, without.mean());
    bench.exact("channels that differ with six of them", 0.0, with.differing(&without));
}

/// T11: the back of a one-sided emitter is dark.
pub fn back_side(bench: &mut Bench) {
    for (name, light) in [("rectangle", rectangle(1.0, 1.0, 1.0)), ("disk", disk(1.0, 0.5))] {
        let stage = lit_by(light, DVec3::Y, DVec3::Y);
        bench.exact(format!("{name} that faces away"), 0.0, measure::radiance(&stage, 256));
    }
    let mut mesh = floor_seen_at(0.0, 0.0);
    mesh.place(stage::floor(1.0, 0.5), stage::glow(1.0));
    bench.exact("mesh that faces away", 0.0, measure::radiance(&mesh, 256));
}

/// T12: nothing leaves a closed box, however near its wall is to the light compared with the way to the floor: a fifth of 1e-4 of it
/// here, some three hundred roundings of the distance.
pub fn closed_box(bench: &mut Bench) {
    for (distance, half) in [(2.0, 1.0), (1e3, 0.1), (1e5, 10.0)] {
        for (name, light) in [("sphere", sphere(1e9, half as f32 * 0.8)), ("point", point(1e9))] {
            let mut stage = lit_by(light, DVec3::Y * distance, -DVec3::Y).depth(4);
            let centre = Vec3::Y * distance as f32;
            let wall = Vec3::splat(half as f32);
            stage.place(stage::cuboid(centre - wall, centre + wall), stage::grey(0.5));
            let found = measure::radiance(&stage, 64);
            bench.exact(format!("{name} in a box of {} m, {distance} m away", 2.0 * half), 0.0, found);
        }
    }
}

fn point(intensity: f32) -> LightKind {
    LightKind::Point { intensity: Vec3::splat(intensity) }
}

/// T17: half a disk behind a knife's edge gives half its light.
pub fn knife_edge(bench: &mut Bench) {
    let mut stage = lit_by(disk(1.0, 1.0), DVec3::Y, -DVec3::Y);
    stage.place(stage::quad(Vec3::new(-25.0, 0.5, 0.0), Vec3::Z * 25.0, Vec3::X * 25.0), stage::grey(0.0));
    let found = measure::irradiance(&stage, 65_536);
    bench.direct("edge through the axis at half the height: E", PI / 4.0, found);
}

/// T63: a light too dim to matter is no slower than another.
pub fn dim(bench: &mut Bench) {
    let scene_of = |radiance: f32| {
        let stage = lit_by(rectangle(radiance, 1.0, 1.0), DVec3::Y, -DVec3::Y);
        measure::prepared(&stage, 1)
    };
    let scenes = [1e-3, 1e-40].map(scene_of);
    let mut pictures: [Option<Picture>; 2] = [None, None];
    let mut best = [f64::INFINITY; 2];
    // In turns, so that whatever else the machine does slows down both; the best of many is the time without it.
    for _ in 0..bench.pick(1, 25) {
        for ((scene, picture), best) in scenes.iter().zip(&mut pictures).zip(&mut best) {
            let start = std::time::Instant::now();
            *picture = Some(measure::develop(scene, scene.resolution().full(), 1 << 15));
            *best = best.min(start.elapsed().as_secs_f64());
        }
    }
    let [bright, dim] = pictures.map(|picture| picture.expect("at least one of each").mean());
    // Radiance 1e-40 is subnormal: its spacing is 1.4e-45, and its product with rho/pi E another few of those.
    bench.absolute("radiance 1e-40: L", bright * 1e-37, dim, 1e-43);
    if bench.is_full() {
        bench.at_most("seconds compared with radiance 1e-3", 1.1, best[1] / best[0]);
    }
}
