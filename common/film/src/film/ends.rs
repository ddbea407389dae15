//! Tiles that end before the others.

use super::error::estimate_of_first;
use super::{Film, TileTree};
use crate::adaptive::{ADAPTIVE_SPP_MIN, TileOutlook, tiles_that_end};
use crate::{SampleBlock, Tile};

impl Film {
    /// Tiles that need no more samples for an estimated relative mean squared error of the frame of at most `target`, as the first
    /// `spp` samples per pixel tell, which all tiles have that have not ended. None before [`ADAPTIVE_SPP_MIN`] samples and between
    /// powers of two.
    pub fn tiles_that_end(&self, spp: u64, target: f64) -> Vec<Tile> {
        if spp < ADAPTIVE_SPP_MIN || !spp.is_power_of_two() {
            return Vec::new();
        }
        let outlook = |(&tile, tree): (&Tile, &TileTree)| {
            let level = tree.end.map_or(spp, |end| end.end()).ilog2();
            let error = estimate_of_first(level, tree.passed.get(&level)?)?;
            Some(TileOutlook { tile, is_open: tree.end.is_none(), error })
        };
        let tiles: Option<Vec<_>> = self.tiles.iter().map(outlook).collect();
        tiles.map_or(Vec::new(), |tiles| tiles_that_end(&tiles, target, self.spp()))
    }

    /// Makes the samples that a tile has all that it gets; what comes later is not needed. Whether these are a power of two, from
    /// the first one on.
    pub fn end_tile(&mut self, tile: Tile) -> bool {
        let Some(tree) = self.tiles.get_mut(&tile) else { return false };
        let mut held = tree.partials.values().map(|partial| partial.block());
        let (Some(block), None) = (held.next(), held.next()) else { return false };
        if block.start() != 0 || !block.samples().is_power_of_two() {
            return false;
        }
        if !tree.is_complete(&self.roots) {
            tree.end = Some(block);
            self.complete += 1;
        }
        true
    }

    /// Samples per pixel of every tile.
    pub fn tile_samples(&self) -> impl Iterator<Item = (Tile, u64)> + '_ {
        let samples = |tree: &TileTree| tree.partials.values().map(|partial| partial.block().samples()).sum();
        self.tiles.iter().map(move |(&tile, tree)| (tile, samples(tree)))
    }
}

impl TileTree {
    /// Whether a tile that has ended gets along without these samples.
    pub(super) fn has_ended_before(&self, block: SampleBlock) -> bool {
        self.end.is_some_and(|end| end.end() <= block.start())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Accepted, FilmTile, Resolution};

    /// All samples of a tile have the same value.
    fn partial(tile: Tile, range: std::ops::Range<u64>, value: f32) -> FilmTile {
        let block = SampleBlock::new(range).unwrap();
        FilmTile::new(tile, block, vec![[value * block.samples() as f32; 3]; tile.area()])
    }

    #[test]
    fn a_tile_that_has_ended_is_divided_by_its_own_samples() {
        let resolution = Resolution::new(4, 2).unwrap();
        let tiles: Vec<_> = resolution.tiles(2).collect();
        let mut film = Film::new(resolution, 2, 64).unwrap();
        assert!(!film.end_tile(tiles[0]), "it has no samples");
        film.add(partial(tiles[0], 0..16, 1.0)).unwrap();
        film.add(partial(tiles[0], 32..48, 1.0)).unwrap();
        assert!(!film.end_tile(tiles[0]), "these are not the first samples");
        film.add(partial(tiles[0], 16..32, 1.0)).unwrap();
        assert!(!film.end_tile(tiles[0]), "48 is no power of two");

        film.forget(tiles[0]);
        film.add(partial(tiles[0], 0..32, 1.0)).unwrap();
        assert!(film.end_tile(tiles[0]) && film.end_tile(tiles[0]), "once is as good as twice");
        assert_eq!(film.add(partial(tiles[0], 32..64, 9.0)), Ok(Accepted::Duplicate));
        film.add(partial(tiles[1], 0..64, 2.0)).unwrap();
        assert!(film.is_complete());
        assert_eq!(film.pixels(), [1.0, 1.0, 2.0, 2.0, 1.0, 1.0, 2.0, 2.0].map(|value| [value; 3]));
        assert_eq!(film.tile_samples().collect::<Vec<_>>(), [(tiles[0], 32), (tiles[1], 64)]);

        assert!(film.forget(tiles[0]) && !film.is_complete(), "it may get all samples again");
        film.add(partial(tiles[0], 0..64, 3.0)).unwrap();
        assert!(film.is_complete());
    }
}
