//! Known bugs, switched on one at a time: proof that the project's tests would see them. Compiled under the feature `mutations` only,
//! which no program of the farm turns on.
//!
//! Each function stands behind one line of the renderer and gives back what it was given, unless its bug is on.

use crate::light::LightSample;
use farm_film::{FilmTile, Tile};
use glam::Vec3;
use std::sync::atomic::{AtomicU8, Ordering};

/// A bug.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Mutation {
    /// Rays that leave a surface draw a time of their own.
    TimePerBounce = 1,
    /// Light sampling forgets the receiver's cosine.
    MissingCosine,
    /// Rays start a millimetre away from their surface.
    AbsoluteEpsilon,
    /// The lens has a radius of one metre, whatever was asked for.
    LensNotScaled,
    /// Points on the lens do not lie in its plane.
    LensOffPlane,
    /// The density of light samples is twice what it is.
    LightPdfDoubled,
    /// One-sided emitters shine from behind.
    EmitterTwoSided,
    /// Roulette's survivors do not stand in for the others.
    RouletteWithoutWeight,
    /// Emitters met by chance are not weighed against light sampling.
    ChanceNotWeighed,
    /// Light samples are not asked for what stands in between.
    NoShadows,
    /// The pixel filter is drawn from, but not followed.
    FilterNotFollowed,
    /// The sequence starts again after 65,536 samples.
    SequenceWraps,
    /// All pixels have the same random numbers.
    PixelsAlike,
    /// Translations of moving things count twice.
    MotionTwice,
    /// Times gather at the opening of the shutter.
    TimeNotUniform,
    /// Normals are transformed as directions are.
    NormalAsDirection,
    /// The density of environment samples lacks the sine of the polar angle.
    EnvironmentWithoutSine,
    /// GGX takes the roughness for its alpha.
    AlphaIsRoughness,
    /// The last column of a tile is its neighbour's first.
    TileEdge,
    /// The second block of a pixel's samples counts twice.
    BlockTwice,
}

impl Mutation {
    /// Every bug.
    pub const ALL: [Self; 20] = [
        Self::TimePerBounce,
        Self::MissingCosine,
        Self::AbsoluteEpsilon,
        Self::LensNotScaled,
        Self::LensOffPlane,
        Self::LightPdfDoubled,
        Self::EmitterTwoSided,
        Self::RouletteWithoutWeight,
        Self::ChanceNotWeighed,
        Self::NoShadows,
        Self::FilterNotFollowed,
        Self::SequenceWraps,
        Self::PixelsAlike,
        Self::MotionTwice,
        Self::TimeNotUniform,
        Self::NormalAsDirection,
        Self::EnvironmentWithoutSine,
        Self::AlphaIsRoughness,
        Self::TileEdge,
        Self::BlockTwice,
    ];
}

/// The bug that is on; 0 is none. Of the whole process, because tests render on several threads.
static CURRENT: AtomicU8 = AtomicU8::new(0);

/// Switches one bug on, or all off.
pub fn select(mutation: Option<Mutation>) {
    CURRENT.store(mutation.map_or(0, |mutation| mutation as u8), Ordering::SeqCst);
}

/// Whether a bug is on.
pub(crate) fn is_on(mutation: Mutation) -> bool {
    CURRENT.load(Ordering::Relaxed) == mutation as u8
}

pub(crate) fn time_of_bounce(time: f32) -> f32 {
    if is_on(Mutation::TimePerBounce) { (time * 7.31 + 0.37).fract() } else { time }
}

pub(crate) fn camera_time(time: f32) -> f32 {
    if is_on(Mutation::TimeNotUniform) { time * time } else { time }
}

pub(crate) fn start(origin: Vec3, direction: Vec3) -> Vec3 {
    if is_on(Mutation::AbsoluteEpsilon) { origin + direction * 1e-3 } else { origin }
}

pub(crate) fn scattered(scattered: Vec3, without_cosine: Vec3) -> Vec3 {
    if is_on(Mutation::MissingCosine) { without_cosine } else { scattered }
}

pub(crate) fn light_sample(light: LightSample) -> LightSample {
    if is_on(Mutation::LightPdfDoubled) { LightSample { pdf: light.pdf * 2.0, ..light } } else { light }
}

pub(crate) fn survival(survival: f32) -> f32 {
    if is_on(Mutation::RouletteWithoutWeight) { 1.0 } else { survival }
}

pub(crate) fn chance_weight(weight: f32) -> f32 {
    if is_on(Mutation::ChanceNotWeighed) { 1.0 } else { weight }
}

pub(crate) fn lens_point(shift: Vec3, radius: f32) -> Vec3 {
    if is_on(Mutation::LensNotScaled) {
        shift / radius
    } else if is_on(Mutation::LensOffPlane) {
        Vec3::new(shift.x, shift.z, shift.y)
    } else {
        shift
    }
}

pub(crate) fn filtered(offset: [f32; 2], u: [f32; 2], radius: f32) -> [f32; 2] {
    if is_on(Mutation::FilterNotFollowed) { u.map(|u| (2.0 * u - 1.0) * radius) } else { offset }
}

pub(crate) fn low_index(low: u32) -> u32 {
    if is_on(Mutation::SequenceWraps) { low & 0xffff } else { low }
}

pub(crate) fn pixel_of_sequence(x: u32, y: u32) -> (u32, u32) {
    if is_on(Mutation::PixelsAlike) { (0, 0) } else { (x, y) }
}

pub(crate) fn translation(now: Vec3, at_first: Vec3) -> Vec3 {
    if is_on(Mutation::MotionTwice) { now + (now - at_first) } else { now }
}

pub(crate) fn environment_density(pdf: f64, height: f64) -> f64 {
    if is_on(Mutation::EnvironmentWithoutSine) { pdf * (1.0 - height * height).max(0.0).sqrt() } else { pdf }
}

pub(crate) fn alpha(alpha: f32, roughness: f32) -> f32 {
    if is_on(Mutation::AlphaIsRoughness) { roughness } else { alpha }
}

pub(crate) fn pixel_of_tile((x, y): (u32, u32), tile: Tile, width: u32) -> (u32, u32) {
    let last = x + 1 == tile.x1() && tile.x1() < width;
    if last && is_on(Mutation::TileEdge) { (x + 1, y) } else { (x, y) }
}

pub(crate) fn block_sums(whole: FilmTile) -> FilmTile {
    if whole.block().start() != 16 || !is_on(Mutation::BlockTwice) {
        return whole;
    }
    let sums = whole.sums().iter().map(|sum| sum.map(|value| value * 2.0)).collect();
    FilmTile::new(whole.tile(), whole.block(), sums)
}
