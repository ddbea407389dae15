//! Wide nodes: eight boxes side by side, so that one ray is tested against all at once.

use super::{
    bounds::{Bounds, Box3, MovingBox},
    lanes::{Lanes, splat3},
    ray::LocalRay,
    tree::{Slot, Tree, WIDTH},
};

/// A reference from a node: a node's index, or a leaf's with the top bit set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Link(pub u32);

impl Link {
    const LEAF: u32 = 1 << 31;

    /// The leaf's index, if it is one.
    #[inline(always)]
    pub fn leaf(self) -> Option<u32> {
        (self.0 & Self::LEAF != 0).then_some(self.0 & !Self::LEAF)
    }
}

/// One ray's constants, spread over lanes.
#[derive(Clone, Copy)]
pub(super) struct NodeRay<S> {
    origin: [S; 3],
    inverse_near: [S; 3],
    inverse_far: [S; 3],
    /// Plane met first and plane met last, per axis: 0..3 are the low sides, 3..6 the high ones.
    first: [usize; 3],
    last: [usize; 3],
    time: S,
    rest: S,
}

impl<S: Lanes> NodeRay<S> {
    #[inline(always)]
    pub fn new(ray: &LocalRay) -> Self {
        let [x, y, z] = ray.inverse_near;
        let side =
            |inverse: f32, axis: usize| if inverse >= 0.0 { (axis, axis + 3) } else { (axis + 3, axis) };
        let (x, y, z) = (side(x, 0), side(y, 1), side(z, 2));
        Self {
            origin: splat3(ray.origin),
            inverse_near: splat3(ray.inverse_near),
            inverse_far: splat3(ray.inverse_far),
            first: [x.0, y.0, z.0],
            last: [x.1, y.1, z.1],
            time: S::splat(ray.time),
            rest: S::splat(1.0 - ray.time),
        }
    }
}

/// A node that eight children hang on.
pub(super) trait WideNode: Sized {
    type Bounds: Bounds;

    /// A node over the boxes of its children; empty places have empty boxes.
    fn new(bounds: &[Self::Bounds; WIDTH], links: [Link; WIDTH]) -> Self;

    fn links(&self) -> &[Link; WIDTH];

    /// Side `plane` of all children: 0..3 the low x, y, z, 3..6 the high ones.
    fn plane<S: Lanes>(&self, plane: usize, ray: &NodeRay<S>) -> S;

    /// Which children the ray meets no later than `t_max`, and where it enters them.
    #[inline(always)]
    fn meet<S: Lanes>(&self, ray: &NodeRay<S>, t_max: f32) -> (u32, S) {
        let (mut near, mut far) = (S::splat(0.0), S::splat(t_max));
        for axis in 0..3 {
            let first = self.plane(ray.first[axis], ray);
            near = first.sub(ray.origin[axis]).mul(ray.inverse_near[axis]).max(near);
            let last = self.plane(ray.last[axis], ray);
            far = last.sub(ray.origin[axis]).mul(ray.inverse_far[axis]).min(far);
        }
        (near.at_most(far), near)
    }
}

/// Boxes that stand still.
#[repr(C, align(64))]
pub(super) struct StillNode {
    planes: [[f32; WIDTH]; 6],
    links: [Link; WIDTH],
}

/// Boxes whose sides move on straight lines through the shutter.
#[repr(C, align(64))]
pub(super) struct MovingNode {
    open: [[f32; WIDTH]; 6],
    close: [[f32; WIDTH]; 6],
    links: [Link; WIDTH],
}

fn planes(boxes: impl Fn(usize) -> Box3) -> [[f32; WIDTH]; 6] {
    std::array::from_fn(|plane| {
        std::array::from_fn(|i| {
            let b = boxes(i);
            if plane < 3 { b.low[plane] } else { b.high[plane - 3] }
        })
    })
}

impl WideNode for StillNode {
    type Bounds = Box3;

    fn new(bounds: &[Box3; WIDTH], links: [Link; WIDTH]) -> Self {
        Self { planes: planes(|i| bounds[i]), links }
    }

    #[inline(always)]
    fn links(&self) -> &[Link; WIDTH] {
        &self.links
    }

    #[inline(always)]
    fn plane<S: Lanes>(&self, plane: usize, _: &NodeRay<S>) -> S {
        S::load(&self.planes[plane])
    }
}

impl WideNode for MovingNode {
    type Bounds = MovingBox;

    fn new(bounds: &[MovingBox; WIDTH], links: [Link; WIDTH]) -> Self {
        // The sides of an empty place stay numbers when they are multiplied by zero.
        let finite = |b: Box3| {
            let within = |v: glam::Vec3| v.clamp(glam::Vec3::splat(f32::MIN), glam::Vec3::splat(f32::MAX));
            Box3 { low: within(b.low), high: within(b.high) }
        };
        Self { open: planes(|i| finite(bounds[i].open)), close: planes(|i| finite(bounds[i].close)), links }
    }

    #[inline(always)]
    fn links(&self) -> &[Link; WIDTH] {
        &self.links
    }

    #[inline(always)]
    fn plane<S: Lanes>(&self, plane: usize, ray: &NodeRay<S>) -> S {
        // Rounding of this form is monotone in both ends, so a box stays within its parent's at every moment.
        S::load(&self.open[plane]).mul(ray.rest).add(S::load(&self.close[plane]).mul(ray.time))
    }
}

/// A tree ready for rays.
pub(super) struct Wide<N> {
    pub nodes: Vec<N>,
    /// Where a ray starts; `None` when there is nothing.
    pub root: Option<Link>,
    /// Entries that the stack of a ray may need.
    pub stack: usize,
    /// Nodes on the longest way to a leaf.
    pub depth: usize,
}

impl<N: WideNode> Wide<N> {
    /// Puts boxes into the shape of a tree; `bounds` are those of the leaves. Returns the box of the whole, too.
    pub fn new(tree: &Tree, leaves: &[N::Bounds]) -> (Self, N::Bounds) {
        let mut of_nodes = vec![N::Bounds::EMPTY; tree.nodes.len()];
        let mut nodes = Vec::with_capacity(tree.nodes.len());
        for (index, slots) in tree.nodes.iter().enumerate().rev() {
            let bounds: [N::Bounds; WIDTH] = slots.map(|slot| match slot {
                Slot::Empty => N::Bounds::EMPTY,
                Slot::Node(node) => of_nodes[node as usize],
                Slot::Leaf(leaf) => leaves[leaf as usize],
            });
            of_nodes[index] = bounds.iter().fold(N::Bounds::EMPTY, |a, &b| a.union(b));
            nodes.push(N::new(&bounds, slots.map(link)));
        }
        nodes.reverse();
        let whole = match of_nodes.first() {
            Some(whole) => *whole,
            None => leaves.iter().fold(N::Bounds::EMPTY, |a, &b| a.union(b)),
        };
        let root = match (tree.nodes.is_empty(), tree.leaves.is_empty()) {
            (true, true) => None,
            (true, false) => Some(link(Slot::Leaf(0))),
            (false, _) => Some(link(Slot::Node(0))),
        };
        // Each level leaves at most all but one of its children behind.
        let stack = tree.depth * (WIDTH - 1) + 1;
        (Self { nodes, root, stack, depth: tree.depth }, whole)
    }

    /// Bytes of all nodes.
    pub fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<N>()
    }
}

fn link(slot: Slot) -> Link {
    match slot {
        Slot::Empty => Link(Link::LEAF),
        Slot::Node(index) => Link(index),
        Slot::Leaf(index) => Link(index | Link::LEAF),
    }
}
