//! What the stories and benchmarks that run the real farm have in common.

pub mod scenes;
