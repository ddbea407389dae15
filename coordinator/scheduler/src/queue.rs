//! The units of one job that are not durable yet.
//!
//! Most of a job is never written down: a cursor walks over its cells in planning order, and all from the cursor on is
//! untouched and open. A cell becomes pieces when the cursor takes it, or when a result for it comes early. So memory grows
//! with what is being worked on, not with the job.
//!
//! ```text
//! untouched --take--> open <--release-- leased --reserve--> storing --accept--> (gone: durable)
//!                      `---------------- reserve --------------^   `--unreserve--> open
//! ```

use crate::piece::{History, Piece, PieceKey};
use crate::plan::{Cell, Plan};
use crate::progress::{Milestone, Progress};
use crate::{Verdict, policy};
use farm_film::{FrameIndex, SampleBlock, Tile, WorkUnit};
use farm_job::LeaseId;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// The units of one job that are not durable yet, and how far its frames are.
#[derive(Clone, Debug)]
pub(crate) struct Queue {
    plan: Plan,
    progress: Progress,
    /// The first untouched cell.
    cursor: Option<Cell>,
    /// Cells beyond the cursor that are touched.
    ahead: BTreeSet<Cell>,
    /// What is left of touched cells.
    pieces: BTreeMap<PieceKey, Piece>,
    /// Pieces that may be given out.
    open: BTreeSet<PieceKey>,
}

/// What became of an accepted unit.
pub(crate) struct Accepted {
    /// Leases on the same samples, now pointless.
    pub displaced: Vec<LeaseId>,
    pub milestones: Vec<Milestone>,
}

impl Queue {
    pub fn new(plan: Plan) -> Self {
        Self {
            progress: Progress::new(&plan),
            cursor: plan.first_cell(0),
            plan,
            ahead: BTreeSet::new(),
            pieces: BTreeMap::new(),
            open: BTreeSet::new(),
        }
    }

    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    pub fn progress(&self) -> &Progress {
        &self.progress
    }

    pub fn piece(&self, key: PieceKey) -> Option<&Piece> {
        self.pieces.get(&key)
    }

    /// A piece as a unit.
    pub fn unit(&self, key: PieceKey) -> Option<WorkUnit> {
        self.pieces.get(&key).map(|piece| self.plan.unit(key.cell, piece.block))
    }

    pub fn history_mut(&mut self, key: PieceKey) -> Option<&mut History> {
        self.pieces.get_mut(&key).map(|piece| &mut piece.history)
    }

    /// Whether there is anything to give out.
    pub fn has_open(&self) -> bool {
        !self.open.is_empty() || self.cursor.is_some()
    }

    /// Whether nothing is left to do.
    pub fn is_done(&self) -> bool {
        self.pieces.is_empty() && self.cursor.is_none()
    }

