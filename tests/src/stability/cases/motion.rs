//! Motion blur. One column of the picture is one unit of length, unless a case says otherwise.

use crate::stability::bench::{Bench, POWER};
use crate::stability::measure::{self, Measurement, Picture};
use crate::stability::stage::{self, Stage};
use farm_scene::{LightKind, Path, Projection, Transform};
use glam::{DVec3, Quat, Vec3};
use std::f64::consts::PI;

/// A parallel view from above onto x in [0, width] and z in [0, height], one pixel per unit, with the shutter open for a second.
pub fn overview(width: u32, height: u32, eye_height: f64) -> Stage {
    let mut stage = Stage::new().size(width, height);
    let middle = DVec3::new(f64::from(width) / 2.0, 0.0, f64::from(height) / 2.0);
    // Looking down with +X to the right: the picture's up is -Z.
    let down = Transform::Trs {
        translation: middle + DVec3::Y * eye_height,
        rotation: glam::DQuat::from_rotation_x(-PI / 2.0),
        scale: DVec3::ONE,
    };
    let node = stage.node(down);
    stage.camera_at(node, Projection::Orthographic { ymag: height as f32 / 2.0 });
    stage.shutter(0.0, 1.0);
    stage
}

/// A horizontal rectangle over `x0..x1` at a height, wide in z, facing up.
fn strip(x0: f32, x1: f32, height: f32) -> farm_scene::Mesh {
    stage::quad(Vec3::new((x0 + x1) / 2.0, height, 0.5), Vec3::Z * 200.0, Vec3::X * ((x1 - x0) / 2.0))
}

/// Checks the ramp that an edge leaves which sweeps 64 columns.
fn ramp(bench: &mut Bench, name: &str, stage: &Stage, spp: u64, bright: f64, falling: bool) {
    for column in [0u32, 31, 63] {
        let share = 1.0 - (f64::from(column) + 0.5) / 64.0;
        let expected = bright * if falling { share } else { 1.0 - share };
        let pictures = measure::pictures_of(stage, measure::tile(column, 0, column + 1, 1), spp);
        let found = measure::over(&pictures, Picture::mean);
        // Known to a thousandth of the ramp's height, of which the far end has a hundredth.
        bench.coarse(format!("{name}, column {column}"), expected, found, POWER * bright / expected);
    }
}

/// T34: an edge that sweeps over the picture.
pub fn sweeping_edge(bench: &mut Bench) {
    let spp = bench.pick(4096, 16_384);
    let mut animated = overview(64, 1, 10.0);
    let node = animated.place(strip(-100.0, 0.0, 0.0), stage::glow(1.0));
    animated.slide(node, Vec3::X * 64.0);
    ramp(bench, "animated node", &animated, spp, 1.0, true);
    let mut vector = overview(64, 1, 10.0);
    let node = vector.place(strip(-100.0, 0.0, 0.0), stage::glow(1.0));
    vector.scene.nodes[node as usize].motion_vector = Some(Vec3::X * 64.0);
    ramp(bench, "motion vector", &vector, spp, 1.0, true);
}

/// T35: a disk that moves eight times its radius leaves a plateau. A sixteenth of a column is a pixel here, so that a pixel's height
/// bends the chord by less than 1e-5.
pub fn moving_disk(bench: &mut Bench) {
    let scale = 16u32;
    let size = f64::from(scale);
    for (y, name) in [(0.0f64, "on the axis"), (4.0, "4 off the axis")] {
        let mut stage = overview(96 * scale, 96 * scale, 10.0);
        let kind = LightKind::Disk { radiance: Vec3::ONE, radius: 8.0 * scale as f32 };
        // From 16 to 80 columns; it faces up.
        let from = DVec3::new(16.0 * size, 0.0, 48.0 * size);
        let node = stage.light(kind, stage::look(from, from + DVec3::Y));
        stage.slide(node, Vec3::X * 64.0 * scale as f32);
        let row = (48 * scale) + (y * size) as u32;
        let tile = measure::tile(48 * scale, row, 48 * scale + 4, row + 1);
        let at = y + 0.5 / size;
        let expected = 2.0 * (64.0 - at * at).sqrt() / 64.0;
        let found =
            measure::over(&measure::pictures_of(&stage, tile, bench.pick(4096, 16_384)), Picture::mean);
        bench.statistical(format!("R=8 D=64, {name}: plateau"), expected, found);
    }
}

/// T36: the shadow of an edge that moves is a ramp as well.
pub fn moving_shadow(bench: &mut Bench) {
    let mut stage = overview(64, 1, 1.0);
    stage.place(stage::floor(0.0, 500.0), stage::grey(0.5));
    let sun = LightKind::Directional { irradiance: Vec3::splat(2.0) };
    stage.light(sun, stage::look(DVec3::Y * 50.0, DVec3::ZERO));
    let node = stage.place(strip(-100.0, 0.0, 5.0), stage::grey(0.0));
    stage.slide(node, Vec3::X * 64.0);
    ramp(bench, "sun 2 on albedo .5", &stage, bench.pick(4096, 16_384), 1.0 / PI, false);
}

