//! Small scenes, built in code: what a case puts in front of the renderer.

use farm_scene::{
    Camera, Channel, Environment, Image, Instance, Integrator, Interpolation, Lens, Light, LightKind,
    Material, Mesh, Node, Path, Pixels, Projection, Scene, Settings, Shutter, Transform,
};
use glam::{DMat3, DQuat, DVec3, Quat, Vec3};

/// Half the height of the patch that [`Stage::eye_on`] sees, metres: so small that what a pixel measures is the radiance at a
/// point. Irradiance that varies over a metre changes by its square over the patch, 1e-8.
const PATCH: f32 = 1e-4;

/// A scene under construction together with how it is to be rendered.
#[derive(Clone, Debug)]
pub struct Stage {
    /// What is rendered.
    pub scene: Scene,
    /// How; one pixel, direct light only and a box filter unless a case says otherwise.
    pub settings: Settings,
}

impl Default for Stage {
    fn default() -> Self {
        Self::new()
    }
}

impl Stage {
    /// An empty scene without a camera.
    pub fn new() -> Self {
        let settings = Settings {
            camera: 0,
            width: 1,
            height: 1,
            integrator: Integrator::Path,
            filter: farm_scene::Filter::Box,
            max_depth: 1,
            seed: 0,
            fps: 1.0,
            clamp: None,
        };
        Self { scene: Scene::default(), settings }
    }

    /// A node below the root, or below `parent`.
    pub fn node_below(&mut self, parent: Option<u32>, transform: Transform) -> u32 {
        self.scene.nodes.push(Node {
            name: format!("node {}", self.scene.nodes.len()),
            parent,
            transform,
            motion_vector: None,
            instances: Vec::new(),
            skin: None,
            morph_weights: Vec::new(),
        });
        self.scene.nodes.len() as u32 - 1
    }

    /// A node below the root.
    pub fn node(&mut self, transform: Transform) -> u32 {
        self.node_below(None, transform)
    }

    /// Draws a mesh at a node.
    pub fn draw(&mut self, node: u32, mesh: Mesh, material: Material) {
        let index = |len: usize| len as u32 - 1;
        self.scene.meshes.push(mesh);
        self.scene.materials.push(material);
        let instance =
            Instance { mesh: index(self.scene.meshes.len()), material: index(self.scene.materials.len()) };
        self.scene.nodes[node as usize].instances.push(instance);
    }

    /// Draws a mesh whose vertices are in world space; returns its node.
    pub fn place(&mut self, mesh: Mesh, material: Material) -> u32 {
        let node = self.node(Transform::IDENTITY);
        self.draw(node, mesh, material);
        node
    }

    /// A light at a node of its own, whose index is returned.
    pub fn light(&mut self, kind: LightKind, transform: Transform) -> u32 {
        let node = self.node(transform);
        self.light_at(kind, node);
        node
    }

    /// A light at a node that is there.
    pub fn light_at(&mut self, kind: LightKind, node: u32) {
        self.scene.lights.push(Light { name: format!("light {}", self.scene.lights.len()), node, kind });
    }

    /// A camera at `from` that looks at `to`; its node is returned.
    pub fn camera(&mut self, from: DVec3, to: DVec3, projection: Projection) -> u32 {
        let node = self.node(look(from, to));
        self.camera_at(node, projection);
        node
    }

    /// A camera at a node that is there.
    pub fn camera_at(&mut self, node: u32, projection: Projection) {
        let camera =
            Camera { name: "eye".to_owned(), node, projection, lens: None, shutter: Shutter::default() };
        self.scene.cameras.push(camera);
    }

    /// A parallel camera straight above `point` of a surface, a hand's breadth away, that sees a patch of a tenth of a
    /// millimetre.
    pub fn eye_on(&mut self, point: DVec3, normal: DVec3) -> u32 {
        self.camera(point + normal * 0.01, point, Projection::Orthographic { ymag: PATCH })
    }

    /// Width and height of the picture, pixels.
    pub fn size(mut self, width: u32, height: u32) -> Self {
        (self.settings.width, self.settings.height) = (width, height);
        self
    }

    /// Most surfaces that scatter a path's light.
    pub fn depth(mut self, max_depth: u32) -> Self {
        self.settings.max_depth = max_depth;
        self
    }