    /// Every lease on any piece, in planning order.
    pub fn leases(&self) -> impl Iterator<Item = LeaseId> + '_ {
        self.pieces.values().flat_map(|piece| piece.leases.iter().copied())
    }

    /// The first open piece that `may` be given out, cut to at most `samples_max` samples per pixel of its tile, by its position
    /// and its pixels.
    pub fn take(
        &mut self,
        samples_max: impl Fn(u32, Tile) -> u64,
        may: impl Fn(&Piece) -> bool,
    ) -> Option<PieceKey> {
        let returned =
            self.open.iter().take(policy::PIECES_LOOKED_AT).find(|key| may(&self.pieces[key])).copied();
        let key = match (returned, self.cursor) {
            (Some(key), Some(cursor)) if key.cell < cursor => key,
            (Some(key), None) => key,
            (_, Some(cursor)) => self.touch(cursor),
            (None, None) => return None,
        };
        let samples_max = samples_max(key.cell.tile, self.plan.tile(key.cell.tile));
        let mut block = self.pieces[&key].block;
        while let Some((left, _)) = block.children().filter(|_| block.samples() > samples_max) {
            block = left;
        }
        self.carve(key, block);
        Some(key)
    }

    /// Notes that a worker renders a piece; the number of leases it has had so far.
    pub fn lease(&mut self, key: PieceKey, lease: LeaseId) -> u32 {
        let piece = self.pieces.get_mut(&key).expect("a piece is leased while it is there");
        piece.leases.push(lease);
        piece.history.attempts += 1;
        let attempts = piece.history.attempts;
        self.file(key);
        attempts
    }

    /// Ends a lease on a piece, which is open again if it was the only one.
    pub fn release(&mut self, key: PieceKey, lease: LeaseId) {
        if let Some(piece) = self.pieces.get_mut(&key) {
            piece.leases.retain(|held| *held != lease);
            self.file(key);
        }
    }

    /// Whether all samples of a unit are open or being rendered.
    pub fn verdict(&self, unit: &WorkUnit) -> Verdict {
        let Some(cell) = self.plan.locate(unit) else { return Verdict::Foreign };
        let wanted = if self.is_ended(cell) {
            false
        } else if !self.is_touched(cell) {
            true
        } else if let Some((_, piece)) = self.containing(cell, unit.block) {
            !piece.storing
        } else {
            let parts = || self.pieces.range(within(cell, unit.block)).map(|(_, piece)| piece);
            parts().all(|piece| !piece.storing)
                && parts().map(|piece| piece.block.samples()).sum::<u64>() == unit.block.samples()
        };
        if wanted { Verdict::Wanted } else { Verdict::NotNeeded }
    }

    /// Makes a wanted unit a piece of its own that is being stored. Leases on samples that no longer make a piece are
    /// ended and returned; those on exactly this piece live on until it is accepted.
    pub fn reserve(&mut self, unit: &WorkUnit) -> Vec<LeaseId> {
        let cell = self.plan.locate(unit).expect("a wanted unit is part of the plan");
        if !self.is_touched(cell) {
            self.touch(cell);
        }
        let displaced = match self.containing(cell, unit.block) {
            Some((key, _)) => self.carve(key, unit.block),
            None => self.unite(cell, unit.block),
        };
        let key = PieceKey { cell, start: unit.block.start() };
        self.pieces.get_mut(&key).expect("the piece was just made").storing = true;
        self.file(key);
        displaced
    }

    /// Opens a reserved unit again, if it has not become pointless since; `rejected`: who sent something that is no result.
    pub fn unreserve(&mut self, unit: &WorkUnit, rejected: Option<Arc<str>>) {
        let Some(key) = self.storing(unit) else { return };
        let piece = self.pieces.get_mut(&key).expect("the piece was just found");
        piece.storing = false;
        piece.history.rejected.extend(rejected);
        self.file(key);
    }

    /// Notes that a reserved unit is durable. None when it has become pointless since.
    pub fn accept(&mut self, unit: &WorkUnit) -> Option<Accepted> {
        let key = self.storing(unit)?;
        let piece = self.remove(key)?;
        let milestones = self.done(key.cell, piece.block.samples());
        Some(Accepted { displaced: piece.leases, milestones })
    }

    /// Notes that the finished picture of a frame is there from an earlier life.
    pub fn complete_frame(&mut self, frame: FrameIndex) {
        if let Some(position) = self.plan.frame_position(frame) {
            self.progress.complete_frame(&self.plan, position);
            self.advance();
        }
    }

    /// Notes that a unit is durable from an earlier life, in which it may have been merged over several rounds. Nothing is
    /// leased yet. Samples that are no part of the plan, or are there already, are passed over.
    pub fn cover(&mut self, unit: &WorkUnit) -> Vec<Milestone> {
        if let Some(cell) = self.plan.locate(unit) {
            return self.cover_part(cell, unit.block);
        }
        let rounds = self.plan.rounds().iter().copied();
        let parts: Vec<SampleBlock> = rounds.filter(|round| unit.block.contains(*round)).collect();
        if parts.iter().map(|part| part.samples()).sum::<u64>() != unit.block.samples() {
            return Vec::new();
        }
        let cell = |block| self.plan.locate(&WorkUnit { block, ..*unit });
        let cells: Vec<_> = parts.into_iter().filter_map(|block| Some((cell(block)?, block))).collect();
        cells.into_iter().flat_map(|(cell, block)| self.cover_part(cell, block)).collect()
    }

    /// Ends a frame at `spp` samples per pixel. None when that is not the end of a round, or the frame is complete.
    pub fn truncate(&mut self, frame: FrameIndex, spp: u64) -> Option<Accepted> {
        let position = self.plan.frame_position(frame)?;
        let rounds = 1 + self.plan.rounds().iter().position(|round| round.end() == spp)? as u8;
        let is_complete = self.progress.is_complete(position, self.cursor);
        if is_complete || rounds >= self.progress.limit(&self.plan, position) {
            return None;
        }
        let milestones = self.progress.truncate(&self.plan, position, rounds, self.cursor);
        let from = Cell { frame: position, round: rounds, tile: 0 };
        let to = Cell { frame: position, round: u8::MAX, tile: 0 };
        let keys: Vec<_> = self
            .pieces
            .range(PieceKey { cell: from, start: 0 }..PieceKey { cell: to, start: 0 })
            .map(|(key, _)| *key)
            .collect();
        let displaced = keys.into_iter().filter_map(|key| self.remove(key)).flat_map(|piece| piece.leases);
        let displaced = displaced.collect();
        let ahead: Vec<Cell> = self.ahead.range(from..to).copied().collect();
        for cell in ahead {
            self.ahead.remove(&cell);
        }
        self.advance();
        Some(Accepted { displaced, milestones })
    }

    /// Ends tiles of a frame at `spp` samples per pixel. None when that is not the end of a round, or the frame is complete.
    pub fn end_tiles(&mut self, frame: FrameIndex, tiles: &[Tile], spp: u64) -> Option<Accepted> {
        let position = self.plan.frame_position(frame)?;
        let rounds = 1 + self.plan.rounds().iter().position(|round| round.end() == spp)? as u8;
        let limit = self.progress.limit(&self.plan, position);
        if self.progress.is_complete(position, self.cursor) || rounds >= limit {
            return None;
        }
        let is_open = |tile: &u32| !self.progress.has_ended(position, *tile);
        let tiles: BTreeSet<u32> =
            tiles.iter().filter_map(|tile| self.plan.tile_position(*tile)).filter(is_open).collect();
        let mut displaced = Vec::new();
        for tile in tiles {
            for round in rounds..limit {
                displaced.extend(self.drop_cell(Cell { frame: position, round, tile }));
            }
            self.progress.end_tile(&self.plan, position, tile, rounds);
        }
        let milestones = self.progress.advance(&self.plan, position, self.cursor);
        self.advance();
        Some(Accepted { displaced, milestones })
    }

    /// Gets along without a cell; the leases on it, which end.
    fn drop_cell(&mut self, cell: Cell) -> Vec<LeaseId> {
        let whole = self.plan.block(cell);
        let was_touched = self.is_touched(cell);
        let keys: Vec<_> = self.pieces.range(within(cell, whole)).map(|(key, _)| *key).collect();
        let pieces: Vec<Piece> = keys.into_iter().filter_map(|key| self.remove(key)).collect();
        let left: u64 = pieces.iter().map(|piece| piece.block.samples()).sum();
        self.progress.drop_cell(&self.plan, cell, if was_touched { whole.samples() - left } else { 0 });
        self.ahead.remove(&cell);
        pieces.into_iter().flat_map(|piece| piece.leases).collect()
    }

    /// Opens tiles of a frame again, of which some or all is durable; the leases on them, which end.
    pub fn reopen(&mut self, frame: u32, tiles: &[u32]) -> Vec<LeaseId> {
        if self.plan.is_adaptive() {
            return self.restart(frame);
        }
        let rounds = self.progress.reopen(&self.plan, frame, self.cursor);
        let cells = (0..rounds).flat_map(|round| tiles.iter().map(move |&tile| Cell { frame, round, tile }));
        let touched: Vec<Cell> = cells.filter(|cell| self.is_touched(*cell)).collect();
        let mut displaced = Vec::new();
        for cell in touched {
            let whole = self.plan.block(cell);
            let keys: Vec<_> = self.pieces.range(within(cell, whole)).map(|(key, _)| *key).collect();
            let pieces: Vec<Piece> = keys.into_iter().filter_map(|key| self.remove(key)).collect();
            self.progress.undo(&self.plan, cell, pieces.iter().map(|piece| piece.block.samples()).sum());
            displaced.extend(pieces.into_iter().flat_map(|piece| piece.leases));
            self.insert(cell, whole, History::default());
        }
        displaced
    }

    /// Makes a frame one of which nothing is there; the leases on it, which end.
    fn restart(&mut self, frame: u32) -> Vec<LeaseId> {
        let cell = |round, tile| Cell { frame, round, tile };
        let all = PieceKey { cell: cell(0, 0), start: 0 }..PieceKey { cell: cell(u8::MAX, 0), start: 0 };
        let keys: Vec<_> = self.pieces.range(all).map(|(key, _)| *key).collect();
        let displaced = keys.into_iter().filter_map(|key| self.remove(key)).flat_map(|piece| piece.leases);
        let displaced = displaced.collect();
        let ahead: Vec<Cell> = self.ahead.range(cell(0, 0)..cell(u8::MAX, 0)).copied().collect();
        for cell in ahead {
            self.ahead.remove(&cell);
        }
        self.progress.restart(&self.plan, frame, self.cursor);
        let tiles = self.plan.tiles() as u32;
        let rounds = self.plan.rounds().len() as u8;
        let cells = (0..rounds).flat_map(|round| (0..tiles).map(move |tile| cell(round, tile)));
        let cursor = self.cursor;
        for cell in cells.filter(|cell| cursor.is_none_or(|cursor| *cell < cursor)) {
            self.progress.begin(&self.plan, cell);
            self.insert(cell, self.plan.block(cell), History::default());
        }
        displaced
    }

    /// Drops everything that is left to do; the leases on it.
    pub fn abandon(&mut self) -> Vec<LeaseId> {
        let leases = self.leases().collect();
        self.pieces.clear();
        self.open.clear();
        self.ahead.clear();
        self.cursor = None;
        leases
    }

    /// Forgets every failure, for a new try.
    pub fn forgive(&mut self) {
        for piece in self.pieces.values_mut() {
            piece.history = History { attempts: piece.history.attempts, ..History::default() };
        }
    }

    fn cover_part(&mut self, cell: Cell, block: SampleBlock) -> Vec<Milestone> {
        if self.is_ended(cell) {
            return Vec::new();
        }
        if !self.is_touched(cell) && block == self.plan.block(cell) {
            self.progress.begin(&self.plan, cell);
            self.ahead.insert(cell);
            self.advance();
            return self.done(cell, block.samples());
        }
        if !self.is_touched(cell) {
            self.touch(cell);
        }
        let samples = match self.containing(cell, block) {
            Some((key, _)) => {
                self.carve(key, block);
                self.remove(PieceKey { cell, start: block.start() });
                block.samples()
            }
            None => {
                let keys: Vec<_> = self.pieces.range(within(cell, block)).map(|(key, _)| *key).collect();
                keys.into_iter().filter_map(|key| self.remove(key)).map(|piece| piece.block.samples()).sum()
            }
        };
        if samples == 0 { Vec::new() } else { self.done(cell, samples) }
    }

    /// Counts samples per pixel of a cell that have become durable.
    fn done(&mut self, cell: Cell, samples: u64) -> Vec<Milestone> {
        let area = self.plan.tile(cell.tile).area() as u128;
        self.progress.add(cell, area * u128::from(samples));
        let left = self.pieces.range(PieceKey { cell, start: 0 }..).next();
        if left.is_some_and(|(key, _)| key.cell == cell) {
            return Vec::new();
        }
        let milestones = self.progress.complete_cell(&self.plan, cell, self.cursor);
        self.advance();
        milestones
    }

    /// Whether a cell needs nothing any more, for a reason that lies in its tile or its frame.
    fn is_ended(&self, cell: Cell) -> bool {
        self.is_frame_ended(cell) || cell.round >= self.progress.tile_limit(&self.plan, cell.frame, cell.tile)
    }

    fn is_frame_ended(&self, cell: Cell) -> bool {
        self.progress.is_complete(cell.frame, self.cursor)
            || cell.round >= self.progress.limit(&self.plan, cell.frame)
    }

    fn is_touched(&self, cell: Cell) -> bool {
        self.cursor.is_none_or(|cursor| cell < cursor) || self.ahead.contains(&cell)
    }

    /// Makes an untouched cell one open piece.
    fn touch(&mut self, cell: Cell) -> PieceKey {
        self.progress.begin(&self.plan, cell);
        let key = self.insert(cell, self.plan.block(cell), History::default());
        self.ahead.insert(cell);
        self.advance();
        key
    }

    /// Moves the cursor to the first untouched cell.
    fn advance(&mut self) {
        while let Some(cell) = self.cursor {
            if !self.is_ended(cell) && !self.ahead.remove(&cell) {
                break;
            }
            self.cursor = if self.is_frame_ended(cell) {
                self.progress.pass(cell.frame);
                cell.frame.checked_add(1).and_then(|frame| self.plan.first_cell(frame))
            } else {
                self.plan.next_cell(cell)
            };
        }
    }

    /// The piece that `block` is, or is part of.
    fn containing(&self, cell: Cell, block: SampleBlock) -> Option<(PieceKey, &Piece)> {
        let upto = PieceKey { cell, start: block.start() };
        let (key, piece) = self.pieces.range(..=upto).next_back()?;
        (key.cell == cell && piece.block.contains(block)).then_some((*key, piece))
    }

    /// The piece that is exactly `unit` and is being stored.
    fn storing(&self, unit: &WorkUnit) -> Option<PieceKey> {
        let key = PieceKey { cell: self.plan.locate(unit)?, start: unit.block.start() };
        self.pieces.get(&key).filter(|piece| piece.storing && piece.block == unit.block).map(|_| key)
    }

    /// Makes `block` a piece of its own and what surrounds it within its piece open ones; ends leases on the whole.
    fn carve(&mut self, key: PieceKey, block: SampleBlock) -> Vec<LeaseId> {
        if self.pieces[&key].block == block {
            return Vec::new();
        }
        let piece = self.remove(key).expect("the piece was just seen");
        let mut whole = piece.block;
        while whole != block {
            let (left, right) = whole.children().expect("a block within another is one of its descendants");
            let (inner, outer) = if left.contains(block) { (left, right) } else { (right, left) };
            self.insert(key.cell, outer, piece.history.clone());
            whole = inner;
        }
        self.insert(key.cell, block, piece.history);
        piece.leases
    }

    /// Makes one piece of all those within `block`, which they cover; ends their leases.
    fn unite(&mut self, cell: Cell, block: SampleBlock) -> Vec<LeaseId> {
        let keys: Vec<_> = self.pieces.range(within(cell, block)).map(|(key, _)| *key).collect();
        let mut history = History::default();
        let mut displaced = Vec::new();
        for piece in keys.into_iter().filter_map(|key| self.remove(key)) {
            history.merge(piece.history);
            displaced.extend(piece.leases);
        }
        self.insert(cell, block, history);
        displaced
    }

    fn insert(&mut self, cell: Cell, block: SampleBlock, history: History) -> PieceKey {
        let key = PieceKey { cell, start: block.start() };
        self.pieces.insert(key, Piece { block, leases: Vec::new(), storing: false, history });
        self.open.insert(key);
        key
    }

    fn remove(&mut self, key: PieceKey) -> Option<Piece> {
        self.open.remove(&key);
        self.pieces.remove(&key)
    }

    fn file(&mut self, key: PieceKey) {
        if self.pieces.get(&key).is_some_and(Piece::is_open) {
            self.open.insert(key);
        } else {
            self.open.remove(&key);
        }
    }
}

/// The keys of pieces that begin within a block.
fn within(cell: Cell, block: SampleBlock) -> std::ops::Range<PieceKey> {
    PieceKey { cell, start: block.start() }..PieceKey { cell, start: block.end() }
}
