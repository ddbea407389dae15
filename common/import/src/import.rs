//! From a file to a scene, step by step.

use crate::accessor::Accessors;
use crate::camera;
use crate::document::{self, Document};
use crate::environment::{self, ExrEnvironment, Named};
use crate::error::{Fault, ImportError, Place};
use crate::fields::Fields;
use crate::material::Materials;
use crate::mesh::{Geometry, MeshReader, Needs};
use crate::node::{self, Selection};
use crate::report::{ImportReport, Warnings};
use crate::source::Source;
use crate::texture::Textures;
use crate::{animation, container, framing, light, references};
use farm_scene::{Channel, Instance, Node, Path as ChannelPath, Scene, Transform};
use gltf::json::Root;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Elements that a primitive of a node is charged as: it takes that many times longer to look at than a vertex.
const DRAWN_ELEMENTS: u64 = 32;

/// What to take from a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ImportOptions {
    /// The animation to play; none means the first.
    pub animation: Option<String>,
}

/// A scene and how it came to be.
#[derive(Clone, Debug)]
pub struct Imported {
    /// Checked by [`Scene::validate`]; has at least one camera.
    pub scene: Scene,
    /// What was read and left out.
    pub report: ImportReport,
    /// An environment that the scene names and that is still to be decoded.
    pub exr_environment: Option<ExrEnvironment>,
}

/// Imports the glTF 2.0 file (`.gltf` or `.glb`) at `path`.
///
/// # Errors
/// Whatever is missing, malformed, or required but not understood: one sentence that names the place.
pub fn import(path: &Path, options: &ImportOptions) -> Result<Imported, ImportError> {
    import_file(path, options).map_err(|fault| fault.in_file(path))
}

fn import_file(path: &Path, options: &ImportOptions) -> Result<Imported, Fault> {
    let (source, file) = Source::open(path)?;
    let warnings = Warnings::default();
    let container = container::split(&file)?;
    let document = document::parse(container.json, &warnings)?;
    references::check(&document.root)?;
    let accessors = Accessors::load(&document.root, container.bin, &source)?;
    let context =
        Context { document: &document, accessors: &accessors, source: &source, warnings: &warnings };
    let mut imported = context.build(options)?;
    if imported.scene.cameras.is_empty() {
        framing::add_camera(&mut imported.scene);
    }
    imported.scene.validate().map_err(|err| Fault::at(err.place, err.fault))?;
    (imported.report.files, imported.report.bytes_read) = source.into_files();
    imported.report.warnings = warnings.into_sentences();
    Ok(imported)
}

struct Context<'a> {
    document: &'a Document,
    accessors: &'a Accessors<'a>,
    source: &'a Source,
    warnings: &'a Warnings,
}

/// A primitive that is drawn: by which of the file's nodes, which geometry, which material.
struct Drawn {
    node: usize,
    geometry: usize,
    material: u32,
}

/// A geometry with what its uses need, and where it was met first.
struct Wanted {
    geometry: Geometry,
    needs: Needs,
    mesh: usize,
    primitive: usize,
}

