//! How far the frames of a job are: which rounds are complete, and which frames.

use crate::plan::{Cell, Plan};
use std::collections::{BTreeMap, BTreeSet};

/// Something that a picture has reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Milestone {
    /// Every tile of the frame has samples `[0, spp)`.
    Round { frame: u32, spp: u64 },
    /// Nothing is missing.
    Frame { frame: u32, spp: u64 },
}

/// Progress of the frames that have begun and are not complete; the others are numbers.
#[derive(Clone, Debug)]
pub(crate) struct Progress {
    frames: BTreeMap<u32, FrameProgress>,
    /// Complete, although planning has not passed them yet.
    complete_ahead: BTreeSet<u32>,
    /// Complete frames that were ended early, or parts of which were.
    cut: BTreeMap<u32, Cut>,
    frames_done: u64,
    samples_done: u128,
    samples: u128,
}

/// What a complete frame has got that has less than the others.
#[derive(Clone, Debug)]
struct Cut {
    rounds: u8,
    /// Over all pixels.
    samples: u128,
}

#[derive(Clone, Debug)]
struct FrameProgress {
    /// Complete cells of each round.
    cells: Vec<u64>,
    /// Durable samples over all pixels of each round.
    samples: Vec<u128>,
    /// Rounds of which something was begun.
    begun: u8,
    /// Complete rounds from the first one on.
    complete: u8,
    /// Rounds this frame gets.
    limit: u8,
    /// Cells that each round has: those of tiles that have not ended before it.
    wanted: Vec<u64>,
    /// Samples over all pixels in them.
    wanted_samples: Vec<u128>,
    /// Rounds of the tiles that get fewer than the frame.
    ended: BTreeMap<u32, u8>,
}

impl Progress {
    pub fn new(plan: &Plan) -> Self {
        Self {
            frames: BTreeMap::new(),
            complete_ahead: BTreeSet::new(),
            cut: BTreeMap::new(),
            frames_done: 0,
            samples_done: 0,
            samples: frame_samples(plan, 0, plan.rounds().len() as u8) * u128::from(plan.frames()),
        }
    }

    /// Notes that something of `cell` has begun.
    pub fn begin(&mut self, plan: &Plan, cell: Cell) {
        let frame = self.frame(plan, cell.frame);
        frame.begun = frame.begun.max(cell.round + 1);
    }

    /// Notes that `samples` more of a cell are durable, over all its pixels.
    pub fn add(&mut self, cell: Cell, samples: u128) {
        let frame = self.frames.get_mut(&cell.frame).expect("a cell has begun before anything of it is done");
        frame.samples[usize::from(cell.round)] += samples;
        self.samples_done += samples;
    }

    /// Notes that nothing of a cell is missing any more.
    pub fn complete_cell(&mut self, plan: &Plan, cell: Cell, cursor: Option<Cell>) -> Vec<Milestone> {
        let frame = self.frames.get_mut(&cell.frame).expect("a cell has begun before it is complete");
        frame.cells[usize::from(cell.round)] += 1;
        self.advance(plan, cell.frame, cursor)
    }

    /// Ends a frame after its first `rounds` rounds.
    pub fn truncate(
        &mut self,
        plan: &Plan,
        position: u32,
        rounds: u8,
        cursor: Option<Cell>,
    ) -> Vec<Milestone> {
        let frame = self.frame(plan, position);
        let (before, was) = (usize::from(rounds), frame.limit);
        frame.limit = rounds;
        let dropped: u128 = frame.samples[before..].iter().sum();
        frame.samples[before..].fill(0);
        let unwanted: u128 = frame.wanted_samples[before..usize::from(was)].iter().sum();
        self.samples_done -= dropped;
        self.samples -= unwanted;
        self.advance(plan, position, cursor)
    }

