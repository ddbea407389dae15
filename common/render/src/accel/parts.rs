//! The trees of an [`Accel`](super::Accel): baked triangles, shared meshes, deforming meshes, and the level above them.

use std::sync::Arc;

use glam::Vec3;

use super::{
    bounds::{Bounds, Box3, MovingBox},
    geometry::TriangleMesh,
    lanes::Lanes,
    node::{MovingNode, StillNode, Wide, WideNode},
    ray::{Hit, LocalRay},
    shape::Shape,
    tree::{Tree, WIDTH},
    triangle::{Packet, TriangleRay, candidates, finish, normal_f64},
    walk::{Search, Visit, walk},
};

/// Triangles that stand still in the space of their tree.
pub(super) struct StillPart {
    pub tree: Wide<StillNode>,
    pub packets: Vec<Packet>,
}

/// Triangles whose corners are interpolated for each ray.
pub(super) struct DeformingPart {
    pub tree: Wide<MovingNode>,
    pub leaves: Vec<Leaf>,
    pub mesh: Arc<TriangleMesh>,
}

/// Triangles of one leaf.
pub(super) struct Leaf {
    count: u8,
    primitives: [u32; WIDTH],
}

/// A tree in the space of one geometry.
pub(super) enum Part {
    Still(StillPart),
    Deforming(DeformingPart),
}

/// Why triangles were left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Dropped {
    pub not_finite: usize,
    pub no_area: usize,
}

/// Whether a triangle can be met at all; counts it if not.
fn usable(corners: &[Vec3; 3], dropped: &mut Dropped) -> bool {
    let finite = corners.iter().all(|p| p.is_finite());
    let [a, b, c] = corners.map(|p| p.as_dvec3());
    let area = normal_f64(a, b, c);
    if !finite {
        dropped.not_finite += 1;
    } else if area == glam::DVec3::ZERO {
        dropped.no_area += 1;
    }
    finite && area != glam::DVec3::ZERO
}

impl StillPart {
    /// Builds over triangles with their identities. Returns their box, too.
    pub fn new(triangles: impl Iterator<Item = (u32, [Vec3; 3])>, dropped: &mut Dropped) -> (Self, Box3) {
        let triangles: Vec<_> = triangles.filter(|(_, corners)| usable(corners, dropped)).collect();
        let boxes: Vec<Box3> = triangles.iter().map(|(_, corners)| Box3::of(*corners)).collect();
        let tree = Tree::build(&boxes, WIDTH);
        let members = |leaf: &std::ops::Range<u32>| &tree.primitives[leaf.start as usize..leaf.end as usize];
        let packets = tree
            .leaves
            .iter()
            .map(|leaf| Packet::new(members(leaf).iter().map(|&i| triangles[i as usize])))
            .collect();
        let (wide, whole) = Wide::new(&tree, &leaf_bounds(&tree, &boxes));
        (Self { tree: wide, packets }, whole)
    }

    /// Number of triangles; places after the last of a packet repeat it.
    pub fn triangles(&self) -> usize {
        let different = |p: &Packet| 1 + p.ids.windows(2).filter(|pair| pair[0] != pair[1]).count();
        self.packets.iter().map(different).sum()
    }

    /// Offers every triangle that the ray may meet first; `name` turns an identity into (instance, primitive).
    #[inline(always)]
    pub fn search<S: Lanes, const ANY: bool, F: FnMut(&Hit) -> bool>(
        &self,
        ray: &LocalRay,
        near: f32,
        search: &mut Search<'_, F>,
        name: impl Fn(u32) -> (u32, u32),
    ) -> bool {
        let mut visit = StillLeaves::<S, _, ANY> {
            part: self,
            rays: Rays { ray, triangle: TriangleRay::new(ray), near },
            name,
        };
        walk::<S, _, F>(&self.tree, ray, search, &mut visit)
    }
}

impl DeformingPart {
    /// Builds over a deforming mesh. Returns its box, too.
    pub fn new(mesh: Arc<TriangleMesh>, dropped: &mut Dropped) -> (Self, MovingBox) {
        let count = mesh.keys.len();
        let at_key = |primitive: u32, key: usize| {
            mesh.triangles[primitive as usize].map(|i| mesh.keys[key][i as usize])
        };
        let mut primitives = Vec::new();
        let mut boxes = Vec::new();
        for primitive in 0..mesh.triangles.len() as u32 {
            // Kept when any key has an area; finite at all of them.
            let keys: Vec<_> = (0..count).map(|key| at_key(primitive, key)).collect();
            let mut why = Dropped::default();
            let usable_keys = keys.iter().filter(|corners| usable(corners, &mut why)).count();
            if why.not_finite > 0 {
                dropped.not_finite += 1;
            } else if usable_keys == 0 {
                dropped.no_area += 1;
            } else {
                let of_keys: Vec<_> = (0..)
                    .zip(&keys)
                    .map(|(key, corners)| (mesh.jumps.key_time(key, count), Box3::of(*corners)))
                    .collect();
                boxes.push(MovingBox::around(&of_keys));
                primitives.push(primitive);
            }
        }
        let middles: Vec<Box3> = boxes.iter().map(|b| b.middle()).collect();
        let tree = Tree::build(&middles, WIDTH);
        let leaves = tree.leaves.iter().map(|range| {
            let members = &tree.primitives[range.start as usize..range.end as usize];
            let mut leaf = Leaf { count: members.len() as u8, primitives: [0; WIDTH] };
            for (place, &i) in leaf.primitives.iter_mut().zip(members) {
                *place = primitives[i as usize];
            }
            leaf
        });
        let leaves = leaves.collect();
        let (wide, whole) = Wide::new(&tree, &leaf_bounds(&tree, &boxes));
        (Self { tree: wide, leaves, mesh }, whole)
    }

