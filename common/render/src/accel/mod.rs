//! Which surface a ray meets first, and whether it meets any: the only place that knows trees.
//!
//! The answer depends on the geometry alone: not on the shape of the trees, the order of visits, or the processor. Equally near
//! hits go to the smallest (instance, primitive). There is no least distance, and no length is compared to a constant: a
//! scene scaled by a power of two gives the same hits bit for bit. A mesh is watertight within itself.
//!
//! Scenes pay for what they use: still triangles that appear once are baked into one tree in world space, which is all there is
//! when nothing else is in the scene; instances, moving boxes and analytic shapes add their level when they occur. A box
//! test rounds outwards, a triangle test falls back to f64 where f32 cannot decide.

mod bounds;
mod build;
mod geometry;
mod lanes;
mod node;
mod parts;
mod ray;
mod shape;
mod surface;
mod tree;
mod triangle;
mod walk;

#[cfg(test)]
mod tests;

use std::{marker::PhantomData, sync::Arc};

pub use build::AccelReport;
pub use geometry::{Geometry, InstanceDesc, TriangleMesh};
pub use ray::{Hit, Ray};
pub use surface::{SurfacePoint, offset_origin};

use self::{
    lanes::{Lanes, Portable},
    node::{MovingNode, StillNode, WideNode},
    parts::{Part, StillPart, Target, Upper},
    ray::LocalRay,
    shape::Shape,
    triangle::Meeting,
    walk::{Search, Visit, walk},
};
use crate::transform::{InverseAffine, MotionTransform};

/// All geometry of a scene, ready for rays. Immutable and shared between threads.
pub struct Accel {
    geometries: Vec<Geometry>,
    instances: Vec<Instance>,
    baked: Baked,
    parts: Vec<Part>,
    upper: Level,
    report: AccelReport,
    #[cfg(target_arch = "x86_64")]
    avx2: bool,
}

/// An instance and what rays need of its place.
struct Instance {
    geometry: u32,
    transform: MotionTransform,
    place: Place,
}

/// How an instance is stored.
enum Place {
    /// Its triangles are in the tree in world space.
    Baked,
    /// It has a tree of its own in world space: it deforms or moves, and its map has no inverse.
    World(Arc<TriangleMesh>),
    /// Rays are taken into its space; by this map, if it stands still.
    Object(Option<InverseAffine>),
}

/// Triangles in world space, numbered through over the instances that they come from.
struct Baked {
    part: StillPart,
    /// First number of each baked instance, and the instance.
    starts: Vec<(u32, u32)>,
}

impl Baked {
    /// The (instance, primitive) of a number.
    #[inline(always)]
    fn name(&self, number: u32) -> (u32, u32) {
        let after = self.starts.partition_point(|&(start, _)| start <= number);
        let (start, instance) = self.starts[after - 1];
        (instance, number - start)
    }
}

/// What stands above the trees of triangles.
enum Level {
    /// Nothing: all is baked.
    Single,
    Still(Upper<StillNode>),
    Moving(Upper<MovingNode>),
}

impl Accel {
    /// The nearest hit in `[0, t_max]` that `filter` accepts; `None` also for a ray that is not finite or has no direction. The
    /// filter may be asked about hits that turn out not to be the nearest, and must answer the same each time.
    #[inline]
    pub fn closest(&self, ray: &Ray, filter: impl FnMut(&Hit) -> bool) -> Option<Hit> {
        self.query::<false, _>(ray, filter)
    }

    /// Whether there is any hit in `[0, t_max]` that `filter` accepts.
    #[inline]
    pub fn occluded(&self, ray: &Ray, filter: impl FnMut(&Hit) -> bool) -> bool {
        self.query::<true, _>(ray, filter).is_some()
    }

    /// What was built, and what was left out.
    pub fn report(&self) -> &AccelReport {
        &self.report
    }

    /// What was passed to the build.
    pub fn geometry(&self, instance: u32) -> &Geometry {
        &self.geometries[self.instances[instance as usize].geometry as usize]
    }

    /// Object to world space of an instance over the shutter.
    pub fn transform(&self, instance: u32) -> &MotionTransform {
        &self.instances[instance as usize].transform
    }

    #[inline]
    fn query<const ANY: bool, F: FnMut(&Hit) -> bool>(&self, ray: &Ray, mut filter: F) -> Option<Hit> {
        #[cfg(target_arch = "x86_64")]
        if self.avx2 {
            // SAFETY: the processor has AVX2, asked once at the build.
            return unsafe { query_avx2::<ANY, F>(self, ray, filter) };
        }
        query_portable::<ANY>(self, ray, &mut filter)
    }
}

