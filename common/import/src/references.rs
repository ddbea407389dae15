//! Every index of a document, checked once: past this, what an index refers to is there, and nodes form trees.

use crate::error::{Fault, Place};
use gltf::json::{Index, Material, Root, texture};

/// Checks every index of the document, also of parts that no scene uses.
pub(crate) fn check(root: &Root) -> Result<(), Fault> {
    check_data(root)?;
    check_meshes(root)?;
    for (index, material) in root.materials.iter().enumerate() {
        let place = Place::new("material", index, material.name.as_deref());
        for texture in textures_of(material) {
            within(texture, root.textures.len(), &place, "texture")?;
        }
    }
    check_nodes(root)?;
    check_trees(root)?;
    check_motion(root)
}

/// The light of KHR_lights_punctual that a node has.
pub(crate) fn light_of(node: &gltf::json::Node) -> Option<usize> {
    let extensions = node.extensions.as_ref()?;
    Some(extensions.khr_lights_punctual.as_ref()?.light.value())
}

fn within<T>(index: Index<T>, len: usize, place: &Place, kind: &str) -> Result<(), Fault> {
    place.ensure(index.value() < len, || format!("refers to {kind} {index}, but there are only {len}"))
}

fn maybe<T>(index: Option<Index<T>>, len: usize, place: &Place, kind: &str) -> Result<(), Fault> {
    index.map_or(Ok(()), |index| within(index, len, place, kind))
}

fn check_data(root: &Root) -> Result<(), Fault> {
    let views = root.buffer_views.len();
    for (index, view) in root.buffer_views.iter().enumerate() {
        within(view.buffer, root.buffers.len(), &Place::new("bufferView", index, None), "buffer")?;
    }
    for (index, accessor) in root.accessors.iter().enumerate() {
        let place = Place::new("accessor", index, accessor.name.as_deref());
        maybe(accessor.buffer_view, views, &place, "bufferView")?;
        if let Some(sparse) = &accessor.sparse {
            within(sparse.indices.buffer_view, views, &place.field("sparse.indices"), "bufferView")?;
            within(sparse.values.buffer_view, views, &place.field("sparse.values"), "bufferView")?;
        }
    }
    for (index, image) in root.images.iter().enumerate() {
        maybe(image.buffer_view, views, &Place::new("image", index, image.name.as_deref()), "bufferView")?;
    }
    for (index, texture) in root.textures.iter().enumerate() {
        let place = Place::new("texture", index, texture.name.as_deref());
        maybe(texture.sampler, root.samplers.len(), &place, "sampler")?;
        maybe(source_of(texture), root.images.len(), &place, "image")?;
    }
    Ok(())
}

/// The texture's image; the typed view has a special index where there is none.
pub(crate) fn source_of(texture: &gltf::json::Texture) -> Option<Index<gltf::json::Image>> {
    Some(texture.source).filter(|source| source.value() != u32::MAX as usize)
}

fn textures_of(material: &Material) -> impl Iterator<Item = Index<texture::Texture>> {
    let pbr = &material.pbr_metallic_roughness;
    let mut infos =
        vec![&pbr.base_color_texture, &pbr.metallic_roughness_texture, &material.emissive_texture];
    if let Some(extensions) = &material.extensions {
        infos.extend(extensions.transmission.as_ref().map(|it| &it.transmission_texture));
        infos.extend(extensions.volume.as_ref().map(|it| &it.thickness_texture));
        let specular = extensions.specular.as_ref();
        infos.extend(specular.map(|it| &it.specular_texture));
        infos.extend(specular.map(|it| &it.specular_color_texture));
    }
    let mut indices: Vec<_> = infos.into_iter().flatten().map(|info| info.index).collect();
    indices.extend(material.normal_texture.as_ref().map(|it| it.index));
    indices.extend(material.occlusion_texture.as_ref().map(|it| it.index));
    indices.into_iter()
}

