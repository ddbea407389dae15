//! Scenes in the Cornell box (Goral et al. 1984), made as wide as a film frame.

use super::gltf::{Gltf, Material, Placement, Scale, View};
use super::shapes::{Shape, ceiling, ceiling_with_hole, cuboid, floor, quad, unit_sphere};

/// Half the room's width, its height and half its depth, metres.
const X: f32 = 1.6;
const Y: f32 = 1.8;
const Z: f32 = 1.5;

const WHITE: [f32; 3] = [0.725, 0.71, 0.68];
const RED: [f32; 3] = [0.63, 0.065, 0.05];
const GREEN: [f32; 3] = [0.14, 0.45, 0.091];

/// Fills the frame with the room's open side.
const VIEW: View =
    View { eye: [0.0, 0.9, 5.0], target: [0.0, 0.9, 0.0], yfov_degrees: 27.75, lens: None, shutter: None };

/// Walls, and a lamp of `half` width and depth in the ceiling. Returns the white of the walls.
fn room(gltf: &mut Gltf, half: [f32; 2], strength: f32) -> Material {
    let (x, z) = ([-half[0], half[0]], [-half[1], half[1]]);
    let white = gltf.diffuse("white", WHITE);
    let (red, green) = (gltf.diffuse("red", RED), gltf.diffuse("green", GREEN));
    let lamp = gltf.emitter("lamp", [1.0, 0.83, 0.6], strength);
    let pale = floor(0.0, [-X, X], [-Z, Z])
        .with(&quad([[-X, 0.0, -Z], [X, 0.0, -Z], [X, Y, -Z], [-X, Y, -Z]]))
        .with(&ceiling_with_hole(Y, [-X, X], [-Z, Z], [x, z]));
    let left = quad([[-X, 0.0, Z], [-X, 0.0, -Z], [-X, Y, -Z], [-X, Y, Z]]);
    let right = quad([[X, 0.0, -Z], [X, 0.0, Z], [X, Y, Z], [X, Y, -Z]]);
    let parts = [(pale, white), (left, red), (right, green), (ceiling(Y, x, z), lamp)]
        .map(|(shape, material)| (gltf.geometry(&shape), material));
    let mesh = gltf.mesh("room", &parts);
    gltf.node("room", mesh, Placement::ORIGIN);
    white
}

fn put(gltf: &mut Gltf, name: &str, shape: &Shape, material: Material, placement: Placement) {
    let geometry = gltf.geometry(shape);
    let mesh = gltf.mesh(name, &[(geometry, material)]);
    gltf.node(name, mesh, placement);
}

/// The picture of the README: soft shadows from the lamp, a glossy golden ball, a lens that is sharp on it and soft before
/// and behind it, and a blue ball in flight.
pub fn cornell(scale: Scale) -> Gltf {
    let mut gltf = Gltf::new(scale);
    let white = room(&mut gltf, [0.6, 0.4], 9.0);
    let tall = cuboid([-0.3, 0.0, -0.3], [0.3, 1.1, 0.3]);
    put(&mut gltf, "tall box", &tall, white, Placement::turned([0.48, 0.0, -0.85], -17.0));

    let sphere = gltf.unit_sphere(&unit_sphere(3));
    let ball = |gltf: &mut Gltf, name: &str, material, at, radius| {
        let mesh = gltf.mesh(name, &[(sphere, material)]);
        gltf.node(name, mesh, Placement::sized(at, radius))
    };
    let gold = gltf.metal("gold", [1.0, 0.71, 0.29], 0.25);
    ball(&mut gltf, "gold", gold, [-0.58, 0.44, -0.05], 0.44);
    let silver = gltf.metal("silver", [0.95, 0.94, 0.92], 0.1);
    ball(&mut gltf, "silver", silver, [0.16, 0.22, 0.42], 0.22);
    let blue = gltf.plastic("blue", [0.08, 0.22, 0.75], 0.3);
    let flying = ball(&mut gltf, "flying", blue, [0.02, 1.12, 0.1], 0.15);
    gltf.move_while_open(flying, [0.4, 0.16, 0.0]);

    // A row from the lens to the back wall, to see what is in focus.
    for (index, (z, color)) in [
        (1.28, [0.8, 0.25, 0.1]),
        (0.78, [0.85, 0.55, 0.1]),
        (0.28, [0.75, 0.75, 0.2]),
        (-0.22, [0.2, 0.6, 0.3]),
        (-0.72, [0.15, 0.5, 0.7]),
        (-1.22, [0.4, 0.25, 0.7]),
    ]
    .into_iter()
    .enumerate()
    {
        let material = gltf.plastic(&format!("pearl {index}"), color, 0.4);
        ball(&mut gltf, &format!("pearl {index}"), material, [1.16 + 0.17 * z, 0.11, z], 0.11);
    }
    // Before the lens: out of focus, at the left edge.
    ball(&mut gltf, "near", gold, [-1.02, 0.12, 1.22], 0.12);
    gltf.camera(View { lens: Some((0.14, 4.68)), shutter: Some((0.0, 0.02)), ..VIEW });
    gltf
}

