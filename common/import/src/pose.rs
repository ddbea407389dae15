//! The scene at time 0: where nodes are, and a box around everything that is drawn.

use farm_scene::{Channel, Mesh, Node, Path, Scene, Skin, Skinning, Transform};
use glam::{DMat4, DQuat, DVec3, Vec3};

/// A box, and what faces where in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Extent {
    pub min: DVec3,
    pub max: DVec3,
    /// Sum of the triangles' areas times their normals: 0 for closed surfaces, otherwise towards the open side.
    pub vector_area: DVec3,
}

impl Extent {
    const EMPTY: Self = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY, vector_area: DVec3::ZERO };

    fn add(&mut self, point: DVec3) {
        if point.is_finite() {
            self.min = self.min.min(point);
            self.max = self.max.max(point);
        }
    }

    fn is_empty(&self) -> bool {
        !(self.max - self.min).is_finite()
    }

    fn corners(&self) -> impl Iterator<Item = DVec3> + use<> {
        let (min, max) = (self.min, self.max);
        (0..8).map(move |corner| {
            let pick = |bit: u32, low: f64, high: f64| if corner & bit == 0 { low } else { high };
            DVec3::new(pick(1, min.x, max.x), pick(2, min.y, max.y), pick(4, min.z, max.z))
        })
    }
}

/// Beyond this effort, a second or so, meshes are framed as they are at rest.
const EFFORT_MAX: u64 = 1 << 27;

/// Around everything that is drawn at time 0; none when nothing is.
pub(crate) fn extent(scene: &Scene) -> Option<Extent> {
    let places = places(scene);
    let shapes: Vec<Extent> = scene.meshes.iter().map(shape).collect();
    let exactly = effort(scene) <= EFFORT_MAX;
    let mut all = Extent::EMPTY;
    for (index, (node, place)) in scene.nodes.iter().zip(&places).enumerate() {
        for instance in &node.instances {
            let mesh = &scene.meshes[instance.mesh as usize];
            let rest = shapes[instance.mesh as usize];
            let shape = if exactly { morphed(rest, mesh, scene, index) } else { rest };
            match (node.skin, &mesh.skinning) {
                (Some(skin), Some(skinning)) if exactly => {
                    let joints: Vec<DMat4> = joint_places(&scene.skins[skin as usize], &places).collect();
                    add_skinned(&mut all, mesh, skinning, &joints);
                }
                _ => {
                    add_placed(&mut all, shape, *place);
                    all.vector_area += cofactors(*place, shape.vector_area);
                }
            }
        }
    }
    (!all.is_empty()).then_some(all)
}

/// Vertices, and the like, that deforming everything has to look at.
fn effort(scene: &Scene) -> u64 {
    let instances =
        scene.nodes.iter().flat_map(|node| node.instances.iter().map(move |it| (node.skin, it.mesh)));
    let efforts = instances.map(|(skin, mesh)| {
        let mesh = &scene.meshes[mesh as usize];
        let vertices = mesh.positions.len();
        let (targets, channels) = (mesh.morph_targets.len(), scene.channels.len());
        let morphed = if targets > 0 { vertices.saturating_mul(targets).saturating_add(channels) } else { 0 };
        let influences = mesh.skinning.as_ref().map_or(0, |skinning| skinning.influences as usize);
        let joints = skin.map_or(0, |skin| scene.skins[skin as usize].joints.len());
        let skinned = if joints > 0 { vertices.saturating_mul(influences).saturating_add(joints) } else { 0 };
        (morphed as u64).saturating_add(skinned as u64)
    });
    efforts.fold(0, u64::saturating_add)
}

fn add_placed(all: &mut Extent, shape: Extent, place: DMat4) {
    if !shape.is_empty() {
        shape.corners().for_each(|corner| all.add(place.transform_point3(corner)));
    }
}

/// Adds every vertex where its joints take it; morph targets are left to the margin.
fn add_skinned(all: &mut Extent, mesh: &Mesh, skinning: &Skinning, joints: &[DMat4]) {
    let influences = skinning.influences.max(1) as usize;
    let pairs = skinning.joints.chunks_exact(influences).zip(skinning.weights.chunks_exact(influences));
    for (position, (vertex_joints, weights)) in mesh.positions.iter().zip(pairs) {
        let point = position.as_dvec3();
        let blended = vertex_joints
            .iter()
            .zip(weights)
            .filter(|(_, weight)| **weight != 0.0)
            .filter_map(|(joint, weight)| {
                Some(joints.get(usize::from(*joint))?.transform_point3(point) * f64::from(*weight))
            })
            .sum();
        all.add(blended);
    }
}

