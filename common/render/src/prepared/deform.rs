//! Vertices under morph targets and skins (glTF 2.0, 3.7.2.2 and 3.7.3.3).

use super::pose::Pose;
use super::track::{STEPS, Step, Track};
use farm_scene::{Mesh, Scene};
use glam::{DAffine3, DMat3, DMat4, DVec3, Vec3, Vec4};

/// Most linear segments of a deformation over the shutter.
const SEGMENTS_MAX: u32 = 32;

/// Segments are added until vertices are met to this fraction of the mesh's size.
const DEFORMATION_TOLERANCE: f32 = 1e-4;

/// A mesh's vertices at one moment. In the renderer's space when skinned, in the node's otherwise.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Deformed {
    pub positions: Vec<Vec3>,
    pub normals: Option<Vec<Vec3>>,
    pub tangents: Option<Vec<Vec4>>,
}

/// Whether the node's drawing of `mesh` is anything but the mesh itself.
pub(crate) fn is_deformed(scene: &Scene, node: u32, mesh: &Mesh) -> bool {
    is_skinned(scene, node, mesh) || !mesh.morph_targets.is_empty()
}

/// Whether the node's skin places the mesh, so that the node's own place does not.
pub(crate) fn is_skinned(scene: &Scene, node: u32, mesh: &Mesh) -> bool {
    scene.nodes[node as usize].skin.is_some() && mesh.skinning.is_some()
}

/// The mesh at keys uniform over each piece of the shutter: one when nothing moves, more the further vertices are from straight lines.
pub(crate) fn deformation_keys(
    scene: &Scene,
    track: &mut Track<'_>,
    node: u32,
    mesh: &Mesh,
) -> Vec<Deformed> {
    let (origin, is_open, pieces) = (track.origin(), track.is_open(), track.pieces());
    let mut at = |piece, step| deform(scene, node, mesh, track.at(Step { piece, step }), origin);
    if !is_open {
        return vec![at(0, 0)];
    }
    // As many keys in every piece.
    let mut pieces: Vec<Vec<Deformed>> =
        (0..pieces).map(|piece| vec![at(piece, 0), at(piece, STEPS)]).collect();
    loop {
        let segments = pieces[0].len() as u32 - 1;
        let width = STEPS / segments;
        let mut middles_of =
            |piece| (0..segments).map(|segment| at(piece, segment * width + width / 2)).collect::<Vec<_>>();
        let middles: Vec<Vec<Deformed>> = (0..pieces.len()).map(&mut middles_of).collect();
        let met = pieces.iter().zip(&middles).all(|(keys, middles)| is_met(keys, middles));
        if segments >= SEGMENTS_MAX || met {
            break;
        }
        pieces = pieces.into_iter().zip(middles).map(|(keys, middles)| refined(keys, middles)).collect();
    }
    let mut keys: Vec<Deformed> = pieces.into_iter().flatten().collect();
    if keys.iter().all(|key| *key == keys[0]) {
        keys.truncate(1);
    }
    keys
}

/// Keys with one more between each two.
fn refined(keys: Vec<Deformed>, middles: Vec<Deformed>) -> Vec<Deformed> {
    let mut finer = Vec::with_capacity(keys.len() + middles.len());
    let mut keys = keys.into_iter();
    finer.extend(keys.next());
    for (middle, key) in middles.into_iter().zip(keys) {
        finer.extend([middle, key]);
    }
    finer
}

fn is_met(keys: &[Deformed], middles: &[Deformed]) -> bool {
    let (low, high) = keys[0]
        .positions
        .iter()
        .filter(|position| position.is_finite())
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)));
    let tolerance = (high - low).length() * DEFORMATION_TOLERANCE;
    keys.windows(2).zip(middles).all(|(pair, middle)| {
        let ends = pair[0].positions.iter().zip(&pair[1].positions);
        // Written so that a vertex that is no number never asks for more keys.
        !ends.zip(&middle.positions).any(|((a, b), m)| ((*a + *b) * 0.5 - *m).length() > tolerance)
    })
}

