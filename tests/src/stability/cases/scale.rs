//! Scenes that are large, small, far away, thin or broken.

use crate::stability::bench::Bench;
use crate::stability::cases::motion::still_life;
use crate::stability::measure::{self, Measurement, Picture};
use crate::stability::stage::{self, Stage};
use farm_scene::{
    Dielectric, Integrator, LightKind, Material, Mesh, Projection, Surface, Textured, Transform, Volume,
};
use glam::{DMat4, DQuat, DVec3, Mat4, Vec3};

/// T45: nothing comes through the walls of a closed box.
pub fn black_box(bench: &mut Bench) {
    for (name, sides) in [("each way", None), ("into a corner", Some(DVec3::ONE))] {
        let directions = [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z];
        let directions = sides.map_or(directions.to_vec(), |corner| vec![corner, -corner]);
        let mut total = Measurement::from(0.0);
        for towards in directions {
            let mut stage = Stage::new().size(64, 64).depth(2);
            stage.place(stage::cuboid(Vec3::splat(-0.5), Vec3::splat(0.5)), stage::grey(0.0));
            stage.camera(DVec3::new(0.1, 0.03, -0.07), towards * 9.0, Projection::Perspective { yfov: 1.8 });
            stage.environment(1, &[1e6]);
            let picture = measure::picture(&stage, bench.pick(64, 512));
            total.mean += picture.greys().sum::<f64>();
            total.counters = total.counters.plus(picture.counters);
        }
        bench.exact(format!("unit box under a sky of 1e6, {name}: light"), 0.0, total);
    }
}

/// Everything of a scene that has a length, times `factor`.
fn scale(stage: &mut Stage, factor: f32) {
    let by = |transform: &mut Transform| match transform {
        Transform::Trs { translation, .. } => *translation *= f64::from(factor),
        Transform::Matrix(matrix) => {
            matrix.w_axis = (matrix.w_axis.truncate() * f64::from(factor)).extend(1.0)
        }
    };
    stage.scene.nodes.iter_mut().for_each(|node| by(&mut node.transform));
    for mesh in &mut stage.scene.meshes {
        mesh.positions.iter_mut().for_each(|position| *position *= factor);
    }
    for volume in stage.scene.materials.iter_mut().filter_map(|material| material.volume.as_mut()) {
        volume.attenuation_distance *= factor;
    }
    for node in &mut stage.scene.nodes {
        node.motion_vector = node.motion_vector.map(|vector| vector * factor);
    }
    for channel in &mut stage.scene.channels {
        if let farm_scene::Path::Translation(values) = &mut channel.path {
            values.iter_mut().for_each(|value| *value *= factor);
        }
    }
    for camera in &mut stage.scene.cameras {
        if let Some(lens) = &mut camera.lens {
            lens.aperture_radius *= factor;
            lens.focus_distance *= factor;
        }
        if let Projection::Orthographic { ymag } = &mut camera.projection {
            *ymag *= factor;
        }
    }
    for light in &mut stage.scene.lights {
        match &mut light.kind {
            LightKind::Sphere { radius, .. } | LightKind::Disk { radius, .. } => *radius *= factor,
            LightKind::Rectangle { width, height, .. } => {
                (*width, *height) = (*width * factor, *height * factor);
            }
            LightKind::Point { intensity } | LightKind::Spot { intensity, .. } => {
                *intensity *= factor * factor;
            }
            LightKind::Directional { .. } => {}
        }
    }
}

/// The still life with every kind of light, coloured glass, a lens, motion and an instance with a scale of its own.
pub fn everything() -> Stage {
    let mut stage = still_life().depth(5);
    let surface = Surface::MetallicRoughness {
        metallic: Textured::constant(0.0),
        roughness: Textured::constant(0.2),
        dielectric: Dielectric { ior: 1.5, specular: None, transmission: Some(Textured::constant(1.0)) },
    };
    let volume = Volume { attenuation_distance: 0.5, attenuation_color: Vec3::new(0.9, 0.5, 0.2) };
    let glass = Material { surface, volume: Some(volume), ..stage::grey(1.0) };
    stage.place(stage::globe(Vec3::new(-0.2, 0.4, 1.2), 0.4, 8), glass);
    let at = |x: f64, y: f64, z: f64| stage::look(DVec3::new(x, y, z), DVec3::new(0.0, 0.3, 0.0));
    let radiance = Vec3::new(3.0, 2.0, 1.0);
    stage.light(LightKind::Sphere { radiance, radius: 0.2 }, at(-2.0, 2.0, 1.0));
    stage.light(LightKind::Rectangle { radiance, width: 0.5, height: 0.25 }, at(2.0, 2.5, 0.5));
    stage.light(LightKind::Disk { radiance, radius: 0.3 }, at(1.0, 2.0, 2.0));
    stage.light(LightKind::Point { intensity: radiance }, at(-1.0, 3.0, -1.0));
    let spot = LightKind::Spot { intensity: radiance, inner_cone: 0.3, outer_cone: 0.6 };
    stage.light(spot, at(0.0, 3.0, -2.0));
    stage.light(LightKind::Directional { irradiance: radiance }, at(1.0, 1.0, 0.25));
    stage.environment(4, &[0.1, 0.5, 0.2, 0.9, 0.3, 0.2, 0.1, 0.4]);
    let node =
        stage.node_below(Some(0), stage::scaled(DVec3::new(-0.5, 0.0, 0.8), DVec3::new(0.3, 0.6, 0.3)));
    stage.draw(node, stage::globe(Vec3::Y, 1.0, 6), stage::grey(0.9));
    stage.slide(node, Vec3::new(0.25, 0.0, 0.25));
    stage.shutter(0.0, 1.0);
    stage.lens(0.03125, 4.0);
    stage
}

