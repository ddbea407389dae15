//! Randomness by address: the numbers of a sample depend on who asks, never on who asked before.
//!
//! An address is (seed, frame, pixel, sample index, dimension set). A set is four numbers that belong together: they are one
//! point of a four-dimensional low-discrepancy sequence. Sets are padded: each shuffles the sample indices anew and scrambles
//! its points anew (Burley 2020, "Practical Hash-based Owen Scrambling", section 5). The shuffle is nested as well, so the
//! samples `[j 2^k, (j+1) 2^k)` of a pixel are, in every set, a digital net of their own: rendering blocks of samples in
//! different places, or adding more samples later, costs no convergence.

mod hash;
mod owen;
mod sobol;

use crate::math;
pub(crate) use hash::mix;

/// How the numbers of a pixel's samples hang together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sequence {
    /// Owen-scrambled Sobol points.
    #[default]
    Sobol,
    /// Independent numbers, to measure what the other is worth.
    Independent,
}

/// The random numbers of one sample of one pixel.
#[derive(Clone, Copy, Debug)]
pub struct Sampler {
    sequence: Sequence,
    /// Of the pixel's sequence; of the sample for independent numbers.
    key: u64,
    /// Low half of the sample index, lowest bit first, ready to be shuffled.
    index: owen::Digits,
}

impl Sampler {
    /// The Sobol numbers of sample `index` of the pixel at column `x`, row `y`.
    pub fn new(seed: u64, frame: u32, x: u32, y: u32, index: u64) -> Self {
        Self::with_sequence(Sequence::Sobol, seed, frame, x, y, index)
    }

    /// The numbers of sample `index` of the pixel at column `x`, row `y`, from the given kind of sequence.
    pub fn with_sequence(sequence: Sequence, seed: u64, frame: u32, x: u32, y: u32, index: u64) -> Self {
        // The sequence has 2^32 points; what comes after is another sequence.
        let (high, low) = ((index >> 32) as u32, index as u32);
        #[cfg(feature = "mutations")]
        let ((x, y), low) = (crate::mutations::pixel_of_sequence(x, y), crate::mutations::low_index(low));
        let mut key = mix(mix(mix(seed) ^ join(x, y)) ^ join(frame, high));
        if sequence == Sequence::Independent {
            key = mix(key ^ u64::from(low));
        }
        Self { sequence, key, index: owen::Digits::from_reversed(low.reverse_bits()) }
    }

    /// A number of the sample and a dimension set, from which any amount of independent randomness can be hashed.
    pub fn key(&self, dimension_set: u32) -> u64 {
        mix(mix(self.key ^ hash::spread(dimension_set)) ^ u64::from(self.index.bits()))
    }

    /// The four numbers in [0, 1) of a dimension set. Two sets of one sample are independent of each other.
    ///
    /// The first two are distributed best: any box of a power-of-two number of samples holds exactly its share of them. They belong
    /// to what matters most: a direction, a point of a light.
    pub fn set(&self, dimension_set: u32) -> [f32; 4] {
        let key = mix(self.key ^ hash::spread(dimension_set));
        let bits = match self.sequence {
            Sequence::Sobol => {
                let index_reversed = self.index.scramble((key >> 32) as u32);
                let seeds = hash::four(key);
                let point = sobol::point_reversed(index_reversed).map(owen::Digits::from_reversed);
                core::array::from_fn(|i| point[i].scramble(seeds[i]).reverse_bits())
            }
            Sequence::Independent => hash::four(key),
        };
        bits.map(math::unit_f32)
    }
}

fn join(low: u32, high: u32) -> u64 {
    u64::from(high) << 32 | u64::from(low)
}

#[cfg(test)]
mod tests;
