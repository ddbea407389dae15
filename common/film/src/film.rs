//! A frame's tiles on their way to a picture: the dyadic merge tree.

mod ends;
mod error;

use crate::{Differences, FilmTile, Resolution, Rgb, SampleBlock, SampleRange, Tile, add_rgb};
use std::collections::BTreeMap;

/// A partial that this film cannot take.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FilmError {
    /// Not one of the frame's tiles.
    #[error("tile {0} is none of this frame's tiles")]
    ForeignTile(Tile),
    /// Samples outside the frame's range, or across the boundary of one of its blocks.
    #[error("samples {0} are not part of this frame's sample blocks")]
    ForeignBlock(SampleBlock),
    /// Some, but not all of these samples are already there.
    #[error("samples {block} of tile {tile} overlap samples that are already there")]
    Overlap {
        /// The tile.
        tile: Tile,
        /// The block that was offered.
        block: SampleBlock,
    },
}

/// What became of a partial.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Accepted {
    /// Its samples were new and are now part of the picture.
    New,
    /// All its samples were there already, or its tile gets along without them; nothing changed.
    Duplicate,
}

/// One tile of the finished picture: mean radiance per pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct ResolvedTile {
    /// Which pixels.
    pub tile: Tile,
    /// Mean radiance in scanline order.
    pub pixels: Vec<Rgb>,
}

/// The tiles of one frame. Takes partials in any order and division; siblings merge as soon as both are there, so a tile
/// holds at most one partial per level.
#[derive(Clone, Debug)]
pub struct Film {
    resolution: Resolution,
    samples: SampleRange,
    roots: Vec<SampleBlock>,
    tiles: BTreeMap<Tile, TileTree>,
    complete: usize,
}

#[derive(Clone, Debug, Default)]
struct TileTree {
    /// Disjoint blocks by first sample.
    partials: BTreeMap<u64, FilmTile>,
    /// Differences within the first 2^k samples, by k, for all k that were passed.
    passed: BTreeMap<u32, Differences>,
    /// All that the tile gets, where that is less than the frame's samples.
    end: Option<SampleBlock>,
}

impl Film {
    /// An empty frame of square tiles of `tile_side` pixels and samples `[0, spp)`.
    pub fn new(resolution: Resolution, tile_side: u32, spp: u64) -> Result<Self, crate::SampleBlockError> {
        Self::with_tiles(resolution, resolution.tiles(tile_side), SampleRange::new(0..spp)?)
    }

    /// An empty frame of the given disjoint tiles, for partials that were planned elsewhere.
    pub fn with_tiles(
        resolution: Resolution,
        tiles: impl IntoIterator<Item = Tile>,
        samples: SampleRange,
    ) -> Result<Self, crate::SampleBlockError> {
        let tiles = tiles.into_iter().map(|tile| (tile, TileTree::default())).collect();
        Ok(Self { resolution, samples, roots: samples.blocks()?, tiles, complete: 0 })
    }

    /// The frame's width and height.
    pub fn resolution(&self) -> Resolution {
        self.resolution
    }

    /// Samples per pixel of the finished frame.
    pub fn spp(&self) -> u64 {
        self.samples.end() - self.samples.start()
    }

    /// The blocks of a finished tile, largest first.
    pub fn roots(&self) -> &[SampleBlock] {
        &self.roots
    }

    /// Adds a partial. Bits of the finished frame do not depend on the order or division of what is added.
    pub fn add(&mut self, partial: FilmTile) -> Result<Accepted, FilmError> {
        let (tile, block) = (partial.tile(), partial.block());
        let root = self
            .roots
            .iter()
            .copied()
            .find(|root| root.contains(block))
            .ok_or(FilmError::ForeignBlock(block))?;
        let tree = self.tiles.get_mut(&tile).ok_or(FilmError::ForeignTile(tile))?;
        let is_there = tree.partials.values().any(|held| held.block().contains(block));
        if is_there || tree.has_ended_before(block) {
            return Ok(Accepted::Duplicate);
        }
        if tree.partials.values().any(|held| held.block().overlaps(block)) {
            return Err(FilmError::Overlap { tile, block });
        }
        tree.insert(partial, root);
        if tree.is_complete(&self.roots) {
            self.complete += 1;
        }
        Ok(Accepted::New)
    }

    /// Forgets every sample of a tile, to be rendered again; whether it is one of the frame's.
    pub fn forget(&mut self, tile: Tile) -> bool {
        let Some(tree) = self.tiles.get_mut(&tile) else { return false };
        if tree.is_complete(&self.roots) {
            self.complete -= 1;
        }
        *tree = TileTree::default();
        true
    }