/// T46: a scene times a power of two is the same picture, to the bit: no length is compared with a constant.
pub fn powers_of_two(bench: &mut Bench) {
    for integrator in [Integrator::Path, Integrator::Distribution] {
        let mut stage = everything();
        stage.settings.integrator = integrator;
        let reference = measure::picture(&stage, 64);
        bench.at_least(format!("{integrator:?}: mean radiance"), 0.01, reference.mean());
        for exponent in [-20, -1, 10, 20] {
            let mut scaled = stage.clone();
            scale(&mut scaled, 2f32.powi(exponent));
            let picture = measure::picture(&scaled, 64);
            let found = Measurement { mean: picture.differing(&reference), ..count(&picture) };
            bench.exact(format!("{integrator:?}, times 2^{exponent}: channels that differ"), 0.0, found);
        }
    }
}

fn count(picture: &Picture) -> Measurement {
    Measurement { mean: 0.0, standard_error: None, counters: picture.counters }
}

/// T47: a scene far from the origin, camera included, is the same picture.
pub fn far_away(bench: &mut Bench) {
    let reference = measure::picture(&still_life(), 256);
    for distance in [1e3, 1e5, 1e7] {
        let mut stage = still_life();
        stage.scene.nodes[0].transform = stage::at(DVec3::new(1.0, -0.5, 0.75) * distance);
        let picture = measure::picture(&stage, 256);
        let found = Measurement { mean: picture.largest_difference(&reference), ..count(&picture) };
        bench.at_most(format!("root at {distance:e}: largest relative difference"), 1e-5, found);
    }
}

/// T49: plates that lie close upon each other.
pub fn close_plates(bench: &mut Bench) {
    for gap in [5e-5f32, 1e-6] {
        let lights = [
            ("sun", LightKind::Directional { irradiance: Vec3::ONE }),
            ("rectangle", LightKind::Rectangle { radiance: Vec3::ONE, width: 1.0, height: 1.0 }),
        ];
        for (name, light) in lights {
            let mut stage = Stage::new();
            stage.place(stage::floor(0.0, 50.0), stage::grey(0.5));
            stage.place(stage::floor(gap, 50.0), stage::grey(0.5));
            // The eye is in the gap.
            let from = DVec3::Y * f64::from(gap / 2.0);
            stage.camera(from, DVec3::ZERO, Projection::Orthographic { ymag: 1e-4 });
            stage.light(light, stage::look(DVec3::new(0.5, 1.0, 0.2), DVec3::ZERO));
            bench.exact(format!("{gap:e} apart, {name}: light below"), 0.0, measure::radiance(&stage, 64));
            stage.scene.nodes[1].instances.clear();
            bench.at_least(
                format!("{gap:e} apart, {name}: without the upper"),
                1e-3,
                measure::radiance(&stage, 64),
            );
        }
    }
}

