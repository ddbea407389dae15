//! Primitives to meshes. A mesh is what a primitive's accessors say, so primitives of the same accessors are one mesh; and it
//! holds only what the materials, skins and weights that meet it ask for.

use crate::accessor::{Accessors, Reader};
use crate::error::{Fault, Place};
use crate::report::{ImportReport, Warnings};
use crate::tangents;
use crate::topology::{self, gather};
use farm_scene::{Mesh, MorphTarget, Skinning};
use glam::{Vec2, Vec3, Vec4};
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::validation::Checked;
use gltf::json::{Accessor, Index};
use std::collections::{BTreeMap, BTreeSet};

/// What makes two primitives the same geometry.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Geometry {
    attributes: BTreeMap<Semantic, usize>,
    indices: Option<usize>,
    mode: u32,
    targets: Vec<[Option<usize>; 3]>,
}

impl Geometry {
    /// The geometry of a primitive that has a surface; none for points, lines, and primitives without positions.
    pub fn of(primitive: &Primitive, place: &Place) -> Result<Option<Self>, Fault> {
        let Checked::Valid(mode) = primitive.mode else {
            return Err(place.fault("has a mode that glTF 2.0 does not know; 0 to 6 are known"));
        };
        let attributes: BTreeMap<Semantic, usize> = primitive
            .attributes
            .iter()
            .filter_map(|(semantic, index)| match semantic {
                Checked::Valid(Semantic::Extras(_)) | Checked::Invalid => None,
                Checked::Valid(semantic) => Some((semantic.clone(), index.value())),
            })
            .collect();
        let surface = matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan);
        if !surface || !attributes.contains_key(&Semantic::Positions) {
            return Ok(None);
        }
        let value = |index: Option<Index<Accessor>>| index.map(|index| index.value());
        let targets = primitive.targets.iter().flatten();
        Ok(Some(Self {
            attributes,
            indices: value(primitive.indices),
            mode: mode.as_gl_enum(),
            targets: targets
                .map(|target| [target.positions, target.normals, target.tangents].map(value))
                .collect(),
        }))
    }

    /// Number of morph targets.
    pub fn targets(&self) -> usize {
        self.targets.len()
    }

    /// Whether vertices name joints.
    pub fn has_joints(&self) -> bool {
        self.attributes.contains_key(&Semantic::Joints(0))
    }
}

/// What the uses of a geometry ask for, all together.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Needs {
    /// Texture coordinate sets, numbered as in the file.
    pub uv_sets: BTreeSet<u32>,
    /// The set that a normal map uses.
    pub tangents: Option<u32>,
    /// Whether a skin deforms it.
    pub skinned: bool,
    /// Whether some weight is ever other than 0.
    pub morphed: bool,
}

/// Where a mesh is read from, and what is noted on the way.
pub(crate) struct MeshReader<'a> {
    pub accessors: &'a Accessors<'a>,
    pub warnings: &'a Warnings,
    /// Texture coordinate sets that materials use, numbered as in the file; a mesh stores set `i` of this list as its set `i`.
    pub uv_sets: &'a [u32],
}

