//! The order of samples within a frame: whole pictures, one after the other.

use farm_film::{SampleBlock, SampleBlockError, SampleRange};

/// The first and largest block of `[0, spp)` opened up into doublings, `[0,16) [16,32) [32,64) ..`, then the smaller ones that
/// follow it.
pub(crate) fn rounds(spp: u64) -> Result<Vec<SampleBlock>, SampleBlockError> {
    let blocks = SampleRange::new(0..spp)?.blocks()?;
    let mut doublings = Vec::new();
    let mut first = blocks[0];
    while let Some((left, right)) = first.children() {
        doublings.push(right);
        first = left;
    }
    Ok([first].into_iter().chain(doublings.into_iter().rev()).chain(blocks[1..].iter().copied()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ends(spp: u64) -> Vec<u64> {
        rounds(spp).unwrap().into_iter().map(SampleBlock::end).collect()
    }

    #[test]
    fn rounds_double_a_picture_and_end_with_what_is_left() {
        assert_eq!(ends(64), [16, 32, 64]);
        assert_eq!(ends(100), [16, 32, 64, 96, 100]);
        assert_eq!(ends(7), [7]);
        assert_eq!(ends(24), [16, 24]);
        assert!(ends((1 << 61) + 1).len() < usize::from(u8::MAX));
    }

    #[test]
    fn rounds_follow_each_other() {
        for spp in [1, 1000, 12_345, 1 << 20] {
            let mut next = 0;
            for round in rounds(spp).unwrap() {
                assert_eq!(round.start(), next);
                next = round.end();
            }
            assert_eq!(next, spp);
        }
    }
}
