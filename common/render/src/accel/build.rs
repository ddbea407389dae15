//! From geometries and instances to trees: what is baked, what is shared, what is left out.

use std::sync::Arc;

use glam::Vec3;

use super::{
    Accel, Baked, Geometry, Instance, InstanceDesc, Level, Place, TriangleMesh,
    bounds::{Bounds, Box3, MovingBox},
    parts::{DeformingPart, Dropped, Part, StillPart, Target, Upper},
    shape::Shape,
    triangle::Packet,
};
use crate::transform::{Jumps, MotionTransform};

/// A mesh with several instances is baked all the same while its copies together stay below this: a level costs every ray more.
const BAKED_COPIES_MAX: usize = 1 << 14;

/// Keys per segment for the rare mesh that has to be baked although it turns.
const PIECES: usize = 16;

/// What was built, for the report of a render.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AccelReport {
    /// Bytes of all nodes.
    pub node_bytes: usize,
    /// Bytes of triangles as the trees hold them; a shared mesh counts once.
    pub triangle_bytes: usize,
    /// Nodes on the longest way to a leaf, over all levels.
    pub depth: usize,
    /// Instances in the scene.
    pub instances: usize,
    /// Instances whose triangles are baked into the tree in world space.
    pub baked_instances: usize,
    /// Triangles in trees; a shared mesh counts once.
    pub triangles: usize,
    /// Triangles left out because a coordinate is not finite.
    pub dropped_not_finite: usize,
    /// Triangles left out because they have no area.
    pub dropped_no_area: usize,
    /// Instances of shapes left out because the instance flattens them away, or its place is not finite.
    pub dropped_instances: usize,
    /// Instances, those that are left out included, that their place flattens or puts nowhere.
    pub flattened_instances: usize,
    /// Levels of trees: 0 in an empty scene, 2 where there are instances.
    pub levels: usize,
    /// Whether nodes of the upper level move.
    pub moving_instances: bool,
    /// Whether there are deforming meshes.
    pub deforming_meshes: bool,
    /// Whether there are analytic shapes.
    pub shapes: bool,
}

impl Accel {
    /// Builds trees over everything. The indices of hits are those of `instances` and of each geometry's primitives.
    ///
    /// # Panics
    /// When an instance names a geometry that is not there, a triangle a vertex that is not there, or there are 2^32 primitives.
    pub fn build(geometries: Vec<Geometry>, instances: Vec<InstanceDesc>) -> Self {
        Builder::new(geometries, instances).finish()
    }
}

struct Builder {
    geometries: Vec<Geometry>,
    instances: Vec<Instance>,
    parts: Vec<Part>,
    /// Part of each geometry that several instances share, and its bounds.
    shared: Vec<Option<(u32, MovingBox)>>,
    entries: Vec<(MovingBox, Target)>,
    dropped: Dropped,
    report: AccelReport,
}

impl Builder {
    fn new(geometries: Vec<Geometry>, descs: Vec<InstanceDesc>) -> Self {
        for geometry in &geometries {
            if let Geometry::Triangles(mesh) = geometry {
                mesh.check();
            }
        }
        let mut uses = vec![0usize; geometries.len()];
        for desc in &descs {
            uses[desc.geometry as usize] += 1;
        }
        let instances = descs.into_iter().map(|InstanceDesc { geometry, transform }| {
            let place = place_of(&geometries[geometry as usize], uses[geometry as usize], &transform);
            Instance { geometry, transform, place }
        });
        let instances: Vec<Instance> = instances.collect();
        Self {
            shared: vec![None; geometries.len()],
            report: AccelReport { instances: instances.len(), ..AccelReport::default() },
            geometries,
            instances,
            parts: Vec::new(),
            entries: Vec::new(),
            dropped: Dropped::default(),
        }
    }

    fn finish(mut self) -> Accel {
        let (baked, baked_box) = self.bake();
        for index in 0..self.instances.len() {
            self.place(index);
        }
        if !self.entries.is_empty() && !baked.part.packets.is_empty() {
            self.entries.push((MovingBox::standing(baked_box), Target::Baked));
        }
        let upper = self.upper();
        self.count(&baked, &upper);
        Accel {
            geometries: self.geometries,
            instances: self.instances,
            baked,
            parts: self.parts,
            upper,
            report: self.report,
            #[cfg(target_arch = "x86_64")]
            avx2: std::arch::is_x86_feature_detected!("avx2"),
        }
    }

