//! Stories about rays and scenes.

mod agreement;
mod edges;
mod extremes;

use glam::{DVec3, Mat3, Quat, Vec3};

use super::{
    triangle::{Packet, TriangleRay, candidates, finish},
    *,
};
use crate::transform::{Affine, Jumps, TransformKey};

/// A small generator, so that a failure names its seed.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }
    fn signed(&mut self) -> f32 {
        self.next() * 2.0 - 1.0
    }
    fn point(&mut self) -> Vec3 {
        Vec3::new(self.signed(), self.signed(), self.signed())
    }
    fn rotation(&mut self) -> Quat {
        Quat::from_xyzw(self.signed(), self.signed(), self.signed(), self.signed()).normalize()
    }
}

fn all(_: &Hit) -> bool {
    true
}

fn still(mesh: TriangleMesh) -> Accel {
    Accel::build(vec![Geometry::Triangles(Arc::new(mesh))], vec![placed(0, Affine::IDENTITY)])
}

fn placed(geometry: u32, affine: Affine) -> InstanceDesc {
    InstanceDesc { geometry, transform: MotionTransform::fixed(affine) }
}

fn soup(random: &mut Random, count: usize, size: f32) -> TriangleMesh {
    let mut positions = Vec::new();
    for _ in 0..count {
        let centre = random.point();
        positions.extend((0..3).map(|_| centre + random.point() * size));
    }
    let triangles = (0..count as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    TriangleMesh::fixed(positions, triangles)
}

fn random_ray(random: &mut Random) -> Ray {
    let origin = random.point() * 2.0;
    Ray { time: random.next(), ..Ray::new(origin, random.point() - origin * random.next()) }
}

/// The same arithmetic without any tree.
fn scan(mesh: &TriangleMesh, ray: &Ray) -> Option<Hit> {
    let local = LocalRay::new(ray.origin, ray.direction, ray.time)?;
    let mut filter = all;
    let mut search = Search { t_max: ray.t_max.min(f32::MAX), best: None, filter: &mut filter };
    for primitive in (0..mesh.triangles.len() as u32).rev() {
        let packet = Packet::new([(primitive, mesh.corners(primitive, ray.time))].into_iter());
        let found = candidates::<Portable>(&packet, &TriangleRay::new(&local), f32::MAX);
        if found.lanes != 0
            && let Some(meeting) = finish(&packet, &found, 0, &local)
        {
            search.offer(meeting, 0, primitive);
        }
    }
    search.best
}

/// Moeller-Trumbore in f64 over everything, as independent of the code under test as can be.
fn reference(accel: &Accel, ray: &Ray) -> Option<(f64, u32, u32)> {
    let mut best: Option<(f64, u32, u32)> = None;
    for instance in 0..accel.instances.len() as u32 {
        let Geometry::Triangles(mesh) = accel.geometry(instance) else { continue };
        for primitive in 0..mesh.triangles.len() as u32 {
            let map = accel.transform(instance).at(ray.time);
            let [a, b, c] = mesh.corners(primitive, ray.time).map(|p| map.point_f64(p.as_dvec3()));
            if let Some(t) = moeller(ray, a, b, c)
                && t <= f64::from(ray.t_max)
                && best.is_none_or(|best| t < best.0)
            {
                best = Some((t, instance, primitive));
            }
        }
    }
    best
}

fn moeller(ray: &Ray, a: DVec3, b: DVec3, c: DVec3) -> Option<f64> {
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let (e1, e2) = (b - a, c - a);
    let p = d.cross(e2);
    let determinant = e1.dot(p);
    let s = o - a;
    let u = s.dot(p) / determinant;
    let q = s.cross(e1);
    let v = d.dot(q) / determinant;
    let t = e2.dot(q) / determinant;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t >= 0.0).then_some(t)
}

