//! The shape of a tree: a binary one by locally-ordered clustering and reinsertion, then folded into eight-wide nodes.
//!
//! The shape decides the time of a ray, never its answer.

use obvhs::{
    aabb::Aabb,
    bvh2::{Bvh2, reinsertion::ReinsertionOptimizer},
    ploc::{PlocBuilder, PlocSearchDistance, SortPrecision},
};

use super::bounds::Box3;

/// Children of a node.
pub(super) const WIDTH: usize = 8;

/// Relative cost of testing a leaf's packet against that of a node.
const PACKET_COST: f32 = 1.0;

/// Share of the nodes that each round of reinsertion looks at.
const REINSERTION: f32 = 0.05;

/// What a place in a wide node holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Slot {
    Empty,
    /// Index of a node, larger than that of the node it stands in.
    Node(u32),
    /// Index into [`Tree::leaves`].
    Leaf(u32),
}

/// The shape of a wide tree.
#[derive(Debug, Default)]
pub(super) struct Tree {
    /// Parents before children; the first is the root. No node at all when one leaf holds everything.
    pub nodes: Vec<[Slot; WIDTH]>,
    /// Ranges of `primitives`.
    pub leaves: Vec<std::ops::Range<u32>>,
    /// Primitives in the order of the leaves.
    pub primitives: Vec<u32>,
    /// Nodes on the longest way to a leaf.
    pub depth: usize,
}

impl Tree {
    /// Builds over the boxes of primitives, at most `leaf_max` of them in a leaf. Boxes are finite.
    pub fn build(boxes: &[Box3], leaf_max: usize) -> Self {
        if boxes.is_empty() {
            return Self::default();
        }
        if boxes.len() <= leaf_max {
            let all = 0..boxes.len() as u32;
            return Self { leaves: vec![all.clone()], primitives: all.collect(), ..Self::default() };
        }
        let binary = binary_tree(boxes);
        let plan = Plan::new(&binary, leaf_max);
        let mut tree = Self::default();
        tree.primitives.reserve(boxes.len());
        tree.emit(&binary, &plan);
        tree
    }

    fn emit(&mut self, binary: &Bvh2, plan: &Plan) {
        self.nodes.push([Slot::Empty; WIDTH]);
        let mut pending = vec![(0usize, 0u32, 1usize)];
        let mut children = Vec::with_capacity(WIDTH);
        while let Some((wide, root, depth)) = pending.pop() {
            self.depth = self.depth.max(depth);
            children.clear();
            plan.children(binary, root, &mut children);
            for (slot, &child) in children.iter().enumerate() {
                self.nodes[wide][slot] = if plan.is_leaf(child) {
                    self.leaf(binary, child)
                } else {
                    self.nodes.push([Slot::Empty; WIDTH]);
                    pending.push((self.nodes.len() - 1, child, depth + 1));
                    Slot::Node(self.nodes.len() as u32 - 1)
                };
            }
        }
    }

    fn leaf(&mut self, binary: &Bvh2, root: u32) -> Slot {
        let first = self.primitives.len() as u32;
        let mut pending = vec![root];
        while let Some(index) = pending.pop() {
            let node = &binary.nodes[index as usize];
            if node.is_leaf() {
                self.primitives.push(binary.primitive_indices[node.first_index as usize]);
            } else {
                pending.extend([node.first_index + 1, node.first_index]);
            }
        }
        self.leaves.push(first..self.primitives.len() as u32);
        Slot::Leaf(self.leaves.len() as u32 - 1)
    }
}

