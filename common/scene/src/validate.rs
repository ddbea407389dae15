//! The one place where a scene's parts are checked against each other.

use crate::{Material, Mesh, Path, Pixels, Projection, Scene, Surface, TextureRef};

/// A scene whose parts do not fit together.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {fault}")]
pub struct SceneError {
    /// Which part, such as `mesh 3 "wheel"`.
    pub place: String,
    /// What is wrong with it.
    pub fault: String,
}

fn fault(place: impl Into<String>, fault: impl Into<String>) -> SceneError {
    SceneError { place: place.into(), fault: fault.into() }
}

fn ensure(holds: bool, place: impl FnOnce() -> String, what: &str) -> Result<(), SceneError> {
    if holds { Ok(()) } else { Err(fault(place(), what)) }
}

impl Scene {
    /// Checks every index, length and range that the types cannot express. Vertex values may be anything.
    pub fn validate(&self) -> Result<(), SceneError> {
        self.validate_nodes()?;
        for (index, mesh) in self.meshes.iter().enumerate() {
            validate_mesh(mesh, || format!("mesh {index} {:?}", mesh.name))?;
        }
        for (index, material) in self.materials.iter().enumerate() {
            for texture in material.texture_refs() {
                let known = (texture.texture as usize) < self.textures.len();
                ensure(
                    known,
                    || format!("material {index} {:?}", material.name),
                    "uses a texture that is not there",
                )?;
            }
        }
        for (index, texture) in self.textures.iter().enumerate() {
            let known = (texture.image as usize) < self.images.len();
            ensure(known, || format!("texture {index}"), "uses an image that is not there")?;
        }
        for (index, image) in self.images.iter().enumerate() {
            validate_image(image, || format!("image {index} {:?}", image.name))?;
        }
        self.validate_views()?;
        self.validate_motion()
    }

    fn validate_nodes(&self) -> Result<(), SceneError> {
        // Looked up once per mesh: a mesh of many vertices may have many instances.
        let joints_needed: Vec<usize> = self.meshes.iter().map(joints_needed).collect();
        for (index, node) in self.nodes.iter().enumerate() {
            let place = || format!("node {index} {:?}", node.name);
            ensure(
                node.parent.is_none_or(|parent| (parent as usize) < index),
                place,
                "comes before its parent",
            )?;
            ensure(
                node.skin.is_none_or(|skin| (skin as usize) < self.skins.len()),
                place,
                "uses a skin that is not there",
            )?;
            for instance in &node.instances {
                ensure(
                    (instance.material as usize) < self.materials.len(),
                    place,
                    "uses a material that is not there",
                )?;
                let Some(mesh) = self.meshes.get(instance.mesh as usize) else {
                    return Err(fault(place(), "uses a mesh that is not there"));
                };
                let weights = node.morph_weights.len();
                ensure(
                    weights == 0 || weights == mesh.morph_targets.len(),
                    place,
                    "has another number of morph weights than its mesh has targets",
                )?;
                if let Some(skin) = node.skin {
                    let known =
                        joints_needed[instance.mesh as usize] <= self.skins[skin as usize].joints.len();
                    ensure(known, place, "has a mesh that refers to joints that its skin does not have")?;
                }
            }
        }
        for (index, skin) in self.skins.iter().enumerate() {
            let place = || format!("skin {index}");
            ensure(skin.joints.len() == skin.inverse_bind.len(), place, "has not one matrix per joint")?;
            let known = skin.joints.iter().all(|&joint| (joint as usize) < self.nodes.len());
            ensure(known, place, "refers to a node that is not there")?;
        }
        Ok(())
    }

    fn validate_views(&self) -> Result<(), SceneError> {
        for (index, camera) in self.cameras.iter().enumerate() {
            let place = || format!("camera {index} {:?}", camera.name);
            ensure((camera.node as usize) < self.nodes.len(), place, "is at a node that is not there")?;
            let projection = match camera.projection {
                Projection::Perspective { yfov } => yfov > 0.0 && yfov < std::f32::consts::PI,
                Projection::Orthographic { ymag } => ymag > 0.0 && ymag.is_finite(),
            };
            ensure(projection, place, "has a field of view that is zero, negative or too wide")?;
            if let Some(lens) = camera.lens {
                ensure(
                    lens.aperture_radius > 0.0 && lens.aperture_radius.is_finite(),
                    place,
                    "has an aperture radius that is not a positive number",
                )?;
                ensure(lens.focus_distance > 0.0, place, "has a focus distance that is not positive")?;
                ensure(!matches!(lens.blades, 1 | 2), place, "has an aperture of one or two blades")?;
                ensure(lens.rotation.is_finite(), place, "has an aperture rotation that is not finite")?;
                ensure(
                    lens.anamorphic_ratio > 0.0 && lens.anamorphic_ratio.is_finite(),
                    place,
                    "has an anamorphic ratio that is not a positive number",
                )?;
            }
            let shutter = camera.shutter;
            ensure(
                shutter.open.is_finite() && shutter.close.is_finite() && shutter.open <= shutter.close,
                place,
                "has a shutter that closes before it opens",
            )?;
        }
        for (index, light) in self.lights.iter().enumerate() {
            let known = (light.node as usize) < self.nodes.len();
            ensure(known, || format!("light {index} {:?}", light.name), "is at a node that is not there")?;
        }
        if let Some(environment) = &self.environment {
            let place = || "environment".to_owned();
            validate_image(&environment.image, place)?;
            ensure(
                matches!(environment.image.pixels, Pixels::Float(_)),
                place,
                "is no image of float values",
            )?;
            ensure(
                environment.intensity >= 0.0 && environment.intensity.is_finite(),
                place,
                "has an intensity that is negative or not finite",
            )?;
        }
        Ok(())
    }