impl MeshReader<'_> {
    /// Reads a geometry; none when it has no triangles.
    pub fn read(
        &self,
        geometry: &Geometry,
        needs: &Needs,
        name: &str,
        place: &Place,
        report: &mut ImportReport,
    ) -> Result<Option<Mesh>, Fault> {
        let attributes = Attributes { geometry, accessors: self.accessors, place };
        let Some(positions) = attributes.reader(&Semantic::Positions, &[Type::Vec3])? else {
            return Ok(None);
        };
        let indices = geometry.indices.map(|index| Index::new(index as u32));
        let topology =
            topology::read(self.accessors, mode_of(geometry.mode), indices, positions.count(), place)?;
        let Some(topology) = topology.filter(|topology| !topology.triangles.is_empty()) else {
            return Ok(None);
        };
        if topology.left_over > 0 {
            self.warnings.add(place, "ends with vertices that are not enough for a triangle; ignored");
        }
        let vertices = &topology.vertices;
        let all = attributes.charged(&positions, positions.count(), vertices)?;
        let mut mesh = Mesh {
            name: name.to_owned(),
            positions: all.map(Vec3::from_array).collect(),
            triangles: topology.triangles,
            ..Mesh::default()
        };
        let attributes = Loaded { attributes, count: positions.count(), vertices };
        mesh.normals = attributes.normals(&mesh)?;
        mesh.colors = attributes.colors()?;
        mesh.uvs = attributes.uvs(needs, self.uv_sets)?;
        if needs.skinned {
            mesh.skinning = attributes.skinning()?;
        }
        if needs.morphed {
            mesh.morph_targets =
                attributes.morph_targets(mesh.normals.is_some(), needs.tangents.is_some())?;
        }
        if let Some(set) = needs.tangents {
            self.add_tangents(&mut mesh, &attributes, set, place)?;
        }
        count(&mesh, report);
        Ok(Some(mesh))
    }

    fn add_tangents(
        &self,
        mesh: &mut Mesh,
        attributes: &Loaded,
        set: u32,
        place: &Place,
    ) -> Result<(), Fault> {
        // Tangents that come without normals do not fit the flat ones.
        if mesh.normals.is_some()
            && let Some(tangents) = attributes.tangents()?
        {
            if tangents.iter().all(|tangent| tangent.is_finite()) {
                mesh.tangents = Some(tangents);
                return Ok(());
            }
            self.warnings.add(place, "has tangents of no length; all are made anew");
        }
        let slot = self.uv_sets.iter().position(|&known| known == set);
        let Some(uvs) = slot.and_then(|slot| mesh.uvs.get(slot)) else {
            self.warnings.add(place, "has no texture coordinates for its normal map, which has no effect");
            return Ok(());
        };
        let made = tangents::generate(&tangents::Surface {
            positions: &mesh.positions,
            triangles: &mesh.triangles,
            normals: mesh.normals.as_deref(),
            uvs,
        });
        self.accessors.charge(made.doubles.len() as u64, place)?;
        double(mesh, &made.doubles);
        mesh.triangles = made.triangles;
        mesh.tangents = Some(made.tangents);
        Ok(())
    }
}

fn mode_of(mode: u32) -> Mode {
    match mode {
        gltf::json::mesh::TRIANGLE_STRIP => Mode::TriangleStrip,
        gltf::json::mesh::TRIANGLE_FAN => Mode::TriangleFan,
        _ => Mode::Triangles,
    }
}

/// Appends a copy of each of the `doubles` to every attribute.
fn double(mesh: &mut Mesh, doubles: &[u32]) {
    fn append<T: Copy>(list: &mut Vec<T>, doubles: &[u32]) {
        list.extend(doubles.iter().map(|&vertex| list[vertex as usize]).collect::<Vec<_>>());
    }
    append(&mut mesh.positions, doubles);
    mesh.normals.iter_mut().for_each(|list| append(list, doubles));
    mesh.uvs.iter_mut().for_each(|list| append(list, doubles));
    mesh.colors.iter_mut().for_each(|list| append(list, doubles));
    for target in &mut mesh.morph_targets {
        let lists = [&mut target.positions, &mut target.normals, &mut target.tangents];
        lists.into_iter().flatten().for_each(|list| append(list, doubles));
    }
    if let Some(skinning) = &mut mesh.skinning {
        let influences = skinning.influences as usize;
        for &vertex in doubles {
            let range = vertex as usize * influences..(vertex as usize + 1) * influences;
            skinning.joints.extend_from_within(range.clone());
            skinning.weights.extend_from_within(range);
        }
    }
}

fn count(mesh: &Mesh, report: &mut ImportReport) {
    let corners = |triangle: &[u32; 3]| triangle.map(|vertex| mesh.positions[vertex as usize].as_dvec3());
    let degenerate = |triangle: &&[u32; 3]| {
        let [a, b, c] = corners(triangle);
        (b - a).cross(c - a) == glam::DVec3::ZERO
    };
    report.triangles_stored += mesh.triangles.len() as u64;
    report.triangles_degenerate += mesh.triangles.iter().filter(degenerate).count() as u64;
    report.vertices_not_finite +=
        mesh.positions.iter().filter(|position| !position.is_finite()).count() as u64;
}

