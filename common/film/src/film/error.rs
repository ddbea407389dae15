//! Errors of a film: of the whole and of each tile, now and at every power of two that was passed.

use super::{Film, TileTree};
use crate::error_estimate::{Decays, ErrorEstimate};
use crate::{Differences, SampleBlock, Tile};
use std::collections::{BTreeMap, BTreeSet};

impl Film {
    /// Estimated error of the picture as [`Film::resolve`] gives it now, whatever samples each tile has. None while a tile has no
    /// sample, or none that could be compared with another.
    ///
    /// Tiles with the same samples are taken together. The value depends on the samples that are there, not on the order or
    /// division in which they came, as long as all partials carry their [`Differences`].
    pub fn error_estimate(&self) -> Option<ErrorEstimate> {
        let mut groups: BTreeMap<Vec<SampleBlock>, (Differences, usize)> = BTreeMap::new();
        for (tile, tree) in &self.tiles {
            let (blocks, differences) = tree.present();
            let group = groups.entry(blocks).or_default();
            group.0.add_all(&differences);
            group.1 += tile.area();
        }
        let estimates = groups.iter().map(|(blocks, (differences, pixels))| {
            Some((*pixels as f64, Decays::new(differences)?.estimate(blocks)))
        });
        ErrorEstimate::of_parts(&estimates.collect::<Option<Vec<_>>>()?)
    }

    /// Estimated error of the picture of the first 16, 32, 64 .. samples per pixel, for all of these numbers that every tile has
    /// passed, newest last. A film of fewer than 16 samples has one, if their number is a power of two.
    pub fn error_levels(&self) -> Vec<ErrorEstimate> {
        let passed: BTreeSet<u32> =
            self.tiles.values().flat_map(|tree| tree.passed.keys().copied()).collect();
        let level = |level: u32| {
            let mut sum = Differences::default();
            for tree in self.tiles.values() {
                sum.add_all(tree.passed.get(&level)?);
            }
            estimate_of_first(level, &sum)
        };
        passed.into_iter().filter_map(level).collect()
    }

    /// [`Film::error_estimate`] of every tile that has one.
    pub fn tile_errors(&self) -> impl Iterator<Item = (Tile, ErrorEstimate)> + '_ {
        self.tiles.iter().filter_map(|(&tile, tree)| {
            let (blocks, differences) = tree.present();
            Some((tile, Decays::new(&differences)?.estimate(&blocks)))
        })
    }

    /// [`Film::error_levels`] of one tile; empty for a tile that is none of this frame's.
    pub fn tile_error_levels(&self, tile: Tile) -> Vec<ErrorEstimate> {
        let passed = self.tiles.get(&tile).into_iter().flat_map(|tree| &tree.passed);
        passed.filter_map(|(&level, differences)| estimate_of_first(level, differences)).collect()
    }
}

impl TileTree {
    /// Blocks and differences of what is there, in index order.
    fn present(&self) -> (Vec<SampleBlock>, Differences) {
        let mut differences = Differences::default();
        for partial in self.partials.values() {
            differences.add_all(partial.differences());
        }
        (self.partials.values().map(|partial| partial.block()).collect(), differences)
    }
}