    /// Gives the camera a lens.
    pub fn lens(&mut self, aperture_radius: f32, focus_distance: f32) {
        let lens = Lens { aperture_radius, focus_distance, blades: 0, rotation: 0.0, anamorphic_ratio: 1.0 };
        self.scene.cameras[0].lens = Some(lens);
    }

    /// Opens the shutter for these seconds.
    pub fn shutter(&mut self, open: f64, close: f64) {
        self.scene.cameras[0].shutter = Shutter { open, close };
    }

    /// Animates a node linearly from the first to the last value within the second that begins at time 0.
    pub fn animate(&mut self, node: u32, path: Path) {
        self.scene.channels.push(Channel {
            node,
            times: vec![0.0, 1.0],
            interpolation: Interpolation::Linear,
            path,
        });
    }

    /// Moves a node by `by` in the second that begins at time 0, from where it stands.
    pub fn slide(&mut self, node: u32, by: Vec3) {
        let Transform::Trs { translation, .. } = self.scene.nodes[node as usize].transform else {
            panic!("only a node of translation, rotation and scale is animated");
        };
        let from = translation.as_vec3();
        self.animate(node, Path::Translation(vec![from, from + by]));
    }

    /// Light from infinitely far, rows of `width` values from the top.
    pub fn environment(&mut self, width: u32, values: &[f32]) {
        let height = values.len() as u32 / width;
        let pixels = Pixels::Float(values.iter().map(|&value| [value; 3]).collect());
        let image = Image { name: "sky".to_owned(), width, height, pixels };
        let environment =
            Environment { image, intensity: 1.0, rotation: Quat::IDENTITY, visible_to_camera: true };
        self.scene.environment = Some(environment);
    }
}

/// A place at `from`, turned so that -Z points at `to`.
pub fn look(from: DVec3, to: DVec3) -> Transform {
    let back = (from - to).normalize();
    let up = if back.y.abs() > 0.99 { DVec3::X } else { DVec3::Y };
    let right = up.cross(back).normalize();
    let rotation = DQuat::from_mat3(&DMat3::from_cols(right, back.cross(right), back)).normalize();
    Transform::Trs { translation: from, rotation, scale: DVec3::ONE }
}

/// A place without rotation.
pub fn at(translation: DVec3) -> Transform {
    Transform::Trs { translation, rotation: DQuat::IDENTITY, scale: DVec3::ONE }
}

/// A place with a scale.
pub fn scaled(translation: DVec3, scale: DVec3) -> Transform {
    Transform::Trs { translation, rotation: DQuat::IDENTITY, scale }
}