/// The accessors of a geometry.
struct Attributes<'a> {
    geometry: &'a Geometry,
    accessors: &'a Accessors<'a>,
    place: &'a Place<'a>,
}

impl<'a> Attributes<'a> {
    fn reader(&self, semantic: &Semantic, types: &[Type]) -> Result<Option<Reader<'a>>, Fault> {
        let Some(&index) = self.geometry.attributes.get(semantic) else { return Ok(None) };
        self.reader_at(index, types, &semantic.to_string()).map(Some)
    }

    fn reader_at(&self, index: usize, types: &[Type], name: &str) -> Result<Reader<'a>, Fault> {
        let reader = self.accessors.reader(Index::new(index as u32), types, &self.place.field(name))?;
        let integer = matches!(reader.component(), ComponentType::U32);
        let place = self.place.field(name);
        place
            .then("accessor", index, None)
            .ensure(!integer, || "has 32-bit integers where floats are wanted".to_owned())?;
        Ok(reader)
    }

    /// The elements of `vertices`, once the accessor is known to have `count` of them.
    fn charged<'r, const N: usize>(
        &self,
        reader: &'r Reader,
        count: usize,
        vertices: &'r [u32],
    ) -> Result<impl Iterator<Item = [f32; N]> + use<'r, N>, Fault> {
        let held = reader.count();
        self.place
            .ensure(held == count, || format!("has an attribute of {held} elements for {count} positions"))?;
        self.accessors.charge(vertices.len() as u64, self.place)?;
        Ok(gather(reader, vertices))
    }
}

/// The accessors of a geometry whose vertices are known.
struct Loaded<'a> {
    attributes: Attributes<'a>,
    count: usize,
    vertices: &'a [u32],
}