fn deform(scene: &Scene, node: u32, mesh: &Mesh, pose: &Pose, origin: DVec3) -> Deformed {
    let mut deformed = Deformed {
        positions: mesh.positions.clone(),
        normals: mesh.normals.clone(),
        tangents: mesh.tangents.clone(),
    };
    morph(mesh, &pose.morph_weights[node as usize], &mut deformed);
    if let Some(skin) = scene.nodes[node as usize].skin
        && mesh.skinning.is_some()
    {
        apply_skin(mesh, &joint_matrices(scene, skin, pose, origin), &mut deformed);
    }
    for normal in deformed.normals.iter_mut().flatten() {
        *normal = normal.normalize_or_zero();
    }
    deformed
}

fn morph(mesh: &Mesh, weights: &[f32], deformed: &mut Deformed) {
    for (target, &weight) in mesh.morph_targets.iter().zip(weights) {
        if weight == 0.0 {
            continue;
        }
        if let Some(deltas) = &target.positions {
            for (position, delta) in deformed.positions.iter_mut().zip(deltas) {
                *position += *delta * weight;
            }
        }
        if let (Some(normals), Some(deltas)) = (&mut deformed.normals, &target.normals) {
            for (normal, delta) in normals.iter_mut().zip(deltas) {
                *normal += *delta * weight;
            }
        }
        if let (Some(tangents), Some(deltas)) = (&mut deformed.tangents, &target.tangents) {
            for (tangent, delta) in tangents.iter_mut().zip(deltas) {
                *tangent += (*delta * weight).extend(0.0);
            }
        }
    }
}

/// Mesh space to the renderer's space, per joint.
fn joint_matrices(scene: &Scene, skin: u32, pose: &Pose, origin: DVec3) -> Vec<DAffine3> {
    let skin = &scene.skins[skin as usize];
    skin.joints
        .iter()
        .zip(&skin.inverse_bind)
        .map(|(&joint, bind)| {
            let mut world = pose.places[joint as usize].world;
            world.translation -= origin;
            world * DAffine3::from_mat4(DMat4::from_cols_array(&bind.to_cols_array().map(f64::from)))
        })
        .collect()
}

fn apply_skin(mesh: &Mesh, joints: &[DAffine3], deformed: &mut Deformed) {
    let skinning = mesh.skinning.as_ref().expect("only a mesh with influences is skinned");
    let influences = skinning.influences as usize;
    for vertex in 0..deformed.positions.len() {
        let at = vertex * influences..(vertex + 1) * influences;
        let mut matrix = DAffine3 { matrix3: DMat3::ZERO, translation: DVec3::ZERO };
        for (&joint, &weight) in skinning.joints[at.clone()].iter().zip(&skinning.weights[at]) {
            if weight != 0.0 {
                let joint = joints[usize::from(joint)];
                matrix.matrix3 += joint.matrix3 * f64::from(weight);
                matrix.translation += joint.translation * f64::from(weight);
            }
        }
        let position = &mut deformed.positions[vertex];
        *position = matrix.transform_point3(position.as_dvec3()).as_vec3();
        if let Some(normals) = &mut deformed.normals {
            normals[vertex] =
                (cofactor(matrix.matrix3) * normals[vertex].as_dvec3()).normalize_or_zero().as_vec3();
        }
        if let Some(tangents) = &mut deformed.tangents {
            let tangent = tangents[vertex];
            let direction = matrix.transform_vector3(tangent.truncate().as_dvec3()).normalize_or_zero();
            tangents[vertex] = direction.as_vec3().extend(tangent.w);
        }
    }
}

/// Transforms normals as `m` transforms tangents, for any `m`: the inverse transpose times the determinant.
pub(crate) fn cofactor(m: DMat3) -> DMat3 {
    DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis))
}
