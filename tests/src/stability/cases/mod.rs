//! The cases, by chapter. What each one's letter and number stand for is said where it is registered.

pub mod apertures;
pub mod direct_light;
pub mod environment;
pub mod furnaces;
pub mod fuzz;
pub mod glossy;
pub mod lens;
pub mod limits;
pub mod motion;
pub mod numerics;
pub mod quadrature;
pub mod scale;
pub mod stills;
pub mod traversal;
