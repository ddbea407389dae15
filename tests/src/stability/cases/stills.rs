//! Motion of every kind against the mean of many stills, each at a moment drawn within its slice of the shutter.

use super::motion::{overview, still_life};
use super::numerics::Chance;
use crate::stability::bench::Bench;
use crate::stability::measure::{self, Measurement, Picture, REPLICATES};
use crate::stability::stage::{self, Stage};
use farm_film::Counters;
use farm_scene::{
    Channel, Dielectric, Instance, Interpolation, LightKind, Material, MorphTarget, Path, Skin, Skinning,
    Surface, Textured, Transform,
};
use glam::{DVec3, Mat4, Quat, Vec3};
use std::f32::consts::{FRAC_PI_2, PI};

/// Stills per shutter.
const STILLS: u32 = 16;

/// A number that a picture is compared by.
type View = fn(&Picture) -> f64;

/// What two pictures are compared by: how bright, and how bright to the right and to the bottom.
const VIEWS: [(&str, View); 3] = [
    ("mean", Picture::mean),
    ("to the right", |picture| weighted(picture, |x, _| x / f64::from(picture.tile.width()))),
    ("to the bottom", |picture| weighted(picture, |_, y| y / f64::from(picture.tile.height()))),
];

fn weighted(picture: &Picture, weight: impl Fn(f64, f64) -> f64) -> f64 {
    picture.points().map(|(x, y, value)| weight(x, y) * value).sum::<f64>() / picture.pixels.len() as f64
}

/// Holds a stage whose shutter is open from 0 to 1 against its stills. Their times are stratified and uniform, so the means agree
/// exactly; what is left is noise.
fn against_stills(bench: &mut Bench, name: &str, stage: &Stage) {
    against_stills_with(bench, name, stage, bench.pick(64, 512));
}

fn against_stills_with(bench: &mut Bench, name: &str, stage: &Stage, spp: u64) {
    let moving = measure::pictures(stage, spp);
    let mut still = stage.clone();
    let mut sums = [const { Vec::new() }; 3];
    let mut counters = Counters::default();
    for replicate in 0..REPLICATES {
        let mut chance = Chance(replicate);
        let mut values = [0.0; 3];
        for slice in 0..STILLS {
            let time = (f64::from(slice) + chance.unit()) / f64::from(STILLS);
            still.shutter(time, time);
            still.settings.seed = chance.bits();
            let scene = measure::prepared(&still, still.settings.seed);
            let picture = measure::develop(&scene, scene.resolution().full(), spp / 4);
            counters = counters.plus(picture.counters);
            for (value, (_, view)) in values.iter_mut().zip(VIEWS) {
                *value += view(&picture) / f64::from(STILLS);
            }
        }
        sums.iter_mut().zip(values).for_each(|(all, value)| all.push(value));
    }
    for ((view_name, view), values) in VIEWS.into_iter().zip(sums) {
        let stills = Measurement::of(&values, counters);
        let found = measure::over(&moving, view).minus(stills, stills.mean);
        // Both sides carry noise, so half a percent of the value is asked for, not a tenth.
        bench.coarse(format!("{name}: {view_name}"), stills.mean, found, 5e-3);
    }
}

/// The still life with the globe on a node of its own that a case may animate.
fn with_globe_animated(path: Path) -> Stage {
    let mut stage = still_life();
    stage.animate(2, path);
    stage.shutter(0.0, 1.0);
    stage
}

/// Turns by 90 and 180 degrees, off the pivot.
pub fn turns(bench: &mut Bench) {
    for degrees in [90.0f32, 180.0] {
        let turn = Quat::from_rotation_y(degrees.to_radians());
        let stage = with_globe_animated(Path::Rotation(vec![Quat::IDENTITY, turn]));
        against_stills(bench, &format!("turn by {degrees}"), &stage);
    }
}

/// A scale that goes through zero and comes out mirrored.
pub fn through_zero(bench: &mut Bench) {
    let stage = with_globe_animated(Path::Scale(vec![Vec3::ONE, Vec3::new(-1.0, 1.0, 1.0)]));
    against_stills(bench, "scale x from 1 to -1", &stage);
    let stage = with_globe_animated(Path::Scale(vec![Vec3::ONE, -Vec3::ONE]));
    against_stills(bench, "scale from 1 to -1", &stage);
}

/// Vertices that move by themselves.
pub fn morph(bench: &mut Bench) {
    let stage = morphing(Interpolation::Linear, vec![0.0, 1.0]);
    against_stills(bench, "morph", &stage);
}

