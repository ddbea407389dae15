//! The command line that both programs share: which scene, how it is rendered, and how faults end a program.

mod fault;
mod parse;
mod picture;
mod resolve;
mod scene_file;

pub use farm_import::ImportReport;
pub use fault::Fault;
pub(crate) use parse::positive;
pub use parse::{bytes, duration, resolution};
pub use picture::{PictureArgs, ShutterPosition};
pub use resolve::Loaded;