/// One primitive per leaf; at least two primitives.
fn binary_tree(boxes: &[Box3]) -> Bvh2 {
    let whole = boxes.iter().fold(Box3::EMPTY, |a, b| a.union(*b));
    let scale = power_of_two_scale(whole);
    let aabbs: Vec<Aabb> = boxes
        .iter()
        .enumerate()
        .map(|(i, b)| {
            let nudge = nudge(i as u32, b, scale);
            Aabb::new((b.low * scale + nudge).into(), (b.high * scale + nudge).into())
        })
        .collect();
    let indices = (0..boxes.len() as u32).collect();
    let mut binary = PlocBuilder::with_capacity(boxes.len()).build(
        PlocSearchDistance::Medium,
        &aabbs,
        indices,
        SortPrecision::U64,
        2,
    );
    // Back to the true boxes: children still stand behind their parents.
    for i in (0..binary.nodes.len()).rev() {
        let node = binary.nodes[i];
        let aabb = if node.is_leaf() {
            let b = &boxes[binary.primitive_indices[node.first_index as usize] as usize];
            Aabb::new((b.low * scale).into(), (b.high * scale).into())
        } else {
            let first = node.first_index as usize;
            binary.nodes[first].aabb().union(binary.nodes[first + 1].aabb())
        };
        binary.nodes[i].set_aabb(aabb);
    }
    ReinsertionOptimizer::default().run(&mut binary, REINSERTION, None);
    binary
}

/// Brings the scene to about unit size, so that no area leaves the range of f32 and the shape does not hang on the unit of length.
fn power_of_two_scale(whole: Box3) -> f32 {
    let size = (whole.high * 0.5 - whole.low * 0.5).max_element();
    let exponent = i32::from((size.to_bits() >> 23) as u8) - 127;
    f32::from_bits(((127 - exponent).clamp(1, 254) as u32) << 23)
}

