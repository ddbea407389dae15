//! Which partials of an open frame are in which objects, and which objects are worth merging. Told, never looks.

use super::partials::Holding;
use farm_film::{SampleBlock, Tile};
use object_store::path::Path;
use std::collections::{BTreeMap, BTreeSet};

/// So many partials that could be merged away are worth an effort, while the store has nothing else to do and while it has:
/// fewer cost no more than a few objects.
const WORTH_IT_IDLE: usize = 4;
const WORTH_IT_BUSY: usize = 64;

/// Bytes of objects that are merged in one go: they are held in memory, coded and decoded, and what is to be acknowledged shares
/// the disk with them.
const BYTES_MAX: usize = 32 << 20;

/// A partial that is part of no other.
#[derive(Clone, Copy, Debug)]
struct Node {
    block: SampleBlock,
    /// The object that holds it.
    object: u64,
}

/// The durable partials of one frame.
#[derive(Debug)]
pub struct Shelf {
    /// Siblings merge within these: a coordinator that starts again sees how the error fell from one to the next.
    rounds: Vec<SampleBlock>,
    /// By number, as they came.
    objects: BTreeMap<u64, Holding>,
    next: u64,
    /// By first sample.
    tiles: BTreeMap<Tile, Vec<Node>>,
    nodes: usize,
    /// By how many there are more nodes than there would be if all siblings were merged.
    surplus: usize,
    /// What of that an effort in vain has left.
    stuck: usize,
}

/// Objects that are to be merged with each other.
pub struct Crowd(pub(super) Vec<Path>);

impl Crowd {
    /// How many they are.
    #[expect(clippy::len_without_is_empty, reason = "one that is empty is none")]
    pub fn len(&self) -> usize {
        self.0.len()
    }
}

impl Shelf {
    /// An empty one, of a job with such rounds, in order.
    pub fn new(rounds: Vec<SampleBlock>) -> Self {
        let (objects, tiles) = (BTreeMap::new(), BTreeMap::new());
        Self { rounds, objects, next: 0, tiles, nodes: 0, surplus: 0, stuck: 0 }
    }

    /// Notes an object that is durable, and that is the one to keep where another holds the same.
    pub fn add(&mut self, holding: Holding) {
        let object = self.next;
        self.next += 1;
        for &(tile, block) in &holding.parts {
            self.change(tile, |nodes| {
                if !nodes.iter().any(|node| node.block != block && node.block.contains(block)) {
                    nodes.retain(|node| !block.contains(node.block));
                    let place = nodes.partition_point(|node| node.block.start() < block.start());
                    nodes.insert(place, Node { block, object });
                }
            });
        }
        self.objects.insert(object, holding);
    }

    /// Takes those objects out that hold nothing but parts of what is in others: a coordinator was killed after it had merged
    /// them.
    pub fn take_superfluous(&mut self) -> Vec<Path> {
        let needed: BTreeSet<u64> = self.tiles.values().flatten().map(|node| node.object).collect();
        let superfluous = self.objects.extract_if(.., |number, _| !needed.contains(number));
        superfluous.map(|(_, holding)| holding.path).collect()
    }

    /// What is to be merged now, if anything: there is something when a fifth of all nodes goes by it, and half of them while the
    /// store is busy, so that each partial is written a few times at most. Always makes fewer nodes of them.
    pub fn crowd(&self, is_busy: bool) -> Option<Crowd> {
        let left = self.nodes - self.surplus;
        let enough = if is_busy { left.max(WORTH_IT_BUSY) } else { (left / 4).max(WORTH_IT_IDLE) };
        if self.surplus.saturating_sub(self.stuck) < enough {
            return None;
        }
        let (mut numbers, mut bytes) = (BTreeSet::new(), 0);
        for pair in self.tiles.values().flat_map(|nodes| nodes.windows(2)) {
            let (left, right) = (pair[0], pair[1]);
            if parent_within(&self.rounds, left.block, right.block).is_none() {
                continue;
            }
            let both = [left.object, right.object];
            let new = both.iter().filter(|number| !numbers.contains(*number));
            let more: usize = new.map(|number| self.objects[number].bytes).sum();
            if numbers.is_empty() || bytes + more <= BYTES_MAX {
                bytes += more;
                numbers.extend(both);
            }
        }
        Some(Crowd(numbers.iter().map(|number| self.objects[number].path.clone()).collect()))
    }

    /// Notes that a crowd was replaced.
    pub fn replaced(&mut self, crowd: &Crowd, by: Vec<Holding>) {
        let gone: BTreeSet<&Path> = crowd.0.iter().collect();
        let gone = self.objects.extract_if(.., |_, holding| gone.contains(&holding.path));
        for (number, holding) in gone.collect::<Vec<_>>() {
            for (tile, _) in holding.parts {
                self.change(tile, |nodes| nodes.retain(|node| node.object != number));
            }
        }
        by.into_iter().for_each(|holding| self.add(holding));
        self.stuck = 0;
    }