    /// Whether all samples of `block` are there for `tile`.
    pub fn holds(&self, tile: Tile, block: SampleBlock) -> bool {
        self.tiles
            .get(&tile)
            .is_some_and(|tree| tree.partials.values().any(|held| held.block().contains(block)))
    }

    /// The partials held now, for whoever stores them.
    pub fn partials(&self) -> impl Iterator<Item = &FilmTile> {
        self.tiles.values().flat_map(|tree| tree.partials.values())
    }

    /// Whether every tile has all samples that it gets.
    pub fn is_complete(&self) -> bool {
        self.complete == self.tiles.len()
    }

    /// Mean radiance of every tile that has any sample; of the finished frame once it is complete.
    pub fn resolve(&self) -> impl Iterator<Item = ResolvedTile> + '_ {
        self.tiles.iter().filter_map(|(&tile, tree)| tree.resolve(tile))
    }

    /// Mean radiance of the frame in scanline order; pixels that have no sample yet are black.
    pub fn pixels(&self) -> Vec<Rgb> {
        let width = self.resolution.width() as usize;
        let mut pixels = vec![[0.0; 3]; self.resolution.area()];
        for resolved in self.resolve() {
            let rows = resolved.pixels.chunks_exact(resolved.tile.width() as usize);
            for (y, row) in (resolved.tile.y0() as usize..).zip(rows) {
                let start = y * width + resolved.tile.x0() as usize;
                pixels[start..start + row.len()].copy_from_slice(row);
            }
        }
        pixels
    }
}

impl TileTree {
    fn insert(&mut self, mut partial: FilmTile, root: SampleBlock) {
        self.pass(&partial);
        // Merge upwards while the sibling is there, but never past a block of the frame's range.
        while partial.block() != root
            && let Some(sibling) = partial.block().sibling()
            && self.partials.get(&sibling.start()).is_some_and(|held| held.block() == sibling)
            && let Some(other) = self.partials.remove(&sibling.start())
        {
            partial = partial.merge(other);
            self.pass(&partial);
        }
        self.partials.insert(partial.block().start(), partial);
    }

    /// Remembers the differences of a block of the first samples.
    fn pass(&mut self, partial: &FilmTile) {
        let block = partial.block();
        if block.start() == 0 && block.samples().is_power_of_two() {
            self.passed.insert(block.samples().ilog2(), partial.differences().clone());
        }
    }

    fn is_complete(&self, roots: &[SampleBlock]) -> bool {
        if self.end.is_some() {
            return true;
        }
        self.partials.len() == roots.len()
            && roots
                .iter()
                .all(|root| self.partials.get(&root.start()).is_some_and(|held| held.block() == *root))
    }