impl Context<'_> {
    fn build(&self, options: &ImportOptions) -> Result<Imported, Fault> {
        let root = &self.document.root;
        let mut report = ImportReport { animations: animation::names(root), ..ImportReport::default() };
        let selection = Selection::of(root);
        let mut scene = Scene::default();
        if let Some(index) = animation::choose(root, options.animation.as_deref(), self.warnings)? {
            scene.channels = animation::read(root, index, self.accessors, &selection, self.warnings)?;
        }
        self.add_nodes(&mut scene, &selection)?;
        let mut materials = Materials::new(Textures::new(root, self.accessors, self.source, self.warnings));
        let (drawn, wanted) = self.survey(&selection, &scene.channels, &mut materials, &mut report)?;
        let uv_sets = materials.compact_uv_sets();
        let meshes = self.read_meshes(&wanted, &uv_sets, &mut scene, &mut report)?;
        scene.materials = materials.materials;
        (scene.textures, scene.images) = materials.textures.decode()?;
        self.add_instances(&mut scene, &selection, &drawn, &meshes)?;
        self.add_skins_and_weights(&mut scene, &selection)?;
        self.add_copies(&mut scene, &selection)?;
        self.add_views(&mut scene, &selection)?;
        let exr_environment = self.add_environment(&mut scene, &selection)?;
        let triangles = |instance: &Instance| scene.meshes[instance.mesh as usize].triangles.len() as u64;
        report.triangles_drawn = scene.nodes.iter().flat_map(|node| &node.instances).map(triangles).sum();
        if report.triangles_drawn == 0 {
            self.warnings.add(&"scene", "has no triangles");
        }
        Ok(Imported { scene, report, exr_environment })
    }

    fn add_nodes(&self, scene: &mut Scene, selection: &Selection) -> Result<(), Fault> {
        let moved: BTreeSet<u32> =
            scene.channels.iter().filter(|it| moves_place(it)).map(|it| it.node).collect();
        for &index in &selection.nodes {
            let mut transform = self.document.transforms[index];
            if let Transform::Matrix(matrix) = transform
                && moved.contains(&(scene.nodes.len() as u32))
            {
                let place = Place::new("node", index, self.document.root.nodes[index].name.as_deref());
                self.warnings.add(&place, "has a matrix but is animated; the matrix was taken apart");
                let (scale, rotation, translation) = matrix.to_scale_rotation_translation();
                place.ensure(rotation.is_normalized(), || {
                    "is animated but has a matrix that is singular".to_owned()
                })?;
                transform = Transform::Trs { translation, rotation, scale };
            }
            scene.nodes.push(node::read_node(&self.document.root, index, transform, selection)?);
        }
        Ok(())
    }

    /// Finds all that is drawn, and what each geometry needs for it.
    fn survey(
        &self,
        selection: &Selection,
        channels: &[Channel],
        materials: &mut Materials,
        report: &mut ImportReport,
    ) -> Result<(Vec<Drawn>, Vec<Wanted>), Fault> {
        let root = &self.document.root;
        let weighted = |channel: &&Channel| matches!(channel.path, ChannelPath::MorphWeights { .. });
        let weighted: BTreeSet<u32> = channels.iter().filter(weighted).map(|channel| channel.node).collect();
        let (mut drawn, mut wanted, mut known) = (vec![], Vec::<Wanted>::new(), BTreeMap::new());
        for &node in selection.nodes.iter().filter(|&&node| selection.drawn[node]) {
            let Some(mesh) = root.nodes[node].mesh.map(|mesh| mesh.value()) else { continue };
            let node_place = Place::new("node", node, root.nodes[node].name.as_deref());
            let mesh_place = node_place.then("mesh", mesh, root.meshes[mesh].name.as_deref());
            let is_weighted = selection.numbers[node].is_some_and(|number| weighted.contains(&number));
            let morphed = is_weighted || weights_of(root, node).iter().any(|&weight| weight != 0.0);
            let primitives = &root.meshes[mesh].primitives;
            // A mesh of many parts may be named by many nodes.
            self.accessors.charge(primitives.len() as u64 * DRAWN_ELEMENTS, &mesh_place)?;
            for (primitive, part) in primitives.iter().enumerate() {
                let place = mesh_place.then("primitive", primitive, None);
                let Some(geometry) = Geometry::of(part, &place)? else {
                    self.warnings
                        .add(&place, "has points, lines or no positions, and so no surface; skipped");
                    report.primitives_skipped += 1;
                    continue;
                };
                let targets = animation::morph_targets_of(root, node);
                place.ensure(geometry.targets() == targets, || {
                    "has another number of morph targets than the mesh's other primitives".to_owned()
                })?;
                let material = materials.number(part.material.map(|material| material.value()))?;
                let slot = *known.entry(geometry.clone()).or_insert_with(|| {
                    wanted.push(Wanted {
                        geometry: geometry.clone(),
                        needs: Needs::default(),
                        mesh,
                        primitive,
                    });
                    wanted.len() - 1
                });
                let needs = &mut wanted[slot].needs;
                let look = &materials.materials[material as usize];
                needs.uv_sets.extend(look.texture_refs().map(|texture| texture.uv_set));
                if let Some(normal_map) = look.normal_map {
                    let set = *needs.tangents.get_or_insert(normal_map.texture.uv_set);
                    if set != normal_map.texture.uv_set {
                        self.warnings.add(
                            &place,
                            "has normal maps on different texture coordinates; one set's tangents serve all",
                        );
                    }
                }
                needs.skinned |= root.nodes[node].skin.is_some() && geometry.has_joints();
                needs.morphed |= morphed;
                drawn.push(Drawn { node, geometry: slot, material });
            }
        }
        Ok((drawn, wanted))
    }

    fn read_meshes(
        &self,
        wanted: &[Wanted],
        uv_sets: &[u32],
        scene: &mut Scene,
        report: &mut ImportReport,
    ) -> Result<Vec<Option<u32>>, Fault> {
        let reader = MeshReader { accessors: self.accessors, warnings: self.warnings, uv_sets };
        let mut numbers = vec![];
        for Wanted { geometry, needs, mesh, primitive } in wanted {
            let name = self.document.root.meshes[*mesh].name.as_deref();
            let mesh_place = Place::new("mesh", *mesh, name);
            let place = mesh_place.then("primitive", *primitive, None);
            let read = reader.read(geometry, needs, name.unwrap_or_default(), &place, report)?;
            numbers.push(read.map(|mesh| {
                scene.meshes.push(mesh);
                (scene.meshes.len() - 1) as u32
            }));
        }
        Ok(numbers)
    }

    fn add_instances(
        &self,
        scene: &mut Scene,
        selection: &Selection,
        drawn: &[Drawn],
        meshes: &[Option<u32>],
    ) -> Result<(), Fault> {
        for Drawn { node, geometry, material } in drawn {
            if let (Some(number), Some(mesh)) = (selection.numbers[*node], meshes[*geometry]) {
                scene.nodes[number as usize].instances.push(Instance { mesh, material: *material });
            }
        }
        Ok(())
    }

    fn add_skins_and_weights(&self, scene: &mut Scene, selection: &Selection) -> Result<(), Fault> {
        let root = &self.document.root;
        let mut skins = BTreeMap::new();
        for (number, &index) in selection.nodes.iter().enumerate().filter(|(_, node)| selection.drawn[**node])
        {
            let meshes = scene.nodes[number].instances.iter().map(|it| &scene.meshes[it.mesh as usize]);
            let (mut skinned, mut targets) = (false, 0);
            for mesh in meshes {
                skinned |= mesh.skinning.is_some();
                targets = targets.max(mesh.morph_targets.len());
            }
            if targets > 0 {
                let mut weights = weights_of(root, index).to_vec();
                let place = Place::new("node", index, root.nodes[index].name.as_deref());
                place.ensure(weights.is_empty() || weights.len() == targets, || {
                    format!("has {} weights for {targets} morph targets", weights.len())
                })?;
                place.ensure(weights.iter().all(|weight| weight.is_finite()), || {
                    "has weights that are too large".to_owned()
                })?;
                weights.resize(targets, 0.0);
                scene.nodes[number].morph_weights = weights;
            }
            if let Some(skin) = root.nodes[index].skin.filter(|_| skinned) {
                let slot = match skins.get(&skin.value()) {
                    Some(&slot) => slot,
                    None => {
                        scene.skins.push(node::read_skin(root, skin.value(), self.accessors, selection)?);
                        (scene.skins.len() - 1) as u32
                    }
                };
                skins.insert(skin.value(), slot);
                scene.nodes[number].skin = Some(slot);
            }
        }
        // Weights of meshes that turned out to have no targets move nothing.
        let nodes = &scene.nodes;
        scene
            .channels
            .retain(|channel| moves_place(channel) || !nodes[channel.node as usize].morph_weights.is_empty());
        Ok(())
    }

    /// EXT_mesh_gpu_instancing: one child per copy, which draws what the node itself would have drawn.
    fn add_copies(&self, scene: &mut Scene, selection: &Selection) -> Result<(), Fault> {
        for (number, &index) in selection.nodes.iter().enumerate().filter(|(_, node)| selection.drawn[**node])
        {
            let drawn = scene.nodes[number].instances.len() + scene.nodes[number].morph_weights.len();
            let Some(copies) = node::read_copies(&self.document.root, index, drawn, self.accessors)? else {
                continue;
            };
            let instances = std::mem::take(&mut scene.nodes[number].instances);
            let motion_vector = scene.nodes[number].motion_vector.take();
            let morph_weights = scene.nodes[number].morph_weights.clone();
            let name = scene.nodes[number].name.clone();
            scene.nodes.extend(copies.into_iter().map(|transform| Node {
                name: name.clone(),
                parent: Some(number as u32),
                transform,
                motion_vector,
                instances: instances.clone(),
                skin: None,
                morph_weights: morph_weights.clone(),
            }));
        }
        Ok(())
    }

    fn add_views(&self, scene: &mut Scene, selection: &Selection) -> Result<(), Fault> {
        let root = &self.document.root;
        let mut names = BTreeSet::new();
        for (number, &index) in selection.nodes.iter().enumerate().filter(|(_, node)| selection.drawn[**node])
        {
            scene.cameras.extend(camera::read(root, index, number as u32, &mut names)?);
            scene.lights.extend(light::read(root, index, number as u32, self.warnings)?);
        }
        Ok(())
    }

    fn add_environment(
        &self,
        scene: &mut Scene,
        selection: &Selection,
    ) -> Result<Option<ExrEnvironment>, Fault> {
        let Some(index) = selection.scene else { return Ok(None) };
        let file_scene = &self.document.root.scenes[index];
        let place = Place::new("scene", index, file_scene.name.as_deref());
        match environment::read(&Fields::of_extras(&file_scene.extras), &place, self.source)? {
            None => Ok(None),
            Some(Named::Exr(exr)) => Ok(Some(exr)),
            Some(Named::Loaded(environment, report)) => {
                if report.pixels_repaired > 0 {
                    let count = report.pixels_repaired;
                    self.warnings.add(
                        &place,
                        format!("has an environment with {count} pixels that are no radiance; black"),
                    );
                }
                scene.environment = Some(environment);
                Ok(None)
            }
        }
    }
}

fn moves_place(channel: &Channel) -> bool {
    !matches!(channel.path, ChannelPath::MorphWeights { .. })
}

/// A node's morph weights at rest: its own, or else its mesh's.
fn weights_of(root: &Root, node: usize) -> &[f32] {
    let node = &root.nodes[node];
    let mesh = node.mesh.and_then(|mesh| root.meshes[mesh.value()].weights.as_deref());
    node.weights.as_deref().or(mesh).unwrap_or_default()
}