/// Where a skin's joints take the mesh.
fn joint_places<'a>(skin: &'a Skin, places: &'a [DMat4]) -> impl Iterator<Item = DMat4> + 'a {
    skin.joints.iter().zip(&skin.inverse_bind).map(|(&joint, bind)| places[joint as usize] * bind.as_dmat4())
}

/// How a transform moves areas: the cross product of its columns.
fn cofactors(place: DMat4, area: DVec3) -> DVec3 {
    let [x, y, z] = [place.x_axis, place.y_axis, place.z_axis].map(|axis| axis.truncate());
    y.cross(z) * area.x + z.cross(x) * area.y + x.cross(y) * area.z
}

/// Around a mesh at rest.
fn shape(mesh: &Mesh) -> Extent {
    let mut shape = Extent::EMPTY;
    mesh.positions.iter().for_each(|position| shape.add(position.as_dvec3()));
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|vertex| mesh.positions[vertex as usize].as_dvec3());
        let area = (b - a).cross(c - a) / 2.0;
        shape.vector_area += if area.is_finite() { area } else { DVec3::ZERO };
    }
    shape
}

/// The shape grown by what its targets add at most.
fn morphed(mut shape: Extent, mesh: &Mesh, scene: &Scene, node: usize) -> Extent {
    if mesh.morph_targets.is_empty() {
        return shape;
    }
    let rest = &scene.nodes[node].morph_weights;
    let animated = scene.channels.iter().find_map(|channel| match &channel.path {
        Path::MorphWeights { targets, values } if channel.node as usize == node => {
            let first = value_index(channel) * *targets as usize;
            values.get(first..first + *targets as usize)
        }
        _ => None,
    });
    for (target, &weight) in mesh.morph_targets.iter().zip(animated.unwrap_or(rest)) {
        let mut change = Extent { min: DVec3::ZERO, max: DVec3::ZERO, vector_area: DVec3::ZERO };
        let moved = target.positions.iter().flatten();
        moved.for_each(|&by| change.add((by * weight).as_dvec3()));
        shape.min += change.min;
        shape.max += change.max;
    }
    shape
}

/// World place of each node.
fn places(scene: &Scene) -> Vec<DMat4> {
    let mut transforms: Vec<Transform> = scene.nodes.iter().map(|node| node.transform).collect();
    for channel in &scene.channels {
        pose(&mut transforms[channel.node as usize], channel);
    }
    let mut places: Vec<DMat4> = vec![];
    for (node, transform) in scene.nodes.iter().zip(transforms) {
        places.push(parent_place(node, &places) * matrix(transform));
    }
    places
}

fn parent_place(node: &Node, places: &[DMat4]) -> DMat4 {
    node.parent.map_or(DMat4::IDENTITY, |parent| places[parent as usize])
}

fn matrix(transform: Transform) -> DMat4 {
    match transform {
        Transform::Matrix(matrix) => matrix,
        Transform::Trs { translation, rotation, scale } => {
            DMat4::from_scale_rotation_translation(scale, rotation, translation)
        }
    }
}

/// The value at the last key that is not after time 0, or else at the first: key times are seldom below 0.
fn value_index(channel: &Channel) -> usize {
    let key = channel.times.partition_point(|&time| time <= 0.0).saturating_sub(1);
    match channel.interpolation {
        farm_scene::Interpolation::CubicSpline => 3 * key + 1,
        _ => key,
    }
}

fn pose(transform: &mut Transform, channel: &Channel) {
    let Transform::Trs { translation, rotation, scale } = transform else { return };
    let index = value_index(channel);
    let vector = |values: &[Vec3]| values.get(index).map(|value| value.as_dvec3());
    match &channel.path {
        Path::Translation(values) => *translation = vector(values).unwrap_or(*translation),
        Path::Scale(values) => *scale = vector(values).unwrap_or(*scale),
        Path::Rotation(values) => {
            let value = values.get(index).map(|value| DQuat::from_array(value.to_array().map(f64::from)));
            *rotation = value.unwrap_or(*rotation);
        }
        Path::MorphWeights { .. } => {}
    }
}