/// Moves each box by a hair of its own. Clustering merges boxes that choose each other; among boxes in an exactly regular row,
/// or all the same, everyone's choice would be the next one, and each pass over the row would merge a single pair.
fn nudge(index: u32, b: &Box3, scale: f32) -> glam::Vec3 {
    const OF_SIZE: f32 = 1.0 / (1 << 14) as f32;
    const OF_PLACE: f32 = 1.0 / (1 << 21) as f32;
    let size = (b.high - b.low).max_element();
    let place = b.low.abs().max(b.high.abs()).max_element();
    let hash = (u64::from(index) + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let hash = (hash ^ (hash >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 16;
    let part = |shift: u32| ((hash >> shift) & 0xFFFF) as f32 / 65536.0;
    glam::Vec3::new(part(0), part(16), part(32)) * ((size * OF_SIZE).max(place * OF_PLACE) * scale)
}

/// The cheapest way to fold each binary subtree into at most i wide slots, by dynamic programming (Ylitie, Karras, Laine 2017,
/// "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", section 3.1).
struct Plan {
    entries: Vec<PlanEntry>,
}

#[derive(Clone, Copy)]
struct PlanEntry {
    /// Cost when represented by at most 1..=7 slots.
    cost: [f32; WIDTH - 1],
    /// For 2..=8 slots: how many go to the left child; none means that one slot fewer is as good.
    left: [u8; WIDTH - 1],
    /// Primitives below, capped well above any leaf's.
    primitives: u8,
    leaf: bool,
}

impl Plan {
    fn new(binary: &Bvh2, leaf_max: usize) -> Self {
        let blank = PlanEntry { cost: [0.0; WIDTH - 1], left: [0; WIDTH - 1], primitives: 1, leaf: true };
        let mut plan = Self { entries: vec![blank; binary.nodes.len()] };
        for index in children_first(binary) {
            plan.visit(binary, index as usize, leaf_max);
        }
        plan.entries[0].leaf = false;
        plan
    }

    fn visit(&mut self, binary: &Bvh2, index: usize, leaf_max: usize) {
        let node = &binary.nodes[index];
        let area = node.aabb().half_area();
        if node.is_leaf() {
            self.entries[index].cost = [area * PACKET_COST; WIDTH - 1];
            return;
        }
        let first = node.first_index as usize;
        let (a, b) = (self.entries[first], self.entries[first + 1]);
        let mut entry = PlanEntry {
            cost: [0.0; WIDTH - 1],
            left: [0; WIDTH - 1],
            primitives: (a.primitives + b.primitives).min(100),
            leaf: false,
        };
        let distribute = |slots: usize| {
            let (mut best, mut left) = (f32::INFINITY, 1);
            for l in 1..slots {
                let r = slots - l;
                if l < WIDTH && r < WIDTH && a.cost[l - 1] + b.cost[r - 1] < best {
                    (best, left) = (a.cost[l - 1] + b.cost[r - 1], l);
                }
            }
            (best, left as u8)
        };
        let (inner, left) = distribute(WIDTH);
        entry.left[WIDTH - 2] = left;
        entry.cost[0] = inner + area;
        if usize::from(entry.primitives) <= leaf_max && area * PACKET_COST <= entry.cost[0] {
            (entry.cost[0], entry.leaf) = (area * PACKET_COST, true);
        }
        for slots in 2..WIDTH {
            let (cost, left) = distribute(slots);
            (entry.cost[slots - 1], entry.left[slots - 2]) =
                if cost < entry.cost[slots - 2] { (cost, left) } else { (entry.cost[slots - 2], 0) };
        }
        self.entries[index] = entry;
    }

    fn is_leaf(&self, index: u32) -> bool {
        self.entries[index as usize].leaf
    }

    /// The binary nodes that become the children of the wide node in `root`'s place.
    fn children(&self, binary: &Bvh2, root: u32, out: &mut Vec<u32>) {
        self.spread(binary, root, WIDTH, true, out);
    }

    fn spread(&self, binary: &Bvh2, index: u32, slots: usize, opened: bool, out: &mut Vec<u32>) {
        if slots == 1 && !opened {
            out.push(index);
            return;
        }
        let left = usize::from(self.entries[index as usize].left[slots - 2]);
        let first = binary.nodes[index as usize].first_index;
        if binary.nodes[index as usize].is_leaf() {
            out.push(index);
        } else if left == 0 {
            self.spread(binary, index, slots - 1, false, out);
        } else {
            self.spread(binary, first, left, false, out);
            self.spread(binary, first + 1, slots - left, false, out);
        }
    }
}

/// Every child before its parent; reinsertion leaves the nodes in no order.
fn children_first(binary: &Bvh2) -> Vec<u32> {
    let mut order = Vec::with_capacity(binary.nodes.len());
    let mut pending = vec![0u32];
    while let Some(index) = pending.pop() {
        order.push(index);
        let node = &binary.nodes[index as usize];
        if !node.is_leaf() {
            pending.extend([node.first_index, node.first_index + 1]);
        }
    }
    order.reverse();
    order
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    fn check(boxes: &[Box3], leaf_max: usize) -> Tree {
        let tree = Tree::build(boxes, leaf_max);
        let mut seen: Vec<u32> = tree.primitives.clone();
        seen.sort_unstable();
        assert!(seen.iter().enumerate().all(|(i, &p)| i == p as usize), "each primitive is in one leaf");
        assert_eq!(seen.len(), boxes.len());
        let mut reached = (0, 0);
        for slot in tree.nodes.iter().flatten() {
            match slot {
                Slot::Node(_) => reached.0 += 1,
                Slot::Leaf(leaf) => {
                    reached.1 += 1;
                    assert!(tree.leaves[*leaf as usize].len() <= leaf_max);
                }
                Slot::Empty => {}
            }
        }
        if !tree.nodes.is_empty() {
            assert_eq!(reached, (tree.nodes.len() - 1, tree.leaves.len()));
        }
        tree
    }

    fn unit_box_at(p: Vec3) -> Box3 {
        Box3 { low: p, high: p + Vec3::ONE }
    }

    #[test]
    fn every_primitive_is_in_exactly_one_leaf() {
        for count in [0, 1, 2, 7, 8, 9, 100, 1000] {
            let boxes: Vec<_> = (0..count)
                .map(|i| unit_box_at(Vec3::new((i * 7 % 13) as f32, (i * 5 % 11) as f32, i as f32 * 0.1)))
                .collect();
            for leaf_max in [1, 4, 8] {
                check(&boxes, leaf_max);
            }
        }
    }

    #[test]
    fn rows_and_heaps_of_equal_boxes_make_shallow_trees() {
        let same = vec![unit_box_at(Vec3::ONE); 50_000];
        let row: Vec<_> = (0..50_000).map(|i| unit_box_at(Vec3::X * i as f32)).collect();
        for boxes in [same, row] {
            let tree = check(&boxes, 8);
            assert!(tree.depth < 40, "depth {}", tree.depth);
        }
    }
}
