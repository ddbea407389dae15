//! Depth of field. Blur radius in pixels: `b = r |F - z| / (z F) x H / (2 tan(fov / 2))`.

use crate::stability::bench::Bench;
use crate::stability::measure::{self, Picture};
use crate::stability::stage::{self, Stage};
use farm_film::Tile;
use farm_render::sampling::Aperture;
use farm_scene::{LightKind, Projection};
use glam::{DVec3, Vec3};
use std::f64::consts::PI;

/// Height of the pictures, pixels.
const H: u32 = 1000;

/// Radius of the small disks that are blurred, pixels.
const SPOT: f64 = 4.0;

fn camera(height: u32) -> Stage {
    let mut stage = Stage::new().size(height, height);
    stage.camera(DVec3::ZERO, -DVec3::Z, Projection::Perspective { yfov: std::f32::consts::FRAC_PI_2 });
    stage
}

/// Metres that a pixel covers at distance `z`, for a field of view of 90 degrees.
fn pixel_at(z: f64, height: u32) -> f64 {
    2.0 * z / f64::from(height)
}

/// A glowing disk of radius [`SPOT`] pixels at distance `z` on the axis.
fn spot(z: f64) -> Stage {
    let mut stage = camera(H);
    let radius = (SPOT * pixel_at(z, H)) as f32;
    let light = LightKind::Disk { radiance: Vec3::ONE, radius };
    stage.light(light, stage::look(-DVec3::Z * z, DVec3::ZERO));
    stage
}

/// A square of pixels around the centre of the picture.
fn middle(half: u32) -> Tile {
    measure::tile(H / 2 - half, H / 2 - half, H / 2 + half, H / 2 + half)
}

/// Radius of the uniform disk with which a disk of [`SPOT`] pixels was blurred, from the picture's second moment. Moments of
/// convolved images add: `a^2/2` of the spot, `b^2/2` of the blur, `1/6` of the pixel.
fn blur_radius(picture: &Picture) -> f64 {
    let centre = f64::from(H) / 2.0;
    let (mut flux, mut moment) = (0.0, 0.0);
    for (x, y, value) in picture.points() {
        flux += value;
        moment += value * ((x - centre).powi(2) + (y - centre).powi(2));
    }
    (2.0 * (moment / flux - 1.0 / 6.0) - SPOT * SPOT).max(0.0).sqrt()
}

/// T29: how far, how evenly and without loss a lens spreads light.
pub fn blur(bench: &mut Bench) {
    let spp = bench.pick(384, 1024);
    for (focus, z, expected) in [(2.0, 4.0, 6.25), (2.0, 6.0, 25.0 / 3.0), (f64::INFINITY, 6.0, 25.0 / 6.0)] {
        let mut stage = spot(z);
        stage.lens(0.05, focus as f32);
        let pictures = measure::pictures_of(&stage, middle(expected as u32 + 7), spp);
        bench.statistical(
            format!("r=.05 F={focus} z={z} fov 90 H=1000: pixels"),
            expected,
            measure::over(&pictures, blur_radius),
        );
        let flux = measure::over(&pictures, |picture| picture.greys().sum());
        bench.direct(format!("F={focus} z={z}: flux, in pixels"), PI * SPOT * SPOT, flux);
    }
    // In focus the picture is the pinhole's: the edge of the spot is as sharp.
    let mut sharp = spot(2.0);
    sharp.lens(0.05, 2.0);
    let difference = |picture: &Picture| {
        let outside = |&(x, y, _): &(f64, f64, f64)| (x - 500.0).hypot(y - 500.0) > SPOT + 0.75;
        picture.points().filter(outside).map(|(_, _, value)| value).sum()
    };
    let found = measure::over(&measure::pictures_of(&sharp, middle(8), 64), difference);
    bench.exact("z=F: light outside the spot's own pixels", 0.0, found);
    rings(bench);
    edge(bench);
}

/// Numbers drawn from the aperture fall evenly into eight rings of equal area: chi-squared with 7 degrees of freedom, whose
/// quantile for the family's 1e-4 / 256 = 4e-7 is 43.4.
fn rings(bench: &mut Bench) {
    let aperture = Aperture::new(0, 0.0, 1.0);
    let mut counts = [0u32; 8];
    let draws = 1u32 << 18;
    for index in 0..draws {
        let sampler = farm_render::sampler::Sampler::with_sequence(
            farm_render::sampler::Sequence::Independent,
            7,
            0,
            0,
            0,
            u64::from(index),
        );
        let [u, v, ..] = sampler.set(0);
        let ring = aperture.sample([u, v]).length_squared() * 8.0;
        counts[(ring as usize).min(7)] += 1;
    }
    let each = f64::from(draws) / 8.0;
    let chi2: f64 = counts.iter().map(|&count| (f64::from(count) - each).powi(2) / each).sum();
    bench.at_most("aperture: chi-squared over 8 rings", 43.4, chi2);
}