    /// Notes that a whole frame is there from an earlier life.
    pub fn complete_frame(&mut self, plan: &Plan, position: u32) {
        if self.complete_ahead.insert(position) {
            self.frames_done += 1;
            self.samples_done += frame_samples(plan, 0, plan.rounds().len() as u8);
        }
    }

    /// Makes a frame one that has begun again, if it was complete; rounds that it gets.
    pub fn reopen(&mut self, plan: &Plan, position: u32, cursor: Option<Cell>) -> u8 {
        if !self.is_complete(position, cursor) {
            return self.limit(plan, position);
        }
        self.complete_ahead.remove(&position);
        let rounds = plan.rounds().len() as u8;
        let limit = self.cut.remove(&position).map_or(rounds, |cut| cut.rounds);
        let all = |round: u8| if round < limit { plan.tiles() } else { 0 };
        let samples = |round: u8| if round < limit { plan.round_samples(round) } else { 0 };
        let frame = FrameProgress {
            cells: (0..rounds).map(all).collect(),
            samples: (0..rounds).map(samples).collect(),
            begun: limit,
            complete: limit,
            limit,
            ..FrameProgress::new(plan)
        };
        self.frames.insert(position, frame);
        self.frames_done -= 1;
        limit
    }

    /// Forgets all that is known of a frame: it gets all of its rounds again, and so do its tiles.
    pub fn restart(&mut self, plan: &Plan, position: u32, cursor: Option<Cell>) {
        let whole = frame_samples(plan, 0, plan.rounds().len() as u8);
        let was_complete = self.is_complete(position, cursor);
        let (wanted, done) = match self.frames.remove(&position) {
            Some(frame) => {
                let wanted = &frame.wanted_samples[..usize::from(frame.limit)];
                (wanted.iter().sum(), frame.samples.iter().sum())
            }
            None if was_complete => {
                let samples = self.cut.get(&position).map_or(whole, |cut| cut.samples);
                (samples, samples)
            }
            None => (whole, 0),
        };
        self.cut.remove(&position);
        self.complete_ahead.remove(&position);
        self.frames_done -= u64::from(was_complete);
        self.samples = self.samples - wanted + whole;
        self.samples_done -= done;
    }

    /// Ends a tile after its first `rounds` rounds, once [`Self::drop_cell`] was told of the others; with the last of its tiles the
    /// frame ends.
    pub fn end_tile(&mut self, plan: &Plan, position: u32, tile: u32, rounds: u8) {
        let frame = self.frame(plan, position);
        frame.ended.insert(tile, rounds);
        if frame.ended.len() as u64 == plan.tiles() {
            let longest = frame.ended.values().copied().max().unwrap_or(rounds);
            frame.limit = frame.limit.min(longest);
        }
    }

    /// Notes that a frame gets along without a cell, of which `durable` samples per pixel were there.
    pub fn drop_cell(&mut self, plan: &Plan, cell: Cell, durable: u64) {
        let (round, whole) = (usize::from(cell.round), plan.cell_samples(cell));
        let frame = self.frame(plan, cell.frame);
        let done = plan.tile(cell.tile).area() as u128 * u128::from(durable);
        frame.wanted[round] -= 1;
        frame.wanted_samples[round] -= whole;
        frame.cells[round] -= u64::from(done == whole);
        frame.samples[round] -= done;
        self.samples_done -= done;
        self.samples -= whole;
    }

    /// Rounds that a tile gets.
    pub fn tile_limit(&self, plan: &Plan, position: u32, tile: u32) -> u8 {
        let Some(frame) = self.frames.get(&position) else { return plan.rounds().len() as u8 };
        frame.ended.get(&tile).map_or(frame.limit, |rounds| frame.limit.min(*rounds))
    }

    /// Whether a tile was ended.
    pub fn has_ended(&self, position: u32, tile: u32) -> bool {
        self.frames.get(&position).is_some_and(|frame| frame.ended.contains_key(&tile))
    }

