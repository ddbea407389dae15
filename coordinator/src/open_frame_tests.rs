//! When frames of made-up samples end.

use super::*;
use farm_film::{Differences, LeafSum, Resolution};
use farm_job::Stop;

const SIDE: u32 = 16;

fn spec(error: f64) -> JobSpec {
    let mut spec = crate::forecast::tests::spec(512, Stop { error: Some(error), ..Stop::default() });
    (spec.settings.width, spec.settings.height, spec.tile_side) = (SIDE, SIDE, SIDE);
    spec
}

/// Independent samples around 1.
fn partial(block: SampleBlock) -> FilmTile {
    if let Some((left, right)) = block.children() {
        return partial(left).merge(partial(right));
    }
    let tile = Resolution::new(SIDE, SIDE).unwrap().full();
    let mut differences = Differences::default();
    let mut leaf = |(x, y): (u32, u32)| {
        let mut leaf = LeafSum::default();
        for index in block.start()..block.end() {
            let mut hash = u64::from(x) << 40 ^ u64::from(y) << 20 ^ index;
            for _ in 0..3 {
                hash = (hash ^ hash >> 31).wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(1);
            }
            leaf.add([(hash >> 40) as f32 / (1 << 23) as f32; 3], &mut differences);
        }
        leaf
    };
    let leaves: Vec<_> = tile.pixels().map(&mut leaf).collect();
    FilmTile::leaf(tile, block, &leaves, differences)
}

/// Samples per pixel after each round, the estimate then, and whether the frame ended there.
fn run(spec: &JobSpec) -> Vec<(u64, ErrorEstimate, bool)> {
    let mut frame = OpenFrame::new(spec).unwrap();
    let mut rounds = Vec::new();
    for block in spec.rounds().unwrap() {
        frame.restore(partial(block), Counters::default()).unwrap();
        let round = frame.round(block.end(), false).unwrap();
        rounds.push((block.end(), frame.outlook().error.unwrap(), round.ends));
        if round.ends {
            break;
        }
    }
    rounds
}

#[test]
fn an_estimate_that_may_be_low_by_chance_does_not_end_a_frame() {
    let all = run(&spec(1e-12));
    let (_, low, _) = *all.iter().find(|(spp, ..)| *spp == 128).unwrap();
    // The estimate after 128 samples is low enough, but not by its own deviation.
    let target = low.rel_mse * 1.02;
    assert!(low.cautious() > target);
    let rounds = run(&spec(target));
    let ((end, error, ends), before) = rounds.split_last().unwrap();
    assert!(*ends && *end > 128 && error.cautious() <= target, "{end}: {error:?}");
    assert!(before.iter().all(|(_, error, ends)| !ends && error.cautious() > target));
    assert!(before.iter().any(|(spp, error, _)| *spp == 128 && error.rel_mse <= target));
}

#[test]
fn what_comes_after_its_tile_has_ended_is_not_counted() {
    let mut frame = OpenFrame::new(&spec(1e-3)).unwrap();
    let blocks = [0..16, 16..32].map(|range| SampleBlock::new(range).unwrap());
    let counters = |block: SampleBlock| Counters { samples: block.samples(), ..Counters::default() };
    frame.restore(partial(blocks[0]), counters(blocks[0])).unwrap();
    frame.ended.insert(partial(blocks[0]).tile(), 16);
    frame.restore(partial(blocks[1]), counters(blocks[1])).unwrap();
    assert_eq!(frame.outlook().samples, 16);
}
