//! The gRPC side of a coordinator.

mod accept;
mod connection;
mod control;
mod crowd;
mod enrol;
mod farm;
mod guard;
mod line;
mod listen;
mod policy;
mod quota;
mod uploads;

pub use accept::Security;
pub use control::ControlService;
pub use listen::{Listener, serve_memory};
pub use uploads::UploadLimits;
