//! What the halves of sample blocks say about the variance of their means.

use crate::{ExactSum, Tile};
use serde::{Deserialize, Serialize};

/// Keeps relative errors finite where the picture is black.
const RELATIVE_FLOOR: f64 = 0.01;

/// Highest level: blocks of 2^62 samples.
const LEVEL_MAX: usize = 62;

/// Side of the squares of pixels that are asked together what the value of one of them may be.
const CELL_SIDE: u32 = 4;

/// No true value is taken to be less than this part of what was found. It bounds the relative value of a pair, so that a few
/// dark pixels with one bright sample, which may be lamps or fireflies, do not make up the whole estimate.
const BELIEVED_MIN: f64 = 0.125;

/// Sums over pairs of sibling blocks of one size, each pair in one pixel. With `a`, `b` the means of the two halves, a pair's
/// value is the mean of `(a - b)^2 / 4` over the channels, its relative value that over `value^2 + 0.01`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LevelDifferences {
    /// How many pairs.
    pub pairs: u64,
    /// Of the values.
    pub squared: ExactSum,
    /// Of the values' squares: how far single pairs decide.
    pub squared_spread: ExactSum,
    /// How many pairs have a relative value: all from the leaf upwards, none within it.
    pub relative_pairs: u64,
    /// Of the relative values.
    pub relative: ExactSum,
    /// Of their squares.
    pub relative_spread: ExactSum,
}

/// Sums of sibling differences by size of the block that two siblings make up: what remains of samples that were added up.
///
/// Additions are exact, so the sums do not depend on the division of the work: neither into blocks nor into tiles, but that
/// relative values ask the neighbourhood in squares of 4 pixels, which the tiles must not cut if they are to be the same.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Differences {
    /// Entry `k - 1` is of blocks of `2^k` samples.
    levels: Vec<LevelDifferences>,
}

/// Means of the two halves of a block of one pixel's samples.
pub(crate) type Halves = [[f64; 3]; 2];

impl Differences {
    /// Entry `k - 1` is of blocks of `2^k` samples; levels that were not observed have no pairs.
    pub fn levels(&self) -> &[LevelDifferences] {
        &self.levels
    }

    /// Whether these can be the sums of a block of `samples` samples of `pixels` pixels: of no more pairs than there are.
    pub fn fit(&self, pixels: usize, samples: u64) -> bool {
        let fits = |(index, level): (usize, &LevelDifferences)| {
            let pairs_max = u128::from(samples >> (index + 1)) * pixels as u128;
            u128::from(level.pairs.max(level.relative_pairs)) <= pairs_max
        };
        self.levels.len() <= LEVEL_MAX && self.levels.iter().enumerate().all(fits)
    }

    /// Adds other sums, level by level.
    pub fn add_all(&mut self, other: &Self) {
        for (level, more) in (1..).zip(&other.levels) {
            let sums = self.level_mut(level);
            sums.pairs += more.pairs;
            sums.squared.add_sum(&more.squared);
            sums.squared_spread.add_sum(&more.squared_spread);
            sums.relative_pairs += more.relative_pairs;
            sums.relative.add_sum(&more.relative);
            sums.relative_spread.add_sum(&more.relative_spread);
        }
    }

    /// Adds a pair that makes up a block of `2^level` samples.
    pub(crate) fn add(&mut self, level: u32, [left, right]: Halves) {
        let squared: f64 = left.into_iter().zip(right).map(|(a, b)| (a - b) * (a - b) / 12.0).sum();
        let sums = self.level_mut(level);
        // What left the range of sums says nothing.
        if sums.squared_spread.add(squared * squared) && sums.squared.add(squared) {
            sums.pairs += 1;
        }
    }

