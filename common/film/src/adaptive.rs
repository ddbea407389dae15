//! Which tiles of a frame have samples enough, so that the frame reaches an error with the fewest samples.
//!
//! The frame's error is the mean over its tiles. The next doubling of a tile of `n` samples per pixel takes `n` more per pixel and
//! lowers its error from `e(n)` to `e(2n)`, so doublings are worth `(e(n) - e(2n)) / n`, whatever the size of the tile. In the cheapest
//! plan all doublings that are made are worth more than all that are not; it is found by making them in order of their worth
//! until the frame's error is low enough. A tile that gets none in the plan, and none in a plan for a smaller error either,
//! ends.
//!
//! A tile that ends does so for good, on the word of samples that are part of the picture: one whose samples happened to find
//! little ends rather than one that found much. So the first levels decide nothing, the plan is cautious, and a tile beside
//! one that is far from its end goes on: what its samples have missed may be what its neighbour has met. How much of a bias
//! is left is measured by `cargo run --release -p farm-tests --bin convergence -- --adaptive`.

use crate::{ErrorEstimate, Tile};
use std::cmp::Ordering;
use std::collections::{BTreeMap, BinaryHeap};

/// Samples per pixel before which no tile ends.
pub const ADAPTIVE_SPP_MIN: u64 = 64;

/// Largest bias of a tile's mean, as a part of the noise of its pixels, that was found on the benchmark set beyond what chance
/// explains; root mean square over the tiles of a scene.
pub const BIAS_OVER_NOISE: f64 = 0.02;

/// A tile ends only if it would also end on the way to this part of the error that is wanted.
const CAUTION: f64 = 0.5;

/// Doublings ahead of a tile beside which none ends: sixteen times the samples.
const FAR_ABOVE: u32 = 4;

/// How it stands with a tile.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TileOutlook {
    /// Which one.
    pub tile: Tile,
    /// Whether it may get more samples.
    pub is_open: bool,
    /// Of its samples.
    pub error: ErrorEstimate,
}

/// The open tiles that have enough when the mean relative error over all pixels is to be at most `target` and no pixel gets
/// more than `spp_max` samples. `tiles` are those of a regular grid, in any order.
pub(crate) fn tiles_that_end(tiles: &[TileOutlook], target: f64, spp_max: u64) -> Vec<Tile> {
    let plan = doublings(tiles, target * CAUTION, spp_max);
    let side = tiles.iter().map(|at| at.tile.width().max(at.tile.height())).max().unwrap_or(1);
    let cell = |tile: Tile| (i64::from(tile.x0() / side), i64::from(tile.y0() / side));
    let ahead: BTreeMap<_, _> = tiles.iter().zip(&plan).map(|(at, ahead)| (cell(at.tile), *ahead)).collect();
    let is_beside_far = |tile: Tile| {
        let (column, row) = cell(tile);
        let around = (-1..=1).flat_map(|y| (-1..=1).map(move |x| (column + x, row + y)));
        around.into_iter().any(|cell| ahead.get(&cell).is_some_and(|ahead| *ahead >= FAR_ABOVE))
    };
    let ends = |(at, ahead): &(&TileOutlook, &u32)| at.is_open && **ahead == 0 && !is_beside_far(at.tile);
    tiles.iter().zip(&plan).filter(ends).map(|(at, _)| at.tile).collect()
}

/// How often each tile's samples are doubled in the cheapest plan.
fn doublings(tiles: &[TileOutlook], target: f64, spp_max: u64) -> Vec<u32> {
    let area = |index: usize| tiles[index].tile.area() as f64;
    let pixels: f64 = (0..tiles.len()).map(area).sum();
    let mut left: f64 = (0..tiles.len()).map(|index| area(index) * tiles[index].error.rel_mse).sum();
    let mut plan = vec![0; tiles.len()];
    let next = |index: usize, made: u32| Doubling::new(&tiles[index], index, made, spp_max);
    let mut offers: BinaryHeap<Doubling> =
        (0..tiles.len()).filter(|index| tiles[*index].is_open).filter_map(|index| next(index, 0)).collect();
    while left > target * pixels
        && let Some(best) = offers.pop()
    {
        left -= area(best.index) * best.gain;
        plan[best.index] += 1;
        offers.extend(next(best.index, plan[best.index]));
    }
    plan
}

/// A doubling that could be made.
#[derive(Debug)]
struct Doubling {
    /// Which tile's.
    index: usize,
    /// What it takes off the tile's error.
    gain: f64,
    /// The same per sample.
    worth: f64,
}

impl Doubling {
    /// The doubling after `made` others; none beyond `spp_max` samples.
    fn new(at: &TileOutlook, index: usize, made: u32, spp_max: u64) -> Option<Self> {
        let spp =
            at.error.spp.checked_shl(made).filter(|spp| *spp < spp_max && spp >> made == at.error.spp)?;
        let gain = at.error.rel_mse_after(made) - at.error.rel_mse_after(made + 1);
        Some(Self { index, gain, worth: gain / spp as f64 })
    }
}