fn check_meshes(root: &Root) -> Result<(), Fault> {
    let accessors = root.accessors.len();
    for (index, mesh) in root.meshes.iter().enumerate() {
        let mesh_place = Place::new("mesh", index, mesh.name.as_deref());
        for (index, primitive) in mesh.primitives.iter().enumerate() {
            let place = mesh_place.then("primitive", index, None);
            maybe(primitive.indices, accessors, &place, "accessor")?;
            maybe(primitive.material, root.materials.len(), &place, "material")?;
            for &attribute in primitive.attributes.values() {
                within(attribute, accessors, &place, "accessor")?;
            }
            for target in primitive.targets.iter().flatten() {
                for attribute in [target.positions, target.normals, target.tangents] {
                    maybe(attribute, accessors, &place.field("targets"), "accessor")?;
                }
            }
        }
    }
    Ok(())
}

fn check_nodes(root: &Root) -> Result<(), Fault> {
    let nodes = root.nodes.len();
    let lights: &[gltf::json::extensions::scene::khr_lights_punctual::Light] = root.as_ref();
    maybe(root.scene, root.scenes.len(), &Place::only("scene"), "scene")?;
    for (index, scene) in root.scenes.iter().enumerate() {
        let place = Place::new("scene", index, scene.name.as_deref());
        scene.nodes.iter().try_for_each(|&node| within(node, nodes, &place, "node"))?;
    }
    for (index, node) in root.nodes.iter().enumerate() {
        let place = Place::new("node", index, node.name.as_deref());
        maybe(node.camera, root.cameras.len(), &place, "camera")?;
        maybe(node.mesh, root.meshes.len(), &place, "mesh")?;
        maybe(node.skin, root.skins.len(), &place, "skin")?;
        node.children.iter().flatten().try_for_each(|&child| within(child, nodes, &place, "node"))?;
        if let Some(light) = light_of(node) {
            let len = lights.len();
            place.ensure(light < len, || format!("refers to light {light}, but there are only {len}"))?;
        }
    }
    for (index, skin) in root.skins.iter().enumerate() {
        let place = Place::new("skin", index, skin.name.as_deref());
        skin.joints.iter().try_for_each(|&joint| within(joint, nodes, &place, "node"))?;
        maybe(skin.skeleton, nodes, &place, "node")?;
        maybe(skin.inverse_bind_matrices, root.accessors.len(), &place, "accessor")?;
    }
    Ok(())
}

/// Each node's parent.
pub(crate) fn parents(root: &Root) -> Vec<Option<usize>> {
    let mut parents = vec![None; root.nodes.len()];
    for (index, node) in root.nodes.iter().enumerate() {
        for child in node.children.iter().flatten() {
            parents[child.value()] = Some(index);
        }
    }
    parents
}

/// No node has two parents, and none is its own ancestor.
fn check_trees(root: &Root) -> Result<(), Fault> {
    let mut children = vec![false; root.nodes.len()];
    for (index, node) in root.nodes.iter().enumerate() {
        for child in node.children.iter().flatten().map(Index::value) {
            let place = Place::new("node", index, node.name.as_deref());
            place.ensure(!children[child], || {
                format!("has child {child}, which is already a child of a node")
            })?;
            children[child] = true;
        }
    }
    // With one parent each, whatever cannot be reached from above is on a cycle or below one.
    let mut reached: Vec<bool> = children.iter().map(|is_child| !is_child).collect();
    let mut open: Vec<usize> = (0..root.nodes.len()).filter(|&node| reached[node]).collect();
    while let Some(node) = open.pop() {
        for child in root.nodes[node].children.iter().flatten().map(Index::value) {
            reached[child] = true;
            open.push(child);
        }
    }
    if let Some(node) = reached.iter().position(|&reached| !reached) {
        let place = Place::new("node", node, root.nodes[node].name.as_deref());
        return Err(place.fault("is on or below a cycle: following parents leads back to a child"));
    }
    Ok(())
}

