//! Stiff and extreme scenes.

use super::*;

#[test]
fn scaling_by_a_power_of_two_changes_nothing_but_the_unit() {
    let mut random = Random(11);
    let mesh = soup(&mut random, 300, 0.1);
    let shared = soup(&mut random, 9000, 1e-3);
    let places: Vec<_> = (0..2)
        .map(|_| (Mat3::from_quat(random.rotation()) * Mat3::from_diagonal(Vec3::splat(0.5)), random.point()))
        .collect();
    let build = |scale: f32| {
        let scaled = |mesh: &TriangleMesh| {
            let positions = mesh.keys[0].iter().map(|&p| p * scale).collect();
            Geometry::Triangles(Arc::new(TriangleMesh::fixed(positions, mesh.triangles.clone())))
        };
        let mut instances: Vec<_> =
            places.iter().map(|&(m, t)| placed(1, Affine::new(m, t * scale))).collect();
        instances.push(placed(0, Affine::IDENTITY));
        instances.push(placed(2, Affine::new(Mat3::IDENTITY * scale * 0.1, Vec3::ZERO)));
        Accel::build(vec![scaled(&mesh), scaled(&shared), Geometry::Sphere], instances)
    };
    let accel = build(1.0);
    for exponent in [-20, 20] {
        let scale = 2f32.powi(exponent);
        let scaled = build(scale);
        for _ in 0..5000 {
            let ray = random_ray(&mut random);
            let big = Ray { origin: ray.origin * scale, ..ray };
            let hit = accel.closest(&ray, all);
            let expected = hit.map(|h| Hit { t: h.t * scale, ..h });
            assert_eq!(scaled.closest(&big, all), expected, "2^{exponent}: {ray:?}");
            let Some(hit) = hit else { continue };
            let (a, b) = (accel.surface(&hit, 0.0), scaled.surface(&Hit { t: hit.t * scale, ..hit }, 0.0));
            assert_eq!((a.point * scale, a.error * scale), (b.point, b.error));
            assert_eq!(a.normal_geometric, b.normal_geometric);
        }
    }
}

#[test]
fn heaps_and_shrinking_rows_of_triangles_are_built_fast_and_hit_right() {
    let corner = [Vec3::ZERO, Vec3::X, Vec3::Y];
    let heap = TriangleMesh::fixed(corner.to_vec(), vec![[0, 1, 2]; 100_000]);
    let accel = still(heap);
    assert!(accel.report().depth < 60, "{:?}", accel.report());
    let hit = accel.closest(&Ray::new(Vec3::new(0.2, 0.2, 1.0), -Vec3::Z), all).expect("a hit");
    assert_eq!((hit.t, hit.primitive), (1.0, 0));

    let positions = (0..=126).flat_map(|k| corner.map(|p| p * 2f32.powi(-k))).collect();
    let triangles = (0..=126).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
    let mesh = TriangleMesh::fixed(positions, triangles);
    let accel = still(mesh.clone());
    for k in 0..=126 {
        let p = Vec3::new(0.3, 0.3, 0.0) * 2f32.powi(-k);
        for direction in [-Vec3::Z, Vec3::new(0.3, 0.2, -1.0)] {
            let ray = Ray::new(p - direction, direction);
            let hit = accel.closest(&ray, all);
            assert_eq!(hit, scan(&mesh, &ray), "k = {k}");
            assert!(direction != -Vec3::Z || hit.map(|h| h.primitive) == Some(0), "k = {k}");
        }
    }
}

#[test]
fn worthless_triangles_are_counted_and_change_nothing() {
    let mut random = Random(5);
    let clean = soup(&mut random, 100, 0.3);
    let mut dirty = clean.clone();
    let count = dirty.keys[0].len() as u32;
    dirty.keys[0].extend([Vec3::NAN, Vec3::X * f32::INFINITY, Vec3::X, Vec3::X * 2.0, Vec3::X * 3.0]);
    dirty.triangles.extend([
        [0, 1, count],
        [0, count + 1, 2],
        [count + 2, count + 3, count + 4],
        [7, 7, 8],
        [9, 9, 9],
    ]);
    dirty.triangles.extend_from_within(0..50);
    let (clean, dirty) = (still(clean), still(dirty));
    let report = dirty.report();
    assert_eq!((report.dropped_not_finite, report.dropped_no_area), (2, 3));
    for _ in 0..2000 {
        let ray = random_ray(&mut random);
        assert_eq!(clean.closest(&ray, all), dirty.closest(&ray, all));
    }
}