/// The image of a straight edge is the integral of the lens' profile: for an even disk the area left of a chord.
fn edge(bench: &mut Bench) {
    let mut stage = camera(H);
    let z = 4.0f32;
    stage.place(stage::quad(Vec3::new(-50.0, 0.0, -z), Vec3::X * 50.0, Vec3::Y * 50.0), stage::glow(1.0));
    stage.lens(0.05, 2.0);
    let b = 6.25;
    // Integral of the share of the disk left of x: F(x) = x/2 - G(x), over one pixel.
    let share = |x: f64| {
        let x = x.clamp(-b, b);
        0.5 + (x * (b * b - x * x).max(0.0).sqrt() + b * b * (x / b).asin()) / (PI * b * b)
    };
    let pictures = measure::pictures_of(&stage, measure::tile(495, 500, 504, 501), 4096);
    for column in [495u32, 498, 500, 503] {
        let left = f64::from(column) - 500.0;
        let steps = 2000;
        let mean: f64 =
            (0..steps).map(|i| 1.0 - share(left + (f64::from(i) + 0.5) / f64::from(steps))).sum::<f64>()
                / f64::from(steps);
        let found = measure::over(&pictures, |picture| picture.at(column, 500));
        // The edge has a height of 1, of which the outer columns have a part: half a percent of that part is seen with 5 x 0.2 %.
        bench.coarse(format!("edge at z=4, column {left:+} from it"), mean, found, 2e-3);
    }
}

/// T30: an aperture of no size is the pinhole.
pub fn no_aperture(bench: &mut Bench) {
    let pinhole = measure::develop(&measure::prepared(&spot(4.0), 3), middle(6), 64);
    let mut closed = spot(4.0);
    closed.lens(f32::from_bits(1), 2.0);
    let found = measure::develop(&measure::prepared(&closed, 3), middle(6), 64);
    bench.at_least("light in the picture", 0.01, pinhole.mean());
    bench.exact("r=1e-45 against no lens: channels that differ", 0.0, found.differing(&pinhole));
}

/// T31: a focus distance of a micrometre is an even blur; none at all is refused.
pub fn nearest_focus(bench: &mut Bench) {
    let mut stage = camera(16);
    stage.lens(0.05, 1e-6);
    // The right half of the sky shines; rays leave the lens in all directions across the axis, half of them to the right.
    let sky: Vec<f32> = (0..8).map(|column| if (2..6).contains(&column) { 1.0 } else { 0.0 }).collect();
    stage.environment(8, &sky);
    let pictures = measure::pictures_of(&stage, measure::tile(0, 0, 16, 16), 256);
    bench.statistical("F=1e-6: mean under half a sky", 0.5, measure::over(&pictures, Picture::mean));
    let corner = measure::over(&pictures, |picture| (picture.at(0, 0) + picture.at(15, 15)) / 2.0);
    bench.coarse("F=1e-6: its corners", 0.5, corner, 3e-3);
    for focus in [0.0, -1.0, f32::NAN] {
        stage.lens(0.05, focus);
        let refused = farm_render::PreparedScene::new(
            &std::sync::Arc::new(stage.scene.clone()),
            &stage.settings,
            farm_film::FrameIndex(0),
        );
        bench.holds(format!("F={focus} is refused"), refused.is_err());
    }
}

/// T32: the plane in focus stays sharp behind a lens a hundred times wider than its distance.
pub fn wide_open(bench: &mut Bench) {
    let mut stage = camera(H);
    stage
        .place(stage::quad(Vec3::new(-500.0, 0.0, -2.0), Vec3::X * 500.0, Vec3::Y * 500.0), stage::glow(1.0));
    stage.lens(100.0, 2.0);
    let picture = measure::develop(&measure::prepared(&stage, 9), measure::tile(490, 496, 510, 504), 256);
    let column = |x: u32| (496..504).map(|y| picture.at(x, y)).sum::<f64>() / 8.0;
    bench.exact("r=100 F=z=2: a pixel left of the edge", 1.0, column(498));
    bench.exact("r=100 F=z=2: a pixel right of it", 0.0, column(501));
    bench.relative("r=100 F=z=2: the two pixels at the edge together", 1.0, column(499) + column(500), 0.01);
}

/// T33: an aperture too small to be seen changes nothing that can be seen.
pub fn smallest_aperture(bench: &mut Bench) {
    let pinhole = measure::develop(&measure::prepared(&spot(4.0), 3), middle(6), 256);
    let mut tiny = spot(4.0);
    tiny.lens(1e-30, 2.0);
    let found = measure::develop(&measure::prepared(&tiny, 3), middle(6), 256);
    bench.at_most("r=1e-30 against no lens: largest difference", 1e-6, found.largest_difference(&pinhole));
}