/// Diffuse walls, two diffuse boxes.
pub fn cornell_diffuse(scale: Scale) -> Gltf {
    let mut gltf = Gltf::new(scale);
    let white = room(&mut gltf, [0.45, 0.3], 16.0);
    let tall = cuboid([-0.3, 0.0, -0.3], [0.3, 1.1, 0.3]);
    put(&mut gltf, "tall box", &tall, white, Placement::turned([-0.55, 0.0, -0.5], 18.0));
    let short = cuboid([-0.3, 0.0, -0.3], [0.3, 0.55, 0.3]);
    put(&mut gltf, "short box", &short, white, Placement::turned([0.6, 0.0, 0.35], -17.0));
    gltf.camera(VIEW);
    gltf
}

/// Metal balls of roughness 0.05 to 0.5.
pub fn glossy_metals(scale: Scale) -> Gltf {
    let mut gltf = Gltf::new(scale);
    room(&mut gltf, [0.45, 0.3], 16.0);
    let sphere = gltf.unit_sphere(&unit_sphere(4));
    for (index, (roughness, color)) in [
        (0.05, [0.95, 0.93, 0.88]),
        (0.1, [1.0, 0.77, 0.34]),
        (0.2, [0.95, 0.64, 0.54]),
        (0.35, [0.56, 0.57, 0.58]),
        (0.5, [1.0, 0.77, 0.34]),
    ]
    .into_iter()
    .enumerate()
    {
        let name = format!("roughness {roughness}");
        let metal = gltf.metal(&name, color, roughness);
        let mesh = gltf.mesh(&name, &[(sphere, metal)]);
        let along = index as f32 - 2.0;
        gltf.node(&name, mesh, Placement::sized([along * 0.6, 0.27, 0.4 - 0.1 * along * along], 0.27));
    }
    gltf.camera(VIEW);
    gltf
}

/// A solid glass ball and a glass block under a small lamp: light reaches the floor behind them through glass only.
pub fn glass_caustic(scale: Scale) -> Gltf {
    let mut gltf = Gltf::new(scale);
    room(&mut gltf, [0.2, 0.2], 60.0);
    let glass = gltf.glass("glass", 1.5);
    let sphere = gltf.unit_sphere(&unit_sphere(4));
    let mesh = gltf.mesh("ball", &[(sphere, glass)]);
    gltf.node("ball", mesh, Placement::sized([-0.45, 0.45, 0.0], 0.4));
    let block = cuboid([-0.25, 0.05, -0.25], [0.25, 0.75, 0.25]);
    put(&mut gltf, "block", &block, glass, Placement::turned([0.6, 0.0, -0.1], 30.0));
    gltf.camera(VIEW);
    gltf
}

/// A white room whose only light comes through a slit from a bright chamber behind its back wall.
pub fn slit(scale: Scale) -> Gltf {
    /// Half the slit's width, metres.
    const HALF: f32 = 0.03;
    /// Where the chamber ends.
    const BACK: f32 = -2.5;
    let mut gltf = Gltf::new(scale);
    let white = gltf.diffuse("white", WHITE);
    let blue = gltf.diffuse("blue", [0.15, 0.2, 0.6]);
    let lamp = gltf.emitter("lamp", [1.0, 0.9, 0.75], 400.0);
    let wall = |x0: f32, x1: f32| quad([[x0, 0.0, -Z], [x1, 0.0, -Z], [x1, Y, -Z], [x0, Y, -Z]]);
    let side = |x: f32, z0: f32, z1: f32| quad([[x, 0.0, z0], [x, 0.0, z1], [x, Y, z1], [x, Y, z0]]);
    let pale = floor(0.0, [-X, X], [BACK, Z])
        .with(&ceiling(Y, [-X, X], [BACK, Z]))
        .with(&wall(-X, -HALF))
        .with(&wall(HALF, X))
        .with(&side(X, Z, BACK));
    let parts = [
        (pale, white),
        (side(-X, BACK, Z), blue),
        (quad([[-X, 0.0, BACK], [X, 0.0, BACK], [X, Y, BACK], [-X, Y, BACK]]), lamp),
    ]
    .map(|(shape, material)| (gltf.geometry(&shape), material));
    let mesh = gltf.mesh("room", &parts);
    gltf.node("room", mesh, Placement::ORIGIN);
    let block = cuboid([-0.25, 0.0, -0.25], [0.25, 0.7, 0.25]);
    put(&mut gltf, "block", &block, white, Placement::turned([0.7, 0.0, 0.2], 25.0));
    gltf.camera(VIEW);
    gltf
}