/// Separate triangles.
pub fn triangles(corners: &[[Vec3; 3]]) -> Mesh {
    Mesh {
        name: "triangles".to_owned(),
        positions: corners.iter().flatten().copied().collect(),
        triangles: (0..corners.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        ..Mesh::default()
    }
}

/// A parallelogram with corners `centre +- x +- y`; its front is the side of x cross y.
pub fn quad(centre: Vec3, x: Vec3, y: Vec3) -> Mesh {
    Mesh {
        name: "quad".to_owned(),
        positions: vec![centre - x - y, centre + x - y, centre + x + y, centre - x + y],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

/// A horizontal square of side `2 half` at a height, facing up.
pub fn floor(height: f32, half: f32) -> Mesh {
    quad(Vec3::Y * height, Vec3::Z * half, Vec3::X * half)
}

/// A horizontal square of side `2 half` around `centre`, facing down.
pub fn ceiling(centre: Vec3, half: f32) -> Mesh {
    quad(centre, Vec3::X * half, Vec3::Z * half)
}

/// A closed box, facing outwards.
pub fn cuboid(low: Vec3, high: Vec3) -> Mesh {
    let corner = |i: u32| {
        let pick = |bit: u32, axis: usize| if i >> bit & 1 == 0 { low[axis] } else { high[axis] };
        Vec3::new(pick(0, 0), pick(1, 1), pick(2, 2))
    };
    let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    Mesh {
        name: "box".to_owned(),
        positions: (0..8).map(corner).collect(),
        triangles: faces.iter().flat_map(|f| [[f[0], f[1], f[2]], [f[0], f[2], f[3]]]).collect(),
        ..Mesh::default()
    }
}

/// A closed globe of `rings` bands and twice as many segments, facing outwards, with shared vertices.
pub fn globe(centre: Vec3, radius: f32, rings: u32) -> Mesh {
    let segments = 2 * rings;
    let point = |ring: u32, segment: u32| {
        let (theta, phi) = (
            std::f64::consts::PI * f64::from(ring) / f64::from(rings),
            std::f64::consts::TAU * f64::from(segment) / f64::from(segments),
        );
        let direction = DVec3::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin());
        (centre.as_dvec3() + direction * f64::from(radius)).as_vec3()
    };
    let mut mesh = Mesh { name: "globe".to_owned(), ..Mesh::default() };
    mesh.positions.push(point(0, 0));
    mesh.positions.extend((1..rings).flat_map(|ring| (0..segments).map(move |s| point(ring, s))));
    mesh.positions.push(point(rings, 0));
    let (top, bottom) = (0, mesh.positions.len() as u32 - 1);
    let index = |ring: u32, segment: u32| match ring {
        0 => top,
        ring if ring == rings => bottom,
        ring => 1 + (ring - 1) * segments + segment % segments,
    };
    for ring in 0..rings {
        for s in 0..segments {
            let [a, b, c, d] =
                [index(ring, s), index(ring, s + 1), index(ring + 1, s + 1), index(ring + 1, s)];
            if ring > 0 {
                mesh.triangles.push([a, b, c]);
            }
            if ring + 1 < rings {
                mesh.triangles.push([a, c, d]);
            }
        }
    }
    mesh
}

/// A regular polygon around `centre` in the plane of the unit vectors x and y, facing x cross y, as a fan.
pub fn polygon(centre: Vec3, x: Vec3, y: Vec3, radius: f32, sides: u32) -> Mesh {
    let corner = |i: u32| {
        let angle = std::f64::consts::TAU * f64::from(i) / f64::from(sides);
        centre + x * (f64::from(radius) * angle.cos()) as f32 + y * (f64::from(radius) * angle.sin()) as f32
    };
    Mesh {
        name: "polygon".to_owned(),
        positions: std::iter::once(centre).chain((0..sides).map(corner)).collect(),
        triangles: (0..sides).map(|i| [0, 1 + i, 1 + (i + 1) % sides]).collect(),
        ..Mesh::default()
    }
}

/// A grey diffuse material.
pub fn grey(albedo: f32) -> Material {
    Material::lambert("grey", Vec3::splat(albedo))
}

/// A grey one-sided emitter that scatters nothing.
pub fn glow(radiance: f32) -> Material {
    Material::emitter("glow", Vec3::splat(radiance))
}

/// A white metal of the given GGX alpha.
pub fn white_metal(alpha: f64) -> Material {
    Material::metal("metal", Vec3::ONE, alpha.sqrt() as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn faces_outwards(mesh: &Mesh, centre: Vec3) -> bool {
        mesh.triangles.iter().all(|triangle| {
            let [a, b, c] = triangle.map(|i| mesh.positions[i as usize] - centre);
            (b - a).cross(c - a).dot(a + b + c) > 0.0
        })
    }

    #[test]
    fn closed_bodies_face_outwards_and_share_every_edge() {
        for mesh in [cuboid(Vec3::splat(-1.0), Vec3::ONE), globe(Vec3::ZERO, 1.0, 7)] {
            assert!(faces_outwards(&mesh, Vec3::ZERO), "{}", mesh.name);
            let mut edges: Vec<[u32; 2]> =
                mesh.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).collect();
            edges.sort_unstable();
            assert!(edges.iter().all(|&[a, b]| edges.binary_search(&[b, a]).is_ok()), "{}", mesh.name);
        }
    }

    #[test]
    fn a_place_looks_where_it_was_told_to() {
        for to in [DVec3::X, -DVec3::Y, DVec3::new(1.0, 2.0, -3.0)] {
            let Transform::Trs { rotation, .. } = look(DVec3::ZERO, to) else { unreachable!() };
            assert!((rotation * -DVec3::Z - to.normalize()).length() < 1e-12);
        }
    }
}
