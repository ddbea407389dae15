//! Ranges of sample indices, and the aligned blocks that are nodes of the merge tree.
//!
//! Sample indices are split into leaves of [`LEAF_SAMPLES`]; a block is a leaf or the union of two sibling blocks.
//! A sample count that is no multiple of the leaf ends with one short leaf.

use serde::{Deserialize, Serialize};

/// Samples per pixel of a leaf: summed in index order in f64 and rounded once.
pub const LEAF_SAMPLES: u64 = 16;

/// Largest sample index a range may reach; leaves room for doubling without overflow.
const SAMPLES_MAX: u64 = 1 << 62;

/// A range or block that cannot be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SampleBlockError {
    /// No sample, or reversed, or absurdly far.
    #[error("sample range {start}..{end} is empty, reversed or too large")]
    Range {
        /// First index.
        start: u64,
        /// One past the last index.
        end: u64,
    },
    /// Not a node of the merge tree.
    #[error(
        "sample range {start}..{end} is no block of the merge tree: a block starts at a multiple of its length, \
         and its length is {LEAF_SAMPLES} times a power of two, or less than {LEAF_SAMPLES} for a last leaf"
    )]
    NotABlock {
        /// First index.
        start: u64,
        /// One past the last index.
        end: u64,
    },
}

/// Half-open, non-empty range of sample indices per pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct SampleRange {
    start: u64,
    end: u64,
}

impl SampleRange {
    /// `range`, refused when it is empty.
    pub fn new(range: std::ops::Range<u64>) -> Result<Self, SampleBlockError> {
        if range.start < range.end && range.end <= SAMPLES_MAX {
            Ok(Self { start: range.start, end: range.end })
        } else {
            Err(SampleBlockError::Range { start: range.start, end: range.end })
        }
    }

    /// First index.
    pub fn start(self) -> u64 {
        self.start
    }

    /// One past the last index.
    pub fn end(self) -> u64 {
        self.end
    }

    /// The fewest blocks that make up this range, in index order. `start` must be a multiple of the leaf.
    pub fn blocks(self) -> Result<Vec<SampleBlock>, SampleBlockError> {
        if !self.start.is_multiple_of(LEAF_SAMPLES) {
            return Err(SampleBlockError::NotABlock { start: self.start, end: self.end });
        }
        let mut blocks = Vec::new();
        let mut start = self.start;
        while start < self.end {
            let left = self.end - start;
            let len = if left < LEAF_SAMPLES {
                left
            } else {
                let aligned = if start == 0 { u64::MAX } else { start & start.wrapping_neg() };
                aligned.min(1 << left.ilog2())
            };
            blocks.push(SampleBlock { start, len });
            start += len;
        }
        Ok(blocks)
    }
}

/// A node of the merge tree: `[start, start + len)` with `len` the leaf times a power of two and `start` a multiple of
/// `len`; or a last leaf of fewer samples, which has no sibling.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "SampleRange", into = "SampleRange")]
pub struct SampleBlock {
    start: u64,
    len: u64,
}

impl TryFrom<SampleRange> for SampleBlock {
    type Error = SampleBlockError;

    fn try_from(range: SampleRange) -> Result<Self, SampleBlockError> {
        let (start, len) = (range.start, range.end.saturating_sub(range.start));
        let is_block = if len < LEAF_SAMPLES {
            len > 0 && start.is_multiple_of(LEAF_SAMPLES)
        } else {
            len.is_power_of_two() && start.is_multiple_of(len)
        };
        if is_block && range.end <= SAMPLES_MAX {
            Ok(Self { start, len })
        } else {
            Err(SampleBlockError::NotABlock { start: range.start, end: range.end })
        }
    }
}

impl From<SampleBlock> for SampleRange {
    fn from(block: SampleBlock) -> Self {
        Self { start: block.start, end: block.end() }
    }
}

