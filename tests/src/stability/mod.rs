//! Stiff and extreme cases with a certain answer: none of them is a stored picture, each is held against a closed form, a
//! quadrature of its own, or the bits of the same thing said differently.
//!
//! A statistical check compares with at least [`measure::REPLICATES`] independently seeded replicates, whose spread gives the
//! standard error; all of them share one family error; a check that would not see a bias of 0.5 % is red. Seeds are fixed, so a run
//! passes or fails for good. A sample that is NaN, infinite or negative makes any check red.

pub mod bench;
pub mod cases;
pub mod measure;
#[cfg(feature = "mutations")]
pub mod mutation_proof;
pub mod registry;
pub mod run;
pub mod stage;
pub mod table;
