//! What comes out of a renderer, and how its parts add up to a picture.
//!
//! Promise: any split of a frame into tiles and sample blocks, merged in any order, resolves to the same bits.
//! Reads no clock, socket or file, and knows nothing of scenes.

mod adaptive;
mod decay;
mod differences;
mod error_estimate;
mod exact_sum;
mod film;
mod film_tile;
mod sample_block;
mod tile;
mod work_unit;

pub use adaptive::{ADAPTIVE_SPP_MIN, BIAS_OVER_NOISE};
pub use differences::{Differences, LevelDifferences};
pub use error_estimate::{ErrorEstimate, Prediction};
pub use exact_sum::ExactSum;
pub use film::{Accepted, Film, FilmError, ResolvedTile};
pub use film_tile::{Counters, FilmTile, LeafSum, Rgb, add_rgb};
pub use sample_block::{LEAF_SAMPLES, SampleBlock, SampleBlockError, SampleRange};
pub use tile::{RESOLUTION_MAX, Resolution, Tile, TileError};
pub use work_unit::{FrameIndex, WorkUnit};
