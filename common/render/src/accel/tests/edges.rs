//! Where triangles meet, and which of several is hit.

use super::*;

fn sphere(centre: Vec3, radius: f32, steps: u32) -> TriangleMesh {
    let mut positions = vec![];
    for i in 0..=steps {
        for j in 0..2 * steps {
            let (theta, phi) = (
                std::f32::consts::PI * i as f32 / steps as f32,
                std::f32::consts::PI * j as f32 / steps as f32,
            );
            let p = match i {
                0 => Vec3::Y,
                i if i == steps => -Vec3::Y,
                _ => Vec3::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin()),
            };
            positions.push(centre + p * radius);
        }
    }
    let mut triangles = vec![];
    for i in 0..steps {
        for j in 0..2 * steps {
            let at = |i: u32, j: u32| i * 2 * steps + j % (2 * steps);
            triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    TriangleMesh::fixed(positions, triangles)
}

#[test]
fn no_ray_escapes_a_sphere_far_from_the_origin() {
    let centre = Vec3::new(148376.0, 1234.0, -223423.0);
    let accel = still(sphere(centre, 2.0, 50));
    let mut random = Random(7);
    for _ in 0..50_000 {
        let ray = Ray::new(centre + random.point() * 0.5, random.point());
        assert!(accel.closest(&ray, all).is_some(), "{ray:?}");
    }
}

#[test]
fn rays_through_the_edges_and_corners_of_a_grid_hit_it() {
    let accel = still(grid(18));
    for half_x in 2..=34 {
        for half_y in 2..=34 {
            let target = Vec3::new(half_x as f32 * 0.5, half_y as f32 * 0.5, 0.0);
            for from in
                [Vec3::Z, Vec3::new(1.0, 0.0, 1.0), Vec3::new(-3.0, 5.0, 2.0), Vec3::new(0.25, 0.25, -8.0)]
            {
                let hit = accel.closest(&Ray::new(target + from, -from), all);
                assert_eq!(hit.map(|h| h.t), Some(1.0), "{target} from {from}");
            }
        }
    }
}

#[test]
fn equally_near_hits_go_to_the_smallest_instance_and_primitive() {
    let quad = Arc::new(grid(1));
    let geometries = vec![Geometry::Triangles(quad.clone()), Geometry::Triangles(quad), Geometry::Rectangle];
    let plane = Affine::new(Mat3::IDENTITY, Vec3::ZERO);
    for order in [[0, 1, 2], [2, 1, 0], [1, 2, 0]] {
        let instances = order.map(|g| placed(g, plane)).into();
        let accel = Accel::build(geometries.clone(), instances);
        for (x, y, primitive) in [(0.5, 0.25, 0), (0.25, 0.5, 1), (0.5, 0.5, 0)] {
            let hit = accel.closest(&Ray::new(Vec3::new(x, y, 1.0), -Vec3::Z), all).expect("a hit");
            let primitive = if order[0] == 2 { 0 } else { primitive };
            assert_eq!((hit.t, hit.instance, hit.primitive), (1.0, 0, primitive), "order {order:?}");
        }
    }
}

#[test]
fn filter_opens_the_way_to_what_lies_behind() {
    let mut random = Random(3);
    let mesh = soup(&mut random, 200, 0.5);
    let accel = still(mesh);
    for _ in 0..200 {
        let ray = random_ray(&mut random);
        let mut seen: Vec<Hit> = Vec::new();
        let unseen = |seen: &[Hit], h: &Hit| !seen.iter().any(|s| s.primitive == h.primitive);
        while let Some(hit) = accel.closest(&ray, |h| unseen(&seen, h)) {
            assert!(seen.last().is_none_or(|last| last.t <= hit.t));
            seen.push(hit);
        }
        assert!(!accel.occluded(&ray, |h| unseen(&seen, h)));
    }
}

#[test]
fn signs_of_zeros_in_a_direction_do_not_matter() {
    let accel = still(grid(4));
    for signs in 0..8 {
        let sign = |bit: u32| if signs & bit == 0 { 1.0f32 } else { -1.0 };
        let along_z = Vec3::new(0.0 * sign(1), 0.0 * sign(2), sign(4));
        for (x, y) in [(0.0, 0.0), (4.0, 4.0), (1.0, 2.5), (2.0, 2.0)] {
            let origin = Vec3::new(x, y, -3.0 * sign(4));
            let hit = accel.closest(&Ray::new(origin, along_z), all);
            assert_eq!(hit.map(|h| h.t), Some(3.0), "{origin} {along_z}");
        }
        let beside = Ray::new(Vec3::new(-0.1, 1.0, -3.0 * sign(4)), along_z);
        assert_eq!(accel.closest(&beside, all), None);
    }
}
