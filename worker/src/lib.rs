//! Renders the units that a coordinator hands out. Keeps nothing that cannot be fetched again, and never executes anything
//! that a job brings.

pub mod access;
pub mod agent;
mod blocking;
pub mod by_hand;
pub mod cli;
pub mod client;
pub mod disk_cache;
pub mod driver;
pub mod frames;
mod heartbeat;
pub mod link;
pub mod log;
pub mod program;
pub mod render_pool;
pub mod renderer;
pub mod scene_cache;
pub mod settings;
mod spare;
mod time_of_day;

pub use blocking::blocking;
