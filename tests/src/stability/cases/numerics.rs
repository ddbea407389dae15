//! Sums, seeds and numbers at the ends of their ranges.

use crate::stability::bench::Bench;
use crate::stability::cases::motion::still_life;
use crate::stability::measure::{self, REPLICATES};
use crate::stability::stage::{self, Stage};
use farm_film::{
    Counters, Differences, Film, FilmTile, FrameIndex, LeafSum, Resolution, SampleBlock, SampleRange, Tile,
};
use farm_image::{Frame, FrameMetadata, SampleFormat, pixels_digest, read_image, write_frame};
use farm_render::sampler::Sampler;
use farm_render::{PreparedScene, render, render_sample};
use farm_scene::LightKind;
use glam::{DVec3, Vec3};
use std::collections::BTreeSet;
use std::sync::Arc;

/// T58: a sum of 2^25 equal samples is exact where a plain one stalls.
pub fn long_sums(bench: &mut Bench) {
    for value in [1.0f32, 0.1] {
        let tile = measure::tile(0, 0, 1, 1);
        let mut leaf = LeafSum::default();
        (0..16).for_each(|_| leaf.add([value; 3], &mut Differences::default()));
        let samples = SampleRange::new(0..1 << 25).expect("a range");
        let resolution = Resolution::new(1, 1).expect("a picture");
        let mut film = Film::with_tiles(resolution, [tile], samples).expect("a film");
        for start in (0..1u64 << 25).step_by(16) {
            film.add(FilmTile::new(tile, measure::block(start, start + 16), vec![leaf.round()]))
                .expect("a part of it");
        }
        let mean = f64::from(film.pixels()[0][0]);
        bench.exact(format!("2^25 samples of {value}: mean"), f64::from(value), mean);
        let naive = (0..1u64 << 25).fold(0.0f32, |sum, _| sum + value);
        let lost = f64::from(naive) / f64::from(1u32 << 25) / f64::from(value);
        bench.at_most(format!("the same summed plainly, for comparison: share of {value}"), 0.7, lost);
    }
    let mut stage = Stage::new();
    stage.place(stage::floor(0.0, 1.0), stage::glow(0.1));
    stage.eye_on(DVec3::ZERO, DVec3::Y);
    let picture = measure::picture(&stage, 1 << bench.pick(18, 25));
    let counters = picture.counters;
    let mean = f64::from(picture.pixels[0][0]);
    let found = measure::Measurement { mean, standard_error: None, counters };
    bench.exact("an emitter of 0.1, rendered: mean", f64::from(0.1f32), found);
}

/// Root mean squared error over replicates of the mean of samples `[0, n)`, for each n, of an integral in the given dimension set.
fn sequence_errors(counts: &[u64], replicates: u64) -> Vec<f64> {
    let mut squares = vec![0.0; counts.len()];
    for replicate in 0..replicates {
        let mut sum = 0.0;
        let mut next = 0;
        for index in 0..counts[counts.len() - 1] {
            let [a, b, c, d] = Sampler::new(replicate, 0, 3, 4, index).set(2).map(f64::from);
            // Smooth in four dimensions with a kink, and of mean 1: what light over an edge is like.
            sum += 4.0 * a * b * f64::from(u8::from(c + d < 1.0)) * 2.0;
            if index + 1 == counts[next] {
                squares[next] += (sum / counts[next] as f64 - 1.0).powi(2);
                next += 1;
            }
        }
    }
    squares.iter().map(|square| (square / replicates as f64).sqrt()).collect()
}