fn check_motion(root: &Root) -> Result<(), Fault> {
    let accessors = root.accessors.len();
    for (index, animation) in root.animations.iter().enumerate() {
        let animation_place = Place::new("animation", index, animation.name.as_deref());
        for (index, sampler) in animation.samplers.iter().enumerate() {
            let place = animation_place.then("sampler", index, None);
            within(sampler.input, accessors, &place, "accessor")?;
            within(sampler.output, accessors, &place, "accessor")?;
        }
        for (index, channel) in animation.channels.iter().enumerate() {
            let place = animation_place.then("channel", index, None);
            within(channel.sampler, animation.samplers.len(), &place, "sampler")?;
            within(channel.target.node, root.nodes.len(), &place, "node")?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault_of(rest: &str) -> String {
        let json = format!(r#"{{"asset": {{"version": "2.0"}}, {rest}}}"#);
        let root = Root::from_str(&json).expect(rest);
        check(&root)
            .err()
            .map(|fault| format!("{}: {}", fault.place.unwrap_or_default(), fault.what))
            .unwrap_or_default()
    }

    #[test]
    fn every_kind_of_index_is_checked() {
        let view = r#""buffers": [{"byteLength": 4}], "bufferViews": [{"buffer": 0, "byteLength": 4}]"#;
        for (rest, expected) in [
            (r#""scene": 0"#.to_owned(), "scene: refers to scene 0"),
            (r#""scenes": [{"nodes": [0]}]"#.to_owned(), "scene 0: refers to node 0"),
            (r#""nodes": [{"camera": 0}]"#.to_owned(), "node 0: refers to camera 0"),
            (r#""nodes": [{"name": "x", "mesh": 3}]"#.to_owned(), "node 0 \"x\": refers to mesh 3, but there are only 0"),
            (r#""nodes": [{"skin": 0}]"#.to_owned(), "skin 0"),
            (r#""nodes": [{"children": [1]}]"#.to_owned(), "node 1"),
            (r#""nodes": [{"extensions": {"KHR_lights_punctual": {"light": 0}}}]"#.to_owned(), "light 0"),
            (r#""skins": [{"joints": [0]}]"#.to_owned(), "skin 0: refers to node 0"),
            (r#""bufferViews": [{"buffer": 0, "byteLength": 4}]"#.to_owned(), "bufferView 0: refers to buffer 0"),
            (r#""images": [{"bufferView": 0}]"#.to_owned(), "image 0"),
            (r#""textures": [{"source": 0}]"#.to_owned(), "texture 0: refers to image 0"),
            (r#""textures": [{"sampler": 0}]"#.to_owned(), "texture 0: refers to sampler 0"),
            (r#""materials": [{"normalTexture": {"index": 0}}]"#.to_owned(), "material 0: refers to texture 0"),
            (r#""meshes": [{"primitives": [{"attributes": {}, "indices": 0}]}]"#.to_owned(), "mesh 0 / primitive 0"),
            (r#""meshes": [{"primitives": [{"attributes": {"POSITION": 9}}]}]"#.to_owned(), "accessor 9"),
            (r#""meshes": [{"primitives": [{"attributes": {}, "targets": [{"NORMAL": 0}]}]}]"#.to_owned(), "targets"),
            (
                format!(r#"{view}, "accessors": [{{"bufferView": 1, "componentType": 5126, "type": "SCALAR", "count": 1}}]"#),
                "accessor 0: refers to bufferView 1",
            ),
            (
                r#""animations": [{"samplers": [], "channels": [{"sampler": 0, "target": {"node": 0, "path": "scale"}}]}]"#
                    .to_owned(),
                "channel 0: refers to sampler 0",
            ),
        ] {
            let fault = fault_of(&rest);
            assert!(fault.contains(expected), "{rest}: {fault}");
        }
        assert_eq!(fault_of(r#""nodes": [{"children": [1]}, {}], "scenes": [{"nodes": [0]}]"#), "");
    }

    #[test]
    fn nodes_that_form_no_tree_are_refused() {
        assert!(fault_of(r#""nodes": [{"children": [0]}]"#).contains("cycle"));
        assert!(
            fault_of(r#""nodes": [{"children": [1]}, {"children": [2]}, {"children": [0]}]"#)
                .contains("cycle")
        );
        assert!(
            fault_of(r#""nodes": [{"children": [2]}, {"children": [2]}, {}]"#).contains("already a child")
        );
    }
}
