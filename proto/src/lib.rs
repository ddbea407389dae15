//! The wire: gRPC messages, and their conversion to and from the farm's own types.
//!
//! Past [`convert`] nothing is optional by accident and nothing is checked twice. Never decides anything.

pub mod convert;
mod limits;

pub use limits::{
    CONTROL_BYTES_MAX, ENROL_BYTES_MAX, MESSAGE_BYTES_MAX, PARTIAL_BYTES_MAX, SCENE_CHUNK_BYTES,
};

/// Messages as they travel.
#[allow(missing_docs, clippy::all, unused_qualifications)]
pub mod v1 {
    tonic::include_proto!("farm.v1");
}

/// Both sides of a connection must speak the same; raised with every change that an older side would misread.
pub const PROTOCOL_VERSION: u32 = 1;

/// The services and messages in a form that gRPC tools read.
pub const DESCRIPTOR: &[u8] = tonic::include_file_descriptor_set!("farm_descriptor");
