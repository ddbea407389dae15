//! Random small scenes: anything may be degenerate, nothing may go wrong.

use super::numerics::Chance;
use crate::stability::bench::Bench;
use crate::stability::measure::{self, Measurement, Picture};
use crate::stability::stage::{self, Stage};
use farm_film::{Counters, Film, FrameIndex};
use farm_render::{PreparedScene, render};
use farm_scene::{
    Dielectric, Emission, Filter, Integrator, LightKind, Material, Mesh, Mirror, Path, Projection, Surface,
    Textured, Transform, Volume,
};
use glam::{DMat4, DQuat, DVec3, Quat, Vec3};
use std::sync::Arc;
use std::time::Instant;

/// Longest that one of these scenes may take: a hundred times the usual.
const SECONDS_MAX: f64 = 5.0;

/// A number of random size: mostly ordinary, sometimes extreme, sometimes zero.
fn size(chance: &mut Chance) -> f64 {
    match chance.below(12) {
        0 => 0.0,
        1 => 10f64.powf(chance.unit() * 16.0 - 8.0),
        _ => 0.2 + chance.unit() * 2.0,
    }
}

fn signed(chance: &mut Chance) -> f64 {
    chance.unit() * 2.0 - 1.0
}

fn vector(chance: &mut Chance, reach: f64) -> DVec3 {
    DVec3::new(signed(chance), signed(chance), signed(chance)) * reach
}

fn rotation(chance: &mut Chance) -> DQuat {
    let q = DQuat::from_vec4(vector(chance, 1.0).extend(signed(chance)));
    if q.length() > 1e-3 { q.normalize() } else { DQuat::IDENTITY }
}

fn transform(chance: &mut Chance) -> Transform {
    if chance.below(6) == 0 {
        // Any matrix: sheared, mirrored, or flat because two columns are one.
        let x = vector(chance, 1.0);
        let y = if chance.below(3) == 0 { x } else { vector(chance, 1.0) };
        let columns = [x, y, vector(chance, 1.0)].map(|column| column.extend(0.0));
        let place = vector(chance, 2.0).extend(1.0);
        return Transform::Matrix(DMat4::from_cols(columns[0], columns[1], columns[2], place));
    }
    let sign = if chance.below(4) == 0 { -1.0 } else { 1.0 };
    Transform::Trs {
        translation: vector(chance, 2.0),
        rotation: rotation(chance),
        scale: DVec3::new(size(chance) * sign, size(chance), size(chance)),
    }
}

fn mesh(chance: &mut Chance) -> Mesh {
    let mut mesh = match chance.below(5) {
        0 => stage::cuboid(Vec3::splat(-0.5), Vec3::splat(0.5)),
        1 => stage::globe(Vec3::ZERO, 0.6, 3 + chance.below(6) as u32),
        2 => stage::quad(Vec3::ZERO, Vec3::X, Vec3::Y),
        3 => stage::polygon(Vec3::ZERO, Vec3::X, Vec3::Z, 1.0, 3 + chance.below(9) as u32),
        _ => {
            let corner = |chance: &mut Chance| vector(chance, 1.0).as_vec3();
            let one = |chance: &mut Chance| [corner(chance), corner(chance), corner(chance)];
            let all: Vec<_> = (0..1 + chance.below(8)).map(|_| one(chance)).collect();
            stage::triangles(&all)
        }
    };
    if chance.below(4) == 0 {
        mesh.normals =
            Some(mesh.positions.iter().map(|_| vector(chance, 1.0).as_vec3().normalize_or_zero()).collect());
    }
    if chance.below(8) == 0 {
        let broken = [f32::NAN, f32::INFINITY, 0.0, 1e30][chance.below(4)];
        let vertex = chance.below(mesh.positions.len());
        mesh.positions[vertex][chance.below(3)] = broken;
    }
    mesh
}

fn color(chance: &mut Chance) -> Vec3 {
    match chance.below(6) {
        0 => Vec3::ZERO,
        1 => Vec3::ONE,
        _ => Vec3::new(chance.unit() as f32, chance.unit() as f32, chance.unit() as f32),
    }
}

fn edge_or_inside(chance: &mut Chance) -> f32 {
    match chance.below(5) {
        0 => 0.0,
        1 => 1.0,
        2 => 10f64.powf(-6.0 * chance.unit()) as f32,
        _ => chance.unit() as f32,
    }
}

fn material(chance: &mut Chance) -> Material {
    let ior = [1.0, 1.0001, 1.33, 1.5, 2.42, 100.0, f32::MAX, 0.0][chance.below(8)];
    let transmission = (chance.below(4) == 0).then(|| Textured::constant(edge_or_inside(chance)));
    let surface = match chance.below(8) {
        0 => Surface::Unlit,
        1 => Surface::Mirror(Mirror {
            reflectance: color(chance),
            roughness: edge_or_inside(chance),
            centered: chance.below(2) == 0,
        }),
        _ => Surface::MetallicRoughness {
            metallic: Textured::constant(edge_or_inside(chance)),
            roughness: Textured::constant(edge_or_inside(chance)),
            dielectric: Dielectric { ior, specular: None, transmission },
        },
    };
    let volume = (chance.below(3) == 0).then(|| Volume {
        attenuation_distance: size(chance).max(1e-6) as f32,
        attenuation_color: color(chance),
    });
    let emission = (chance.below(4) == 0)
        .then(|| Emission { radiance: Textured::constant(color(chance) * size(chance) as f32) });
    Material {
        surface,
        volume,
        emission,
        double_sided: chance.below(2) == 0,
        ..Material::lambert("any", color(chance))
    }
}

