//! The gRPC side of a coordinator.

mod connection;
mod control;
mod farm;
mod listen;

pub use control::ControlService;
pub use listen::{Listener, serve_memory};
