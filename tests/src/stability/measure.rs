//! From a stage to numbers: pictures, and means over independently seeded replicates.

use super::stage::Stage;
use farm_film::{Counters, Film, FrameIndex, Resolution, Rgb, SampleBlock, Tile};
use farm_render::{PreparedScene, render};
use std::sync::Arc;

/// Independent pictures behind every statistical check.
pub const REPLICATES: u64 = 32;

/// First seed of the replicates; fixed, so that a run passes or fails for good.
const SEED: u64 = 0x7e55_e1a7_ed5e_ed00;

/// A number that was measured.
#[derive(Clone, Copy, Debug)]
pub struct Measurement {
    /// Mean over replicates.
    pub mean: f64,
    /// From the spread between replicates; none for what has no spread by construction.
    pub standard_error: Option<f64>,
    /// Of all replicates.
    pub counters: Counters,
}

impl Measurement {
    /// Mean and standard error of independent values.
    pub fn of(values: &[f64], counters: Counters) -> Self {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / (n - 1.0);
        Self { mean, standard_error: Some((variance / n).sqrt()), counters }
    }

    /// The same in another unit.
    pub fn times(self, factor: f64) -> Self {
        let standard_error = self.standard_error.map(|se| se * factor.abs());
        Self { mean: self.mean * factor, standard_error, ..self }
    }

    /// The same for shares that stratified samples count, `spp` for each replicate, of something that begins or ends once within them:
    /// all replicates may count the same number though the truth lies between it and the next. The count is off by less than
    /// one, so its spread is at most half of one.
    pub fn of_steps(self, spp: u64) -> Self {
        let smallest = 0.5 / spp as f64 / (REPLICATES as f64).sqrt();
        Self { standard_error: self.standard_error.map(|se| se.max(smallest)), ..self }
    }

    /// The difference of two independent measurements, plus `around`, so that it can be held against that.
    pub fn minus(self, other: Self, around: f64) -> Self {
        let square = |m: Self| m.standard_error.unwrap_or(0.0).powi(2);
        Self {
            mean: self.mean - other.mean + around,
            standard_error: Some((square(self) + square(other)).sqrt()),
            counters: self.counters.plus(other.counters),
        }
    }
}

/// A rendered rectangle of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Which pixels.
    pub tile: Tile,
    /// Mean radiance in scanline order.
    pub pixels: Vec<Rgb>,
    /// What was traced and what went wrong.
    pub counters: Counters,
}

impl Picture {
    /// Grey value of a pixel of the frame.
    pub fn at(&self, x: u32, y: u32) -> f64 {
        let index =
            (y - self.tile.y0()) as usize * self.tile.width() as usize + (x - self.tile.x0()) as usize;
        grey(self.pixels[index])
    }

    /// Mean of the grey values.
    pub fn mean(&self) -> f64 {
        self.greys().sum::<f64>() / self.pixels.len() as f64
    }

    /// Grey values in scanline order.
    pub fn greys(&self) -> impl Iterator<Item = f64> + '_ {
        self.pixels.iter().map(|&pixel| grey(pixel))
    }

    /// Pixels of the frame with their grey values; x and y are those of the pixels' centres.
    pub fn points(&self) -> impl Iterator<Item = (f64, f64, f64)> + '_ {
        let centre = |(x, y): (u32, u32)| (f64::from(x) + 0.5, f64::from(y) + 0.5);
        self.tile.pixels().map(centre).zip(self.greys()).map(|((x, y), value)| (x, y, value))
    }

    /// Number of channels in which the two pictures do not agree to the bit.
    pub fn differing(&self, other: &Self) -> f64 {
        assert_eq!(self.pixels.len(), other.pixels.len(), "pictures of one size are compared");
        let pairs = self.pixels.iter().flatten().zip(other.pixels.iter().flatten());
        pairs.filter(|(a, b)| a.to_bits() != b.to_bits()).count() as f64
    }

    /// Largest difference of any channel, relative to the brightest channel of the other picture.
    pub fn largest_difference(&self, other: &Self) -> f64 {
        let brightest = other.pixels.iter().flatten().fold(f32::MIN_POSITIVE, |a, &b| a.max(b.abs()));
        let pairs = self.pixels.iter().flatten().zip(other.pixels.iter().flatten());
        pairs.map(|(a, b)| f64::from((a - b).abs() / brightest)).fold(0.0, f64::max)
    }
}

fn grey(rgb: Rgb) -> f64 {
    rgb.iter().map(|&value| f64::from(value)).sum::<f64>() / 3.0
}

/// Makes the stage's frame 0 ready with the given seed.
pub fn prepared(stage: &Stage, seed: u64) -> PreparedScene {
    let settings = farm_scene::Settings { seed, ..stage.settings };
    PreparedScene::new(&Arc::new(stage.scene.clone()), &settings, FrameIndex(0)).expect("a scene in order")
}

/// Renders samples `[0, spp)` of a rectangle through the film's merge tree.
pub fn develop(scene: &PreparedScene, tile: Tile, spp: u64) -> Picture {
    let samples = farm_film::SampleRange::new(0..spp).expect("at least one sample");
    let mut film = Film::with_tiles(scene.resolution(), [tile], samples).expect("samples from 0 on");
    let mut counters = Counters::default();
    for block in film.roots().to_vec() {
        let rendered = render(scene, tile, block, &|| false).expect("nobody stops it");
        counters = counters.plus(rendered.counters);
        film.add(rendered.tile).expect("a part of this film");
    }
    let resolved = film.resolve().next().expect("the film's only tile");
    Picture { tile, pixels: resolved.pixels, counters }
}

/// The whole picture with the first seed.
pub fn picture(stage: &Stage, spp: u64) -> Picture {
    let scene = prepared(stage, SEED);
    develop(&scene, scene.resolution().full(), spp)
}

/// The whole picture, once per replicate.
pub fn pictures(stage: &Stage, spp: u64) -> Vec<Picture> {
    pictures_of(stage, full(stage), spp)
}

/// A rectangle of the picture, once per replicate.
pub fn pictures_of(stage: &Stage, tile: Tile, spp: u64) -> Vec<Picture> {
    (0..REPLICATES).map(|replicate| develop(&prepared(stage, SEED + replicate), tile, spp)).collect()
}

fn full(stage: &Stage) -> Tile {
    Resolution::new(stage.settings.width, stage.settings.height).expect("a picture").full()
}

/// What `value` says of each replicate.
pub fn over(pictures: &[Picture], value: impl Fn(&Picture) -> f64) -> Measurement {
    let counters = pictures.iter().fold(Counters::default(), |sum, picture| sum.plus(picture.counters));
    Measurement::of(&pictures.iter().map(value).collect::<Vec<_>>(), counters)
}

/// Mean radiance of the picture over replicates of `spp` samples per pixel.
pub fn radiance(stage: &Stage, spp: u64) -> Measurement {
    over(&pictures(stage, spp), Picture::mean)
}

/// Irradiance of the Lambert surface of albedo 1/2 that fills the picture: E = pi L / albedo.
pub fn irradiance(stage: &Stage, spp: u64) -> Measurement {
    radiance(stage, spp).times(2.0 * std::f64::consts::PI)
}

/// A block of the merge tree.
pub fn block(start: u64, end: u64) -> SampleBlock {
    SampleBlock::new(start..end).expect("a block of the merge tree")
}

/// A rectangle of pixels.
pub fn tile(x0: u32, y0: u32, x1: u32, y1: u32) -> Tile {
    Tile::new(x0, y0, x1, y1).expect("a rectangle that holds pixels")
}
