//! Stories of the farm, told by the real programs over loopback.

mod bad_input;
mod bucket;
mod by_hand;
mod closed;
mod durability;
mod error;
mod harness;
mod impostors;
mod intruders;
mod owners;
mod same_bits;
mod server;
mod serving;
mod strangers;
mod workers;
