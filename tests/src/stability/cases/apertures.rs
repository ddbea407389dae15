//! Lenses of all shapes: how far, how evenly and without loss they spread light, and where they do not. Cases beyond the list.

use crate::stability::bench::Bench;
use crate::stability::measure::{self, Picture};
use crate::stability::stage::{self, Stage};
use farm_scene::{Lens, LightKind, Projection};
use glam::{DVec3, Vec3};
use std::f64::consts::{PI, TAU};

/// Radius of the lens and distance of the plane in focus, metres.
const LENS: f64 = 0.05;
const FOCUS: f64 = 2.0;

/// A disk of radius `spot` pixels, `x` pixels right of the axis at distance `z`, seen in a picture `height` pixels high under 90 degrees.
fn spot(height: u32, spot: f64, x: f64, z: f64) -> Stage {
    let mut stage = Stage::new().size(height, height);
    stage.camera(DVec3::ZERO, -DVec3::Z, Projection::Perspective { yfov: std::f32::consts::FRAC_PI_2 });
    let pixel = 2.0 * z / f64::from(height);
    let light = LightKind::Disk { radiance: Vec3::ONE, radius: (spot * pixel) as f32 };
    let at = DVec3::new(x * pixel, 0.0, -z);
    stage.light(light, stage::look(at, at + DVec3::Z));
    stage
}

/// Radius of the blur in pixels of a picture `height` pixels high under 90 degrees.
fn blur(height: u32, z: f64) -> f64 {
    LENS * f64::abs(FOCUS - z) / (z * FOCUS) * f64::from(height) / 2.0
}

fn with_blades(mut stage: Stage, blades: u32, rotation: f32, anamorphic_ratio: f32) -> Stage {
    let (aperture_radius, focus_distance) = (LENS as f32, FOCUS as f32);
    let lens = Lens { aperture_radius, focus_distance, blades, rotation, anamorphic_ratio };
    stage.scene.cameras[0].lens = Some(lens);
    stage
}

/// Mean squared width along x and y around the picture's own centre of light, without the pixel and the spot.
fn widths(picture: &Picture, spot: f64) -> [f64; 2] {
    let (mut flux, mut first, mut second) = (0.0, [0.0; 2], [0.0; 2]);
    for (x, y, value) in picture.points() {
        flux += value;
        for (axis, at) in [x, y].into_iter().enumerate() {
            first[axis] += at * value;
            second[axis] += at * at * value;
        }
    }
    let width = |axis: usize| second[axis] / flux - (first[axis] / flux).powi(2);
    [0, 1].map(|axis| width(axis) - 1.0 / 12.0 - spot * spot / 4.0)
}

/// Five depths, and apertures of three, four, five and six blades, turned and stretched. A regular polygon of circumradius b has mean
/// square widths of b^2 (2 + cos(2 pi / n)) / 12 along either axis, however it is turned; a disk b^2 / 4.
pub fn shapes(bench: &mut Bench) {
    for z in [1.0, 1.5, 3.0, 5.0, 20.0] {
        for (blades, rotation, ratio) in [(0u32, 0.0f32, 1.0f32), (4, 0.3, 1.0), (6, 0.0, 1.5)] {
            shape(bench, z, blades, rotation, ratio);
        }
    }
    for (blades, rotation) in [(3u32, 0.0f32), (5, 1.1)] {
        shape(bench, 5.0, blades, rotation, 1.0);
    }
    for (blades, rotation) in [(0u32, 0.0f32), (4, 0.0), (4, 0.3), (5, 1.1), (6, 0.7)] {
        plateau(bench, blades, rotation);
    }
}

fn shape(bench: &mut Bench, z: f64, blades: u32, rotation: f32, ratio: f32) {
    // A picture whose blur is about three pixels, and a spot of the same size: a sample meets light or does not, and this makes the most
    // of each. The short form knows widths to half a percent, the full form to a tenth.
    let height = 2 * (1.5 / blur(1, z)).round() as u32;
    let radius = blur(height, z);
    let stage = with_blades(spot(height, radius, 0.0, z), blades, rotation, ratio);
    let (centre, half) = (height / 2, (radius * (f64::from(ratio.max(1.0)) + 1.0)) as u32 + 2);
    let tile = measure::tile(centre - half, centre - half, centre + half, centre + half);
    let (spp, power) = bench.pick((256, 5e-3), (8192, 1e-3));
    let pictures = measure::pictures_of(&stage, tile, spp);
    let corner = TAU / f64::from(blades.max(1));
    let square = radius * radius * if blades == 0 { 0.25 } else { (2.0 + corner.cos()) / 12.0 };
    let name = format!("z={z}, {blades} blades turned {rotation}, ratio {ratio}");
    for (axis, expected) in [("x", square * f64::from(ratio).powi(2)), ("y", square)] {
        let found = measure::over(&pictures, |picture| widths(picture, radius)[usize::from(axis == "y")]);
        bench.coarse(format!("{name}: width^2 in {axis}"), expected, found, power);
    }
    let flux = measure::over(&pictures, |picture| picture.greys().sum());
    bench.coarse(format!("{name}: flux"), PI * radius * radius, flux, power);
}

/// Where a spot smaller than the aperture's image is blurred over all of it, the middle has the spot's area over the image's: of a
/// regular polygon n/2 b^2 sin(2 pi / n).
fn plateau(bench: &mut Bench, blades: u32, rotation: f32) {
    let (height, radius, z) = (1000, 4.0, 1.0);
    let stage = with_blades(spot(height, radius, 0.0, z), blades, rotation, 1.0);
    let b = blur(height, z);
    let sides = f64::from(blades);
    let area = b * b * if blades == 0 { PI } else { sides / 2.0 * (TAU / sides).sin() };
    let pictures =
        measure::pictures_of(&stage, measure::tile(500, 500, 501, 501), bench.pick(16_384, 65_536));
    let found = measure::over(&pictures, Picture::mean);
    bench.coarse(
        format!("{blades} blades turned {rotation}: middle of a blurred spot"),
        PI * radius * radius / area,
        found,
        2e-3,
    );
}

/// What lies in the plane of focus is sharp at the edge of the picture too: the plane is a plane, not a sphere.
pub fn focal_plane(bench: &mut Bench) {
    const SPOT: f64 = 2.0;
    for x in [0.0, 300.0, 480.0] {
        let mut stage = spot(1000, SPOT, x, FOCUS);
        stage.lens(0.2, FOCUS as f32);
        let centre = 500 + x as u32;
        let tile = measure::tile(centre - 8, 492, centre + 8, 508);
        let outside = |picture: &Picture| {
            let beyond = |&(px, py, _): &(f64, f64, f64)| (px - 500.0 - x).hypot(py - 500.0) > SPOT + 0.75;
            picture.points().filter(beyond).map(|(_, _, value)| value).sum()
        };
        let pictures = measure::pictures_of(&stage, tile, 64);
        let found = measure::over(&pictures, outside);
        bench.exact(format!("{x} pixels off the axis: light outside"), 0.0, found);
        let flux = measure::over(&pictures, |picture| picture.greys().sum());
        bench.direct(format!("{x} pixels off the axis: flux"), PI * SPOT * SPOT, flux);
    }
}
