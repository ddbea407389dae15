//! The sums that one work unit leaves behind.

use crate::differences::Halves;
use crate::{Differences, LEAF_SAMPLES, SampleBlock, Tile};
use serde::{Deserialize, Serialize};

/// Linear Rec. 709 red, green, blue.
pub type Rgb = [f32; 3];

/// Adds two pixel sums, channel by channel, in f32: the only addition above the leaves.
pub fn add_rgb(a: Rgb, b: Rgb) -> Rgb {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Per-pixel sum of a leaf: added in index order in f64, rounded once to f32.
#[derive(Clone, Copy, Debug, Default)]
pub struct LeafSum {
    sum: [f64; 3],
    samples: u64,
    /// Sums of the leaf's own aligned blocks that wait for their sibling, by level: only for the differences.
    open: [[f64; 3]; LEAF_SAMPLES.ilog2() as usize + 1],
    /// Of the largest block so far that starts with the first sample.
    halves: Halves,
}

impl LeafSum {
    /// Adds one sample's radiance, and to `differences` every pair of sibling blocks that it completes.
    pub fn add(&mut self, radiance: Rgb, differences: &mut Differences) {
        assert!(self.samples < LEAF_SAMPLES, "a leaf has at most {LEAF_SAMPLES} samples");
        let radiance = radiance.map(f64::from);
        self.sum = plus(self.sum, radiance);
        let (mut block, mut level) = (radiance, 0);
        while self.samples >> level & 1 == 1 {
            let (left, scale) = (self.open[level], 1.0 / (1_u64 << level) as f64);
            let halves = [left, block].map(|sum| sum.map(|value| value * scale));
            level += 1;
            differences.add(level as u32, halves);
            if self.samples + 1 == 1 << level {
                self.halves = halves;
            }
            block = plus(left, block);
        }
        self.open[level] = block;
        self.samples += 1;
    }

    /// The leaf's value.
    pub fn round(self) -> Rgb {
        self.sum.map(|sum| sum as f32)
    }
}

fn plus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// What was traced and what went wrong on the way to some pixel sums. Adds up over units; what is said of the frame's geometry is the
/// same in all of its units and does not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Counters {
    /// Samples taken (pixels times samples per pixel).
    pub samples: u64,
    /// Rays from the camera.
    pub rays_camera: u64,
    /// Rays that continue a path.
    pub rays_extension: u64,
    /// Rays that ask whether a light is visible.
    pub rays_shadow: u64,
    /// Samples that came out as NaN and were counted as black.
    pub nan: u64,
    /// Samples that came out infinite and were counted as black.
    pub infinite: u64,
    /// Samples with a negative channel, which was counted as zero.
    pub negative: u64,
    /// Samples counted as black because they were no radiance: the NaN and the infinite ones.
    pub dropped: u64,
    /// Samples brighter than the job's limit on samples, which were darkened to it.
    pub clamped: u64,
    /// Radiance that this took away, the mean over the channels summed over samples, W/sr/m^2.
    pub clamped_radiance: f64,
    /// Triangles of the frame left out because a coordinate is not finite.
    pub triangles_not_finite: u64,
    /// Triangles of the frame left out because they have no area.
    pub triangles_without_area: u64,
    /// Instances of the frame whose place flattens them, or is not finite.
    pub instances_flattened: u64,
}

// Radiance that was taken away is a sum of finite numbers.
impl Eq for Counters {}

impl Counters {
    /// Sums of both.
    pub fn plus(self, other: Self) -> Self {
        Self {
            samples: self.samples + other.samples,
            rays_camera: self.rays_camera + other.rays_camera,
            rays_extension: self.rays_extension + other.rays_extension,
            rays_shadow: self.rays_shadow + other.rays_shadow,
            nan: self.nan + other.nan,
            infinite: self.infinite + other.infinite,
            negative: self.negative + other.negative,
            dropped: self.dropped + other.dropped,
            clamped: self.clamped + other.clamped,
            clamped_radiance: self.clamped_radiance + other.clamped_radiance,
            triangles_not_finite: self.triangles_not_finite.max(other.triangles_not_finite),
            triangles_without_area: self.triangles_without_area.max(other.triangles_without_area),
            instances_flattened: self.instances_flattened.max(other.instances_flattened),
        }
    }

    /// All rays.
    pub fn rays(&self) -> u64 {
        self.rays_camera + self.rays_extension + self.rays_shadow
    }

    /// Samples that could not be taken at face value.
    pub fn faults(&self) -> u64 {
        self.nan + self.infinite + self.negative
    }

    /// Sentences about everything that a clean scene has none of.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.faults() > 0 {
            warnings.push(format!(
                "{} samples could not be taken at face value: {} not a number, {} infinite, {} negative; {} count as black",
                self.faults(),
                self.nan,
                self.infinite,
                self.negative,
                self.dropped
            ));
        }
        let left_out = self.triangles_not_finite + self.triangles_without_area;
        if left_out > 0 {
            warnings.push(format!(
                "{left_out} triangles were left out: {} with a coordinate that is not finite, {} without area",
                self.triangles_not_finite, self.triangles_without_area
            ));
        }
        if self.instances_flattened > 0 {
            warnings.push(format!("{} instances are flattened by their place", self.instances_flattened));
        }
        warnings
    }
}