/// A body under a sky with a gradient, drawn by a node whose linear part is `linear`, with the mesh made so that the body's place in
/// the world stays what it was; `None` draws it as it is.
fn body(linear: Option<Mat4>) -> Stage {
    let mut stage = Stage::new().size(12, 12).depth(3);
    stage.place(stage::floor(-1.5, 6.0), stage::grey(0.5));
    let smooth = stage::globe(Vec3::ZERO, 1.0, 24);
    let facets: Vec<[Vec3; 3]> =
        smooth.triangles.iter().map(|triangle| triangle.map(|i| smooth.positions[i as usize])).collect();
    let mut mesh = stage::triangles(&facets);
    // Shading normals go through the transform as well. One per facet: between unlike normals it would matter in which space unit
    // length is restored.
    let normals = facets.iter().map(|[a, b, c]| (*a + *b + *c).normalize());
    mesh.normals = Some(normals.flat_map(|normal| [normal; 3]).collect());
    let node = if let Some(linear) = linear {
        let inverse = DMat4::from_cols_array(&linear.to_cols_array().map(f64::from)).inverse();
        let normal_matrix = DMat4::from_cols_array(&linear.to_cols_array().map(f64::from)).transpose();
        for position in &mut mesh.positions {
            *position = inverse.transform_point3(position.as_dvec3()).as_vec3();
        }
        for normal in mesh.normals.iter_mut().flatten() {
            *normal = normal_matrix.transform_vector3(normal.as_dvec3()).normalize().as_vec3();
        }
        if linear.determinant() < 0.0 {
            // A mirroring node turns triangles inside out; the mesh is made the other way round.
            mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        }
        let matrix = DMat4::from_cols_array(&linear.to_cols_array().map(f64::from));
        stage.node(Transform::Matrix(matrix))
    } else {
        stage.node(Transform::IDENTITY)
    };
    let one_sided = Material { double_sided: false, ..stage::grey(0.8) };
    stage.draw(node, mesh, one_sided);
    stage.environment(4, &[2.0, 0.5, 0.2, 0.9, 0.3, 0.2, 0.1, 0.4]);
    stage.camera(DVec3::new(0.5, 1.0, 4.0), DVec3::ZERO, Projection::Perspective { yfov: 0.4 });
    stage
}

/// T52: what a node scales is what would have been modelled that way.
pub fn scaled_instances(bench: &mut Bench) {
    let spp = 256;
    let reference = measure::picture(&body(None), spp);
    let tilt = Mat4::from_axis_angle(Vec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
    for (name, linear) in [
        ("1e8", Mat4::from_scale(Vec3::splat(1e8))),
        ("1e-8", Mat4::from_scale(Vec3::splat(1e-8))),
        ("(1, 1e-3, 1e3)", Mat4::from_scale(Vec3::new(1.0, 1e-3, 1e3))),
        ("(1, 1e-3, 1e3), turned", tilt * Mat4::from_scale(Vec3::new(1.0, 1e-3, 1e3))),
        ("(1, -1, 1)", Mat4::from_scale(Vec3::new(1.0, -1.0, 1.0))),
        ("(-2, -1, -.5), turned", tilt * Mat4::from_scale(Vec3::new(-2.0, -1.0, -0.5))),
    ] {
        let picture = measure::picture(&body(Some(linear)), spp);
        let found = Measurement { mean: mean_difference(&picture, &reference), ..count(&picture) };
        bench.at_most(format!("scale {name}: mean relative difference"), 1e-4, found);
    }
    let mut flat = body(None);
    flat.scene.nodes[1].transform = stage::scaled(DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0));
    let picture = measure::picture(&flat, spp);
    bench.exact(
        "scale (1, 1, 0): instances counted as flattened",
        1.0,
        picture.counters.instances_flattened as f64,
    );
    bench.at_least(
        "scale (1, 1, 0): a picture without faults",
        0.01,
        Measurement { mean: picture.mean(), ..count(&picture) },
    );
}

/// Mean over pixels of the difference, relative to the picture's mean. A sample at a silhouette may fall to the other side by a
/// rounding of 1e-7, one in 10^4 of them, and then differs by all it has; the mean forgives that, and only that.
fn mean_difference(a: &Picture, b: &Picture) -> f64 {
    let sum: f64 = a.greys().zip(b.greys()).map(|(a, b)| (a - b).abs()).sum();
    sum / b.greys().sum::<f64>()
}

/// T53: triangles that are none change nothing, and are counted.
pub fn broken_triangles(bench: &mut Bench) {
    let clean = || {
        let mut stage = still_life();
        stage.scene.nodes[0].transform = stage::at(DVec3::ZERO);
        stage
    };
    let reference = measure::picture(&clean(), 64);
    let mut stage = clean();
    let mesh: &mut Mesh = &mut stage.scene.meshes[2];
    let first = mesh.positions.len() as u32;
    mesh.positions.extend([Vec3::NAN, Vec3::INFINITY, Vec3::new(0.0, f32::NEG_INFINITY, 0.0)]);
    let [a, b, c] = mesh.triangles[0];
    let not_finite = [[a, b, first], [first + 1, b, c], [a, first + 2, c], [first, first, first]];
    let no_area = [[a, a, b], [c, c, c], [a, b, a]];
    mesh.triangles.extend(not_finite);
    mesh.triangles.extend(no_area);
    let duplicates = mesh.triangles[..4].to_vec();
    mesh.triangles.extend(duplicates);
    let picture = measure::picture(&stage, 64);
    let found = Measurement { mean: picture.differing(&reference), ..count(&picture) };
    bench.exact("NaN, infinite, without area, double: channels that differ", 0.0, found);
    let counters = picture.counters;
    bench.exact("counted with the result as not finite", 4.0, counters.triangles_not_finite as f64);
    bench.exact("counted with the result as without area", 3.0, counters.triangles_without_area as f64);
    bench.holds("the clean scene has nothing to count", reference.counters.warnings().is_empty());
    needles(bench);
}