/// T59: samples past the 65,536th are new ones.
pub fn endless_sequence(bench: &mut Bench) {
    let counts = [1u64 << 14, 1 << 16, 1 << 18, 1 << bench.pick(19, 20)];
    let errors = sequence_errors(&counts, 16);
    let (doublings, last) = ((counts[3] as f64 / counts[0] as f64).log2(), errors[3] / errors[0]);
    // Plain Monte Carlo has -1/2; the integrand's edge in four dimensions keeps nets from more than about -5/8.
    bench.at_most(
        format!("sequence: slope of log error over log samples, 2^14 to 2^{}", counts[3].ilog2()),
        -0.45,
        last.log2() / doublings,
    );
    for (pair, counts) in errors.windows(2).zip(counts.windows(2)) {
        // Even plain Monte Carlo loses a factor of the root of the ratio; a sequence that repeats loses nothing. Errors of
        // an error from 16 replicates are 18 % each.
        let ratio = (counts[0] as f64 / counts[1] as f64).sqrt();
        bench.at_most(
            format!("sequence: error from {} to {} samples", counts[0], counts[1]),
            (ratio * 1.4).min(0.9),
            pair[1] / pair[0],
        );
    }
    let mut stage = Stage::new();
    stage.place(stage::floor(0.0, 50.0), stage::grey(0.5));
    stage.eye_on(DVec3::X, DVec3::Y);
    let light = LightKind::Disk { radiance: Vec3::ONE, radius: 1.0 };
    stage.light(light, stage::look(DVec3::Y, DVec3::ZERO));
    stage.place(stage::quad(Vec3::new(-25.2, 0.5, 0.0), Vec3::Z * 25.0, Vec3::X * 25.7), stage::grey(0.0));
    let spread =
        |spp: u64| measure::radiance(&stage, spp).standard_error.unwrap_or(0.0) * (REPLICATES as f64).sqrt();
    let (from, to) = bench.pick((14, 17), (16, 20));
    let (few, many) = (spread(1 << from), spread(1 << to));
    bench.at_least("half a disk behind an edge: spread at few samples", 1e-12, few);
    // The error of a spread of 32 replicates is 13 %, of a ratio of two 18 %: over three doublings or more a slope of -1/2 is seen as
    // -.4 at most.
    bench.at_most(
        format!("the same: slope of log error over log samples, 2^{from} to 2^{to}"),
        -0.4,
        (many / few).log2() / f64::from(to - from),
    );
}

/// T60: addresses at the ends of their ranges.
pub fn far_addresses(bench: &mut Bench) {
    let mut stage = Stage::new().size(farm_film::RESOLUTION_MAX, farm_film::RESOLUTION_MAX);
    // One cell of the pattern per few pixels, so that every sample sees its own value.
    let mut corners = Vec::new();
    for i in 0..64 {
        let x = -1.0 + i as f32 / 32.0;
        corners.push([Vec3::new(x, -1.0, 0.0), Vec3::new(x + 0.02, -1.0, 0.0), Vec3::new(x, 1.0, 0.0)]);
    }
    stage.place(stage::triangles(&corners), stage::grey(0.7));
    stage.place(stage::quad(Vec3::NEG_Z, Vec3::X * 9.0, Vec3::Y * 9.0), stage::grey(0.4));
    stage.camera(DVec3::Z * 2.0, DVec3::ZERO, farm_scene::Projection::Perspective { yfov: 0.9 });
    stage.environment(3, &[0.1, 0.9, 0.4, 0.3, 0.8, 0.2]);
    let last = farm_film::RESOLUTION_MAX - 1;
    let far = 1u64 << 32;
    let mut sums = BTreeSet::new();
    let mut faults = Counters::default();
    let mut units = 0;
    for frame in [0, 1, (1 << 31) - 1, u32::MAX] {
        let settings = farm_scene::Settings { fps: 24.0, ..stage.settings };
        let scene = PreparedScene::new(&Arc::new(stage.scene.clone()), &settings, FrameIndex(frame))
            .expect("a scene in order");
        for (x, y) in [(0, 0), (last, 0), (0, last), (last, last), (last - 1, last)] {
            for start in [0, 1 << 16, far - 16, far, far << 8] {
                let tile = measure::tile(x, y, x + 1, y + 1);
                let rendered =
                    render(&scene, tile, measure::block(start, start + 16), &|| false).expect("not stopped");
                sums.insert(rendered.tile.sums()[0].map(f32::to_bits));
                faults = faults.plus(rendered.counters);
                units += 1;
            }
        }
    }
    let found = measure::Measurement { mean: sums.len() as f64, standard_error: None, counters: faults };
    bench.exact(
        format!("frames to 2^32-1, pixels to {last}, samples to 2^40: different sums of {units}"),
        f64::from(units),
        found,
    );
}

/// T61: the largest integer becomes a fraction below one.
pub fn largest_fraction(bench: &mut Bench) {
    let largest = f64::from(farm_render::math::unit_f32(u32::MAX));
    bench.at_most("u32::MAX", 1.0 - 2f64.powi(-24), largest);
    bench.at_least("u32::MAX", 1.0 - 2f64.powi(-23), largest);
}

