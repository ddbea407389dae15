//! Stories of the farm, told by the real programs over loopback.

mod adaptive;
mod bad_input;
mod beyond_loopback;
mod bucket;
mod by_hand;
mod certificates;
mod closed;
mod durability;
mod error;
mod far_away;
mod harness;
mod impostors;
mod intruders;
mod lent_hosts;
mod line;
mod owners;
mod played_host;
mod same_bits;
mod secrets;
mod server;
mod serving;
mod strangers;
mod workers;