impl Ord for Doubling {
    /// The first of several of the same worth comes first.
    fn cmp(&self, other: &Self) -> Ordering {
        self.worth.total_cmp(&other.worth).then(other.index.cmp(&self.index))
    }
}

impl PartialOrd for Doubling {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Doubling {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Doubling {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Resolution;
    use proptest::prelude::*;

    const SPP_MAX: u64 = 1 << 20;

    fn error(spp: u64, rel_mse: f64) -> ErrorEstimate {
        ErrorEstimate {
            spp,
            rmse: rel_mse.sqrt(),
            rel_mse,
            rmse_band: 1.1,
            rel_mse_band: 1.2,
            rate: 1.0,
            rel_rate: 1.0,
            rel_parts: [rel_mse, 0.0, 0.0],
        }
    }

    /// A row of tiles of 64 samples with these errors.
    fn row(errors: &[f64]) -> Vec<TileOutlook> {
        let tiles = Resolution::new(8 * errors.len() as u32, 8).unwrap().tiles(8);
        let outlook =
            |(tile, rel_mse): (Tile, &f64)| TileOutlook { tile, is_open: true, error: error(64, *rel_mse) };
        tiles.zip(errors).map(outlook).collect()
    }

    fn ended(tiles: &[TileOutlook], target: f64) -> Vec<usize> {
        let ended = tiles_that_end(tiles, target, SPP_MAX);
        ended.iter().map(|tile| tiles.iter().position(|at| at.tile == *tile).unwrap()).collect()
    }

    #[test]
    fn tiles_with_little_error_end_and_the_others_go_on() {
        assert_eq!(ended(&row(&[0.1, 1e-5, 0.1, 1e-5]), 0.02), [1, 3]);
        assert_eq!(ended(&row(&[0.1, 0.1, 0.1]), 0.02), Vec::<usize>::new(), "all are alike");
        assert_eq!(ended(&row(&[0.1, 0.0]), 0.02), [1], "there is nothing to gain");
    }

    #[test]
    fn a_tile_beside_one_that_is_far_from_its_end_goes_on() {
        let tiles = row(&[0.1, 1e-5, 1e-5, 1e-5]);
        assert!(doublings(&tiles, 0.5e-3, SPP_MAX)[0] >= FAR_ABOVE);
        assert_eq!(ended(&tiles, 1e-3), [2, 3]);
    }

    #[test]
    fn what_has_ended_stays_and_is_part_of_the_error() {
        let mut tiles = row(&[0.01, 0.01, 0.01]);
        tiles[2].is_open = false;
        assert!(!ended(&tiles, 1e-3).contains(&2));
        // The one that ended has more error than is allowed to all: the others cannot make up for it, and try.
        assert_eq!(doublings(&tiles, 1e-3, 256), [2, 2, 0]);
    }

    proptest! {
        #[test]
        fn the_plan_reaches_the_target_and_no_doubling_left_out_is_worth_more(
            errors in prop::collection::vec(0.0f64..1.0, 1..20), target in 1e-3f64..0.5,
        ) {
            let tiles = row(&errors);
            let plan = doublings(&tiles, target, SPP_MAX);
            let mean: f64 = tiles.iter().zip(&plan).map(|(at, made)| at.error.rel_mse_after(*made)).sum::<f64>()
                / tiles.len() as f64;
            prop_assert!(mean <= target * (1.0 + 1e-9));
            let worth = |index: usize, made: u32| Doubling::new(&tiles[index], index, made, SPP_MAX).unwrap().worth;
            let made = (0..tiles.len()).filter(|i| plan[*i] > 0).map(|i| worth(i, plan[i] - 1));
            let least = made.fold(f64::INFINITY, f64::min);
            for (index, made) in plan.iter().enumerate() {
                prop_assert!(worth(index, *made) <= least);
            }
        }

        #[test]
        fn someone_goes_on_while_the_error_is_above_the_target(
            errors in prop::collection::vec(1e-6f64..1.0, 1..20), share in 0.01f64..0.99,
        ) {
            let tiles = row(&errors);
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            prop_assert!(ended(&tiles, mean * share).len() < tiles.len());
        }

        #[test]
        fn the_order_of_tiles_decides_nothing(errors in prop::collection::vec(1e-6f64..1.0, 1..20), at in 0usize..20) {
            let mut tiles = row(&errors);
            let mut before = tiles_that_end(&tiles, 0.05, SPP_MAX);
            let middle = at % errors.len();
            tiles.rotate_left(middle);
            let mut after = tiles_that_end(&tiles, 0.05, SPP_MAX);
            before.sort();
            after.sort();
            prop_assert_eq!(before, after);
        }
    }
}
