//! Which surface a ray meets: asked of the acceleration structure itself.

use crate::stability::bench::Bench;
use crate::stability::stage;
use farm_render::accel::{Accel, Geometry, InstanceDesc, Ray, TriangleMesh};
use farm_render::sampler::{Sampler, Sequence};
use farm_render::transform::{Affine, MotionTransform};
use farm_scene::Mesh;
use glam::{DVec3, Vec3};
use std::sync::Arc;
use std::time::Instant;

fn numbers(index: u64) -> [f32; 4] {
    Sampler::with_sequence(Sequence::Independent, 17, 0, 0, 0, index).set(0)
}

fn direction(u: f32, v: f32) -> Vec3 {
    farm_render::sampling::uniform_sphere([u, v])
}

fn accel_of(meshes: Vec<Mesh>) -> Accel {
    let geometry =
        |mesh: Mesh| Geometry::Triangles(Arc::new(TriangleMesh::fixed(mesh.positions, mesh.triangles)));
    let count = meshes.len() as u32;
    let fixed = |geometry| InstanceDesc { geometry, transform: MotionTransform::fixed(Affine::IDENTITY) };
    Accel::build(meshes.into_iter().map(geometry).collect(), (0..count).map(fixed).collect())
}

fn ray_through(origin: Vec3, through: Vec3) -> Ray {
    Ray::new(origin, through - origin)
}

/// T43: no ray leaves a closed globe, far from the origin of coordinates (Embree's watertightness test, which allows 2e-5).
pub fn watertight_globe(bench: &mut Bench) {
    let centre = Vec3::new(148_376.0, 1_234.0, -223_423.0);
    let accel = accel_of(vec![stage::globe(centre, 2.0, 100)]);
    let rays = bench.pick(200_000u64, 1_000_000);
    let misses = (0..rays).filter(|&index| {
        let [a, b, c, d] = numbers(index);
        // From within the inner tenth of the globe; f32 has steps of 1/64 there.
        let origin = centre + direction(c, d) * 0.2;
        accel.closest(&Ray::new(origin, direction(a, b)), |_| true).is_none()
    });
    bench.exact(format!("R=2 at {centre}, {rays} inner rays: misses"), 0.0, misses.count() as f64);
}

