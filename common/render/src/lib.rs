//! How a scene is rendered: `render(prepared scene, unit) -> film tile`, a pure function.
//!
//! Reads no clock, file or socket, draws no chance, and gives the same bits on any thread of any x86-64 machine.

pub mod accel;
pub mod bsdf;
mod camera;
pub mod filter;
mod integrator;
mod interaction;
pub mod light;
pub mod math;
#[cfg(feature = "mutations")]
pub mod mutations;
mod prepared;
pub mod sampler;
pub mod sampling;
mod texture;
pub mod transform;
mod unit;

pub use prepared::{PrepareError, PreparedScene, Report, Usage};
pub use unit::{Rendered, render, render_sample};

/// Names everything that decides the bits of a result, of its pixels and of what they say of their error: results of different
/// fingerprints are never mixed.
pub const FINGERPRINT: &str = concat!("tessera-", env!("CARGO_PKG_VERSION"), "-math2");