    /// Notes that nothing came of an effort: it is worth another one when there is more.
    pub fn in_vain(&mut self) {
        self.stuck = self.surplus;
    }

    fn change(&mut self, tile: Tile, change: impl FnOnce(&mut Vec<Node>)) {
        let nodes = self.tiles.entry(tile).or_default();
        let before = (nodes.len(), surplus(nodes, &self.rounds));
        change(nodes);
        self.nodes = self.nodes - before.0 + nodes.len();
        self.surplus = self.surplus - before.1 + surplus(nodes, &self.rounds);
    }
}

/// The parent of two blocks that are siblings, where it is part of a round.
pub(super) fn parent_within(
    rounds: &[SampleBlock],
    block: SampleBlock,
    other: SampleBlock,
) -> Option<SampleBlock> {
    let parent = block.parent().filter(|_| block.sibling() == Some(other))?;
    let after = rounds.partition_point(|round| round.start() <= parent.start());
    rounds[..after].last().filter(|round| round.contains(parent)).map(|_| parent)
}

fn surplus(nodes: &[Node], rounds: &[SampleBlock]) -> usize {
    let mut merged: Vec<SampleBlock> = Vec::new();
    for node in nodes {
        let mut block = node.block;
        while let Some(parent) = merged.last().and_then(|last| parent_within(rounds, *last, block)) {
            merged.pop();
            block = parent;
        }
        merged.push(block);
    }
    nodes.len() - merged.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tile(x: u32) -> Tile {
        Tile::new(x * 8, 0, x * 8 + 8, 8).unwrap()
    }

    fn block(range: std::ops::Range<u64>) -> SampleBlock {
        SampleBlock::new(range).unwrap()
    }

    fn shelf() -> Shelf {
        Shelf::new([0..16, 16..32, 32..64, 64..128].map(block).into())
    }

    fn holding(name: &str, bytes: usize, parts: &[(u32, std::ops::Range<u64>)]) -> Holding {
        let parts = parts.iter().map(|(x, range)| (tile(*x), block(range.clone()))).collect();
        Holding { path: Path::from(name), bytes, parts }
    }

    /// An object for each block, that has it of as many tiles.
    fn add_layers(shelf: &mut Shelf, tiles: u32, bytes: usize, blocks: &[std::ops::Range<u64>]) {
        for range in blocks {
            let parts: Vec<_> = (0..tiles).map(|x| (x, range.clone())).collect();
            shelf.add(holding(&format!("{}-{}", range.start, range.end), bytes, &parts));
        }
    }

    #[test]
    fn siblings_within_a_round_could_be_one() {
        let mut shelf = shelf();
        add_layers(&mut shelf, 1, 9, &[0..16, 16..32, 48..64, 32..48, 112..128, 96..112, 64..96]);
        assert_eq!((shelf.nodes, shelf.surplus), (7, 3), "one per round would be left");
        shelf.add(holding("again", 9, &[(0, 32..48)]));
        assert_eq!((shelf.nodes, shelf.surplus), (7, 3), "a part of what is there changes nothing");
        shelf.add(holding("parent", 9, &[(0, 32..64)]));
        assert_eq!((shelf.nodes, shelf.surplus), (6, 2), "what is part of it counts no more");
        let mut superfluous = shelf.take_superfluous();
        superfluous.sort();
        assert_eq!(superfluous, ["32-48", "48-64", "again"].map(Path::from));
        assert!(shelf.take_superfluous().is_empty());
    }

    #[test]
    fn it_is_crowded_when_half_of_it_could_go() {
        let mut shelf = shelf();
        add_layers(&mut shelf, 100, 9, &[0..16, 32..48, 48..64]);
        assert_eq!((shelf.nodes, shelf.surplus), (300, 100));
        assert!(shelf.crowd(true).is_none());
        assert_eq!(
            shelf.crowd(false).unwrap().len(),
            2,
            "a fifth is enough where there is nothing else to do"
        );
        add_layers(&mut shelf, 100, 9, &[96..112, 112..128, 64..80, 80..96]);
        assert_eq!((shelf.nodes, shelf.surplus), (700, 400));
        let crowd = shelf.crowd(true).unwrap();
        assert_eq!(crowd.len(), 6, "all but the one that has no sibling");
        shelf.in_vain();
        assert!(shelf.crowd(false).is_none());
        shelf.replaced(&crowd, Vec::new());
        add_layers(&mut shelf, 100, 9, &[32..64, 64..128]);
        assert_eq!((shelf.nodes, shelf.surplus, shelf.objects.len()), (300, 0, 3));
        assert!(shelf.crowd(false).is_none());
    }

    #[test]
    fn what_is_merged_at_once_fits_in_memory() {
        let mut shelf = shelf();
        add_layers(&mut shelf, 100, BYTES_MAX / 3, &[32..48, 64..80, 80..96, 48..64]);
        let crowd = shelf.crowd(true).unwrap();
        assert_eq!(crowd.0, ["32-48", "48-64"].map(Path::from), "two siblings, and no more than fits");
    }
}