    /// Adds relative values of pairs, one per pixel of a tile in scanline order.
    ///
    /// What the squared error is divided by is unknown itself. The pair's mean is what a wrong value would hide behind: a
    /// firefly is as bright as it is wrong. So the mean is believed only as far as both halves have it, or the pixels around; of
    /// all rules that were tried this one comes closest on scenes with lamps of less than a pixel, caustics and fireflies.
    pub(crate) fn add_relative(&mut self, level: u32, tile: Tile, pixels: &[Halves]) {
        let means: Vec<_> =
            pixels.iter().map(|[a, b]| std::array::from_fn(|c| 0.5 * (a[c] + b[c]))).collect();
        let cells = Cells { tile };
        let sums_around = cells.sums(&means);
        let sums = self.level_mut(level);
        for ((pixel, [a, b]), mean) in tile.pixels().zip(pixels).zip(&means) {
            let around = &sums_around[cells.index(pixel)];
            let relative = |c: usize| {
                let squared = (a[c] - b[c]) * (a[c] - b[c]) / 4.0;
                let believed = mean[c].min(around.mean_without(mean, c).max(shared(a[c], b[c])));
                squared / (believed * believed + RELATIVE_FLOOR)
            };
            let relative = (relative(0) + relative(1) + relative(2)) / 3.0;
            if sums.relative_spread.add(relative * relative) && sums.relative.add(relative) {
                sums.relative_pairs += 1;
            }
        }
    }

    fn level_mut(&mut self, level: u32) -> &mut LevelDifferences {
        let index = level as usize - 1;
        if self.levels.len() <= index {
            self.levels.resize(index + 1, LevelDifferences::default());
        }
        &mut self.levels[index]
    }
}

/// What two halves both have of their mean: from the whole mean where they agree down to [`BELIEVED_MIN`] of it where one has nothing.
/// Half-way between the smaller one and the harmonic mean, which is close to the mean for longer.
fn shared(a: f64, b: f64) -> f64 {
    let mean = 0.5 * (a + b);
    if mean <= 0.0 {
        return 0.0;
    }
    (0.5 * (a.min(b) + a * b / mean)).max(BELIEVED_MIN * mean)
}

/// Sum of the values of a cell.
#[derive(Clone, Copy, Default)]
struct CellSum {
    sum: [f64; 3],
    pixels: f64,
}

impl CellSum {
    /// The mean over the cell's other pixels, of one channel; 0 where there are none.
    fn mean_without(&self, value: &[f64; 3], channel: usize) -> f64 {
        if self.pixels > 1.0 { (self.sum[channel] - value[channel]) / (self.pixels - 1.0) } else { 0.0 }
    }
}

/// Squares of pixels, aligned to the picture and cut at the edges of a tile.
#[derive(Clone, Copy)]
struct Cells {
    tile: Tile,
}

impl Cells {
    fn columns(self) -> u32 {
        self.tile.x1().div_ceil(CELL_SIDE) - self.tile.x0() / CELL_SIDE
    }

    /// Where a pixel's cell is among them.
    fn index(self, (x, y): (u32, u32)) -> usize {
        let row = y / CELL_SIDE - self.tile.y0() / CELL_SIDE;
        (row * self.columns() + x / CELL_SIDE - self.tile.x0() / CELL_SIDE) as usize
    }