/// T44: rays aimed exactly at the corners and edges that triangles share.
pub fn shared_corners(bench: &mut Bench) {
    let n = 64i32;
    let corner = |x: i32, y: i32| Vec3::new(x as f32, y as f32, 0.0);
    let mut mesh = Mesh::default();
    mesh.positions.extend((0..=n).flat_map(|y| (0..=n).map(move |x| corner(x, y))));
    let index = |x: i32, y: i32| (y * (n + 1) + x) as u32;
    for y in 0..n {
        for x in 0..n {
            let [a, b, c, d] = [index(x, y), index(x + 1, y), index(x + 1, y + 1), index(x, y + 1)];
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let accel = accel_of(vec![mesh]);
    let origins = [Vec3::new(32.0, 32.0, 10.0), Vec3::new(31.3, 17.7, 3.1), Vec3::new(0.1, 63.9, -0.5)];
    let mut misses = 0u32;
    let mut rays = 0u32;
    for y in 1..n {
        for x in 1..n {
            let targets = [corner(x, y), corner(x, y) + Vec3::X * 0.5, corner(x, y) + Vec3::Y * 0.5];
            for target in targets.into_iter().chain([corner(x, y) + Vec3::new(0.5, 0.5, 0.0)]) {
                let straight = Ray::new(target + Vec3::Z * 5.0, Vec3::NEG_Z);
                let slanted = origins.map(|origin| ray_through(origin, target));
                for ray in slanted.into_iter().chain([straight]) {
                    rays += 1;
                    misses += u32::from(accel.closest(&ray, |_| true).is_none());
                }
            }
        }
    }
    bench.exact(format!("64x64 grid, {rays} rays: misses"), 0.0, f64::from(misses));
}

/// T50: the sign of a zero in a direction changes nothing.
pub fn signed_zeros(bench: &mut Bench) {
    let accel =
        accel_of(vec![stage::cuboid(Vec3::splat(-1.0), Vec3::ONE), stage::globe(Vec3::X * 3.0, 0.5, 8)]);
    let mut different = 0;
    let mut hits = 0;
    let mut rays = 0;
    for axis in 0..3 {
        for sign in [-1.0f32, 1.0] {
            for pattern in 0..8u32 {
                for place in 0..25i32 {
                    let mut direction = Vec3::ZERO;
                    let mut twin = Vec3::ZERO;
                    for other in 0..3 {
                        direction[other] = if pattern >> other & 1 == 0 { 0.0 } else { -0.0 };
                        twin[other] = 0.0;
                    }
                    (direction[axis], twin[axis]) = (sign, sign);
                    // Also along faces and edges of the box.
                    let mut origin = Vec3::ZERO;
                    origin[axis] = -5.0 * sign;
                    origin[(axis + 1) % 3] = (place % 5 - 2) as f32 * 0.5;
                    origin[(axis + 2) % 3] = (place / 5 - 2) as f32 * 0.5;
                    let found = accel.closest(&Ray::new(origin, direction), |_| true);
                    rays += 1;
                    hits += u32::from(found.is_some());
                    different += u32::from(found != accel.closest(&Ray::new(origin, twin), |_| true));
                }
            }
        }
    }
    bench.exact(format!("{rays} rays: twins that differ"), 0.0, f64::from(different));
    bench.at_least("of which meet something", f64::from(rays) * 0.5, f64::from(hits));
}

/// T51: a direction that is almost, but not quite, along an axis.
pub fn nearly_axial(bench: &mut Bench) {
    let far = 1e7f32;
    let accel = accel_of(vec![stage::cuboid(Vec3::new(-0.5, -0.5, far), Vec3::new(0.5, 0.5, far + 1.0))]);
    let hit = accel.closest(&Ray::new(Vec3::ZERO, Vec3::new(1e-9, 0.0, 1.0)), |_| true);
    bench.exact("d=(1e-9,0,1), unit box 1e7 away: distance", 1e7, hit.map_or(0.0, |hit| f64::from(hit.t)));
}

/// T54: boxes that no tree can separate, and boxes that differ in size by 2^126.
pub fn inseparable(bench: &mut Bench) {
    let corners = [Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, -1.0, 0.0), Vec3::new(0.0, 1.0, 0.0)];
    let count = bench.pick(100_000usize, 1_000_000);
    let start = Instant::now();
    let accel = accel_of(vec![stage::triangles(&vec![corners; count])]);
    let seconds = start.elapsed().as_secs_f64();
    let hit = accel.closest(&Ray::new(Vec3::Z, Vec3::NEG_Z), |_| true);
    bench.holds(
        format!("{count} identical triangles: the first is hit"),
        hit.is_some_and(|hit| hit.t == 1.0 && hit.primitive == 0),
    );
    let miss = accel.closest(&Ray::new(Vec3::new(2.0, 0.0, 1.0), Vec3::NEG_Z), |_| true);
    bench.holds(format!("{count} identical triangles: a miss is one"), miss.is_none());
    if bench.is_full() {
        bench.at_most("seconds to build them", 10.0, seconds);
    }
    let shrinking: Vec<[Vec3; 3]> = (0..=126)
        .map(|k| {
            let size = 0.5f32.powi(k);
            corners.map(|corner| corner * size * 0.1 + Vec3::new(size, 0.0, 0.0))
        })
        .collect();
    let accel = accel_of(vec![stage::triangles(&shrinking)]);
    let wrong = shrinking
        .iter()
        .filter(|corners| {
            // The ray towards one triangle's middle meets the triangles that all of them, tried one by one, say it meets.
            let target = (corners[0] + corners[1] + corners[2]) / 3.0;
            let ray = Ray::new(target + Vec3::Z * target.x, Vec3::NEG_Z);
            let single = |corners: &[Vec3; 3]| {
                accel_of(vec![stage::triangles(&[*corners])]).closest(&ray, |_| true).map(|hit| hit.t)
            };
            let brute = shrinking
                .iter()
                .filter_map(single)
                .fold(None, |nearest: Option<f32>, t| Some(nearest.map_or(t, |nearest| nearest.min(t))));
            accel.closest(&ray, |_| true).map(|hit| hit.t) != brute
        })
        .count();
    bench.exact("triangles at 2^-k, k to 126: rays of 127 that differ from brute force", 0.0, wrong as f64);
}

/// T56: equally near surfaces are told apart by (instance, primitive) alone.
pub fn coincident(bench: &mut Bench) {
    let n = 24;
    let grid = || {
        let cell = |i: u32| {
            let (x, y) = ((i % n) as f32, (i / n) as f32);
            stage::quad(Vec3::new(x, y, 0.0), Vec3::X * 0.5, Vec3::Y * 0.5)
        };
        let mut mesh = Mesh::default();
        for part in (0..n * n).map(cell) {
            let base = mesh.positions.len() as u32;
            mesh.positions.extend(part.positions);
            mesh.triangles.extend(part.triangles.iter().map(|t| t.map(|i| i + base)));
        }
        mesh
    };
    let mut doubled = grid();
    let half = doubled.triangles.len() as u32;
    doubled.triangles.extend(doubled.triangles.clone());
    // The same surface three times: twice within a mesh, and once more as another instance.
    let accel = accel_of(vec![doubled, grid()]);
    let ask = |from: u64, to: u64| {
        (from..to)
            .filter(|&index| {
                let [a, b, ..] = numbers(index);
                let origin = Vec3::new(a * (n - 1) as f32, b * (n - 1) as f32, 3.0);
                let hit = accel.closest(&Ray::new(origin, Vec3::new(0.01, -0.02, -1.0)), |_| true);
                hit.is_none_or(|hit| hit.instance != 0 || hit.primitive >= half)
            })
            .count()
    };
    for threads in [1u64, 8, 32] {
        let rays = 32_000;
        let wrong: usize = std::thread::scope(|scope| {
            let part = |thread: u64| {
                let ask = &ask;
                scope.spawn(move || ask(rays / threads * thread, rays / threads * (thread + 1)))
            };
            let parts: Vec<_> = (0..threads).map(part).collect();
            parts.into_iter().map(|part| part.join().expect("no panic")).sum()
        });
        bench.exact(format!("{threads} threads, {rays} rays: other winners"), 0.0, wrong as f64);
    }
}

/// T57: a sliver without area that naive tests meet (pbrt-v3, `Triangle.BadCases`).
pub fn sliver(bench: &mut Bench) {
    let corners = [
        Vec3::new(-1_113.454_6, -79.049_614, -56.243_19),
        Vec3::new(-1_113.454_6, -87.092_27, -56.243_19),
        Vec3::new(-1_113.454_6, -79.209_015, -56.243_19),
    ];
    let mut ray = Ray::new(
        Vec3::new(-1_081.479_2, 99.999_954, 87.770_11),
        Vec3::new(-32.107_3, -183.355_87, -144.607_64),
    );
    ray.t_max = 0.9999;
    let accel = accel_of(vec![stage::triangles(&[corners])]);
    bench.holds("x=-1113.45459: no hit", accel.closest(&ray, |_| true).is_none());
    // Beside it the test is alive: a triangle with area in the same place is met.
    let wide = corners.map(|corner| corner + Vec3::new(0.0, 0.0, (corner.y + 80.0) * 5.0));
    let middle = (wide[0] + wide[1] + wide[2]) / 3.0;
    let accel = accel_of(vec![stage::triangles(&[[wide[0], wide[1] + Vec3::X * 9.0, wide[2]]])]);
    let hit = accel.closest(&ray_through(ray.origin, middle + Vec3::X * 3.0), |_| true);
    bench.holds("the same with area: a hit", hit.is_some());
}

/// T48: a basis around any normal is orthonormal and right-handed.
pub fn bases(bench: &mut Bench) {
    use farm_render::math::orthonormal_basis;
    let third = 1.0 / 3f32.sqrt();
    let special = [
        Vec3::Z,
        Vec3::NEG_Z,
        Vec3::new(0.0, 0.0, (-1.0f32).next_up()),
        Vec3::new(-0.0, -0.0, 1.0),
        Vec3::new(-0.0, 0.0, -1.0),
        Vec3::new(0.0, -1.0, -0.0),
        Vec3::new(-1.0, -0.0, 0.0),
        Vec3::splat(third),
        Vec3::splat(third.next_up()),
        Vec3::splat(third.next_down()),
    ];
    let drawn = (0..1_000_000u64).map(|index| {
        let [a, b, ..] = numbers(index);
        direction(a, b)
    });
    let (mut dots, mut handedness) = (0.0f32, 0.0f64);
    for normal in drawn.chain(special) {
        let (x, y) = orthonormal_basis(normal);
        for (dot, expected) in
            [(x.dot(y), 0.0), (x.dot(normal), 0.0), (y.dot(normal), 0.0), (x.dot(x), 1.0), (y.dot(y), 1.0)]
        {
            dots = dots.max((dot - expected).abs());
        }
        let back = x.as_dvec3().cross(y.as_dvec3()) - normal.as_dvec3();
        handedness = handedness.max(DVec3::length(back));
    }
    bench.at_most("1e6 normals and 10 special ones: largest dot product", 4e-7, f64::from(dots));
    bench.at_most("the same: largest |x cross y - n|", 1e-6, handedness);
}