/// Per-pixel radiance sums over one sample block: on disk and wire a *partial EXR*.
#[derive(Clone, Debug, PartialEq)]
pub struct FilmTile {
    tile: Tile,
    block: SampleBlock,
    sums: Vec<Rgb>,
    differences: Differences,
}

impl FilmTile {
    /// `sums` holds one entry per pixel of `tile`, in scanline order. Nothing is known of the differences within the block.
    pub fn new(tile: Tile, block: SampleBlock, sums: Vec<Rgb>) -> Self {
        assert_eq!(sums.len(), tile.area(), "one pixel sum per pixel of the tile");
        Self { tile, block, sums, differences: Differences::default() }
    }

    /// A leaf from the sums of its pixels in scanline order, and the differences that were seen on the way to them.
    pub fn leaf(tile: Tile, block: SampleBlock, leaves: &[LeafSum], mut differences: Differences) -> Self {
        assert!(
            leaves.iter().all(|leaf| leaf.samples == block.samples()),
            "every pixel has all samples of the leaf"
        );
        let level = block.samples().ilog2();
        if level > 0 {
            let halves: Vec<_> = leaves.iter().map(|leaf| leaf.halves).collect();
            differences.add_relative(level, tile, &halves);
        }
        Self::new(tile, block, leaves.iter().map(|leaf| leaf.round()).collect()).with_differences(differences)
    }

    /// The same with the differences that were seen while its samples were added up.
    pub fn with_differences(mut self, differences: Differences) -> Self {
        self.differences = differences;
        self
    }

    /// Which pixels.
    pub fn tile(&self) -> Tile {
        self.tile
    }

    /// Which samples.
    pub fn block(&self) -> SampleBlock {
        self.block
    }

    /// Sums in scanline order.
    pub fn sums(&self) -> &[Rgb] {
        &self.sums
    }

    /// Sibling differences within the block.
    pub fn differences(&self) -> &Differences {
        &self.differences
    }

    /// Whether every sum is finite: what a healthy renderer always returns.
    pub fn is_finite(&self) -> bool {
        self.sums.iter().flatten().all(|value| value.is_finite())
    }

    /// The parent's tile from two sibling blocks of one tile, given in either order.
    pub fn merge(self, other: Self) -> Self {
        assert_eq!(self.tile, other.tile, "siblings cover one tile");
        assert_eq!(self.block.sibling(), Some(other.block), "only siblings merge");
        let (mut left, right) =
            if self.block.start() < other.block.start() { (self, other) } else { (other, self) };
        let block = left.block.parent().expect("a block with a sibling has a parent");
        left.differences.add_all(&right.differences);
        let (level, scale) = (block.samples().ilog2(), 2.0 / block.samples() as f64);
        let halves: Vec<Halves> = left
            .sums
            .iter()
            .zip(&right.sums)
            .map(|(a, b)| [a, b].map(|sum| sum.map(|value| f64::from(value) * scale)))
            .collect();
        halves.iter().for_each(|pair| left.differences.add(level, *pair));
        left.differences.add_relative(level, left.tile, &halves);
        for (a, b) in left.sums.iter_mut().zip(&right.sums) {
            *a = add_rgb(*a, *b);
        }
        Self { block, ..left }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_leaf_rounds_once() {
        let mut leaf = LeafSum::default();
        let mut naive = 0.0f32;
        for _ in 0..16 {
            leaf.add([0.1; 3], &mut Differences::default());
            naive += 0.1;
        }
        let exact = (16.0 * f64::from(0.1f32)) as f32;
        assert_eq!(leaf.round(), [exact; 3]);
        assert_ne!(naive, exact, "the naive sum would have shown a difference");
    }

    #[test]
    fn counts_add_up_but_a_frame_has_its_geometry_once() {
        let unit = Counters {
            samples: 4,
            clamped: 1,
            clamped_radiance: 0.5,
            triangles_without_area: 3,
            ..Counters::default()
        };
        let sum = unit.plus(unit);
        assert_eq!((sum.samples, sum.clamped, sum.clamped_radiance), (8, 2, 1.0));
        assert_eq!(sum.triangles_without_area, 3);
        assert!(sum.warnings()[0].contains("3 triangles"), "{:?}", sum.warnings());
        assert!(Counters { samples: 9, ..Counters::default() }.warnings().is_empty());
    }

    #[test]
    fn siblings_merge_in_either_order() {
        let tile = Tile::new(0, 0, 1, 1).unwrap();
        let make = |range, value| FilmTile::new(tile, SampleBlock::new(range).unwrap(), vec![[value; 3]]);
        let (left, right) = (make(0..16, 1.0e8), make(16..32, 3.3));
        let merged = left.clone().merge(right.clone());
        assert_eq!(merged, right.merge(left));
        assert_eq!(merged.block(), SampleBlock::new(0..32).unwrap());
    }
}