    fn bake(&mut self) -> (Baked, Box3) {
        let mut starts = Vec::new();
        let mut next = 0usize;
        let mut triangles = Vec::new();
        for (index, instance) in self.instances.iter().enumerate() {
            let Place::Baked = instance.place else { continue };
            let Geometry::Triangles(mesh) = &self.geometries[instance.geometry as usize] else { continue };
            let map = instance.transform.at(0.0);
            let world: Vec<Vec3> = mesh.keys[0].iter().map(|&p| map.point(p)).collect();
            starts.push((next as u32, index as u32));
            triangles.push((next as u32, mesh.clone(), world));
            next += mesh.triangles.len();
            assert!(next < u32::MAX as usize, "fewer than 2^32 triangles");
        }
        self.report.baked_instances = starts.len();
        let triangles = triangles.iter().flat_map(|(start, mesh, world)| {
            let corners = |triangle: &[u32; 3]| triangle.map(|i| world[i as usize]);
            (*start..).zip(mesh.triangles.iter().map(corners))
        });
        let (part, whole) = StillPart::new(triangles, &mut self.dropped);
        (Baked { part, starts }, whole)
    }

    /// Gives an instance that is not baked its entry in the upper level.
    fn place(&mut self, index: usize) {
        let instance = &self.instances[index];
        let (geometry, transform) = (instance.geometry as usize, &instance.transform);
        let shape = match &self.geometries[geometry] {
            Geometry::Triangles(_) => None,
            Geometry::Disk => Some(Shape::Disk),
            Geometry::Rectangle => Some(Shape::Rectangle),
            Geometry::Sphere => Some(Shape::Sphere),
        };
        let is_flat = shape.is_none() && transform.is_singular();
        self.report.flattened_instances += usize::from(is_flat);
        let entry = match (&instance.place, shape) {
            (Place::Baked, _) => return,
            (Place::Object(inverse), Some(shape)) => {
                let gone = transform.as_fixed().is_some() && inverse.is_none();
                let bounds = MovingBox::carried(MovingBox::standing(shape.bounds()), transform);
                let target = Target::Shape { instance: index as u32, shape };
                (!gone && bounds.whole().is_finite()).then_some((bounds, target))
            }
            (Place::World(mesh), _) => {
                let mesh = mesh.clone();
                let (part, bounds) = self.part(&mesh);
                bounds.map(|bounds| (bounds, Target::Part { instance: index as u32, part }))
            }
            (Place::Object(_), None) => {
                let transform = transform.clone();
                let (part, bounds) = self.shared_part(geometry);
                let bounds = bounds.map(|b| MovingBox::carried(b, &transform));
                bounds.map(|bounds| (bounds, Target::Part { instance: index as u32, part }))
            }
        };
        match entry {
            Some((bounds, _)) if !bounds.whole().is_finite() => self.drop_instance(is_flat),
            Some(entry) => self.entries.push(entry),
            None if shape.is_some() => self.drop_instance(is_flat),
            None => {}
        }
    }

    fn drop_instance(&mut self, counted: bool) {
        self.report.dropped_instances += 1;
        self.report.flattened_instances += usize::from(!counted);
    }

    fn shared_part(&mut self, geometry: usize) -> (u32, Option<MovingBox>) {
        if let Some((part, bounds)) = self.shared[geometry] {
            return (part, Some(bounds).filter(|b| b.whole().is_finite()));
        }
        let Geometry::Triangles(mesh) = &self.geometries[geometry] else {
            unreachable!("only meshes have parts")
        };
        let mesh = mesh.clone();
        let (part, bounds) = self.part(&mesh);
        self.shared[geometry] = Some((part, bounds.unwrap_or(MovingBox::EMPTY)));
        (part, bounds)
    }

    /// Builds a tree over a mesh; no bounds if nothing of it can be met.
    fn part(&mut self, mesh: &Arc<TriangleMesh>) -> (u32, Option<MovingBox>) {
        let (part, bounds) = if mesh.deforms() {
            let (part, bounds) = DeformingPart::new(mesh.clone(), &mut self.dropped);
            (Part::Deforming(part), bounds)
        } else {
            let triangles = (0..mesh.triangles.len() as u32).map(|i| (i, mesh.corners(i, 0.0)));
            let (part, bounds) = StillPart::new(triangles, &mut self.dropped);
            (Part::Still(part), MovingBox::standing(bounds))
        };
        self.parts.push(part);
        (self.parts.len() as u32 - 1, bounds.whole().is_finite().then_some(bounds))
    }

