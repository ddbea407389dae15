//! How a job divides into units: frames, rounds, tiles. Pure geometry; nothing here changes while a job runs.
//!
//! A *round* is a block of sample indices that every tile of a frame gets before any tile gets the next one
//! ([`JobSpec::rounds`]): `[0,16) [16,32) [32,64) [64,128) ..`, so that the samples of a whole picture double from round to
//! round, and at the end what is left over beyond the last power of two (100 ends with `[64,96) [96,100)`). A *cell* is one round of one tile of
//! one frame; units are cells or dyadic parts of them.

use farm_film::{FrameIndex, LEAF_SAMPLES, Resolution, SampleBlock, Tile, WorkUnit};
use farm_job::{FrameRange, JobSpec, JobSpecError};

/// One round of one tile of one frame. Ordered as they are rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Cell {
    /// Position in the job's frame range.
    pub frame: u32,
    /// Position in [`Plan::rounds`].
    pub round: u8,
    /// Position in scanline order.
    pub tile: u32,
}

/// The division of one job.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    frames: FrameRange,
    resolution: Resolution,
    tile_side: u32,
    columns: u32,
    rows: u32,
    rounds: Vec<SampleBlock>,
    adaptive: bool,
}

impl Plan {
    /// The division of what `spec` asks.
    pub fn new(spec: &JobSpec) -> Result<Self, JobSpecError> {
        spec.validate()?;
        let resolution = spec.resolution()?;
        Ok(Self {
            frames: spec.frames,
            resolution,
            tile_side: spec.tile_side,
            columns: resolution.width().div_ceil(spec.tile_side),
            rows: resolution.height().div_ceil(spec.tile_side),
            rounds: spec.rounds()?,
            adaptive: spec.stop.adaptive,
        })
    }

    /// How many frames.
    pub fn frames(&self) -> u64 {
        self.frames.count()
    }

    /// Tiles per frame.
    pub fn tiles(&self) -> u64 {
        u64::from(self.columns) * u64::from(self.rows)
    }

    /// Blocks that follow each other from sample 0 to the last one.
    pub fn rounds(&self) -> &[SampleBlock] {
        &self.rounds
    }

    /// Whether tiles may end on their own, by what the samples of the whole frame say.
    pub fn is_adaptive(&self) -> bool {
        self.adaptive
    }

    /// Samples over all pixels of a frame in round `round`.
    pub fn round_samples(&self, round: u8) -> u128 {
        self.resolution.area() as u128 * u128::from(self.rounds[usize::from(round)].samples())
    }

    /// The first cell of a frame; none past the last frame.
    pub fn first_cell(&self, frame: u32) -> Option<Cell> {
        self.frames.get(frame).map(|_| Cell { frame, round: 0, tile: 0 })
    }

    /// The cell after `cell`; none after the last.
    pub fn next_cell(&self, cell: Cell) -> Option<Cell> {
        if u64::from(cell.tile) + 1 < self.tiles() {
            Some(Cell { tile: cell.tile + 1, ..cell })
        } else if usize::from(cell.round) + 1 < self.rounds.len() {
            Some(Cell { round: cell.round + 1, tile: 0, ..cell })
        } else {
            self.first_cell(cell.frame.checked_add(1)?)
        }
    }

    /// The picture at a position.
    pub fn frame(&self, position: u32) -> FrameIndex {
        self.frames.get(position).expect("cells lie within the plan")
    }

    /// The position of a picture.
    pub fn frame_position(&self, frame: FrameIndex) -> Option<u32> {
        self.frames.position(frame)
    }

    /// The pixels of a tile.
    pub fn tile(&self, position: u32) -> Tile {
        let (column, row) = (position % self.columns, position / self.columns);
        let (x0, y0) = (column * self.tile_side, row * self.tile_side);
        let x1 = x0.saturating_add(self.tile_side).min(self.resolution.width());
        let y1 = y0.saturating_add(self.tile_side).min(self.resolution.height());
        Tile::new(x0, y0, x1, y1).expect("a tile of the plan holds a pixel")
    }

