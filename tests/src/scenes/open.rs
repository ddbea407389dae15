//! Scenes without a room.

use super::gltf::{Gltf, Placement, Scale, View};
use super::shapes::{ceiling, cuboid, floor, quad, terrain, unit_sphere};

const BASE: View =
    View { eye: [0.0, 1.3, 5.5], target: [0.1, 0.5, 0.0], yfov_degrees: 36.0, lens: None, shutter: None };

/// A row of balls through the focal plane, one ball that flies and one block that turns while the shutter is open.
pub fn lens_motion(scale: Scale) -> Gltf {
    let mut gltf = Gltf::new(scale);
    let grey = gltf.diffuse("grey", [0.6; 3]);
    let wall = gltf.diffuse("wall", [0.35, 0.45, 0.6]);
    let lamp = gltf.emitter("lamp", [1.0, 0.95, 0.9], 9.0);
    let parts = [
        (floor(0.0, [-10.0, 10.0], [-6.0, 8.0]), grey),
        (quad([[-10.0, 0.0, -6.0], [10.0, 0.0, -6.0], [10.0, 4.0, -6.0], [-10.0, 4.0, -6.0]]), wall),
        (ceiling(5.0, [-1.5, 1.5], [-1.0, 2.0]), lamp),
    ]
    .map(|(shape, material)| (gltf.geometry(&shape), material));
    let stage = gltf.mesh("stage", &parts);
    gltf.node("stage", stage, Placement::ORIGIN);

    let sphere = gltf.unit_sphere(&unit_sphere(4));
    for (index, color) in [
        [0.8, 0.2, 0.2],
        [0.8, 0.5, 0.1],
        [0.7, 0.7, 0.1],
        [0.2, 0.7, 0.2],
        [0.1, 0.5, 0.7],
        [0.3, 0.2, 0.8],
        [0.7, 0.2, 0.6],
    ]
    .into_iter()
    .enumerate()
    {
        let name = format!("ball {index}");
        let material = gltf.diffuse(&name, color);
        let mesh = gltf.mesh(&name, &[(sphere, material)]);
        let along = index as f32;
        gltf.node(&name, mesh, Placement::sized([-2.1 + 0.7 * along, 0.4, 2.2 - 1.1 * along], 0.4));
    }
    let pale = gltf.diffuse("pale", [0.9; 3]);
    let mesh = gltf.mesh("flying", &[(sphere, pale)]);
    let flying = gltf.node("flying", mesh, Placement::sized([0.8, 0.35, 1.6], 0.35));
    gltf.animate_translation(flying, &[0.0, 1.0], &[[0.8, 0.35, 1.6], [2.4, 1.15, 1.6]]);
    let block = gltf.geometry(&cuboid([-0.6, -0.12, -0.12], [0.6, 0.12, 0.12]));
    let mesh = gltf.mesh("turning", &[(block, pale)]);
    let turning = gltf.node("turning", mesh, Placement { at: [-1.0, 1.4, -1.0], ..Placement::ORIGIN });
    let half = std::f32::consts::FRAC_1_SQRT_2;
    gltf.animate_rotation(turning, &[0.0, 0.5], &[[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, half, half]]);
    gltf.camera(View { lens: Some((0.07, 6.0)), shutter: Some((0.0, 0.25)), ..BASE });
    gltf
}

/// Hills of 1,002,528 triangles under a large lamp.
pub fn million_triangles(scale: Scale) -> Gltf {
    let mut gltf = Gltf::new(scale);
    let ground = gltf.diffuse("ground", [0.45, 0.4, 0.3]);
    let lamp = gltf.emitter("lamp", [1.0, 0.9, 0.75], 30.0);
    let hills = gltf.geometry(&terrain(708, 16.0, hills));
    let light = gltf.geometry(&ceiling(9.0, [-2.0, 2.0], [-2.0, 2.0]));
    let mesh = gltf.mesh("hills", &[(hills, ground), (light, lamp)]);
    gltf.node("hills", mesh, Placement::ORIGIN);
    gltf.camera(View { eye: [0.0, 3.2, 9.0], target: [0.0, 0.1, 0.0], yfov_degrees: 38.0, ..BASE });
    gltf
}

/// Six octaves of waves, each turned against the last.
fn hills(x: f64, z: f64) -> f64 {
    let (mut height, mut frequency, mut amplitude, mut angle) = (0.0, 0.7f64, 0.5, 0.3f64);
    for _ in 0..6 {
        let (sin, cos) = angle.sin_cos();
        height += amplitude
            * (frequency * (x * cos + z * sin)).sin()
            * (frequency * (z * cos - x * sin) + angle).cos();
        (frequency, amplitude, angle) = (frequency * 2.1, amplitude * 0.47, angle + 1.9);
    }
    height
}

