//! The way of one ray through one tree, nearest first.

use std::mem::MaybeUninit;

use super::{
    lanes::Lanes,
    node::{Link, NodeRay, Wide, WideNode},
    ray::{Hit, LocalRay},
    triangle::Meeting,
};

/// A search for hits of one ray: what is best so far, and what counts at all.
pub(super) struct Search<'a, F> {
    /// Nothing farther than this matters.
    pub t_max: f32,
    pub best: Option<Hit>,
    pub filter: &'a mut F,
}

impl<F: FnMut(&Hit) -> bool> Search<'_, F> {
    /// Takes a hit if it is the nearest so far; among equally near ones the smallest (instance, primitive) wins. Whether
    /// it was taken.
    #[inline(always)]
    pub fn offer(&mut self, meeting: Meeting, instance: u32, primitive: u32) -> bool {
        let Meeting { t, u, v } = meeting;
        let beaten = self
            .best
            .is_some_and(|best| t == best.t && (best.instance, best.primitive) <= (instance, primitive));
        let hit = Hit { t, instance, primitive, u, v };
        if t > self.t_max || beaten || !(self.filter)(&hit) {
            return false;
        }
        self.t_max = t;
        self.best = Some(hit);
        true
    }
}

/// Stack entries kept off the heap: trees of up to 36 levels.
const SMALL_STACK: usize = 256;

/// A link and the distance at which the ray enters it; ordered by distance, because bits of positive numbers are.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Step(u64);

impl Step {
    #[inline(always)]
    fn new(near: f32, link: Link) -> Self {
        Self(u64::from(near.to_bits()) << 32 | u64::from(link.0))
    }

    #[inline(always)]
    fn near(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32)
    }

    #[inline(always)]
    fn link(self) -> Link {
        Link(self.0 as u32)
    }
}

/// What happens at the leaves of a tree. Not a closure, because the compiler cannot be told to inline one, and what is not inlined
/// below a function compiled for AVX2 is not compiled for it.
pub(super) trait Visit<F> {
    /// Looks at a leaf whose box the ray enters at `near` (zero where the tree is a single leaf). Whether to stop.
    fn leaf(&mut self, search: &mut Search<'_, F>, leaf: u32, near: f32) -> bool;
}

/// Visits the leaves that the ray meets, until one says to stop; returns whether it did.
#[inline(always)]
pub(super) fn walk<S: Lanes, N: WideNode, F>(
    tree: &Wide<N>,
    ray: &LocalRay,
    search: &mut Search<'_, F>,
    visit: &mut impl Visit<F>,
) -> bool {
    let Some(root) = tree.root else { return false };
    if let Some(leaf) = root.leaf() {
        return visit.leaf(search, leaf, 0.0);
    }
    let mut small = [MaybeUninit::<Step>::uninit(); SMALL_STACK];
    let mut large = Vec::new();
    let stack: &mut [MaybeUninit<Step>] = if tree.stack <= SMALL_STACK {
        &mut small
    } else {
        large.resize(tree.stack, MaybeUninit::uninit());
        &mut large
    };
    let mut filled = 0;
    let node_ray = NodeRay::<S>::new(ray);
    let mut step = Step::new(0.0, root);
    loop {
        if let Some(leaf) = step.link().leaf() {
            if visit.leaf(search, leaf, step.near()) {
                return true;
            }
        } else {
            // SAFETY: links were made by `Wide::new` from the indices of these very nodes.
            let node = unsafe { tree.nodes.get_unchecked(step.link().0 as usize) };
            let (mut mask, near) = node.meet(&node_ray, search.t_max);
            if mask != 0 {
                let mut nears = [0.0; 8];
                near.store(&mut nears);
                let links = node.links();
                let lane = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                step = Step::new(nears[lane], links[lane]);
                let bottom = filled;
                while mask != 0 {
                    let lane = mask.trailing_zeros() as usize;
                    mask &= mask - 1;
                    let other = Step::new(nears[lane], links[lane]);
                    let (nearer, farther) = if other < step { (other, step) } else { (step, other) };
                    step = nearer;
                    // Keep the new part of the stack sorted, nearest on top.
                    let mut at = filled;
                    while at > bottom {
                        // SAFETY: entries below `filled` are written.
                        let below = unsafe { stack[at - 1].assume_init() };
                        if farther < below {
                            break;
                        }
                        stack[at].write(below);
                        at -= 1;
                    }
                    stack[at].write(farther);
                    filled += 1;
                }
                continue;
            }
        }
        loop {
            if filled == 0 {
                return false;
            }
            filled -= 1;
            // SAFETY: entries below the old `filled` are written.
            step = unsafe { stack[filled].assume_init() };
            if step.near() <= search.t_max {
                break;
            }
        }
    }
}