    /// The position of a tile; none when it is not one of the plan's.
    pub fn tile_position(&self, tile: Tile) -> Option<u32> {
        let (column, row) = (tile.x0() / self.tile_side, tile.y0() / self.tile_side);
        let position = row.checked_mul(self.columns)?.checked_add(column)?;
        (column < self.columns && row < self.rows && self.tile(position) == tile).then_some(position)
    }

    /// The cell that `unit` is, or is part of; none when it is no unit of this plan.
    pub fn locate(&self, unit: &WorkUnit) -> Option<Cell> {
        let frame = self.frame_position(unit.frame)?;
        let tile = self.tile_position(unit.tile)?;
        let round = self.rounds.partition_point(|round| round.end() <= unit.block.start());
        let whole = *self.rounds.get(round)?;
        // A leaf cut short by one sample count is no node of the tree of another.
        let in_tree = unit.block.samples() >= LEAF_SAMPLES || unit.block == whole;
        (in_tree && whole.contains(unit.block)).then_some(Cell { frame, round: round as u8, tile })
    }

    /// The whole of `cell`.
    pub fn block(&self, cell: Cell) -> SampleBlock {
        self.rounds[usize::from(cell.round)]
    }

    /// Samples over all pixels of the whole of `cell`.
    pub fn cell_samples(&self, cell: Cell) -> u128 {
        self.tile(cell.tile).area() as u128 * u128::from(self.block(cell).samples())
    }

    /// `block` of a cell as a unit.
    pub fn unit(&self, cell: Cell, block: SampleBlock) -> WorkUnit {
        WorkUnit { frame: self.frame(cell.frame), block, tile: self.tile(cell.tile) }
    }
}

/// Samples over all pixels of a unit.
pub(crate) fn pixel_samples(unit: &WorkUnit) -> f64 {
    unit.tile.area() as f64 * unit.block.samples() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::spec;

    #[test]
    fn a_frame_gets_one_round_on_every_tile_before_the_next() {
        let plan = Plan::new(&spec(20, 10, 10, 32, "1-2")).unwrap();
        let mut cell = plan.first_cell(0);
        let mut order = Vec::new();
        while let Some(at) = cell {
            order.push((at.frame, at.round, at.tile));
            cell = plan.next_cell(at);
        }
        let frame = |f| [(f, 0, 0), (f, 0, 1), (f, 1, 0), (f, 1, 1)];
        assert_eq!(order, [frame(0), frame(1)].concat());
    }

    #[test]
    fn only_what_the_plan_holds_is_located() {
        let plan = Plan::new(&spec(20, 10, 16, 100, "3-9x3")).unwrap();
        let block = |range| SampleBlock::new(range).unwrap();
        let edge = Tile::new(16, 0, 20, 10).unwrap();
        let unit = |frame, block, tile| WorkUnit { frame: FrameIndex(frame), block, tile };
        assert_eq!(plan.locate(&unit(6, block(64..80), edge)), Some(Cell { frame: 1, round: 3, tile: 1 }));
        assert_eq!(plan.locate(&unit(3, block(96..100), edge)), Some(Cell { frame: 0, round: 4, tile: 1 }));
        let inner = Tile::new(0, 0, 8, 8).unwrap();
        for foreign in [
            unit(4, block(0..16), edge),
            unit(3, block(0..16), inner),
            unit(3, block(0..32), edge),
            unit(3, block(112..128), edge),
            unit(3, block(64..70), edge),
        ] {
            assert_eq!(plan.locate(&foreign), None, "{foreign} is not part of the plan");
        }
    }

    #[test]
    fn every_tile_of_the_frame_has_its_position() {
        let plan = Plan::new(&spec(50, 30, 7, 16, "0")).unwrap();
        let tiles: Vec<_> = Resolution::new(50, 30).unwrap().tiles(7).collect();
        assert_eq!(plan.tiles(), tiles.len() as u64);
        for (position, tile) in (0..).zip(tiles) {
            assert_eq!(plan.tile(position), tile);
            assert_eq!(plan.tile_position(tile), Some(position));
        }
    }
}