    /// Number of triangles.
    pub fn triangles(&self) -> usize {
        self.leaves.iter().map(|leaf| usize::from(leaf.count)).sum()
    }

    /// The triangles of a leaf at a time.
    fn packet(&self, leaf: u32, time: f32) -> Packet {
        let leaf = &self.leaves[leaf as usize];
        let members = leaf.primitives[..usize::from(leaf.count)].iter();
        Packet::new(members.map(|&p| (p, self.mesh.corners(p, time))))
    }

    /// Bytes of the leaves.
    pub fn leaf_bytes(&self) -> usize {
        self.leaves.len() * size_of::<Leaf>()
    }

    /// As [`StillPart::search`].
    #[inline(always)]
    pub fn search<S: Lanes, const ANY: bool, F: FnMut(&Hit) -> bool>(
        &self,
        ray: &LocalRay,
        near: f32,
        search: &mut Search<'_, F>,
        name: impl Fn(u32) -> (u32, u32),
    ) -> bool {
        let mut visit = DeformingLeaves::<S, _, ANY> {
            part: self,
            rays: Rays { ray, triangle: TriangleRay::new(ray), near },
            name,
        };
        walk::<S, _, F>(&self.tree, ray, search, &mut visit)
    }
}

/// A ray in the forms that a part needs.
struct Rays<'a, S> {
    ray: &'a LocalRay,
    triangle: TriangleRay<S>,
    /// Where the ray enters the box of the instance.
    near: f32,
}

impl<S: Lanes> Rays<'_, S> {
    /// Tests a packet and offers what is hit. Whether to stop.
    #[inline(always)]
    fn test<const ANY: bool, F: FnMut(&Hit) -> bool>(
        &self,
        packet: &Packet,
        search: &mut Search<'_, F>,
        name: &impl Fn(u32) -> (u32, u32),
    ) -> bool {
        let found = candidates(packet, &self.triangle, search.t_max);
        let mut lanes = found.lanes;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            // Places after the last triangle repeat it.
            if lane + 1 < WIDTH && packet.ids[lane] == packet.ids[lane + 1] {
                continue;
            }
            if let Some(mut meeting) = finish(packet, &found, lane, self.ray)
                && meeting.t <= search.t_max
            {
                meeting.t = meeting.t.max(self.near);
                let (instance, primitive) = name(packet.ids[lane]);
                if search.offer(meeting, instance, primitive) && ANY {
                    return true;
                }
            }
        }
        false
    }
}

struct StillLeaves<'a, S, N, const ANY: bool> {
    part: &'a StillPart,
    rays: Rays<'a, S>,
    name: N,
}

impl<S, N, F, const ANY: bool> Visit<F> for StillLeaves<'_, S, N, ANY>
where
    S: Lanes,
    N: Fn(u32) -> (u32, u32),
    F: FnMut(&Hit) -> bool,
{
    #[inline(always)]
    fn leaf(&mut self, search: &mut Search<'_, F>, leaf: u32, _: f32) -> bool {
        self.rays.test::<ANY, F>(&self.part.packets[leaf as usize], search, &self.name)
    }
}

struct DeformingLeaves<'a, S, N, const ANY: bool> {
    part: &'a DeformingPart,
    rays: Rays<'a, S>,
    name: N,
}

impl<S, N, F, const ANY: bool> Visit<F> for DeformingLeaves<'_, S, N, ANY>
where
    S: Lanes,
    N: Fn(u32) -> (u32, u32),
    F: FnMut(&Hit) -> bool,
{
    #[inline(always)]
    fn leaf(&mut self, search: &mut Search<'_, F>, leaf: u32, _: f32) -> bool {
        let packet = self.part.packet(leaf, self.rays.ray.time);
        self.rays.test::<ANY, F>(&packet, search, &self.name)
    }
}

fn leaf_bounds<B: Bounds>(tree: &Tree, boxes: &[B]) -> Vec<B> {
    let of_leaf = |range: &std::ops::Range<u32>| {
        let members = &tree.primitives[range.start as usize..range.end as usize];
        members.iter().fold(B::EMPTY, |a, &i| a.union(boxes[i as usize]))
    };
    tree.leaves.iter().map(of_leaf).collect()
}

/// What an entry of the upper level leads to.
#[derive(Clone, Copy, Debug)]
pub(super) enum Target {
    /// The triangles that are baked into world space.
    Baked,
    /// An instance of the part with this index.
    Part { instance: u32, part: u32 },
    /// An analytic shape.
    Shape { instance: u32, shape: Shape },
}

/// The level above the trees: instances as leaves.
pub(super) struct Upper<N> {
    pub tree: Wide<N>,
    pub targets: Vec<Target>,
}

impl<N: WideNode> Upper<N> {
    pub fn new(entries: &[(N::Bounds, Target)]) -> Self {
        let middles: Vec<Box3> = entries.iter().map(|(b, _)| b.middle()).collect();
        let tree = Tree::build(&middles, 1);
        let bounds: Vec<N::Bounds> = entries.iter().map(|(b, _)| *b).collect();
        let targets = tree.primitives.iter().map(|&i| entries[i as usize].1).collect();
        Self { tree: Wide::new(&tree, &leaf_bounds(&tree, &bounds)).0, targets }
    }
}
