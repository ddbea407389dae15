//! What tiles cost beside each other, learnt from what was rendered of them: glass takes longer than sky.

use crate::policy;
use std::collections::BTreeMap;

/// Costs of the tiles of a job's pictures, by position. A tile that costs 2 takes twice the time per sample of one that costs 1;
/// those not seen yet cost 1.
#[derive(Clone, Debug, Default)]
pub(crate) struct Costs {
    tiles: BTreeMap<u32, f64>,
    sum: f64,
}

impl Costs {
    pub fn of(&self, tile: u32) -> f64 {
        self.tiles.get(&tile).copied().unwrap_or(1.0)
    }

    /// What a tile costs on the average.
    pub fn mean(&self) -> f64 {
        if self.tiles.is_empty() { 1.0 } else { self.sum / self.tiles.len() as f64 }
    }

    /// Learns from a unit: what its tile costs by the speed of whoever rendered it.
    pub fn learn(&mut self, tile: u32, measured: f64) {
        let known = self.tiles.get(&tile).copied();
        if known.is_none() && self.tiles.len() >= policy::TILES_REMEMBERED {
            return;
        }
        let smoothed = policy::smooth(known, measured.clamp(1.0 / policy::COST_MAX, policy::COST_MAX));
        self.sum += smoothed - known.unwrap_or(0.0);
        self.tiles.insert(tile, smoothed);
    }
}
