//! Splits frames into work units, hands them to workers and merges what comes back. Acknowledges only what is safe.

mod adaptive;
mod assembly;
mod check;
mod checkpoint;
mod chronicle;
pub mod cli;
mod client;
mod clocks;
pub mod driver;
pub mod farm;
mod forecast;
mod keeper;
mod open_frame;
mod outputs;
mod pieces;
mod progress;
mod registry;
mod report;
pub mod serve;
pub mod service;
mod signals;
pub mod store;
mod tally;
mod truth;
mod variance;
mod views;