/// Five hundred small square lamps of eight colours above balls and blocks.
pub fn many_lights(scale: Scale) -> Gltf {
    let mut gltf = Gltf::new(scale);
    let grey = gltf.diffuse("grey", [0.6; 3]);
    let ground = gltf.geometry(&floor(0.0, [-6.0, 6.0], [-6.0, 6.0]));
    let mesh = gltf.mesh("ground", &[(ground, grey)]);
    gltf.node("ground", mesh, Placement::ORIGIN);

    let square = gltf.geometry(&ceiling(0.0, [-0.02, 0.02], [-0.02, 0.02]));
    let lamps: Vec<_> = (0..8u8)
        .map(|index| {
            let bit = |place: u8| if index >> place & 1 == 1 { 1.0 } else { 0.35 };
            let material = gltf.emitter(
                &format!("lamp {index}"),
                [bit(0), bit(1), bit(2)],
                40.0 + 30.0 * f32::from(index),
            );
            gltf.mesh(&format!("lamp {index}"), &[(square, material)])
        })
        .collect();
    for index in 0..500u32 {
        let [u, v, w] = spread(index);
        let at = [u * 8.0 - 4.0, 0.6 + 2.2 * w, v * 8.0 - 5.0];
        gltf.node(&format!("lamp {index}"), lamps[index as usize % 8], Placement { at, ..Placement::ORIGIN });
    }
    let sphere = gltf.unit_sphere(&unit_sphere(3));
    let block = gltf.geometry(&cuboid([-0.25, 0.0, -0.25], [0.25, 0.9, 0.25]));
    let metal = gltf.metal("metal", [0.9, 0.85, 0.8], 0.3);
    let (ball, block) = (gltf.mesh("ball", &[(sphere, metal)]), gltf.mesh("block", &[(block, grey)]));
    for index in 0..9u32 {
        let at = |y| [(index % 3) as f32 * 1.5 - 1.5, y, (index / 3) as f32 * 1.5 - 2.0];
        if index % 2 == 0 {
            gltf.node(&format!("ball {index}"), ball, Placement::sized(at(0.35), 0.35));
        } else {
            gltf.node(&format!("block {index}"), block, Placement::turned(at(0.0), 20.0 * f64::from(index)));
        }
    }
    gltf.camera(View { eye: [0.0, 2.6, 5.5], target: [0.0, 0.5, -0.5], yfov_degrees: 40.0, ..BASE });
    gltf
}

/// Evenly spread points of the unit cube (Roberts 2018, the R3 sequence), in steps of 2^-24.
fn spread(index: u32) -> [f32; 3] {
    [0.819_172_513_396_164_4f64, 0.671_043_606_703_789_2, 0.549_700_477_901_970_3]
        .map(|step| ((0.5 + step * f64::from(index)).fract() * 16_777_216.0).floor() as f32 / 16_777_216.0)
}

/// Balls and a block in the open, under a sky with a small sun; needs [`sky`] beside it.
pub fn sun_sky(scale: Scale, environment: &str) -> Gltf {
    let mut gltf = Gltf::new(scale);
    gltf.environment(environment);
    let ground = gltf.diffuse("ground", [0.5, 0.48, 0.45]);
    let shape = gltf.geometry(&floor(0.0, [-30.0, 30.0], [-30.0, 30.0]));
    let mesh = gltf.mesh("ground", &[(shape, ground)]);
    gltf.node("ground", mesh, Placement::ORIGIN);
    let sphere = gltf.unit_sphere(&unit_sphere(4));
    let materials = [
        gltf.metal("copper", [0.95, 0.64, 0.54], 0.2),
        gltf.plastic("red", [0.6, 0.1, 0.08], 0.3),
        gltf.diffuse("white", [0.75; 3]),
    ];
    for (index, material) in materials.into_iter().enumerate() {
        let mesh = gltf.mesh(&format!("ball {index}"), &[(sphere, material)]);
        gltf.node(
            &format!("ball {index}"),
            mesh,
            Placement::sized([index as f32 * 1.2 - 1.2, 0.5, 0.3], 0.5),
        );
    }
    let block = gltf.geometry(&cuboid([-0.3, 0.0, -0.3], [0.3, 1.6, 0.3]));
    let mesh = gltf.mesh("block", &[(block, materials[2])]);
    gltf.node("block", mesh, Placement::turned([1.4, 0.0, -1.6], 35.0));
    gltf.camera(BASE);
    gltf
}

/// The sky of [`sun_sky`] as a Radiance HDR, lat-long: blue above, brown below, a sun of 1 degree radius, 50 degrees up, that
/// gives about four times the irradiance of the sky.
pub fn sky() -> Vec<u8> {
    const WIDTH: u32 = 1024;
    const HEIGHT: u32 = 512;
    let sun = glam::DVec3::new(-0.45, 0.766, 0.46).normalize();
    let mut pixels = Vec::with_capacity((WIDTH * HEIGHT) as usize);
    for row in 0..HEIGHT {
        for column in 0..WIDTH {
            let azimuth = ((f64::from(column) + 0.5) / f64::from(WIDTH) - 0.5) * std::f64::consts::TAU;
            let elevation = (0.5 - (f64::from(row) + 0.5) / f64::from(HEIGHT)) * std::f64::consts::PI;
            let (up, flat) = (elevation.sin(), elevation.cos());
            let direction = glam::DVec3::new(azimuth.cos() * flat, up, azimuth.sin() * flat);
            let radiance = if direction.dot(sun) > 1.0f64.to_radians().cos() {
                [11_000.0, 9_500.0, 7_500.0]
            } else if up > 0.0 {
                let haze = (1.0 - up).powi(4);
                [0.25 + 0.7 * haze, 0.5 + 0.5 * haze, 1.0 + 0.1 * haze]
            } else {
                [0.2, 0.17, 0.14]
            };
            pixels.push(image::Rgb(radiance.map(|value: f64| value as f32)));
        }
    }
    let mut bytes = Vec::new();
    image::codecs::hdr::HdrEncoder::new(&mut bytes)
        .encode(&pixels, WIDTH as usize, HEIGHT as usize)
        .expect("an image can be written to memory");
    bytes
}
