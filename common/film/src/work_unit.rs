//! What a worker is asked to render.

use crate::{SampleBlock, Tile};
use serde::{Deserialize, Serialize};

/// Number of one picture of a job; its time is `frame / fps`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct FrameIndex(pub u32);

impl std::fmt::Display for FrameIndex {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.0)
    }
}

/// Frame x tile x sample block: what is rendered, and the name of its result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct WorkUnit {
    /// Which picture.
    pub frame: FrameIndex,
    /// Which sample indices of every pixel of the tile.
    pub block: SampleBlock,
    /// Which pixels.
    pub tile: Tile,
}

impl std::fmt::Display for WorkUnit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "frame {} tile {} samples {}", self.frame, self.tile, self.block)
    }
}
