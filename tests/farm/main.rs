//! Stories of the farm, told by the real programs over loopback.

mod bad_input;
mod by_hand;
mod harness;
mod impostors;
mod same_bits;
mod serving;
mod strangers;
mod workers;