#[test]
fn needles_are_hit_like_the_quad_they_make_up() {
    // A strip of width 1e-7 of its length, seen along and across.
    let positions = vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1e-7, 0.0), Vec3::new(0.0, 1e-7, 0.0)];
    let accel = still(TriangleMesh::fixed(positions, vec![[0, 1, 2], [0, 2, 3]]));
    for i in 0..=100 {
        let x = i as f32 / 100.0;
        for y in [0.0, 0.5e-7, 1e-7] {
            let hit = accel.closest(&Ray::new(Vec3::new(x, y, 2.0), -Vec3::Z), all);
            assert_eq!(hit.map(|h| h.t), Some(2.0), "{x} {y}");
        }
    }
}

#[test]
fn degenerate_triangle_that_fooled_others_is_not_hit() {
    // Pharr, Jakob, Humphreys: Triangle, BadCases.
    let positions = vec![
        Vec3::new(-1113.4546, -79.049614, -56.24319),
        Vec3::new(-1113.4546, -87.09227, -56.24319),
        Vec3::new(-1113.4546, -79.209015, -56.24319),
    ];
    let accel = still(TriangleMesh::fixed(positions, vec![[0, 1, 2]]));
    let ray = Ray {
        t_max: 0.9999,
        ..Ray::new(Vec3::new(-1081.4792, 99.999954, 87.77011), Vec3::new(-32.1073, -183.35587, -144.60764))
    };
    assert_eq!(accel.closest(&ray, all), None);
}

#[test]
fn box_far_away_is_hit_by_a_ray_that_is_almost_parallel_to_an_axis() {
    let mut mesh = cube();
    mesh.keys[0].iter_mut().for_each(|p| *p = *p - Vec3::splat(0.5) + Vec3::Z * 1e7);
    let accel = still(mesh);
    let hit = accel.closest(&Ray::new(Vec3::ZERO, Vec3::new(1e-9, 0.0, 1.0)), all).expect("a hit");
    assert!((hit.t - 1e7).abs() <= 1.0);
}

#[test]
fn extreme_instances_equal_their_baked_twins() {
    let mut random = Random(13);
    let mesh = Arc::new(soup(&mut random, 9000, 0.2));
    let scales = [
        Vec3::splat(1e8),
        Vec3::splat(1e-8),
        Vec3::new(1.0, 1e-3, 1e3),
        Vec3::new(-1.0, 1.0, 1.0),
        Vec3::new(1.0, 1.0, 0.0),
    ];
    for scale in scales {
        // A turned plate a millionth as thick as wide cannot be written down in f32 corners, baked or not.
        let plate = scale.max_element() > scale.min_element() * 1e5 && scale.min_element() > 0.0;
        let rotation = if plate { Quat::IDENTITY } else { random.rotation() };
        let linear = Mat3::from_quat(rotation) * Mat3::from_diagonal(scale);
        let map = Affine::new(linear, random.point() * scale);
        let far = Affine::new(Mat3::IDENTITY, Vec3::splat(1e20));
        let geometry = vec![Geometry::Triangles(mesh.clone())];
        let baked = Accel::build(geometry.clone(), vec![placed(0, map)]);
        let shared = Accel::build(geometry, vec![placed(0, map), placed(0, far)]);
        assert_eq!(baked.report().baked_instances, 1);
        assert_eq!(shared.report().baked_instances, usize::from(scale.z == 0.0), "singular ones are baked");
        let mut hits = 0;
        for _ in 0..500 {
            let (from, to) = (random.point() * 3.0, random.point());
            let ray = Ray::new(map.point(from), map.vector(to - from));
            let (a, b) = (baked.closest(&ray, all), shared.closest(&ray, all));
            let (Some(a), Some(b)) = (a, b) else {
                assert!(a.is_none() && b.is_none(), "{scale} {a:?} {b:?}");
                continue;
            };
            hits += 1;
            assert!(
                (a.t - b.t).abs() <= 1e-4 * a.t.max(0.1) && a.primitive == b.primitive,
                "{scale}: {a:?} {b:?}"
            );
            let (p, q) = (baked.surface(&a, 0.0), shared.surface(&b, 0.0));
            assert!(p.point.is_finite() && p.normal_geometric.is_finite());
            assert!(
                (p.normal_geometric - q.normal_geometric).length() < if plate { 1e-2 } else { 1e-4 },
                "{scale}"
            );
            assert_eq!(
                baked.triangle_vertices(0, a.primitive, 0.0),
                shared.triangle_vertices(0, a.primitive, 0.0)
            );
        }
        assert!(hits > 20, "{scale}: {hits}");
    }
}