    fn upper(&mut self) -> Level {
        let moves = self.entries.iter().any(|(b, _)| b.open != b.close);
        if self.entries.is_empty() {
            Level::Single
        } else if moves {
            Level::Moving(Upper::new(&self.entries))
        } else {
            let still: Vec<_> = self.entries.iter().map(|&(b, target)| (b.open, target)).collect();
            Level::Still(Upper::new(&still))
        }
    }

    fn count(&mut self, baked: &Baked, upper: &Level) {
        let report = &mut self.report;
        let mut add_triangles = |nodes: usize, leaves: usize, triangles: usize, depth: usize| {
            report.node_bytes += nodes;
            report.triangle_bytes += leaves;
            report.triangles += triangles;
            report.depth = report.depth.max(depth);
        };
        let mut still = |part: &StillPart| {
            let (packets, triangles) = (part.packets.len() * size_of::<Packet>(), part.triangles());
            add_triangles(part.tree.bytes(), packets, triangles, part.tree.depth);
        };
        still(&baked.part);
        for part in &self.parts {
            if let Part::Still(part) = part {
                still(part);
            }
        }
        for part in &self.parts {
            if let Part::Deforming(part) = part {
                add_triangles(part.tree.bytes(), part.leaf_bytes(), part.triangles(), part.tree.depth);
            }
        }
        let (bytes, depth) = match upper {
            Level::Single => (0, 0),
            Level::Still(upper) => (upper.tree.bytes(), upper.tree.depth),
            Level::Moving(upper) => (upper.tree.bytes(), upper.tree.depth),
        };
        report.node_bytes += bytes;
        report.depth += depth;
        report.levels = match upper {
            Level::Single => usize::from(!baked.part.packets.is_empty()),
            Level::Still(_) | Level::Moving(_) => 2,
        };
        report.moving_instances = matches!(upper, Level::Moving(_));
        report.deforming_meshes = self.parts.iter().any(|part| matches!(part, Part::Deforming(_)));
        report.shapes = self.entries.iter().any(|(_, target)| matches!(target, Target::Shape { .. }));
        report.dropped_not_finite = self.dropped.not_finite;
        report.dropped_no_area = self.dropped.no_area;
    }
}

/// Decides how an instance is stored.
fn place_of(geometry: &Geometry, uses: usize, transform: &MotionTransform) -> Place {
    let fixed = transform.as_fixed();
    match geometry {
        Geometry::Triangles(mesh) => {
            let alone = uses == 1 || uses * mesh.triangles.len() <= BAKED_COPIES_MAX;
            if transform.is_singular() {
                // There is no way back into object space; baking needs none.
                if fixed.is_some() && !mesh.deforms() {
                    Place::Baked
                } else {
                    Place::World(in_world(mesh, transform))
                }
            } else if fixed.is_some() && !mesh.deforms() && alone {
                Place::Baked
            } else {
                Place::Object(fixed.and_then(|map| map.inverse()))
            }
        }
        Geometry::Disk => Place::Object(fixed.and_then(|map| Shape::Disk.inverse(map))),
        Geometry::Rectangle => Place::Object(fixed.and_then(|map| Shape::Rectangle.inverse(map))),
        Geometry::Sphere => Place::Object(fixed.and_then(|map| Shape::Sphere.inverse(map))),
    }
}

/// A mesh whose keys are taken into world space.
fn in_world(mesh: &TriangleMesh, transform: &MotionTransform) -> Arc<TriangleMesh> {
    // Where both jump, they do so together.
    let jumps = if transform.jumps().is_empty() { mesh.jumps.clone() } else { Jumps::new(transform.jumps()) };
    let per_piece = |segments: usize| segments.div_ceil(jumps.pieces()).max(1);
    let of_mesh = mesh.jumps.segments(mesh.keys.len()).len();
    let segments = per_piece(of_mesh) * per_piece(transform.segments().len()) * PIECES;
    let count = (segments + 1) * jumps.pieces();
    let keys = (0..count).map(|key| {
        let u = jumps.key_time(key, count);
        let map = transform.at(u);
        (0..mesh.keys[0].len() as u32).map(|vertex| map.point(mesh.vertex(vertex, u))).collect()
    });
    Arc::new(TriangleMesh { keys: keys.collect(), jumps, triangles: mesh.triangles.clone() })
}
