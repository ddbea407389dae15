//! What is hit is what a scan over all triangles says, in every build.

use super::*;

#[test]
fn nearest_hit_of_a_baked_scene_is_that_of_a_scan_bit_for_bit() {
    for seed in 0..20 {
        let mut random = Random(seed);
        let mesh = soup(&mut random, [3, 9, 50, 400][seed as usize % 4], 0.3);
        let accel = still(mesh.clone());
        assert!(matches!(accel.upper, Level::Single));
        for _ in 0..500 {
            let ray = random_ray(&mut random);
            assert_eq!(accel.closest(&ray, all), scan(&mesh, &ray), "seed {seed}: {ray:?}");
        }
    }
}

#[test]
fn deforming_scene_agrees_with_a_scan_at_the_time_of_each_ray() {
    for seed in 0..8 {
        let mut random = Random(seed);
        let mesh = deforming(&mut random, 60, 2 + seed as usize % 3);
        let accel = still(mesh.clone());
        assert!(accel.report().deforming_meshes);
        for _ in 0..500 {
            let ray = random_ray(&mut random);
            assert_eq!(accel.closest(&ray, all), scan(&mesh, &ray), "seed {seed}: {ray:?}");
        }
    }
}

#[test]
fn mixed_scenes_agree_with_the_reference() {
    for seed in 0..2 {
        let accel = mixed_scene(seed);
        let report = accel.report();
        assert!(report.moving_instances && report.deforming_meshes && report.levels == 2, "{report:?}");
        assert_eq!(report.triangles, 40 + 6000 + 20 + 20 + 20 + 20, "the shared mesh is stored once");
        agree(&accel, &mut Random(seed + 100), 1000, seed);
    }
}

#[test]
#[cfg(target_arch = "x86_64")]
fn avx2_and_the_fallback_give_the_same_bits() {
    for seed in 0..2 {
        let mut accel = mixed_scene(seed);
        let mut random = Random(seed);
        let rays: Vec<Ray> = (0..10_000).map(|_| random_ray(&mut random)).collect();
        let bits = |hit: Option<Hit>| {
            hit.map(|h| (h.t.to_bits(), h.u.to_bits(), h.v.to_bits(), h.instance, h.primitive))
        };
        let fast: Vec<_> = rays.iter().map(|ray| bits(accel.closest(ray, all))).collect();
        accel.avx2 = false;
        for (ray, fast) in rays.iter().zip(fast) {
            assert_eq!(bits(accel.closest(ray, all)), fast, "seed {seed}: {ray:?}");
        }
    }
}
