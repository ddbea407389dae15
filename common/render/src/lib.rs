//! How a scene is rendered: `render(prepared scene, unit) -> film tile`, a pure function.
//!
//! Reads no clock, file or socket, draws no chance, and gives the same bits on any thread of any x86-64 machine.

pub mod accel;
pub mod bsdf;
pub mod filter;
pub mod light;
pub mod math;
pub mod sampler;
pub mod sampling;
pub mod transform;