/// The still life with a globe whose vertices go elsewhere.
fn morphing(interpolation: Interpolation, times: Vec<f32>) -> Stage {
    let mut stage = still_life();
    let mesh = &mut stage.scene.meshes[1];
    let deltas = mesh.positions.iter().map(|p| Vec3::new(p.y, p.x * p.x, -p.z * 0.5)).collect();
    mesh.morph_targets = vec![MorphTarget { positions: Some(deltas), normals: None, tangents: None }];
    stage.scene.nodes[2].morph_weights = vec![0.0];
    let path = Path::MorphWeights { targets: 1, values: vec![0.0, 1.0] };
    stage.scene.channels.push(Channel { node: 2, times, interpolation, path });
    stage.shutter(0.0, 1.0);
    stage
}

/// A bar of two joints, one of which bends.
pub fn skin(bench: &mut Bench) {
    let mut stage = still_life();
    let mut mesh = stage::globe(Vec3::Y * 0.8, 0.8, 10);
    let weights = mesh.positions.iter().flat_map(|p| {
        let upper = (p.y / 1.6).clamp(0.0, 1.0);
        [1.0 - upper, upper, 0.0, 0.0]
    });
    let skinning = Skinning {
        influences: 4,
        weights: weights.collect(),
        joints: mesh.positions.iter().flat_map(|_| [0, 1, 0, 0]).collect(),
    };
    mesh.skinning = Some(skinning);
    let lower = stage.node_below(Some(0), stage::at(DVec3::new(-0.3, 0.0, 0.9)));
    let upper = stage.node_below(Some(lower), stage::at(DVec3::Y * 0.8));
    let node = stage.node_below(Some(0), Transform::IDENTITY);
    stage.draw(node, mesh, stage::grey(0.7));
    let inverse_bind = vec![Mat4::IDENTITY, Mat4::from_translation(Vec3::Y * -0.8)];
    stage.scene.skins.push(Skin { joints: vec![lower, upper], inverse_bind });
    stage.scene.nodes[node as usize].skin = Some(0);
    stage.animate(upper, Path::Rotation(vec![Quat::IDENTITY, Quat::from_rotation_z(FRAC_PI_2)]));
    stage.shutter(0.0, 1.0);
    against_stills(bench, "skin", &stage);
}

/// A camera that travels and turns.
pub fn camera(bench: &mut Bench) {
    let mut stage = still_life();
    let Transform::Trs { rotation, .. } = stage.scene.nodes[5].transform else { unreachable!("a TRS node") };
    let rotation = rotation.as_quat();
    let turned = Quat::from_rotation_y(0.4) * rotation;
    stage.slide(5, Vec3::new(1.0, 0.3, -0.5));
    stage.animate(5, Path::Rotation(vec![rotation, turned]));
    stage.shutter(0.0, 1.0);
    against_stills(bench, "camera travels and turns", &stage);
}

/// A node that turns within one that turns within one that travels.
pub fn nested(bench: &mut Bench) {
    let mut stage = still_life();
    let first = stage.node_below(Some(0), Transform::IDENTITY);
    let second = stage.node_below(Some(first), stage::at(DVec3::new(0.5, 0.3, 0.5)));
    let third = stage.node_below(Some(second), stage::scaled(DVec3::X * 0.5, DVec3::new(1.0, 0.5, 2.0)));
    stage.draw(third, stage::cuboid(Vec3::splat(-0.3), Vec3::splat(0.3)), stage::grey(0.9));
    stage.slide(first, Vec3::new(-0.5, 0.5, 0.0));
    stage.animate(second, Path::Rotation(vec![Quat::IDENTITY, Quat::from_rotation_y(PI * 0.9)]));
    stage.animate(third, Path::Rotation(vec![Quat::IDENTITY, Quat::from_rotation_x(PI * 0.7)]));
    stage.shutter(0.0, 1.0);
    against_stills(bench, "nested turns", &stage);
}