#[test]
fn plates_a_millionth_apart_shadow_each_other() {
    for gap in [5e-5, 1e-6] {
        let plate = |y: f32| {
            let p = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
            p.map(|[x, z]| Vec3::new(x, y, z))
        };
        let positions = [plate(0.0), plate(gap)].concat();
        let accel = still(TriangleMesh::fixed(positions, vec![[0, 2, 1], [0, 3, 2], [4, 6, 5], [4, 7, 6]]));
        let mut random = Random(17);
        for _ in 0..5000 {
            let (x, z) = (random.signed() * 0.9, random.signed() * 0.9);
            let up = Vec3::new(random.signed(), 0.1 + random.next(), random.signed());
            let lower = Ray { t_max: 1.0, ..Ray::new(Vec3::new(x, -1.0, z), Vec3::Y) };
            let hit = accel.closest(&lower, all).expect("the lower plate");
            assert!(hit.primitive < 2);
            let at = accel.surface(&hit, 0.0);
            let origin = offset_origin(at.point, at.error, at.normal_geometric, up);
            assert!(accel.occluded(&Ray::new(origin, up), |h| h.primitive >= 2), "{gap} {x} {z} {up}");
            assert!(!accel.occluded(&Ray::new(origin, up), |h| h.primitive < 2), "{gap} {x} {z} {up}");
        }
    }
}

#[test]
fn ground_lit_at_a_grazing_angle_does_not_shadow_itself() {
    let sun = Vec3::new(0.9999985, 0.0017453283, 0.0);
    let tilts =
        [Quat::IDENTITY, Quat::from_rotation_y(0.7), Quat::from_rotation_x(0.3) * Quat::from_rotation_z(1.1)];
    for tilt in tilts {
        let mut ground = grid(8);
        let turn = |p: Vec3| tilt * Vec3::new(p.x, p.z, -p.y);
        ground.keys[0].iter_mut().for_each(|p| *p = turn((*p - Vec3::new(4.0, 4.0, 0.0)) * 2500.0));
        let ground = Arc::new(ground);
        let instanced = Affine::new(Mat3::from_quat(tilt.inverse()), Vec3::ZERO);
        let scenes = [
            Accel::build(vec![Geometry::Triangles(ground.clone())], vec![placed(0, Affine::IDENTITY)]),
            Accel::build(
                vec![Geometry::Triangles(ground), Geometry::Sphere],
                vec![
                    InstanceDesc {
                        geometry: 0,
                        transform: MotionTransform::from_keys(vec![
                            TransformKey {
                                translation: Vec3::ZERO,
                                rotation: Quat::IDENTITY,
                                stretch: instanced.linear,
                            },
                            TransformKey {
                                translation: Vec3::X,
                                rotation: Quat::IDENTITY,
                                stretch: instanced.linear,
                            },
                        ]),
                    },
                    placed(1, Affine::new(Mat3::IDENTITY, Vec3::splat(1e6))),
                ],
            ),
        ];
        for (accel, to_world) in scenes.iter().zip([tilt, Quat::IDENTITY]) {
            let mut random = Random(19);
            for _ in 0..3000 {
                let target = to_world * (Vec3::new(random.signed(), 0.0, random.signed()) * 9000.0);
                let origin = to_world * Vec3::new(random.signed() * 100.0, 50.0, random.signed() * 100.0);
                let hit = accel.closest(&Ray::new(origin, target - origin), all).expect("the ground");
                let at = accel.surface(&hit, 0.0);
                let light = to_world * sun;
                let start = offset_origin(at.point, at.error, at.normal_geometric, light);
                let shadow = accel.closest(&Ray::new(start, light), all);
                assert_eq!(shadow, None, "at {target}, tilt {tilt}");
            }
        }
    }
}

