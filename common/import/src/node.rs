//! Which nodes are imported, in which order, and what hangs on them.

use crate::accessor::Accessors;
use crate::error::{Fault, Place};
use crate::fields::Fields;
use crate::references;
use farm_scene::{Node, Skin, Transform};
use glam::{DQuat, DVec3, Mat4, Vec3};
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::{Index, Root};
use std::collections::BTreeSet;

/// Nodes of the chosen scene, parents before children, and nodes above its skins' joints.
pub(crate) struct Selection {
    /// The file's number of each imported node.
    pub nodes: Vec<usize>,
    /// The imported number of each of the file's nodes.
    pub numbers: Vec<Option<u32>>,
    /// Whether each of the file's nodes belongs to the scene; others only carry joints.
    pub drawn: Vec<bool>,
    /// The file's number of each node's parent.
    pub parents: Vec<Option<usize>>,
    /// The chosen scene; none when the file has no scenes, whereupon all nodes are drawn.
    pub scene: Option<usize>,
}

impl Selection {
    /// The default scene or else the first.
    pub fn of(root: &Root) -> Self {
        let mut parents = references::parents(root);
        let scene = root.scene.map(|scene| scene.value()).or((!root.scenes.is_empty()).then_some(0));
        let mut roots: Vec<usize> = match scene {
            Some(scene) => root.scenes[scene].nodes.iter().map(Index::value).collect(),
            None => (0..root.nodes.len()).filter(|&node| parents[node].is_none()).collect(),
        };
        keep_topmost(&mut roots, &mut parents);
        let children = |node: usize| {
            let children = root.nodes[node].children.iter().flatten().map(Index::value);
            children.filter(|&child| parents[child] == Some(node)).collect::<Vec<_>>()
        };
        let mut drawn = vec![false; root.nodes.len()];
        let mut open = roots.clone();
        while let Some(node) = open.pop() {
            drawn[node] = true;
            open.extend(children(node));
        }
        let mut wanted = drawn.clone();
        let skinned = (0..root.nodes.len()).filter(|&node| drawn[node]);
        let skins: BTreeSet<usize> =
            skinned.filter_map(|node| root.nodes[node].skin).map(|it| it.value()).collect();
        for joint in skins.into_iter().flat_map(|skin| &root.skins[skin].joints) {
            let mut above = Some(joint.value());
            while let Some(node) = above.filter(|&node| !wanted[node]) {
                wanted[node] = true;
                above = parents[node];
            }
        }
        // Depth first in the file's order, from the scene's roots and then from those above joints.
        let others =
            (0..root.nodes.len()).filter(|&node| parents[node].is_none() && !drawn[node] && wanted[node]);
        let mut open: Vec<usize> = roots.iter().copied().chain(others).collect();
        open.reverse();
        let (mut nodes, mut numbers) = (vec![], vec![None; root.nodes.len()]);
        while let Some(node) = open.pop() {
            numbers[node] = Some(nodes.len() as u32);
            nodes.push(node);
            let from = open.len();
            open.extend(children(node).into_iter().filter(|&child| wanted[child]));
            open[from..].reverse();
        }
        Self { nodes, numbers, drawn, parents, scene }
    }
}

/// Some files list children as roots of a scene: those below another root go with it, others are cut off from their parent.
fn keep_topmost(roots: &mut Vec<usize>, parents: &mut [Option<usize>]) {
    let mut listed = vec![false; parents.len()];
    roots.retain(|&root| !std::mem::replace(&mut listed[root], true));
    // Answers are remembered on the way up: many roots may share a long way.
    let mut below: Vec<Option<bool>> = vec![None; parents.len()];
    let mut below_another = |root: usize| {
        let (mut way, mut node) = (vec![], root);
        let answer = loop {
            if let Some(known) = below[node] {
                break known;
            }
            way.push(node);
            match parents[node] {
                None => break false,
                Some(above) if listed[above] => break true,
                Some(above) => node = above,
            }
        };
        way.into_iter().for_each(|node| below[node] = Some(answer));
        answer
    };
    let topmost: Vec<usize> = roots.iter().copied().filter(|&root| !below_another(root)).collect();
    topmost.iter().for_each(|&root| parents[root] = None);
    *roots = topmost;
}

/// The node without what hangs on it.
pub(crate) fn read_node(
    root: &Root,
    index: usize,
    transform: Transform,
    selection: &Selection,
) -> Result<Node, Fault> {
    let node = &root.nodes[index];
    let place = Place::new("node", index, node.name.as_deref());
    let motion = Fields::of_extras(&node.extras).numbers("motionVector", &place)?;
    Ok(Node {
        name: node.name.clone().unwrap_or_default(),
        parent: selection.parents[index].and_then(|parent| selection.numbers[parent]),
        transform,
        motion_vector: motion.map(Vec3::from_array).filter(|&motion| motion != Vec3::ZERO),
        instances: vec![],
        skin: None,
        morph_weights: vec![],
    })
}