fn agree(accel: &Accel, random: &mut Random, rays: usize, seed: u64) {
    let mut hits = 0;
    let mut differences = 0;
    for _ in 0..rays {
        let ray = random_ray(random);
        let found = accel.closest(&ray, all);
        let expected = reference(accel, &ray);
        hits += usize::from(expected.is_some());
        let same = match (found, expected) {
            (Some(hit), Some((t, instance, primitive))) => {
                let near = (f64::from(hit.t) - t).abs() <= 1e-4 * t.max(1e-3);
                near && (hit.instance, hit.primitive) == (instance, primitive)
            }
            (None, None) => true,
            _ => false,
        };
        differences += usize::from(!same);
        assert_eq!(accel.occluded(&ray, all), found.is_some(), "seed {seed}: {ray:?}");
    }
    // A ray within f32 rounding of an edge may go either way.
    assert!(
        differences * 1000 <= rays,
        "seed {seed}: {differences} of {rays} rays differ from the reference"
    );
    assert!(hits * 10 > rays, "seed {seed}: the scene is hit");
}

fn turning(random: &mut Random) -> MotionTransform {
    let keys = (0..3).map(|_| TransformKey {
        translation: random.point(),
        rotation: random.rotation(),
        stretch: Mat3::from_diagonal(Vec3::splat(0.3) + random.point() * 0.2),
    });
    MotionTransform::from_keys(keys.collect())
}

fn jumping(random: &mut Random) -> MotionTransform {
    let keys = (0..6).map(|_| TransformKey {
        translation: random.point(),
        rotation: random.rotation(),
        stretch: Mat3::IDENTITY,
    });
    MotionTransform::with_jumps(keys.collect(), Jumps::new(&[0.3]))
}

fn fixed_random(random: &mut Random) -> MotionTransform {
    let linear = Mat3::from_quat(random.rotation()) * Mat3::from_diagonal(Vec3::new(0.5, -0.7, 0.9));
    MotionTransform::fixed(Affine::new(linear, random.point()))
}

fn deforming(random: &mut Random, count: usize, keys: usize) -> TriangleMesh {
    let mut mesh = soup(random, count, 0.3);
    for _ in 1..keys {
        let moved = mesh.keys[0].iter().map(|&p| p + random.point() * 0.2).collect();
        mesh.keys.push(moved);
    }
    mesh
}

fn mixed_scene(seed: u64) -> Accel {
    let mut random = Random(seed);
    // Large enough that sharing is not undone by baking the copies.
    let shared = soup(&mut random, 6000, 0.02);
    let geometries = [
        soup(&mut random, 40, 0.3),
        shared,
        deforming(&mut random, 20, 2),
        deforming(&mut random, 20, 4),
        soup(&mut random, 20, 0.3),
        TriangleMesh { jumps: Jumps::new(&[0.3]), ..deforming(&mut random, 20, 4) },
    ];
    let instances = vec![
        InstanceDesc { geometry: 0, transform: fixed_random(&mut random) },
        InstanceDesc { geometry: 1, transform: fixed_random(&mut random) },
        InstanceDesc { geometry: 1, transform: fixed_random(&mut random) },
        InstanceDesc { geometry: 1, transform: turning(&mut random) },
        InstanceDesc { geometry: 2, transform: fixed_random(&mut random) },
        InstanceDesc { geometry: 3, transform: turning(&mut random) },
        InstanceDesc { geometry: 4, transform: turning(&mut random) },
        InstanceDesc { geometry: 5, transform: jumping(&mut random) },
    ];
    Accel::build(geometries.map(|mesh| Geometry::Triangles(Arc::new(mesh))).into(), instances)
}

fn grid(n: u32) -> TriangleMesh {
    let positions = (0..=n).flat_map(|y| (0..=n).map(move |x| Vec3::new(x as f32, y as f32, 0.0))).collect();
    let at = |x: u32, y: u32| y * (n + 1) + x;
    let triangles = (0..n).flat_map(|y| {
        (0..n).flat_map(move |x| {
            [[at(x, y), at(x + 1, y), at(x + 1, y + 1)], [at(x, y), at(x + 1, y + 1), at(x, y + 1)]]
        })
    });
    TriangleMesh::fixed(positions, triangles.collect())
}

fn cube() -> TriangleMesh {
    let positions = (0..8).map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32)).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
    TriangleMesh::fixed(positions, triangles)
}
