//! One work unit: every sample of every pixel of a tile, added up along the merge tree.

use crate::PreparedScene;
use crate::integrator::{self, Sampling};
use farm_film::{Counters, FilmTile, LEAF_SAMPLES, LeafSum, Rgb, SampleBlock, Tile, add_rgb};

/// What a unit leaves behind.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// Sums per pixel.
    pub tile: FilmTile,
    /// What was traced, and what went wrong.
    pub counters: Counters,
}

/// Renders the samples `block` of every pixel of `tile`. The same bits for the same arguments on any thread and machine.
///
/// `stop` is asked after every leaf of [`LEAF_SAMPLES`] samples of a pixel; once it answers yes, nothing is returned.
pub fn render(
    scene: &PreparedScene,
    tile: Tile,
    block: SampleBlock,
    stop: &dyn Fn() -> bool,
) -> Option<Rendered> {
    assert!(scene.resolution().contains(tile), "a tile lies inside its frame");
    let mut counters = Counters::default();
    let mut sums = Vec::with_capacity(tile.area());
    for (x, y) in tile.pixels() {
        #[cfg(feature = "mutations")]
        let (x, y) = crate::mutations::pixel_of_tile((x, y), tile, scene.resolution().width());
        let mut tree = PixelTree::default();
        let mut start = block.start();
        while start < block.end() {
            if stop() {
                return None;
            }
            let end = block.end().min(start + LEAF_SAMPLES);
            tree.push(render_leaf(scene, x, y, start..end, &mut counters));
            start = end;
        }
        let total = tree.total();
        #[cfg(feature = "mutations")]
        let total = crate::mutations::block_sum(total, block);
        sums.push(total);
    }
    Some(Rendered { tile: FilmTile::new(tile, block, sums), counters })
}

/// The radiance of a single sample, for whoever looks for the cause of a bad pixel.
pub fn render_sample(scene: &PreparedScene, x: u32, y: u32, index: u64) -> Rgb {
    integrator::radiance(scene, Sampling::at(scene, x, y, index), &mut Counters::default()).to_array()
}

fn render_leaf(
    scene: &PreparedScene,
    x: u32,
    y: u32,
    samples: std::ops::Range<u64>,
    counters: &mut Counters,
) -> Rgb {
    let mut leaf = LeafSum::default();
    for index in samples {
        let radiance = integrator::radiance(scene, Sampling::at(scene, x, y, index), counters);
        counters.samples += 1;
        leaf.add(accounted(radiance.to_array(), counters));
    }
    leaf.round()
}

/// What is no radiance is counted and left out.
fn accounted(radiance: Rgb, counters: &mut Counters) -> Rgb {
    if radiance.iter().any(|value| value.is_nan()) {
        counters.nan += 1;
        return [0.0; 3];
    }
    if radiance.iter().any(|value| value.is_infinite()) {
        counters.infinite += 1;
        return [0.0; 3];
    }
    if radiance.iter().any(|&value| value < 0.0) {
        counters.negative += 1;
        return radiance.map(|value| value.max(0.0));
    }
    radiance
}

/// Leaves of one pixel on their way up: a binary counter, in which equal levels merge at once.
#[derive(Default)]
struct PixelTree {
    /// Level and sum of the open nodes, highest first.
    open: Vec<(u32, Rgb)>,
}

impl PixelTree {
    fn push(&mut self, leaf: Rgb) {
        let mut node = (0, leaf);
        while let Some(&(level, left)) = self.open.last()
            && level == node.0
        {
            self.open.pop();
            node = (level + 1, add_rgb(left, node.1));
        }
        self.open.push(node);
    }

    fn total(self) -> Rgb {
        assert_eq!(self.open.len(), 1, "a block is one node of the tree");
        self.open[0].1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leaves_add_up_along_the_tree() {
        let mut tree = PixelTree::default();
        // In index order the ones would be lost against 2^24; in pairs they are not.
        for value in [16_777_216.0f32, 1.0, 1.0, 1.0] {
            tree.push([value; 3]);
        }
        assert_eq!(tree.total(), [(16_777_216.0f32 + 1.0) + (1.0 + 1.0); 3]);
    }

    #[test]
    fn what_is_no_radiance_is_counted() {
        let mut counters = Counters::default();
        assert_eq!(accounted([1.0, f32::NAN, 0.0], &mut counters), [0.0; 3]);
        assert_eq!(accounted([1.0, f32::INFINITY, 0.0], &mut counters), [0.0; 3]);
        assert_eq!(accounted([1.0, -2.0, 0.0], &mut counters), [1.0, 0.0, 0.0]);
        assert_eq!(accounted([1.0, 2.0, 0.0], &mut counters), [1.0, 2.0, 0.0]);
        assert_eq!((counters.nan, counters.infinite, counters.negative), (1, 1, 1));
    }
}
