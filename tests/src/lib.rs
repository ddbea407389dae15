//! What the stories and benchmarks that run the real farm have in common, and the cases that hold the renderer against certain
//! answers.

pub mod convergence;
pub mod fuzz;
pub mod programs;
pub mod scenes;
pub mod stability;