/// The fallback; compiled once for all filters, because its speed matters less than its size.
fn query_portable<const ANY: bool>(
    accel: &Accel,
    ray: &Ray,
    filter: &mut dyn FnMut(&Hit) -> bool,
) -> Option<Hit> {
    query::<Portable, ANY, _>(accel, ray, filter)
}

/// Compiled for AVX2 with everything below it.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn query_avx2<const ANY: bool, F: FnMut(&Hit) -> bool>(accel: &Accel, ray: &Ray, filter: F) -> Option<Hit> {
    query::<lanes::Avx2, ANY, F>(accel, ray, filter)
}

#[inline(always)]
fn query<S: Lanes, const ANY: bool, F: FnMut(&Hit) -> bool>(
    accel: &Accel,
    ray: &Ray,
    mut filter: F,
) -> Option<Hit> {
    // An infinite end would let a box at infinity be met.
    let t_max = ray.t_max.min(f32::MAX);
    let local = LocalRay::new(ray.origin, ray.direction, ray.time)?;
    let mut search = Search { t_max, best: None, filter: &mut filter };
    match &accel.upper {
        Level::Single => {
            let name = |number| accel.baked.name(number);
            accel.baked.part.search::<S, ANY, F>(&local, 0.0, &mut search, name);
        }
        Level::Still(upper) => descend::<S, _, ANY, F>(accel, upper, ray, &local, &mut search),
        Level::Moving(upper) => descend::<S, _, ANY, F>(accel, upper, ray, &local, &mut search),
    }
    search.best
}

/// Walks the upper level and the trees below it.
#[inline(always)]
fn descend<S: Lanes, N: WideNode, const ANY: bool, F: FnMut(&Hit) -> bool>(
    accel: &Accel,
    upper: &Upper<N>,
    ray: &Ray,
    local: &LocalRay,
    search: &mut Search<'_, F>,
) {
    let mut visit = Entries::<S, ANY> { accel, targets: &upper.targets, ray, local, lanes: PhantomData };
    walk::<S, N, F>(&upper.tree, local, search, &mut visit);
}

/// The leaves of the upper level.
struct Entries<'a, S, const ANY: bool> {
    accel: &'a Accel,
    targets: &'a [Target],
    ray: &'a Ray,
    local: &'a LocalRay,
    lanes: PhantomData<S>,
}

impl<S: Lanes, F: FnMut(&Hit) -> bool, const ANY: bool> Visit<F> for Entries<'_, S, ANY> {
    #[inline(always)]
    fn leaf(&mut self, search: &mut Search<'_, F>, leaf: u32, near: f32) -> bool {
        let Self { accel, ray, local, .. } = *self;
        match self.targets[leaf as usize] {
            Target::Baked => {
                let name = |number| accel.baked.name(number);
                accel.baked.part.search::<S, ANY, F>(local, 0.0, search, name)
            }
            Target::Part { instance, part } => {
                let Some(local) = accel.instances[instance as usize].local_ray(ray, local) else {
                    return false;
                };
                let name = |primitive| (instance, primitive);
                match &accel.parts[part as usize] {
                    Part::Still(part) => part.search::<S, ANY, F>(&local, near, search, name),
                    Part::Deforming(part) => part.search::<S, ANY, F>(&local, near, search, name),
                }
            }
            Target::Shape { instance, shape } => {
                let meetings = accel.instances[instance as usize].meet_shape(shape, ray);
                for mut meeting in meetings.into_iter().flatten() {
                    meeting.t = meeting.t.max(near);
                    if search.offer(meeting, instance, 0) && ANY {
                        return true;
                    }
                }
                false
            }
        }
    }
}

impl Instance {
    /// The ray in the space of the instance's tree; `None` while the map is singular.
    #[inline(always)]
    fn local_ray(&self, ray: &Ray, world: &LocalRay) -> Option<LocalRay> {
        let inverse = match &self.place {
            Place::Baked | Place::World(_) => return Some(*world),
            Place::Object(Some(inverse)) => *inverse,
            Place::Object(None) => self.transform.at(ray.time).inverse()?,
        };
        LocalRay::new(inverse.point(ray.origin), inverse.vector(ray.direction), ray.time)
    }

    /// Where a ray meets the shape that this is an instance of.
    fn meet_shape(&self, shape: Shape, ray: &Ray) -> [Option<Meeting>; 2] {
        let inverse = match &self.place {
            Place::Object(Some(inverse)) => Some(*inverse),
            _ => shape.inverse(&self.transform.at(ray.time)),
        };
        match inverse {
            Some(inverse) => shape.meet(inverse.point(ray.origin), inverse.vector(ray.direction)),
            None => [None, None],
        }
    }
}