/// T37: every ray of a path keeps its camera ray's time. Receiver, occluder and emitter travel together, and in their own frame the
/// receiver lies in the umbra; a ray of another time would see them apart.
pub fn time_inheritance(bench: &mut Bench) {
    for mirrored in [false, true] {
        let mut stage = Stage::new().size(16, 4).depth(3);
        let convoy = stage.node(stage::at(DVec3::ZERO));
        stage.slide(convoy, Vec3::X * 10.0);
        let mut carry = |mesh, material| {
            let node = stage.node_below(Some(convoy), Transform::IDENTITY);
            stage.draw(node, mesh, material);
        };
        carry(stage::floor(0.0, 0.05), stage::grey(0.8));
        carry(stage::floor(1.0, 0.2), stage::grey(0.0));
        carry(stage::ceiling(Vec3::Y * 2.0, 0.1), stage::glow(100.0));
        // Seen under 45 degrees from the side, past the occluder; or in a mirror that travels along.
        let (middle, side) = (DVec3::new(5.0, 0.0, 0.0), DVec3::new(0.0, 1.0, 1.0));
        let from = if mirrored {
            let wall = stage::quad(Vec3::new(0.0, 1.0, 1.0), Vec3::X * 40.0, Vec3::new(0.0, 0.7, -0.7));
            carry(wall, stage::white_metal(0.0));
            // The wall at (y, z) = (1, 1) faces the receiver along (0, -1, -1); the eye looks at it along its normal's mirror image.
            middle + DVec3::new(0.0, 0.25, 0.25)
        } else {
            middle + side * 4.0
        };
        let to = if mirrored { middle + side } else { middle };
        // In the mirror a smaller view, which ends before the emitter's lit side comes into it.
        let ymag = if mirrored { 0.5 } else { 2.0 };
        stage.camera(from, to, Projection::Orthographic { ymag });
        stage.shutter(0.0, 1.0);
        let name = if mirrored { "in a mirror" } else { "directly" };
        let pictures = measure::pictures(&stage, bench.pick(256, 1024));
        bench.exact(format!("{name}: light on the receiver"), 0.0, measure::over(&pictures, Picture::mean));
        // The same convoy without its occluder does light the receiver: it is in the picture.
        stage.scene.nodes[2].instances.clear();
        let lit = measure::over(&measure::pictures(&stage, 256), Picture::mean);
        bench.at_least(format!("{name}: light without the occluder"), 1e-5, lit);
    }
}

/// A still life with light, shadow and metal, everything below node 0, the camera too.
pub fn still_life() -> Stage {
    let mut stage = Stage::new().size(16, 12).depth(3);
    let root = stage.node(stage::at(DVec3::ZERO));
    let mut put = |mesh, material| {
        let node = stage.node_below(Some(root), Transform::IDENTITY);
        stage.draw(node, mesh, material);
    };
    put(stage::floor(0.0, 4.0), stage::grey(0.6));
    put(stage::globe(Vec3::new(0.5, 0.5, 0.0), 0.5, 8), stage::white_metal(0.3));
    put(stage::cuboid(Vec3::new(-1.0, 0.0, -0.5), Vec3::new(-0.25, 0.75, 0.25)), stage::grey(0.3));
    put(stage::ceiling(Vec3::new(0.0, 3.0, 1.0), 0.5), stage::glow(10.0));
    let node = stage.node_below(Some(root), stage::look(DVec3::new(0.0, 1.5, 4.0), DVec3::Y * 0.4));
    stage.camera_at(node, Projection::Perspective { yfov: 0.7 });
    stage
}

/// T38: what moves with the camera does not blur; what is said to move and does not is as if it were not said.
pub fn equal_velocity(bench: &mut Bench) {
    let still = still_life();
    let mut moving = still.clone();
    moving.slide(0, Vec3::new(3.0, 1.0, -2.0));
    moving.shutter(0.0, 1.0);
    let spp = bench.pick(256, 1024);
    let (a, b) = (measure::radiance(&still, spp), measure::radiance(&moving, spp));
    bench.statistical("mean of the picture, camera and scene at one velocity", a.mean, b.minus(a, a.mean));
    let mut idle = still.clone();
    idle.slide(0, Vec3::ZERO);
    idle.shutter(0.0, 1.0);
    for node in &mut idle.scene.nodes {
        node.motion_vector = (!node.instances.is_empty()).then_some(Vec3::ZERO);
    }
    let found = measure::picture(&idle, 64).differing(&measure::picture(&still, 64));
    bench.exact("no motion, but keys for it: channels that differ", 0.0, found);
}

/// Mean squared distance from the picture's centre, in pixels, without the pixel's own extent.
fn mean_square_radius(picture: &Picture, centre: (f64, f64)) -> f64 {
    let (mut flux, mut moment) = (0.0, 0.0);
    for (x, y, value) in picture.points() {
        flux += value;
        moment += value * ((x - centre.0).powi(2) + (y - centre.1).powi(2));
    }
    moment / flux - 1.0 / 6.0
}

