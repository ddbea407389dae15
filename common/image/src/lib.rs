//! Film to and from files: partial EXRs, finished frames, previews; and how far two pictures are apart.
//!
//! Promise: a partial EXR is decoded to exactly the sums that were encoded, the same input gives the same bytes, and nothing
//! half-written is ever found under the name of a finished file.

mod attribute;
mod digest;
mod error;
mod file;
mod flip;
mod frame;
mod heat_map;
mod metrics;
mod partial;
mod preview;
mod read;

pub use digest::pixels_digest;
pub use error::ImageError;
pub use file::{write_file, write_file_with};
pub use flip::flip;
pub use frame::{Frame, FrameMetadata, Pass, SampleFormat, encode_frame, write_frame};
pub use heat_map::{difference_png, heat_color};
pub use metrics::{Comparison, Corrected, compare};
pub use partial::{PartialHeader, PartialLimits, decode_partial, encode_partial};
pub use preview::{Exposure, preview_png, rgb_png, write_preview};
pub use read::{Image, read_image};