    /// Notes that a cell lost all that was durable of it; `left` samples per pixel were not.
    pub fn undo(&mut self, plan: &Plan, cell: Cell, left: u64) {
        let frame = self.frames.get_mut(&cell.frame).expect("a cell is undone while its frame is open");
        let (round, area) = (usize::from(cell.round), plan.tile(cell.tile).area() as u128);
        let lost = area * u128::from(plan.block(cell).samples() - left);
        frame.samples[round] -= lost;
        self.samples_done -= lost;
        if left == 0 {
            frame.cells[round] -= 1;
            frame.complete = frame.complete.min(cell.round);
        }
    }

    /// Forgets that a frame was completed early, once planning has passed it.
    pub fn pass(&mut self, position: u32) {
        self.complete_ahead.remove(&position);
    }

    /// Whether nothing of a frame is missing, given where planning is.
    pub fn is_complete(&self, position: u32, cursor: Option<Cell>) -> bool {
        let passed = cursor.is_none_or(|cursor| position < cursor.frame);
        self.complete_ahead.contains(&position) || (passed && !self.frames.contains_key(&position))
    }

    /// Rounds that a frame gets.
    pub fn limit(&self, plan: &Plan, position: u32) -> u8 {
        self.frames.get(&position).map_or(plan.rounds().len() as u8, |frame| frame.limit)
    }

    pub fn frames_done(&self) -> u64 {
        self.frames_done
    }

    pub fn samples_done(&self) -> u128 {
        self.samples_done
    }

    pub fn samples(&self) -> u128 {
        self.samples
    }

    /// The first frame that has begun and is not complete: its position, complete rounds and begun rounds.
    pub fn current(&self) -> Option<(u32, u8, u8)> {
        self.frames
            .first_key_value()
            .map(|(&position, frame)| (position, frame.complete, frame.begun.min(frame.limit)))
    }

    fn frame(&mut self, plan: &Plan, position: u32) -> &mut FrameProgress {
        self.frames.entry(position).or_insert_with(|| FrameProgress::new(plan))
    }

    /// Announces rounds in order, each when it and all before it are complete, and then the frame.
    pub fn advance(&mut self, plan: &Plan, position: u32, cursor: Option<Cell>) -> Vec<Milestone> {
        let Some(frame) = self.frames.get_mut(&position) else { return Vec::new() };
        let mut reached = Vec::new();
        let spp = |rounds: u8| plan.rounds()[usize::from(rounds) - 1].end();
        while frame.complete < frame.limit
            && frame.cells[usize::from(frame.complete)] == frame.wanted[usize::from(frame.complete)]
        {
            frame.complete += 1;
            reached.push(Milestone::Round { frame: position, spp: spp(frame.complete) });
        }
        if frame.complete >= frame.limit {
            let limit = frame.limit;
            reached.push(Milestone::Frame { frame: position, spp: spp(limit) });
            if usize::from(limit) < plan.rounds().len() || !frame.ended.is_empty() {
                let samples = frame.wanted_samples[..usize::from(limit)].iter().sum();
                self.cut.insert(position, Cut { rounds: limit, samples });
            }
            self.frames.remove(&position);
            self.frames_done += 1;
            if cursor.is_some_and(|cursor| position >= cursor.frame) {
                self.complete_ahead.insert(position);
            }
        }
        reached
    }
}

impl FrameProgress {
    fn new(plan: &Plan) -> Self {
        let rounds = plan.rounds().len();
        Self {
            cells: vec![0; rounds],
            samples: vec![0; rounds],
            begun: 0,
            complete: 0,
            limit: rounds as u8,
            wanted: vec![plan.tiles(); rounds],
            wanted_samples: (0..rounds as u8).map(|round| plan.round_samples(round)).collect(),
            ended: BTreeMap::new(),
        }
    }
}

/// Samples over all pixels of a frame in rounds `from..to`.
fn frame_samples(plan: &Plan, from: u8, to: u8) -> u128 {
    (from..to).map(|round| plan.round_samples(round)).sum()
}