fn light(chance: &mut Chance) -> LightKind {
    let strength = color(chance) * size(chance) as f32;
    let length = |chance: &mut Chance| size(chance) as f32;
    match chance.below(6) {
        0 => LightKind::Point { intensity: strength },
        1 => LightKind::Spot {
            intensity: strength,
            inner_cone: 0.5 * chance.unit() as f32,
            outer_cone: 0.5 + chance.unit() as f32,
        },
        2 => LightKind::Directional { irradiance: strength },
        3 => LightKind::Sphere { radiance: strength, radius: length(chance) },
        4 => LightKind::Rectangle { radiance: strength, width: length(chance), height: length(chance) },
        _ => LightKind::Disk { radiance: strength, radius: length(chance) },
    }
}

/// The scene of a seed.
pub fn scene_of(seed: u64) -> Stage {
    let mut chance = Chance(seed);
    let chance = &mut chance;
    let mut stage = Stage::new().size(5, 4).depth([0, 1, 3, 8, 30][chance.below(5)]);
    stage.settings.integrator =
        if chance.below(3) == 0 { Integrator::Distribution } else { Integrator::Path };
    stage.settings.filter = [Filter::Box, Filter::Gaussian, Filter::BlackmanHarris][chance.below(3)];
    for _ in 0..1 + chance.below(5) {
        let parent = (!stage.scene.nodes.is_empty() && chance.below(3) == 0)
            .then(|| chance.below(stage.scene.nodes.len()) as u32);
        let node = stage.node_below(parent, transform(chance));
        stage.draw(node, mesh(chance), material(chance));
        if chance.below(4) == 0 {
            let reach = size(chance);
            stage.scene.nodes[node as usize].motion_vector = Some(vector(chance, reach).as_vec3());
        }
        if chance.below(4) == 0 {
            let turn = rotation(chance).as_quat();
            stage.animate(node, Path::Rotation(vec![Quat::IDENTITY, turn]));
        }
        if chance.below(5) == 0 {
            let to = DVec3::new(size(chance), -size(chance), size(chance)).as_vec3();
            stage.animate(node, Path::Scale(vec![Vec3::ONE, to]));
        }
    }
    for _ in 0..chance.below(4) {
        stage.light(light(chance), transform(chance));
    }
    if chance.below(3) == 0 {
        let values: Vec<f32> = (0..8).map(|_| edge_or_inside(chance) * 3.0).collect();
        stage.environment([1, 2, 4, 8][chance.below(4)], &values);
    }
    let projection = if chance.below(3) == 0 {
        Projection::Orthographic { ymag: size(chance).max(1e-9) as f32 }
    } else {
        Projection::Perspective { yfov: 0.05 + 3.0 * chance.unit() as f32 }
    };
    stage.camera(vector(chance, 4.0) + DVec3::Z * 0.1, vector(chance, 0.5), projection);
    if chance.below(3) == 0 {
        stage.lens(size(chance).max(1e-9) as f32, size(chance).max(1e-9) as f32);
    }
    let open = chance.unit();
    stage.shutter(open, if chance.below(3) == 0 { open } else { open + chance.unit() });
    stage
}

/// Renders a seed's scene whole, and in pieces; says what went wrong.
pub fn try_seed(seed: u64) -> Result<Counters, String> {
    let start = Instant::now();
    let stage = scene_of(seed);
    let scene = PreparedScene::new(&Arc::new(stage.scene), &stage.settings, FrameIndex(0))
        .map_err(|err| format!("refused: {err}"))?;
    let whole = measure::develop(&scene, scene.resolution().full(), 32);
    if !whole.pixels.iter().flatten().all(|value| value.is_finite() && *value >= 0.0) {
        return Err("a pixel is no radiance".to_owned());
    }
    if whole.counters.faults() > 0 {
        return Err(format!(
            "{} NaN, {} infinite, {} negative samples",
            whole.counters.nan, whole.counters.infinite, whole.counters.negative
        ));
    }
    if pieces(&scene, &whole) != 0.0 {
        return Err("in pieces it is another picture".to_owned());
    }
    let seconds = start.elapsed().as_secs_f64();
    if seconds > SECONDS_MAX {
        return Err(format!("it took {seconds:.1} s"));
    }
    Ok(whole.counters)
}

/// Channels that differ when tiles of 3 pixels and leaves of 16 samples are put together.
fn pieces(scene: &PreparedScene, whole: &Picture) -> f64 {
    let mut film = Film::new(scene.resolution(), 3, 32).expect("a film");
    for tile in scene.resolution().tiles(3) {
        for start in [16, 0] {
            let part =
                render(scene, tile, measure::block(start, start + 16), &|| false).expect("not stopped");
            film.add(part.tile).expect("a part of it");
        }
    }
    Picture { pixels: film.pixels(), ..whole.clone() }.differing(whole)
}

/// The command that renders one seed's scene again.
fn replay(seed: u64) -> String {
    format!("see it again with `cargo run --release -p farm-tests --bin stability -- --scene {seed}`")
}

/// Scenes by the hundred, or by the ten thousand.
pub fn random_scenes(bench: &mut Bench) {
    let seeds = bench.pick(400u64, 10_000);
    let mut counters = Counters::default();
    let mut failures = Vec::new();
    for seed in 0..seeds {
        match std::panic::catch_unwind(|| try_seed(seed)) {
            Ok(Ok(found)) => counters = counters.plus(found),
            Ok(Err(reason)) => failures.push(format!("{reason}; {}", replay(seed))),
            Err(_) => failures.push(format!("panic; {}", replay(seed))),
        }
    }
    let found = Measurement { mean: failures.len() as f64, standard_error: None, counters };
    let first = failures.first().map_or(String::new(), |failure| format!(": {failure}"));
    bench.exact(format!("{seeds} random scenes: failures{first}"), 0.0, found);
}