    /// Sums over each cell of one value per pixel of the tile.
    fn sums(self, values: &[[f64; 3]]) -> Vec<CellSum> {
        let rows = self.tile.y1().div_ceil(CELL_SIDE) - self.tile.y0() / CELL_SIDE;
        let mut sums = vec![CellSum::default(); (rows * self.columns()) as usize];
        for (pixel, value) in self.tile.pixels().zip(values) {
            let cell = &mut sums[self.index(pixel)];
            (0..3).for_each(|c| cell.sum[c] += value[c]);
            cell.pixels += 1.0;
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_neighbourhood_is_a_cell_of_the_picture_cut_at_the_edges_of_the_tile() {
        let tile = Tile::new(6, 15, 13, 18).unwrap();
        let values: Vec<_> = tile.pixels().map(|(x, y)| [f64::from(x), f64::from(y), 1.0]).collect();
        let cells = Cells { tile };
        let sums = cells.sums(&values);
        let found: Vec<_> = sums.iter().map(|cell| (cell.sum, cell.pixels)).collect();
        let expected = [
            ([13.0, 30.0, 2.0], 2.0),
            ([38.0, 60.0, 4.0], 4.0),
            ([12.0, 15.0, 1.0], 1.0),
            ([26.0, 66.0, 4.0], 4.0),
            ([76.0, 132.0, 8.0], 8.0),
            ([24.0, 33.0, 2.0], 2.0),
        ];
        assert_eq!(found, expected);
        assert_eq!([(6, 15), (8, 15), (12, 16)].map(|pixel| cells.index(pixel)), [0, 1, 5]);
        let around = |cell: usize, value: [f64; 3]| [0, 1].map(|c| sums[cell].mean_without(&value, c));
        assert_eq!(around(1, [8.0, 15.0, 1.0]), [10.0, 15.0]);
        assert_eq!(around(2, [12.0, 15.0, 1.0]), [0.0, 0.0], "a pixel alone has no neighbours");
    }

    #[test]
    fn the_sums_do_not_depend_on_the_tiles() {
        let value = |x: u32, y: u32| f64::from((x * 7919 + y * 104_729) % 1000).exp2().powf(0.05);
        let of = |tile: Tile| {
            let pixels: Vec<_> = tile.pixels().map(|(x, y)| [[value(x, y); 3], [value(y, x); 3]]).collect();
            let mut differences = Differences::default();
            pixels.iter().for_each(|pair| differences.add(6, *pair));
            differences.add_relative(6, tile, &pixels);
            differences
        };
        let resolution = crate::Resolution::new(50, 30).unwrap();
        for side in [4, 8, 20, 32] {
            let mut sum = Differences::default();
            resolution.tiles(side).for_each(|tile| sum.add_all(&of(tile)));
            assert_eq!(sum, of(resolution.full()), "tiles of {side} pixels");
        }
    }

    /// The relative value that one pixel pair adds among others that are all `[around; around]`.
    fn relative(pair: [f64; 2], around: f64) -> f64 {
        let tile = Tile::new(0, 0, 4, 4).unwrap();
        let mut pixels = vec![[[around; 3]; 2]; 16];
        pixels[5] = pair.map(|value| [value; 3]);
        let mut differences = Differences::default();
        differences.add_relative(5, tile, &pixels);
        differences.levels()[4].relative.value()
    }

    #[test]
    fn a_firefly_does_not_excuse_itself() {
        // The true value is 1, and one half a hundred times too bright.
        let truth = 49.5 * 49.5 / 1.01;
        let (found, excused) = (relative([1.0, 100.0], 1.0), 49.5 * 49.5 / (50.5 * 50.5 + 0.01));
        assert!(found > 50.0 * excused && found < truth, "{found} of {truth}");
        // Where most around are as bright, the firefly is not seen as less than it is.
        let (found, truth) = (relative([1.0, 5.0], 1.0), 2.0 * 2.0 / 1.01);
        assert!(found > 0.3 * truth && found < truth, "{found} of {truth}");
    }

    #[test]
    fn a_pixel_that_agrees_with_itself_is_taken_at_its_word() {
        let found = relative([2.0, 2.2], 0.0);
        assert!((found / (0.01 / (2.1 * 2.1 + 0.01)) - 1.0).abs() < 0.06, "{found}");
        // Lamps of less than a pixel, on black: halves of a few hits each are off by a factor, not by all.
        let found = relative([1.0, 3.0], 0.0);
        assert!(found < 0.7, "{found}");
    }

    #[test]
    fn what_one_half_alone_has_is_bounded() {
        // A firefly or a lamp? Nobody knows.
        let found = relative([0.0, 1e6], 0.0);
        assert!((found / 64.0 - 1.0).abs() < 1e-6, "{found}");
        // What is dim is no error at all.
        assert!((relative([0.0, 0.02], 0.0) / 1e-2 - 1.0).abs() < 0.01);
        assert_eq!(relative([0.0, 0.0], 0.0), 0.0);
    }
}