    /// Folds the blocks from the largest to the smallest and divides by their samples.
    fn resolve(&self, tile: Tile) -> Option<ResolvedTile> {
        let mut partials: Vec<&FilmTile> = self.partials.values().collect();
        partials.sort_by_key(|held| (std::cmp::Reverse(held.block().samples()), held.block().start()));
        let (first, rest) = partials.split_first()?;
        let mut sums = first.sums().to_vec();
        for partial in rest {
            for (sum, value) in sums.iter_mut().zip(partial.sums()) {
                *sum = add_rgb(*sum, *value);
            }
        }
        let samples: u64 = partials.iter().map(|held| held.block().samples()).sum();
        let pixels =
            sums.iter().map(|sum| sum.map(|value| (f64::from(value) / samples as f64) as f32)).collect();
        Some(ResolvedTile { tile, pixels })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Stands for a renderer: sums of made-up samples, by the definition of the merge tree.
    fn rendered(tile: Tile, block: SampleBlock) -> FilmTile {
        if let Some((left, right)) = block.children() {
            return rendered(tile, left).merge(rendered(tile, right));
        }
        let mut differences = Differences::default();
        let leaves: Vec<_> = tile
            .pixels()
            .map(|(x, y)| {
                let mut leaf = crate::LeafSum::default();
                for index in block.start()..block.end() {
                    let mut hash = u64::from(x) << 40 ^ u64::from(y) << 20 ^ index;
                    for _ in 0..2 {
                        hash = (hash ^ hash >> 31).wrapping_mul(0x9E37_79B9_7F4A_7C15);
                    }
                    let value = (hash >> 40) as f32 * 1.7e-5;
                    leaf.add([value, value * value, 1.0 / (value + 1e-3)], &mut differences);
                }
                leaf
            })
            .collect();
        FilmTile::leaf(tile, block, &leaves, differences)
    }

    fn bits(film: &Film) -> Vec<[u32; 3]> {
        film.pixels().iter().map(|pixel| pixel.map(f32::to_bits)).collect()
    }

    fn complete_film(resolution: Resolution, side: u32, spp: u64) -> Film {
        let mut film = Film::new(resolution, side, spp).unwrap();
        for block in film.roots().to_vec() {
            for tile in resolution.tiles(side) {
                assert_eq!(film.add(rendered(tile, block)), Ok(Accepted::New));
            }
        }
        assert!(film.is_complete());
        film
    }

    proptest! {
        #[test]
        fn any_division_order_and_duplicate_give_the_same_bits(
            spp in 1u64..200, side in 1u32..9, splits in prop::collection::vec(any::<bool>(), 64),
            keys in prop::collection::vec(any::<u64>(), 256),
        ) {
            let resolution = Resolution::new(5, 4).unwrap();
            let expected = bits(&complete_film(resolution, 7, spp));
            let mut film = Film::new(resolution, side, spp).unwrap();
            // Divide blocks where the coin says so, then deliver in a shuffled order, some of them twice.
            let mut units = Vec::new();
            let mut coin = splits.iter().cycle();
            for tile in resolution.tiles(side) {
                let mut open = film.roots().to_vec();
                while let Some(block) = open.pop() {
                    match block.children() {
                        Some((left, right)) if *coin.next().unwrap() => open.extend([left, right]),
                        _ => units.push((tile, block)),
                    }
                }
            }
            let mut keyed: Vec<_> = units.iter().zip(keys.iter().cycle()).map(|(unit, key)| (*key, *unit)).collect();
            keyed.sort();
            for (key, (tile, block)) in keyed {
                prop_assert_eq!(film.add(rendered(tile, block)), Ok(Accepted::New));
                if key % 3 == 0 {
                    prop_assert_eq!(film.add(rendered(tile, block)), Ok(Accepted::Duplicate));
                }
            }
            prop_assert!(film.is_complete());
            prop_assert_eq!(bits(&film), expected);
            let whole = complete_film(resolution, side, spp);
            prop_assert_eq!(film.error_estimate(), whole.error_estimate());
            prop_assert!(film.tile_errors().eq(whole.tile_errors()));
            // Squared errors do not know the tiles at all.
            let rmse = |film: &Film| film.error_estimate().map(|estimate| estimate.rmse.to_bits());
            prop_assert_eq!(rmse(&film), rmse(&complete_film(resolution, 7, spp)));
        }
    }

    #[test]
    fn what_does_not_belong_is_refused() {
        let resolution = Resolution::new(8, 8).unwrap();
        let mut film = Film::new(resolution, 8, 64).unwrap();
        let tile = resolution.full();
        let small = Tile::new(0, 0, 4, 4).unwrap();
        let block = |range| SampleBlock::new(range).unwrap();
        assert_eq!(film.add(rendered(small, block(0..16))), Err(FilmError::ForeignTile(small)));
        assert_eq!(film.add(rendered(tile, block(64..128))), Err(FilmError::ForeignBlock(block(64..128))));
        film.add(rendered(tile, block(16..32))).unwrap();
        let overlap = FilmError::Overlap { tile, block: block(0..32) };
        assert_eq!(film.add(rendered(tile, block(0..32))), Err(overlap));
    }

    #[test]
    fn a_forgotten_tile_is_there_again_with_the_same_bits() {
        let resolution = Resolution::new(8, 4).unwrap();
        let mut film = complete_film(resolution, 4, 48);
        let expected = bits(&film);
        let tile = Tile::new(4, 0, 8, 4).unwrap();
        assert!(film.forget(tile) && !film.is_complete());
        assert!(!film.forget(resolution.full()), "that is none of its tiles");
        for block in film.roots().to_vec() {
            assert_eq!(film.add(rendered(tile, block)), Ok(Accepted::New));
        }
        assert!(film.is_complete());
        assert_eq!(bits(&film), expected);
    }

    #[test]
    fn the_sum_of_many_ones_is_exact() {
        // 2^25 samples of 1.0 through the tree; a naive f32 sum would stall at 2^24.
        let tile = Tile::new(0, 0, 1, 1).unwrap();
        let leaf = |start| FilmTile::new(tile, SampleBlock::new(start..start + 16).unwrap(), vec![[16.0; 3]]);
        let mut film = Film::new(Resolution::new(1, 1).unwrap(), 1, 1 << 25).unwrap();
        for start in (0..1u64 << 25).step_by(16) {
            film.add(leaf(start)).unwrap();
        }
        assert_eq!(film.pixels(), [[1.0; 3]]);
    }
}
