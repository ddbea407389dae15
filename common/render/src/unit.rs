//! One work unit: every sample of every pixel of a tile, added up along the merge tree.

use crate::PreparedScene;
use crate::integrator::{self, Sampling};
use farm_film::{Counters, Differences, FilmTile, LEAF_SAMPLES, LeafSum, Rgb, SampleBlock, Tile};

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
    let report = scene.report();
    let mut counters = Counters {
        triangles_not_finite: report.dropped_not_finite,
        triangles_without_area: report.dropped_no_area,
        instances_flattened: report.flattened_instances,
        ..Counters::default()
    };
    // Nodes that wait for their sibling, largest first.
    let mut open: Vec<FilmTile> = Vec::new();
    let mut start = block.start();
    while start < block.end() {
        let end = block.end().min(start + LEAF_SAMPLES);
        let leaf = SampleBlock::new(start..end).expect("a block is made of leaves");
        let mut node = render_leaf(scene, tile, leaf, stop, &mut counters)?;
        while let Some(left) = open.pop_if(|left| left.block().sibling() == Some(node.block())) {
            node = left.merge(node);
        }
        open.push(node);
        start = end;
    }
    let whole = open.pop().filter(|whole| whole.block() == block).expect("a block is one node of the tree");
    #[cfg(feature = "mutations")]
    let whole = crate::mutations::block_sums(whole);
    Some(Rendered { tile: whole, counters })
}

/// The radiance of a single sample, for whoever looks for the cause of a bad pixel.
pub fn render_sample(scene: &PreparedScene, x: u32, y: u32, index: u64) -> Rgb {
    integrator::radiance(scene, Sampling::at(scene, x, y, index), &mut Counters::default()).to_array()
}

fn render_leaf(
    scene: &PreparedScene,
    tile: Tile,
    block: SampleBlock,
    stop: &dyn Fn() -> bool,
    counters: &mut Counters,
) -> Option<FilmTile> {
    let mut leaves = Vec::with_capacity(tile.area());
    let mut differences = Differences::default();
    for (x, y) in tile.pixels() {
        #[cfg(feature = "mutations")]
        let (x, y) = crate::mutations::pixel_of_tile((x, y), tile, scene.resolution().width());
        if stop() {
            return None;
        }
        let mut leaf = LeafSum::default();
        for index in block.start()..block.end() {
            let radiance = integrator::radiance(scene, Sampling::at(scene, x, y, index), counters);
            counters.samples += 1;
            let radiance = accounted(radiance.to_array(), scene.settings.clamp, counters);
            leaf.add(radiance, &mut differences);
        }
        leaves.push(leaf);
    }
    Some(FilmTile::leaf(tile, block, &leaves, differences))
}

/// What is no radiance is counted and left out; what is brighter than `clamp` is darkened, and what that takes away is added up.
fn accounted(radiance: Rgb, clamp: Option<f32>, counters: &mut Counters) -> Rgb {
    if radiance.iter().any(|value| value.is_nan()) {
        counters.nan += 1;
        counters.dropped += 1;
        return [0.0; 3];
    }
    if radiance.iter().any(|value| value.is_infinite()) {
        counters.infinite += 1;
        counters.dropped += 1;
        return [0.0; 3];
    }
    let mut radiance = radiance;
    if radiance.iter().any(|&value| value < 0.0) {
        counters.negative += 1;
        radiance = radiance.map(|value| value.max(0.0));
    }
    match clamp {
        Some(limit) => clamped(radiance, limit, counters),
        None => radiance,
    }
}

fn clamped(radiance: Rgb, limit: f32, counters: &mut Counters) -> Rgb {
    let brightest = radiance.into_iter().fold(0.0, f32::max);
    if brightest <= limit {
        return radiance;
    }
    let sum = |radiance: Rgb| radiance.into_iter().map(f64::from).sum::<f64>();
    let darker = radiance.map(|value| ((f64::from(value) / f64::from(brightest)) * f64::from(limit)) as f32);
    counters.clamped += 1;
    counters.clamped_radiance += (sum(radiance) - sum(darker)) / 3.0;
    darker
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_radiance_is_counted() {
        let mut counters = Counters::default();
        let mut account = |radiance| accounted(radiance, None, &mut counters);
        assert_eq!(account([1.0, f32::NAN, 0.0]), [0.0; 3]);
        assert_eq!(account([1.0, f32::INFINITY, 0.0]), [0.0; 3]);
        assert_eq!(account([1.0, -2.0, 0.0]), [1.0, 0.0, 0.0]);
        assert_eq!(account([1.0, 2e30, 0.0]), [1.0, 2e30, 0.0]);
        let Counters { nan, infinite, negative, dropped, clamped, .. } = counters;
        assert_eq!((nan, infinite, negative, dropped, clamped), (1, 1, 1, 2, 0));
    }

    #[test]
    fn a_limit_keeps_the_colour_and_says_what_it_took() {
        let mut counters = Counters::default();
        let mut account = |radiance| accounted(radiance, Some(2.0), &mut counters);
        assert_eq!(account([2.0, 1.0, 0.0]), [2.0, 1.0, 0.0]);
        assert_eq!(account([8.0, 4.0, 0.0]), [2.0, 1.0, 0.0]);
        assert_eq!(account([f32::MAX, 0.0, f32::MAX]), [2.0, 0.0, 2.0]);
        let taken = (12.0 - 3.0 + 2.0 * f64::from(f32::MAX) - 4.0) / 3.0;
        assert_eq!((counters.clamped, counters.clamped_radiance), (2, taken));
    }
}