impl Loaded<'_> {
    fn read<const N: usize>(
        &self,
        semantic: &Semantic,
        types: &[Type],
        unit: bool,
    ) -> Result<Option<Vec<[f32; N]>>, Fault> {
        let Some(mut reader) = self.attributes.reader(semantic, types)? else { return Ok(None) };
        // Colours and weights are fractions, also where the accessor forgets to say so.
        if unit {
            reader = reader.normalized();
        }
        Ok(Some(self.attributes.charged(&reader, self.count, self.vertices)?.collect()))
    }

    fn normals(&self, mesh: &Mesh) -> Result<Option<Vec<Vec3>>, Fault> {
        let Some(normals) = self.read::<3>(&Semantic::Normals, &[Type::Vec3], false)? else {
            return Ok(None);
        };
        let mut normals: Vec<Vec3> =
            normals.into_iter().map(|normal| Vec3::from_array(normal).normalize_or_zero()).collect();
        if normals.contains(&Vec3::ZERO) {
            repair(&mut normals, mesh);
        }
        Ok(Some(normals))
    }

    /// Unit tangents; those that have no direction are not finite.
    fn tangents(&self) -> Result<Option<Vec<Vec4>>, Fault> {
        let tangents = self.read::<4>(&Semantic::Tangents, &[Type::Vec4], false)?;
        let unit = |[x, y, z, w]: [f32; 4]| {
            Vec3::new(x, y, z).normalize_or(Vec3::NAN).extend(if w < 0.0 { -1.0 } else { 1.0 })
        };
        Ok(tangents.map(|tangents| tangents.into_iter().map(unit).collect()))
    }

    fn colors(&self) -> Result<Option<Vec<Vec4>>, Fault> {
        let semantic = Semantic::Colors(0);
        let Some(reader) = self.attributes.reader(&semantic, &[Type::Vec3, Type::Vec4])? else {
            return Ok(None);
        };
        let opaque = reader.components() == 3;
        let colors = self.read::<4>(&semantic, &[Type::Vec3, Type::Vec4], true)?;
        let color = |[r, g, b, a]: [f32; 4]| Vec4::new(r, g, b, if opaque { 1.0 } else { a });
        Ok(colors.map(|colors| colors.into_iter().map(color).collect()))
    }

    fn uvs(&self, needs: &Needs, known: &[u32]) -> Result<Vec<Vec<Vec2>>, Fault> {
        let mut uvs = vec![];
        let is_needed = |set: &u32| {
            needs.uv_sets.contains(set)
                && self.attributes.geometry.attributes.contains_key(&Semantic::TexCoords(*set))
        };
        let last = known.iter().rposition(is_needed);
        for &set in &known[..last.map_or(0, |last| last + 1)] {
            // A set below a needed one keeps its number by being there, if only as zeros.
            let list = self.read::<2>(&Semantic::TexCoords(set), &[Type::Vec2], false)?;
            uvs.push(list.map_or_else(
                || vec![Vec2::ZERO; self.vertices.len()],
                |list| list.into_iter().map(Vec2::from_array).collect(),
            ));
        }
        Ok(uvs)
    }

    fn skinning(&self) -> Result<Option<Skinning>, Fault> {
        let mut sets = vec![];
        for set in 0.. {
            let Some(joints) = self.attributes.reader(&Semantic::Joints(set), &[Type::Vec4])? else { break };
            let Some(weights) = self.read::<4>(&Semantic::Weights(set), &[Type::Vec4], true)? else { break };
            let kind = matches!(joints.component(), ComponentType::U8 | ComponentType::U16);
            self.attributes.place.ensure(kind && joints.count() == self.count, || {
                format!("has JOINTS_{set} that are not one 8- or 16-bit unsigned VEC4 per position")
            })?;
            sets.push((joints, weights));
        }
        if sets.is_empty() {
            return Ok(None);
        }
        let mut skinning = Skinning { influences: 4 * sets.len() as u32, joints: vec![], weights: vec![] };
        for (slot, &vertex) in self.vertices.iter().enumerate() {
            let weights = sets.iter().flat_map(|(_, weights)| weights[slot]);
            let weights: Vec<f32> = weights.map(|weight| if weight > 0.0 { weight } else { 0.0 }).collect();
            let sum: f32 = weights.iter().sum();
            let joints = sets.iter().flat_map(|(joints, _)| joints.integers::<4>(vertex as usize));
            for (influence, (joint, weight)) in joints.zip(weights).enumerate() {
                // Without weights the first joint takes the vertex along; a joint of no weight need not exist.
                let usable = sum > 0.0 && sum.is_finite();
                let weight = if usable { weight / sum } else { f32::from(u8::from(influence == 0)) };
                skinning.joints.push(if weight > 0.0 { joint as u16 } else { 0 });
                skinning.weights.push(weight);
            }
        }
        Ok(Some(skinning))
    }

    fn morph_targets(&self, normals: bool, tangents: bool) -> Result<Vec<MorphTarget>, Fault> {
        let read = |index: Option<usize>, wanted: bool| -> Result<Option<Vec<Vec3>>, Fault> {
            let Some(index) = index.filter(|_| wanted) else { return Ok(None) };
            let reader = self.attributes.reader_at(index, &[Type::Vec3], "targets")?;
            let all = self.attributes.charged(&reader, self.count, self.vertices)?;
            Ok(Some(all.map(Vec3::from_array).collect()))
        };
        let targets = self.attributes.geometry.targets.iter();
        let target = |[position, normal, tangent]: &[Option<usize>; 3]| {
            Ok(MorphTarget {
                positions: read(*position, true)?,
                normals: read(*normal, normals)?,
                tangents: read(*tangent, tangents)?,
            })
        };
        targets.map(target).collect()
    }
}

/// Gives normals of no length the mean direction of the triangles around them.
fn repair(normals: &mut [Vec3], mesh: &Mesh) {
    let missing: Vec<bool> = normals.iter().map(|&normal| normal == Vec3::ZERO).collect();
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|vertex| mesh.positions[vertex as usize]);
        let weighted = (b - a).cross(c - a);
        for &vertex in triangle.iter().filter(|&&vertex| missing[vertex as usize] && weighted.is_finite()) {
            normals[vertex as usize] += weighted;
        }
    }
    for (normal, _) in normals.iter_mut().zip(missing).filter(|(_, missing)| *missing) {
        *normal = normal.normalize_or(Vec3::Z);
    }
}
