//! Laws that every picture obeys, through the public interface alone.

use farm_film::{Film, FrameIndex, Resolution, SampleBlock};
use farm_render::{PreparedScene, render};
use farm_scene::{
    Camera, Emission, Environment, Filter, Image, Instance, Integrator, Lens, Light, LightKind, Material,
    Mesh, Node, Pixels, Projection, Scene, Settings, Shutter, Textured, Transform,
};
use glam::{DQuat, DVec3, Quat, Vec3};
use std::sync::Arc;

fn node(translation: DVec3) -> Node {
    Node {
        name: String::new(),
        parent: None,
        transform: Transform::Trs { translation, rotation: DQuat::IDENTITY, scale: DVec3::ONE },
        motion_vector: None,
        instances: Vec::new(),
        skin: None,
        morph_weights: Vec::new(),
    }
}

fn quad(corner: Vec3, along: Vec3, up: Vec3) -> Mesh {
    Mesh {
        positions: vec![corner, corner + along, corner + along + up, corner + up],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

/// The cube [-1, 1]^3 seen from inside.
fn room() -> Mesh {
    let mut room = Mesh::default();
    for axis in 0..3 {
        for side in [-1.0f32, 1.0] {
            let n = Vec3::AXES[axis] * side;
            let (a, b) = (Vec3::AXES[(axis + 1) % 3], Vec3::AXES[(axis + 2) % 3] * -side);
            let wall = quad(n - a - b, a * 2.0, b * 2.0);
            let first = room.positions.len() as u32;
            room.positions.extend(wall.positions);
            room.triangles
                .extend(wall.triangles.iter().map(|triangle| triangle.map(|vertex| vertex + first)));
        }
    }
    room
}

/// A camera at the origin that looks along -Z.
fn seen_from(eye: DVec3) -> Scene {
    let camera = Camera {
        name: "eye".to_owned(),
        node: 0,
        projection: Projection::Perspective { yfov: 1.0 },
        lens: None,
        shutter: Shutter::default(),
    };
    Scene { nodes: vec![node(eye)], cameras: vec![camera], ..Scene::default() }
}

fn add(scene: &mut Scene, mesh: Mesh, material: Material) -> usize {
    let mut drawn = node(DVec3::ZERO);
    drawn
        .instances
        .push(Instance { mesh: scene.meshes.len() as u32, material: scene.materials.len() as u32 });
    scene.meshes.push(mesh);
    scene.materials.push(material);
    scene.nodes.push(drawn);
    scene.nodes.len() - 1
}

fn settings(width: u32, height: u32) -> Settings {
    Settings {
        camera: 0,
        width,
        height,
        integrator: Integrator::Path,
        filter: Filter::Box,
        max_depth: 8,
        seed: 1,
        fps: 24.0,
        clamp: None,
    }
}

fn prepared(scene: Scene, settings: &Settings) -> PreparedScene {
    PreparedScene::new(&Arc::new(scene), settings, FrameIndex(0)).unwrap()
}

fn pixels(scene: &PreparedScene, tile_side: u32, spp: u64) -> Vec<[f32; 3]> {
    let mut film = Film::new(scene.resolution(), tile_side, spp).unwrap();
    for block in film.roots().to_vec() {
        for tile in scene.resolution().tiles(tile_side) {
            let rendered = render(scene, tile, block, &|| false).unwrap();
            assert_eq!(rendered.counters.faults(), 0);
            film.add(rendered.tile).unwrap();
        }
    }
    film.pixels()
}

fn mean(pixels: &[[f32; 3]]) -> f64 {
    pixels.iter().flatten().map(|&value| f64::from(value)).sum::<f64>() / (pixels.len() * 3) as f64
}

/// A room with a glossy ball of panels, a moving quad, an area light and a lens: something of everything.
fn everything(scale: f32) -> Scene {
    let mut scene = seen_from(DVec3::new(0.0, 0.0, 0.9) * f64::from(scale));
    scene.cameras[0].lens = Some(Lens {
        aperture_radius: 0.05 * scale,
        focus_distance: 1.2 * scale,
        blades: 6,
        rotation: 0.3,
        anamorphic_ratio: 1.0,
    });
    scene.cameras[0].shutter = Shutter { open: 0.0, close: 0.5 };
    let scaled = |mut mesh: Mesh| {
        mesh.positions.iter_mut().for_each(|position| *position *= scale);
        mesh
    };
    add(&mut scene, scaled(room()), Material::lambert("wall", Vec3::new(0.7, 0.6, 0.5)));
    let lamp = quad(Vec3::new(-0.3, 0.99, -0.3), Vec3::X * 0.6, Vec3::Z * 0.6);
    add(&mut scene, scaled(lamp), Material::emitter("lamp", Vec3::new(9.0, 8.0, 7.0)));
    let plate = quad(Vec3::new(-0.6, -0.5, -0.5), Vec3::new(0.7, 0.0, 0.2), Vec3::Y * 0.9);
    add(&mut scene, scaled(plate), Material::metal("plate", Vec3::new(0.9, 0.8, 0.3), 0.3));
    let flag = quad(Vec3::new(0.1, -0.3, -0.2), Vec3::X * 0.3, Vec3::Y * 0.3);
    let moving = add(&mut scene, scaled(flag), Material::lambert("flag", Vec3::new(0.1, 0.3, 0.9)));
    scene.nodes[moving].motion_vector = Some(Vec3::new(0.2, 0.1, 0.0) * scale);
    scene
}

#[test]
fn a_white_furnace_returns_its_emission_series() {
    // Closed room, emission 0.5, albedo 0.5: 1 - 2^-(depth + 1).
    let mut scene = seen_from(DVec3::ZERO);
    let mut wall = Material::lambert("wall", Vec3::splat(0.5));
    wall.emission = Some(Emission { radiance: Textured::constant(Vec3::splat(0.5)) });
    add(&mut scene, room(), wall);
    let scene = prepared(scene, &settings(16, 16));
    let measured = mean(&pixels(&scene, 16, 256));
    assert!((measured - 0.998047).abs() < 2e-3, "{measured}");
}

#[test]
fn a_point_light_lights_a_floor_as_the_inverse_square_law_says() {
    // T1: 100 cd at height 2, albedo 0.5, seen straight below it.
    let mut scene = seen_from(DVec3::new(0.0, 0.0, 1.0));
    scene.cameras[0].projection = Projection::Orthographic { ymag: 1e-3 };
    add(
        &mut scene,
        quad(Vec3::new(-9.0, -9.0, 0.0), Vec3::X * 18.0, Vec3::Y * 18.0),
        Material::lambert("floor", Vec3::splat(0.5)),
    );
    scene.nodes.push(node(DVec3::new(0.0, 0.0, 2.0)));
    scene.lights.push(Light {
        name: String::new(),
        node: 2,
        kind: LightKind::Point { intensity: Vec3::splat(100.0) },
    });
    let measured = mean(&pixels(&prepared(scene, &settings(4, 4)), 4, 16));
    assert!((measured / 3.978874 - 1.0).abs() < 1e-5, "{measured}");
}

#[test]
fn light_sampling_and_chance_hits_agree_on_a_sphere_light() {
    // T6: sphere of radius 1 at distance 10.
    let mut scene = seen_from(DVec3::new(0.0, 0.0, 1.0));
    scene.cameras[0].projection = Projection::Orthographic { ymag: 1e-3 };
    add(
        &mut scene,
        quad(Vec3::new(-9.0, -9.0, 0.0), Vec3::X * 18.0, Vec3::Y * 18.0),
        Material::lambert("floor", Vec3::ONE),
    );
    scene.nodes.push(node(DVec3::new(0.0, 0.0, 10.0)));
    let kind = LightKind::Sphere { radiance: Vec3::splat(std::f32::consts::PI), radius: 1.0 };
    scene.lights.push(Light { name: String::new(), node: 2, kind });
    let measured = mean(&pixels(&prepared(scene, &settings(8, 8)), 8, 256));
    assert!((measured / 0.0314159 - 1.0).abs() < 2e-3, "{measured}");
}

#[test]
fn a_convex_body_in_a_uniform_environment_shows_its_albedo() {
    let mut scene = seen_from(DVec3::new(0.0, 0.0, 1.0));
    add(
        &mut scene,
        quad(Vec3::new(-99.0, -99.0, 0.0), Vec3::X * 198.0, Vec3::Y * 198.0),
        Material::lambert("floor", Vec3::splat(0.5)),
    );
    let image = Image { name: String::new(), width: 1, height: 1, pixels: Pixels::Float(vec![[1.0; 3]]) };
    scene.environment =
        Some(Environment { image, intensity: 1.0, rotation: Quat::IDENTITY, visible_to_camera: true });
    let measured = mean(&pixels(&prepared(scene, &settings(8, 8)), 8, 64));
    assert!((measured - 0.5).abs() < 2e-3, "{measured}");
}

#[test]
fn tiles_and_blocks_do_not_show() {
    for integrator in [Integrator::Path, Integrator::Distribution] {
        let settings = Settings { integrator, filter: Filter::Gaussian, ..settings(12, 10) };
        let scene = prepared(everything(1.0), &settings);
        let whole = pixels(&scene, 64, 48);
        let mut film = Film::new(scene.resolution(), 5, 48).unwrap();
        for range in [32..48, 16..32, 0..16] {
            for tile in scene.resolution().tiles(5) {
                film.add(
                    render(&scene, tile, SampleBlock::new(range.clone()).unwrap(), &|| false).unwrap().tile,
                )
                .unwrap();
            }
        }
        assert_eq!(film.pixels(), whole, "{integrator:?}");
        assert!(mean(&whole) > 0.01, "something is seen");
    }
}

#[test]
fn a_scene_scaled_by_a_power_of_two_gives_the_same_bits() {
    let expected = pixels(&prepared(everything(1.0), &settings(16, 12)), 16, 16);
    for scale in [(2.0f32).powi(20), (2.0f32).powi(-20)] {
        assert_eq!(
            pixels(&prepared(everything(scale), &settings(16, 12)), 16, 16),
            expected,
            "scale {scale}"
        );
    }
}

#[test]
fn a_frame_that_is_asked_to_stop_leaves_nothing() {
    let scene = prepared(everything(1.0), &settings(4, 4));
    let tile = Resolution::new(4, 4).unwrap().full();
    assert_eq!(render(&scene, tile, SampleBlock::new(0..16).unwrap(), &|| true), None);
}

#[test]
fn the_report_names_what_is_left_out() {
    let scene = prepared(everything(1.0), &settings(4, 4));
    let used: Vec<_> = scene.report().used().map(|usage| usage.feature).collect();
    assert!(used.contains(&"motion blur") && used.contains(&"depth of field"), "{used:?}");
    assert!(scene.report().left_out().any(|feature| feature == "textures"));
}