/// A skin whose joints are all imported.
pub(crate) fn read_skin(
    root: &Root,
    index: usize,
    accessors: &Accessors,
    selection: &Selection,
) -> Result<Skin, Fault> {
    let skin = &root.skins[index];
    let place = Place::new("skin", index, skin.name.as_deref());
    place.ensure(!skin.joints.is_empty(), || "has no joints".to_owned())?;
    let joints = skin.joints.iter().map(|joint| selection.numbers[joint.value()]);
    let joints: Option<Vec<u32>> = joints.collect();
    let joints = joints.ok_or_else(|| place.fault("has a joint that is not imported"))?;
    let inverse_bind = match skin.inverse_bind_matrices {
        None => vec![Mat4::IDENTITY; joints.len()],
        Some(index) => {
            let place = place.field("inverseBindMatrices");
            let reader = accessors.reader(index, &[Type::Mat4], &place)?;
            let (count, held) = (joints.len(), reader.count());
            let floats = matches!(reader.component(), ComponentType::F32);
            place.ensure(floats && held >= count, || format!("are {held}, but must be {count} of floats"))?;
            accessors.charge(count as u64 * 4, &place)?;
            let matrices: Vec<Mat4> =
                (0..count).map(|joint| Mat4::from_cols_array(&reader.floats(joint))).collect();
            place.ensure(matrices.iter().all(|matrix| matrix.is_finite()), || {
                "are not all finite".to_owned()
            })?;
            matrices
        }
    };
    Ok(Skin { joints, inverse_bind })
}

/// Elements that a copy of a node is charged as, beside its instances: it has a transform, a name and lists of its own.
const COPY_ELEMENTS: u64 = 128;

/// The places of EXT_mesh_gpu_instancing relative to the node, which draws `instances`; none when the node has no such
/// extension.
pub(crate) fn read_copies(
    root: &Root,
    index: usize,
    instances: usize,
    accessors: &Accessors,
) -> Result<Option<Vec<Transform>>, Fault> {
    const NAME: &str = "EXT_mesh_gpu_instancing";
    let node = &root.nodes[index];
    let node_place = Place::new("node", index, node.name.as_deref());
    let extensions = node.extensions.as_ref().map(|it| &it.others);
    let Some(extension) = Fields::of_extension(NAME, extensions, &node_place)? else { return Ok(None) };
    let place = node_place.field(NAME);
    let attributes = extension.object("attributes", &place)?;
    let attributes = attributes.ok_or_else(|| place.fault("has no attributes"))?;
    let reader = |key: &str, kind: Type| {
        let Some(accessor) = attributes.count(key, &place)? else { return Ok(None) };
        let (accessor, len) = (accessor as usize, root.accessors.len());
        place
            .ensure(accessor < len, || format!("refers to accessor {accessor}, but there are only {len}"))?;
        accessors.reader(Index::new(accessor as u32), &[kind], &place).map(Some)
    };
    let translations = reader("TRANSLATION", Type::Vec3)?;
    let rotations = reader("ROTATION", Type::Vec4)?;
    let scales = reader("SCALE", Type::Vec3)?;
    let counts: Vec<usize> =
        [&translations, &rotations, &scales].into_iter().flatten().map(|reader| reader.count()).collect();
    let count = counts.first().copied().unwrap_or(0);
    place.ensure(counts.iter().all(|&other| other == count), || {
        "has attributes of different counts".to_owned()
    })?;
    // A node takes far more memory than an element.
    let text = node.name.as_ref().map_or(0, String::len) / 8;
    let each = COPY_ELEMENTS + 2 * instances as u64 + text as u64;
    accessors.charge((count as u64).saturating_mul(each), &place)?;
    let vector = |values: [f32; 3]| DVec3::from_array(values.map(f64::from));
    let copies = (0..count).map(|copy| Transform::Trs {
        translation: translations.as_ref().map_or(DVec3::ZERO, |reader| vector(reader.floats(copy))),
        rotation: rotations.as_ref().map_or(DQuat::IDENTITY, |reader| {
            let [x, y, z, w] = reader.floats::<4>(copy).map(f64::from);
            DQuat::from_xyzw(x, y, z, w).normalize()
        }),
        scale: scales.as_ref().map_or(DVec3::ONE, |reader| vector(reader.floats(copy))),
    });
    let copies: Vec<Transform> = copies.collect();
    let finite = copies.iter().all(|copy| match copy {
        Transform::Trs { translation, rotation, scale } => {
            translation.is_finite() && rotation.is_finite() && scale.is_finite()
        }
        Transform::Matrix(matrix) => matrix.is_finite(),
    });
    place.ensure(finite, || "has places that are not finite, or rotations of length 0".to_owned())?;
    Ok(Some(copies))
}
