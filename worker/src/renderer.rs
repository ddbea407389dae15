//! The door to the renderer: everything that the farm asks of it.

pub use farm_render::{FINGERPRINT, PrepareError, PreparedScene, Rendered, Report, render};