impl SampleBlock {
    /// The block `[start, end)`; refuses a range that is no node of the tree.
    pub fn new(range: std::ops::Range<u64>) -> Result<Self, SampleBlockError> {
        SampleRange::new(range)?.try_into()
    }

    /// First index.
    pub fn start(self) -> u64 {
        self.start
    }

    /// One past the last index.
    pub fn end(self) -> u64 {
        self.start + self.len
    }

    /// Samples per pixel.
    pub fn samples(self) -> u64 {
        self.len
    }

    /// A leaf is summed sample by sample; anything else is the sum of its halves.
    pub fn is_leaf(self) -> bool {
        self.len <= LEAF_SAMPLES
    }

    /// The other half of this block's parent; none for a short last leaf.
    pub fn sibling(self) -> Option<Self> {
        (self.len >= LEAF_SAMPLES).then_some(Self { start: self.start ^ self.len, len: self.len })
    }

    /// The block that this one is half of; none for a short last leaf.
    pub fn parent(self) -> Option<Self> {
        (self.len >= LEAF_SAMPLES).then_some(Self { start: self.start & !self.len, len: self.len * 2 })
    }

    /// Both halves, left first; none for a leaf.
    pub fn children(self) -> Option<(Self, Self)> {
        let len = self.len / 2;
        (!self.is_leaf()).then_some((Self { start: self.start, len }, Self { start: self.start + len, len }))
    }

    /// Whether every sample of `other` is one of this block's.
    pub fn contains(self, other: Self) -> bool {
        self.start <= other.start && other.end() <= self.end()
    }

    /// Whether the two blocks share a sample.
    pub fn overlaps(self, other: Self) -> bool {
        self.start < other.end() && other.start < self.end()
    }
}

impl std::fmt::Display for SampleBlock {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}..{}", self.start, self.end())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn lengths(range: std::ops::Range<u64>) -> Vec<u64> {
        SampleRange::new(range).unwrap().blocks().unwrap().into_iter().map(SampleBlock::samples).collect()
    }

    #[test]
    fn a_range_is_a_short_list_of_blocks() {
        assert_eq!(lengths(0..100), [64, 32, 4]);
        assert_eq!(lengths(0..16), [16]);
        assert_eq!(lengths(0..7), [7]);
        assert_eq!(lengths(16..64), [16, 32]);
        assert_eq!(lengths(0..1 << 40), [1 << 40]);
    }

    #[test]
    fn what_is_no_block_is_refused() {
        for (start, end) in [(0, 0), (16, 0), (8, 16), (16, 48), (0, 48), (3, 5), (0, 17), (0, 1 << 63)] {
            assert!(SampleBlock::new(start..end).is_err(), "{start}..{end} is no block");
        }
    }

    proptest! {
        #[test]
        fn blocks_of_a_range_are_adjacent_nodes_of_the_tree(leaf in 0u64..1 << 20, len in 1u64..1 << 30) {
            let start = leaf * LEAF_SAMPLES;
            let blocks = SampleRange::new(start..start + len).unwrap().blocks().unwrap();
            let mut next = start;
            for block in &blocks {
                prop_assert_eq!(block.start(), next);
                prop_assert_eq!(SampleBlock::new(block.start()..block.end()), Ok(*block));
                next = block.end();
            }
            prop_assert_eq!(next, start + len);
            prop_assert!(blocks.len() <= 2 * 64);
        }

        #[test]
        fn siblings_share_a_parent_whose_children_they_are(level in 0u32..20, index in 0u64..1000) {
            let len = LEAF_SAMPLES << level;
            let block = SampleBlock::new(index * len..(index + 1) * len).unwrap();
            let sibling = block.sibling().unwrap();
            prop_assert_eq!(block.parent(), sibling.parent());
            let (left, right) = block.parent().unwrap().children().unwrap();
            prop_assert!((left, right) == (block, sibling) || (left, right) == (sibling, block));
        }
    }
}