/// A shutter that spans a jump, at the middle of it and elsewhere: nothing is ever between the two places.
pub fn step(bench: &mut Bench) {
    for at in [0.5f32, 0.3] {
        let mut stage = overview(64, 1, 10.0);
        let bar = stage::quad(Vec3::new(8.0, 0.0, 0.5), Vec3::Z * 9.0, Vec3::X * 8.0);
        let node = stage.place(bar, stage::glow(1.0));
        jump(&mut stage, node, at, Path::Translation(vec![Vec3::ZERO, Vec3::X * 40.0]));
        let (before, after) = (f64::from(at), 1.0 - f64::from(at));
        for (column, expected) in [(4u32, before), (48, after), (24, 0.0), (36, 0.0)] {
            let tile = measure::tile(column, 0, column + 1, 1);
            let found =
                measure::over(&measure::pictures_of(&stage, tile, 1024), Picture::mean).of_steps(1024);
            if expected > 0.0 {
                bench.statistical(format!("jump at {at} of the shutter, column {column}"), expected, found);
            } else {
                bench.exact(format!("jump at {at} of the shutter, column {column} between"), expected, found);
            }
        }
    }
    let mut turned = with_globe_animated(Path::Translation(vec![Vec3::ZERO, Vec3::new(-1.0, 0.5, 0.5)]));
    jump(&mut turned, 3, 0.3, Path::Rotation(vec![Quat::IDENTITY, Quat::from_rotation_y(1.0)]));
    against_stills(bench, "one body moves, another jumps", &turned);
    let mut morphed = morphing(Interpolation::Step, vec![0.0, 0.3]);
    morphed.slide(3, Vec3::new(0.0, 0.5, 0.0));
    against_stills(bench, "a morph jumps", &morphed);
    let mut lit = still_life();
    jump(&mut lit, 4, 0.7, Path::Translation(vec![Vec3::ZERO, Vec3::new(1.5, -1.0, 0.0)]));
    lit.shutter(0.0, 1.0);
    against_stills(bench, "an emissive mesh jumps", &lit);
    let mut eye = still_life();
    let Transform::Trs { translation, .. } = eye.scene.nodes[5].transform else { unreachable!("a TRS node") };
    let place = translation.as_vec3();
    jump(&mut eye, 5, 0.6, Path::Translation(vec![place, place + Vec3::new(0.5, 0.2, 0.0)]));
    eye.shutter(0.0, 1.0);
    against_stills(bench, "the camera jumps", &eye);
}

/// Lets a node be elsewhere from a time on.
fn jump(stage: &mut Stage, node: u32, time: f32, path: Path) {
    let channel = Channel { node, times: vec![0.0, time], interpolation: Interpolation::Step, path };
    stage.scene.channels.push(channel);
}

/// Emitters that move light from where they are.
pub fn emitters(bench: &mut Bench) {
    let mut mesh = still_life();
    mesh.slide(4, Vec3::new(2.0, -1.0, 0.0));
    mesh.shutter(0.0, 1.0);
    against_stills(bench, "emissive mesh moves", &mesh);
    let mut light = still_life();
    light.scene.nodes[4].instances.clear();
    let kind = LightKind::Disk { radiance: Vec3::splat(10.0), radius: 0.6 };
    let node = light.light(kind, stage::look(DVec3::new(0.0, 3.0, 1.0), DVec3::Y));
    light.slide(node, Vec3::new(-2.0, 0.0, 1.0));
    light.shutter(0.0, 1.0);
    against_stills(bench, "disk light moves", &light);
}

/// Moving things in a mirror and behind glass.
pub fn seen_otherwise(bench: &mut Bench) {
    let mut mirror = still_life().depth(5);
    let wall = stage::quad(Vec3::new(0.0, 0.9, -1.5), Vec3::X * 1.5, Vec3::Y * 0.8);
    mirror.draw(0, wall, stage::white_metal(0.0));
    mirror.slide(2, Vec3::new(-1.0, 0.5, 0.5));
    mirror.shutter(0.0, 1.0);
    // What the mirror throws onto the floor is found by chance only: twice the samples.
    against_stills_with(bench, "in a mirror", &mirror, bench.pick(128, 1024));
    let mut pane = still_life().depth(5);
    let surface = Surface::MetallicRoughness {
        metallic: Textured::constant(0.0),
        roughness: Textured::constant(0.0),
        dielectric: Dielectric { ior: 1.5, specular: None, transmission: Some(Textured::constant(1.0)) },
    };
    // Before the eye, where its shadow, lit by chance only, falls out of the picture.
    let window = stage::quad(Vec3::new(0.0, 1.36, 3.5), Vec3::X * 0.5, Vec3::Y * 0.4);
    pane.draw(0, window, Material { surface, ..stage::grey(1.0) });
    pane.slide(2, Vec3::new(-1.0, 0.5, 0.5));
    pane.shutter(0.0, 1.0);
    against_stills(bench, "through a pane", &pane);
}

/// Instances that share a mesh move each their own way.
pub fn shared_mesh(bench: &mut Bench) {
    let mut stage = still_life();
    let node = stage.node_below(Some(0), stage::at(DVec3::new(-1.0, 0.2, 0.7)));
    stage.scene.nodes[node as usize].instances.push(Instance { mesh: 1, material: 2 });
    stage.slide(2, Vec3::new(0.0, 1.0, 0.0));
    stage.slide(node, Vec3::new(0.0, 0.0, -1.0));
    stage.shutter(0.0, 1.0);
    against_stills(bench, "one mesh, two motions", &stage);
}