pub(super) fn estimate_of_first(level: u32, differences: &Differences) -> Option<ErrorEstimate> {
    let first = SampleBlock::new(0..1 << level).expect("a power of two from sample 0 is a node");
    Decays::new(differences).map(|decays| decays.estimate(&[first]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FilmTile, LEAF_SAMPLES, LeafSum, Resolution};

    /// Stands for a renderer whose error is known: the samples of a pixel are drawn from the whole down to its halves, so that
    /// the mean of an aligned block of `n` samples has the variance `law(n)` around a true value of 1.
    struct Law<'a> {
        law: &'a dyn Fn(f64) -> f64,
        state: u64,
    }

    impl Law<'_> {
        /// Normal, of mean 0 and variance 1: a sum of twelve uniform numbers.
        fn normal(&mut self) -> f64 {
            let uniform = |_| {
                self.state =
                    (self.state ^ self.state >> 31).wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(1);
                (self.state >> 11) as f64 / (1_u64 << 53) as f64
            };
            (0..12).map(uniform).sum::<f64>() - 6.0
        }

        fn samples(&mut self, level: u32) -> Vec<f64> {
            let mut means = vec![1.0 + (self.law)((1_u64 << level) as f64).sqrt() * self.normal()];
            for level in (0..level).rev() {
                let count = (1_u64 << level) as f64;
                let difference = (self.law)(count) - (self.law)(2.0 * count);
                let halves = |mean: &f64| {
                    let half = difference.max(0.0).sqrt() * self.normal();
                    [mean - half, mean + half]
                };
                means = means.iter().flat_map(halves).collect();
            }
            means
        }
    }

    /// A film of 64x64 pixels in tiles of 32, of 2^level samples, and its true root mean squared error.
    fn film(law: &dyn Fn(f64) -> f64, level: u32) -> (Film, f64) {
        let resolution = Resolution::new(64, 64).unwrap();
        let mut law = Law { law, state: 1 };
        let mut film = Film::new(resolution, 32, 1 << level).unwrap();
        for tile in resolution.tiles(32) {
            let pixels: Vec<_> = tile.pixels().map(|_| law.samples(level)).collect();
            for start in (0..1_u64 << level).step_by(LEAF_SAMPLES as usize) {
                let end = (1 << level).min(start + LEAF_SAMPLES);
                film.add(leaf(tile, start..end, &pixels)).unwrap();
            }
        }
        let squares =
            film.pixels().iter().flatten().map(|value| (f64::from(*value) - 1.0).powi(2)).sum::<f64>();
        (film, (squares / (64.0 * 64.0 * 3.0)).sqrt())
    }

    fn leaf(tile: Tile, samples: std::ops::Range<u64>, pixels: &[Vec<f64>]) -> FilmTile {
        let mut differences = Differences::default();
        let mut sum = |pixel: &Vec<f64>| {
            let mut leaf = LeafSum::default();
            for value in &pixel[samples.start as usize..samples.end as usize] {
                leaf.add([*value as f32; 3], &mut differences);
            }
            leaf
        };
        let leaves: Vec<_> = pixels.iter().map(&mut sum).collect();
        FilmTile::leaf(tile, SampleBlock::new(samples).unwrap(), &leaves, differences)
    }

    #[test]
    fn the_estimate_is_right_at_every_rate() {
        for rate in [1, 2, 3] {
            for level in [4, 6, 9] {
                let (film, truth) = film(&|n: f64| 0.2 * n.powi(-rate), level);
                let estimate = film.error_estimate().unwrap();
                let ratio = estimate.rmse / truth;
                assert!((0.9..1.2).contains(&ratio), "rate {rate}, level {level}: ratio {ratio}");
                assert!(
                    ratio < estimate.rmse_band && 1.0 / ratio < estimate.rmse_band,
                    "{estimate:?}: {truth}"
                );
                assert_eq!(film.error_levels().last(), Some(&estimate));
            }
        }
    }

    #[test]
    fn the_estimate_is_right_where_the_rate_changes() {
        let laws: [&dyn Fn(f64) -> f64; 3] =
            [&|n: f64| 0.1 / n + 0.5 / n.powi(2), &|n: f64| 0.02 / n + 1.0 / n.powi(3), &|n: f64| {
                0.1 / n + 0.3 / n.powf(1.5)
            }];
        for (index, law) in laws.into_iter().enumerate() {
            for level in [5, 6, 8] {
                let (film, truth) = film(law, level);
                let ratio = film.error_estimate().unwrap().rmse / truth;
                assert!((0.9..1.15).contains(&ratio), "law {index}, level {level}: ratio {ratio}");
            }
        }
    }

    /// A pure power between the whole ones is taken for one that will slow down, and a law that has yet to become faster for one that
    /// stays as it is.
    #[test]
    fn where_the_law_is_another_the_estimate_errs_on_the_safe_side() {
        let laws: [&dyn Fn(f64) -> f64; 3] =
            [&|n: f64| 0.2 * n.powf(-1.25), &|n: f64| 0.2 * n.powf(-1.5), &|n: f64| {
                1.0 / (n + n.powi(2) / 32.0)
            }];
        for (law, most) in laws.into_iter().zip([1.35, 1.45, 1.95]) {
            for level in [4, 6, 9] {
                let (film, truth) = film(law, level);
                let ratio = film.error_estimate().unwrap().rmse / truth;
                assert!((0.95..most).contains(&ratio), "level {level}: ratio {ratio}");
            }
        }
    }

    #[test]
    fn every_power_of_two_from_the_leaf_on_has_an_estimate() {
        let law = |n: f64| 0.02 / n + 0.2 / n.powi(2);
        let (film, _) = film(&law, 8);
        let levels = film.error_levels();
        assert_eq!(levels.iter().map(|level| level.spp).collect::<Vec<_>>(), [16, 32, 64, 128, 256]);
        for level in &levels {
            let ratio = level.rmse / law(level.spp as f64).sqrt();
            assert!((0.9..1.1).contains(&ratio), "{level:?}");
        }
        let tiles: Vec<_> = film.tile_errors().collect();
        assert_eq!(tiles.len(), 4);
        for (tile, estimate) in tiles {
            assert!((0.85..1.15).contains(&(estimate.rmse / levels[4].rmse)), "{tile}: {estimate:?}");
            assert_eq!(film.tile_error_levels(tile).last(), Some(&estimate));
        }
    }

    #[test]
    fn a_prediction_comes_true() {
        let law = |n: f64| 0.02 / n + 0.2 / n.powi(2);
        let (film, _) = film(&law, 8);
        let levels = film.error_levels();
        let prediction = levels[2].predict(levels[4].rel_mse).unwrap();
        assert!((prediction.spp / 256.0 - 1.0).abs() < 0.12, "{prediction:?}");
        assert!(prediction.band < 1.8, "{prediction:?}");
        assert_eq!(levels[2].predict(0.0), None);
        // And that of the error with its margin, which is smaller once more levels are known.
        let prediction = levels[2].predict_cautious(levels[4].cautious()).unwrap();
        assert!((prediction.spp / 256.0 - 1.0).abs() < 0.12, "{prediction:?}");
        let margin = |level: usize| levels[level].cautious() / levels[level].rel_mse;
        assert!(margin(4) < 0.97 * margin(2));
    }

    #[test]
    fn a_total_that_is_no_power_of_two_is_estimated_as_it_is_folded() {
        for (rate, spp) in [(1.0, 48), (2.0, 48), (1.0, 100), (2.0, 100), (1.0, 7), (2.0, 7)] {
            let resolution = Resolution::new(128, 64).unwrap();
            let mut film = Film::new(resolution, 128, spp).unwrap();
            let mut law = Law { law: &|n: f64| 0.2 * n.powf(-rate), state: 5 };
            let pixels: Vec<_> = resolution.full().pixels().map(|_| law.samples(7)).collect();
            for start in (0..spp).step_by(16) {
                film.add(leaf(resolution.full(), start..spp.min(start + 16), &pixels)).unwrap();
            }
            assert!(film.is_complete());
            let squares: f64 = film.pixels().iter().map(|value| (f64::from(value[0]) - 1.0).powi(2)).sum();
            let truth = (squares / resolution.area() as f64).sqrt();
            let estimate = film.error_estimate().unwrap();
            assert_eq!(estimate.spp, spp);
            let ratio = estimate.rmse / truth;
            assert!((0.87..1.2).contains(&ratio), "rate {rate}, {spp} spp: ratio {ratio}");
        }
    }

    #[test]
    fn tiles_of_different_numbers_of_samples_are_each_taken_as_they_are() {
        let law = |n: f64| 0.2 / n;
        let resolution = Resolution::new(64, 64).unwrap();
        let mut film = Film::new(resolution, 32, 256).unwrap();
        let mut source = Law { law: &law, state: 9 };
        for (index, tile) in resolution.tiles(32).enumerate() {
            let pixels: Vec<_> = tile.pixels().map(|_| source.samples(8)).collect();
            for start in (0..64_u64 << (index % 3)).step_by(16) {
                film.add(leaf(tile, start..start + 16, &pixels)).unwrap();
            }
        }
        let estimate = film.error_estimate().unwrap();
        let expected = [64.0, 128.0, 256.0, 64.0].map(law).iter().sum::<f64>() / 4.0;
        assert!(
            (estimate.rmse / expected.sqrt() - 1.0).abs() < 0.1,
            "{estimate:?}, expected {}",
            expected.sqrt()
        );
        assert_eq!(estimate.spp, 64);
        assert_eq!(film.error_levels().last().unwrap().spp, 64);
    }

    #[test]
    fn fireflies_are_part_of_the_error_and_not_of_the_rate() {
        let resolution = Resolution::new(64, 64).unwrap();
        for level in [6, 8] {
            let mut ratios = Vec::new();
            for seed in 0..9 {
                let mut law = Law { law: &|n: f64| 0.01 * n.powf(-2.0), state: seed };
                let mut film = Film::new(resolution, 64, 1 << level).unwrap();
                let mut pixels: Vec<_> = resolution.full().pixels().map(|_| law.samples(level)).collect();
                // Every 40,000th sample is 2000 times too bright, and the true value is what their mean is.
                for _ in 0..(4096 << level) / 40_000 {
                    let at = (law.normal().abs() * 1e9) as usize;
                    pixels[at % 4096][at / 4096 % (1 << level)] += 2000.0;
                }
                for start in (0..1_u64 << level).step_by(16) {
                    film.add(leaf(resolution.full(), start..start + 16, &pixels)).unwrap();
                }
                let truth =
                    film.pixels().iter().map(|value| (f64::from(value[0]) - 1.05).powi(2)).sum::<f64>();
                let estimate = film.error_estimate().unwrap();
                assert!(estimate.rate < 1.4, "{estimate:?}");
                ratios.push(estimate.rmse / (truth / 4096.0).sqrt());
            }
            ratios.sort_by(f64::total_cmp);
            assert!(ratios[0] > 0.8 && ratios[8] < 1.25, "{ratios:?}");
        }
    }

    #[test]
    fn nothing_is_known_without_pairs_and_nothing_is_wrong_with_what_is_constant() {
        let resolution = Resolution::new(2, 1).unwrap();
        let mut film = Film::new(resolution, 2, 16).unwrap();
        assert_eq!(film.error_estimate(), None);
        let block = SampleBlock::new(0..16).unwrap();
        film.add(FilmTile::new(resolution.full(), block, vec![[16.0; 3]; 2])).unwrap();
        assert_eq!(film.error_estimate(), None, "a partial without differences, and no sibling");
        let mut film = Film::new(resolution, 2, 16).unwrap();
        film.add(leaf(resolution.full(), 0..16, &[vec![0.5; 16], vec![0.5; 16]])).unwrap();
        let estimate = film.error_estimate().unwrap();
        assert_eq!((estimate.rmse, estimate.rel_mse, estimate.rmse_band), (0.0, 0.0, 1.0));
        assert_eq!(estimate.predict(0.1), None);
    }
}