/// T62: what a file holds of bright pixels.
pub fn bright_pixels(bench: &mut Bench) {
    let resolution = Resolution::new(4, 1).expect("a picture");
    let pixels = [[1e6f32; 3], [65_504.0; 3], [65_520.0, 1.0, 2.0], [f32::INFINITY, 1e30, 0.5]];
    let metadata = FrameMetadata {
        scene_name: "bright".to_owned(),
        scene: [0; 32],
        settings: [0; 32],
        frame: FrameIndex(0),
        spp: 1,
        seed: 0,
        renderer: farm_render::FINGERPRINT.to_owned(),
        counters: Counters::default(),
        error: None,
        seconds: 0.0,
        extra: serde_json::Map::new(),
    };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("bright.exr");
    let frame = Frame { resolution, pixels: &pixels, passes: &[] };
    // Beyond the format: in half 1e6 three times, 65520, infinity and 1e30; in float the infinity.
    for (format, name, first, beyond) in
        [(SampleFormat::Float, "float", 1e6, 1.0), (SampleFormat::Half, "half", 65_504.0, 6.0)]
    {
        let clamped = write_frame(&path, &frame, &metadata, format).expect("a folder to write to");
        let image = read_image(&path).expect("what was just written");
        bench.exact(format!("{name}: 1e6 comes back as"), first, f64::from(image.pixels[0][0]));
        bench.exact(format!("{name}: values counted as beyond"), beyond, clamped as f64);
        let infinite = image.pixels.iter().flatten().filter(|value| !value.is_finite()).count();
        bench.exact(format!("{name}: infinities in the file"), 0.0, infinite as f64);
    }
}

/// T64: however a frame is divided, ordered, doubled and shared among threads, its digest is the same.
pub fn any_division(bench: &mut Bench) {
    let stage = still_life();
    let scene = measure::prepared(&stage, 6);
    let resolution = scene.resolution();
    let spp = 112u64;
    let digest = |film: &Film| pixels_digest(resolution, &film.pixels());
    let whole = {
        let mut film = Film::new(resolution, 1000, spp).expect("a film");
        for block in film.roots().to_vec() {
            film.add(rendered(&scene, resolution.full(), block)).expect("a part of it");
        }
        assert!(film.is_complete(), "all of its parts");
        digest(&film)
    };
    let mut different = 0;
    let rounds = bench.pick(12u64, 60);
    for round in 0..rounds {
        let mut chance = Chance(round);
        let side = [1, 3, 5, 16, 1000][chance.below(5)];
        let mut film = Film::new(resolution, side, spp).expect("a film");
        let mut units = divided(&film, side, &mut chance);
        // A few are delivered twice, in any order, by one to four threads.
        let again: Vec<_> = units.iter().copied().filter(|_| chance.below(5) == 0).collect();
        units.extend(again);
        for last in (1..units.len()).rev() {
            units.swap(last, chance.below(last + 1));
        }
        let threads = 1 + chance.below(4);
        let parts: Vec<FilmTile> = std::thread::scope(|scope| {
            let workers: Vec<_> = units
                .chunks(units.len().div_ceil(threads))
                .map(|units| {
                    let scene = &scene;
                    let work = move || {
                        units.iter().map(|&(tile, block)| rendered(scene, tile, block)).collect::<Vec<_>>()
                    };
                    scope.spawn(work)
                })
                .collect();
            workers.into_iter().flat_map(|worker| worker.join().expect("no panic")).collect()
        });
        for part in parts {
            film.add(part).expect("a part of it");
        }
        different += u32::from(!film.is_complete() || digest(&film) != whole);
    }
    bench.exact(format!("{rounds} random divisions: other digests"), 0.0, f64::from(different));
    let sample = render_sample(&scene, 3, 4, 5);
    bench.holds("a sample asked twice is the same", sample == render_sample(&scene, 3, 4, 5));
}

/// Divides a frame's tiles into blocks by chance.
fn divided(film: &Film, side: u32, chance: &mut Chance) -> Vec<(Tile, SampleBlock)> {
    let mut units = Vec::new();
    for tile in film.resolution().tiles(side) {
        let mut open = film.roots().to_vec();
        while let Some(block) = open.pop() {
            match block.children() {
                Some((left, right)) if chance.below(2) == 0 => open.extend([left, right]),
                _ => units.push((tile, block)),
            }
        }
    }
    units
}

fn rendered(scene: &PreparedScene, tile: Tile, block: SampleBlock) -> FilmTile {
    render(scene, tile, block, &|| false).expect("nobody stops it").tile
}

/// Seeded numbers to choose by (SplitMix64).
#[derive(Clone, Copy, Debug)]
pub struct Chance(pub u64);

impl Chance {
    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ z >> 31
    }

    /// One of `0..n`.
    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }
}