/// T39: what turns stays at its radius.
pub fn turning_tip(bench: &mut Bench) {
    for degrees in [90.0f32, 180.0] {
        for (name, mesh) in [("light", false), ("mesh", true)] {
            let mut stage = overview(64, 64, 10.0);
            let pivot = stage.node(stage::at(DVec3::new(32.0, 0.0, 32.0)));
            let radius = 2.0f32;
            let expected = if mesh {
                let node = stage.node_below(Some(pivot), Transform::IDENTITY);
                let tip = stage::polygon(Vec3::X * 24.0, Vec3::Z, Vec3::X, radius, 16);
                stage.draw(node, tip, stage::glow(1.0));
                // Of a regular polygon: r^2 (2 + cos(2 pi / n)) / 6.
                4.0 * (2.0 + (PI / 8.0).cos()) / 6.0
            } else {
                let tip = DVec3::X * 24.0;
                let node = stage.node_below(Some(pivot), stage::look(tip, tip + DVec3::Y));
                stage.light_at(LightKind::Disk { radiance: Vec3::ONE, radius }, node);
                2.0
            } + 576.0;
            let turn = Quat::from_rotation_y(degrees.to_radians());
            stage.animate(pivot, Path::Rotation(vec![Quat::IDENTITY, turn]));
            let pictures = measure::pictures(&stage, bench.pick(64, 512));
            let found = measure::over(&pictures, |picture| mean_square_radius(picture, (32.0, 32.0)));
            bench.statistical(format!("{name} at R=24 turns by {degrees}: mean R^2"), expected, found);
            // Nothing lies nearer to the pivot than the tip's own radius and a pixel.
            let inside = measure::over(&pictures, |picture| {
                let near = |&(x, y, _): &(f64, f64, f64)| (x - 32.0).hypot(y - 32.0) < 24.0 - 2.0 - 0.75;
                picture.points().filter(near).map(|(_, _, value)| value).sum()
            });
            bench.exact(format!("{name} turns by {degrees}: light nearer to the pivot"), 0.0, inside);
        }
    }
}

/// T40: a cube that crosses a two-metre view within a millionth of its way.
pub fn far_traveller(bench: &mut Bench) {
    let build = |by: f32| {
        let mut stage = overview(2, 2, 1e3);
        // As deep as the view, so that only time decides.
        let cube = stage::cuboid(Vec3::new(0.5, -0.5, -1.0), Vec3::new(1.5, 0.5, 3.0));
        let node = stage.node(stage::at(DVec3::X * f64::from(-by / 2.0)));
        stage.draw(node, cube, stage::glow(1.0));
        if by > 0.0 {
            stage.slide(node, Vec3::X * by);
        }
        stage
    };
    // The cube is before any point for 1e-6 of the time. 2^20 stratified times hold one sample per 2^-20 of the shutter, so a pixel
    // counts one or two hits; the page asks for the scale.
    let tile = measure::tile(0, 0, 2, bench.pick(1, 2));
    let picture = measure::develop(&measure::prepared(&build(1e6), 4), tile, 1 << bench.pick(20, 22));
    let found = Measurement { mean: picture.mean(), standard_error: None, counters: picture.counters };
    bench.relative("a cube 1 long, 1e6 units: mean cover", 1e-6, found, 0.5);
    if bench.is_full() {
        let seconds = |by: f32| {
            let scene = measure::prepared(&build(by), 4);
            let start = std::time::Instant::now();
            measure::develop(&scene, scene.resolution().full(), 1 << 18);
            start.elapsed().as_secs_f64()
        };
        bench.at_most("time of a moving picture over a still one", 3.0, seconds(1e6) / seconds(0.0));
    }
}

/// T41: a shutter that does not stay open sees the moment, to the bit.
pub fn instant(bench: &mut Bench) {
    let mut moving = still_life();
    moving.slide(2, Vec3::new(1.0, 0.5, 0.0));
    moving.shutter(0.25, 0.25);
    let mut posed = still_life();
    posed.scene.nodes[2].transform = stage::at(DVec3::new(0.25, 0.125, 0.0));
    let (a, b) = (measure::picture(&moving, 64), measure::picture(&posed, 64));
    // What is drawn is centred where it rests, so the pose may not move the middle of all: the floor is far wider than the globe.
    bench.exact("shutter .25 to .25 against the pose: channels that differ", 0.0, a.differing(&b));
    bench.at_least("and not the pose at 0", 1.0, a.differing(&measure::picture(&still_life(), 64)));
}

/// T42: the halves of a shutter average to the whole.
pub fn halves(bench: &mut Bench) {
    let with_shutter = |open, close| {
        let mut stage = still_life();
        stage.slide(2, Vec3::new(2.0, 0.0, 1.0));
        stage.shutter(open, close);
        measure::radiance(&stage, bench.pick(256, 1024))
    };
    let (first, second, whole) = (with_shutter(0.0, 0.5), with_shutter(0.5, 1.0), with_shutter(0.0, 1.0));
    let mean = (first.mean + second.mean) / 2.0;
    let halves = first.times(0.5).minus(second.times(-0.5), 0.0);
    bench.statistical("mean of the picture", mean, whole.minus(halves, mean));
}