#[test]
fn shapes_are_hit_where_their_surface_says() {
    let mut random = Random(23);
    let geometries = vec![Geometry::Disk, Geometry::Rectangle, Geometry::Sphere];
    let flat = Affine::new(Mat3::from_cols(Vec3::X, Vec3::Z, Vec3::ZERO), Vec3::new(3.0, 0.0, 0.0));
    let mut instances: Vec<_> =
        (0..3).map(|g| InstanceDesc { geometry: g, transform: fixed_random(&mut random) }).collect();
    instances.push(placed(1, flat));
    instances.push(placed(2, flat));
    instances.extend((0..3).map(|g| InstanceDesc { geometry: g, transform: turning(&mut random) }));
    let accel = Accel::build(geometries, instances);
    assert_eq!(accel.report().dropped_instances, 1, "a flattened sphere has nothing to hit");
    assert_eq!(accel.report().flattened_instances, 1);
    let mut seen = [0; 8];
    for _ in 0..20_000 {
        let ray = random_ray(&mut random);
        let ray = Ray { origin: ray.origin * 2.0, direction: random.point() * 3.0 - ray.origin * 2.0, ..ray };
        let Some(hit) = accel.closest(&ray, all) else { continue };
        seen[hit.instance as usize] += 1;
        let at = accel.surface(&hit, ray.time);
        assert!(
            (ray.origin + ray.direction * hit.t - at.point).length() < 2e-5 * (1.0 + ray.origin.length())
        );
        assert!((at.normal_geometric.length() - 1.0).abs() < 1e-6);
        let away = at.normal_geometric;
        let start = offset_origin(at.point, at.error, at.normal_geometric, away);
        let again = accel.closest(&Ray { time: ray.time, ..Ray::new(start, away) }, all);
        assert!(again.is_none_or(|h| h.instance != hit.instance), "{hit:?} meets itself: {again:?}");
    }
    assert!(seen.iter().enumerate().all(|(i, &n)| (n > 20) == (i != 4)), "{seen:?}");
}

#[test]
fn camera_and_object_that_move_together_stand_still() {
    let step = Vec3::new(1e6, 0.0, 0.0);
    let keys = [Vec3::ZERO, step].map(|translation| TransformKey {
        translation,
        rotation: Quat::IDENTITY,
        stretch: Mat3::IDENTITY,
    });
    let accel = Accel::build(
        vec![Geometry::Triangles(Arc::new(cube()))],
        vec![InstanceDesc { geometry: 0, transform: MotionTransform::from_keys(keys.into()) }],
    );
    for i in 0..=1000 {
        let time = i as f32 / 1000.0;
        let origin = Affine::new(Mat3::IDENTITY, (step.as_dvec3() * f64::from(time)).as_vec3())
            .point(Vec3::new(0.5, 0.5, -2.0));
        let hit = accel.closest(&Ray { time, ..Ray::new(origin, Vec3::Z) }, all);
        assert_eq!(hit.map(|h| h.t), Some(2.0), "time {time}");
    }
}

#[test]
fn empty_scenes_and_unusable_rays_meet_nothing() {
    let nothing = Accel::build(vec![], vec![]);
    assert_eq!(nothing.closest(&Ray::new(Vec3::ZERO, Vec3::X), all), None);
    let empty = still(TriangleMesh::fixed(vec![], vec![]));
    assert_eq!(empty.closest(&Ray::new(Vec3::ZERO, Vec3::X), all), None);
    let accel = still(cube());
    for direction in [Vec3::ZERO, Vec3::NAN] {
        assert_eq!(accel.closest(&Ray::new(Vec3::splat(0.5), direction), all), None);
    }
    let short = Ray { t_max: 0.4, ..Ray::new(Vec3::splat(0.5), Vec3::X) };
    assert!(!accel.occluded(&short, all) && accel.occluded(&Ray { t_max: 0.5, ..short }, all));
}
