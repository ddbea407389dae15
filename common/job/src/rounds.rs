//! The order of samples within a frame: whole pictures, one after the other.

use farm_film::{SampleBlock, SampleBlockError, SampleRange};

/// Parts of a doubling after each of which a frame may end: a frame that ends for its error or time has at most 1/16 more or
/// fewer samples than it should.
const PARTS: u64 = 16;

/// Doublings beyond this many samples per pixel are not divided: there are few enough rounds to keep books of them all.
const PARTS_UP_TO: u64 = 1 << 20;

/// The first and largest block of `[0, spp)` opened up into doublings, `[0,16) [16,32) [32,64) ..`, then the smaller ones that
/// follow it. `fine`: doublings are divided further, down to leaves.
pub(crate) fn rounds(spp: u64, fine: bool) -> Result<Vec<SampleBlock>, SampleBlockError> {
    let blocks = SampleRange::new(0..spp)?.blocks()?;
    let mut doublings = Vec::new();
    let mut first = blocks[0];
    while let Some((left, right)) = first.children() {
        doublings.push(right);
        first = left;
    }
    let whole = [first].into_iter().chain(doublings.into_iter().rev()).chain(blocks[1..].iter().copied());
    if !fine {
        return Ok(whole.collect());
    }
    Ok(whole.flat_map(parts).collect())
}

/// A block in parts of a sixteenth of the samples before its doubling, or in leaves where these are larger.
fn parts(block: SampleBlock) -> Vec<SampleBlock> {
    let samples = doubling(block.start()) / PARTS;
    let mut parts = vec![block];
    while block.start() < PARTS_UP_TO
        && parts[0].samples() > samples
        && let Some(halves) = parts.iter().map(|part| part.children()).collect::<Option<Vec<_>>>()
    {
        parts = halves.into_iter().flat_map(|(left, right)| [left, right]).collect();
    }
    parts
}

/// The largest power of two up to `sample`.
fn doubling(sample: u64) -> u64 {
    sample.checked_ilog2().map_or(0, |level| 1 << level)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ends(spp: u64, fine: bool) -> Vec<u64> {
        rounds(spp, fine).unwrap().into_iter().map(SampleBlock::end).collect()
    }

    #[test]
    fn rounds_double_a_picture_and_end_with_what_is_left() {
        assert_eq!(ends(64, false), [16, 32, 64]);
        assert_eq!(ends(100, false), [16, 32, 64, 96, 100]);
        assert_eq!(ends(7, false), [7]);
        assert_eq!(ends(24, false), [16, 24]);
        assert!(ends((1 << 61) + 1, false).len() < usize::from(u8::MAX));
    }

    #[test]
    fn fine_rounds_end_often_and_at_every_power_of_two() {
        assert_eq!(ends(100, true), [16, 32, 48, 64, 80, 96, 100]);
        let all = ends(1 << 40, true);
        assert!(all.len() < usize::from(u8::MAX), "{} rounds", all.len());
        for pair in all.windows(2).filter(|pair| pair[0] >= 256 && pair[1] <= PARTS_UP_TO) {
            assert!(pair[1] - pair[0] <= pair[0] / 16, "{pair:?}");
        }
        assert!((4..40).all(|level| all.contains(&(1 << level))));
    }

    #[test]
    fn rounds_follow_each_other() {
        for (spp, fine) in [(1, false), (1000, false), (1000, true), (12_345, true), (1 << 20, true)] {
            let mut next = 0;
            for round in rounds(spp, fine).unwrap() {
                assert_eq!(round.start(), next);
                next = round.end();
            }
            assert_eq!(next, spp);
        }
    }
}