/// A floor cut into needles of aspect 1e7 is a floor.
fn needles(bench: &mut Bench) {
    let build = |cut: bool| {
        let mut stage = Stage::new();
        let mut corners = Vec::new();
        if cut {
            // A fan of long thin triangles: 1e-7 wide per unit of length where it is looked at.
            let (width, length) = (1e-6f32, 10.0f32);
            let at = |i: i32, side: f32| Vec3::new(i as f32 * width, 0.0, side * length);
            for i in -600..600 {
                corners.push([at(i, 1.0), at(i + 1, 1.0), at(i, -1.0)]);
                corners.push([at(i + 1, 1.0), at(i + 1, -1.0), at(i, -1.0)]);
            }
            stage.place(stage::triangles(&corners), stage::grey(0.5));
        } else {
            stage.place(stage::floor(0.0, 10.0), stage::grey(0.5));
        }
        stage.camera(DVec3::Y * 0.01, DVec3::ZERO, Projection::Orthographic { ymag: 1e-4 });
        stage.light(
            LightKind::Directional { irradiance: Vec3::ONE },
            stage::look(DVec3::new(0.3, 1.0, 0.1), DVec3::ZERO),
        );
        stage
    };
    let (whole, cut) = (measure::radiance(&build(false), 256), measure::radiance(&build(true), 256));
    bench.relative("2400 needles of aspect 1e7: radiance", whole.mean, cut, 1e-5);
}

/// T55: grazing light on a large plane, without specks.
pub fn grazing_sun(bench: &mut Bench) {
    for (name, cells) in [("one quad", 1u32), ("64 x 64 quads", 64)] {
        let mut stage = Stage::new().size(48, 48);
        let half = 5e3 / cells as f32;
        let corner = |i: u32| (2 * i + 1) as f32 * half - 5e3;
        let mut mesh = Mesh::default();
        for i in 0..cells * cells {
            let centre = Vec3::new(corner(i % cells), 0.0, corner(i / cells));
            let part = stage::quad(centre, Vec3::Z * half, Vec3::X * half);
            let base = mesh.positions.len() as u32;
            mesh.positions.extend(part.positions);
            mesh.triangles.extend(part.triangles.iter().map(|t| t.map(|i| i + base)));
        }
        // Turned about an odd axis, so that no coordinate of the plane is a round number.
        let turn = DQuat::from_axis_angle(DVec3::new(0.3, 0.2, 0.9).normalize(), 0.5);
        let place = |translation: DVec3| Transform::Trs {
            translation: turn * translation,
            rotation: turn,
            scale: DVec3::ONE,
        };
        let node = stage.node(place(DVec3::new(0.0, 7.3, 0.0)));
        stage.draw(node, mesh, stage::grey(0.5));
        let (sin, cos) = 0.1f64.to_radians().sin_cos();
        let towards = turn * DVec3::new(cos, sin, 0.0);
        stage.light(LightKind::Directional { irradiance: Vec3::ONE }, stage::look(towards, DVec3::ZERO));
        // However the picture is turned about the view axis, its corners are within the plane: 5e3 tan(.6) sqrt(2) = 4.8e3.
        let eye = turn * DVec3::new(0.0, 5e3, 1.0);
        stage.camera(eye, turn * DVec3::new(0.0, 7.3, 0.0), Projection::Perspective { yfov: 1.2 });
        let picture = measure::picture(&stage, 16);
        let radiance = 0.5 / std::f64::consts::PI * sin;
        // The sine of a tenth of a degree of directions and normals rounded to 6e-8: 6e-8 / .0017 = 3.4e-5 of itself.
        let found = Measurement { mean: picture.mean(), ..count(&picture) };
        bench.relative(format!("{name}: mean radiance"), radiance, found, 1e-4);
        let (low, high) = picture.greys().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
        bench.at_most(format!("{name}: max - min, in E"), 1e-5, (high - low) * 2.0 * std::f64::consts::PI);
    }
}