    fn validate_motion(&self) -> Result<(), SceneError> {
        for (index, channel) in self.channels.iter().enumerate() {
            let place = || format!("animation channel {index}");
            ensure((channel.node as usize) < self.nodes.len(), place, "moves a node that is not there")?;
            ensure(!channel.times.is_empty(), place, "has no keys")?;
            let increasing = channel.times.windows(2).all(|pair| pair[0] < pair[1]);
            ensure(
                increasing && channel.times.iter().all(|time| time.is_finite()),
                place,
                "has key times that do not increase",
            )?;
            let (values, per_value) = match &channel.path {
                Path::Translation(values) | Path::Scale(values) => (values.len(), 1),
                Path::Rotation(values) => (values.len(), 1),
                Path::MorphWeights { targets, values } => (values.len(), *targets as usize),
            };
            let per_key = if channel.interpolation == crate::Interpolation::CubicSpline { 3 } else { 1 };
            let expected =
                channel.times.len().checked_mul(per_key).and_then(|keys| keys.checked_mul(per_value));
            ensure(Some(values) == expected, place, "has not one value per key")?;
        }
        Ok(())
    }
}

impl Material {
    /// Every texture the material looks up.
    pub fn texture_refs(&self) -> impl Iterator<Item = TextureRef> {
        let mut refs = vec![self.base_color.texture, self.normal_map.map(|map| map.texture)];
        refs.push(self.emission.and_then(|emission| emission.radiance.texture));
        if let Surface::MetallicRoughness { metallic, roughness, dielectric } = self.surface {
            refs.extend([metallic.texture, roughness.texture]);
            refs.push(dielectric.transmission.and_then(|transmission| transmission.texture));
            if let Some(specular) = dielectric.specular {
                refs.extend([specular.strength.texture, specular.color.texture]);
            }
        }
        refs.into_iter().flatten()
    }
}

/// Joints that a skin must have to deform the mesh.
fn joints_needed(mesh: &Mesh) -> usize {
    let joints = mesh.skinning.iter().flat_map(|skinning| &skinning.joints);
    joints.max().map_or(0, |&last| usize::from(last) + 1)
}

fn validate_mesh(mesh: &Mesh, place: impl Fn() -> String) -> Result<(), SceneError> {
    let vertices = mesh.positions.len();
    let inside = mesh.triangles.iter().flatten().all(|&vertex| (vertex as usize) < vertices);
    ensure(inside, &place, "has triangles that refer to vertices that are not there")?;
    ensure(u32::try_from(mesh.triangles.len()).is_ok(), &place, "has more than 2^32 triangles")?;
    let attribute = |len: Option<usize>, name: &str| {
        ensure(
            len.is_none_or(|len| len == vertices),
            &place,
            &format!("has {} {name} for {vertices} positions", len.unwrap_or(0)),
        )
    };
    attribute(mesh.normals.as_ref().map(Vec::len), "normals")?;
    attribute(mesh.tangents.as_ref().map(Vec::len), "tangents")?;
    attribute(mesh.colors.as_ref().map(Vec::len), "colours")?;
    for uvs in &mesh.uvs {
        attribute(Some(uvs.len()), "texture coordinates")?;
    }
    if let Some(skinning) = &mesh.skinning {
        let expected = vertices.checked_mul(skinning.influences as usize);
        let fits = Some(skinning.joints.len()) == expected && Some(skinning.weights.len()) == expected;
        ensure(fits, &place, "has joint influences for another number of vertices")?;
    }
    for target in &mesh.morph_targets {
        attribute(target.positions.as_ref().map(Vec::len), "morph positions")?;
        attribute(target.normals.as_ref().map(Vec::len), "morph normals")?;
        attribute(target.tangents.as_ref().map(Vec::len), "morph tangents")?;
    }
    Ok(())
}

fn validate_image(image: &crate::Image, place: impl Fn() -> String) -> Result<(), SceneError> {
    let pixels = (image.width as usize).checked_mul(image.height as usize).filter(|&pixels| pixels > 0);
    let (values, channels) = match &image.pixels {
        Pixels::Unorm8 { channels, data } => (data.len(), usize::from(*channels)),
        Pixels::Unorm16 { channels, data } => (data.len(), usize::from(*channels)),
        Pixels::Float(data) => (data.len(), 1),
    };
    let fits =
        (1..=4).contains(&channels) && pixels.and_then(|pixels| pixels.checked_mul(channels)) == Some(values);
    ensure(fits, place, "does not hold as many values as its size asks for")
}
