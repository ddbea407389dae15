//! Materials: factors, the textures that multiply them, and the extensions that refine them.

use crate::error::{Fault, Place};
use crate::fields::Fields;
use crate::texture::{Textures, Use};
use farm_scene::{
    AlphaMode, Dielectric, Emission, Material, Mirror, NormalMap, Specular, Surface, TextureRef, Textured,
    Volume,
};
use glam::{Vec3, Vec4};
use gltf::json::extensions::texture::TextureTransform;
use gltf::json::material::{AlphaMode as FileAlphaMode, NormalTexture};
use gltf::json::texture::Info;
use gltf::json::validation::Checked;
use std::collections::BTreeMap;

/// Materials that primitives have asked for so far.
pub(crate) struct Materials<'a> {
    pub materials: Vec<Material>,
    pub textures: Textures<'a>,
    numbers: BTreeMap<Option<usize>, u32>,
}

impl<'a> Materials<'a> {
    /// No materials yet.
    pub fn new(textures: Textures<'a>) -> Self {
        Self { materials: vec![], textures, numbers: BTreeMap::new() }
    }

    /// The number of the file's material `index`; of glTF's default material if there is none.
    pub fn number(&mut self, index: Option<usize>) -> Result<u32, Fault> {
        if let Some(&number) = self.numbers.get(&index) {
            return Ok(number);
        }
        let material = match index {
            None => {
                read(&gltf::json::Material::default(), &Place::only("default material"), &mut self.textures)?
            }
            Some(index) => {
                let material = &self.textures.root.materials[index];
                read(material, &Place::new("material", index, material.name.as_deref()), &mut self.textures)?
            }
        };
        let number = self.materials.len() as u32;
        self.materials.push(material);
        self.numbers.insert(index, number);
        Ok(number)
    }

    /// Renumbers texture coordinate sets so that only used ones count; gives the file's number of each.
    pub fn compact_uv_sets(&mut self) -> Vec<u32> {
        let mut used: Vec<u32> =
            self.materials.iter().flat_map(Material::texture_refs).map(|texture| texture.uv_set).collect();
        used.sort_unstable();
        used.dedup();
        let renumber = |texture: &mut TextureRef| {
            texture.uv_set = used.binary_search(&texture.uv_set).expect("every set was listed") as u32;
        };
        self.materials.iter_mut().for_each(|material| material.for_each_texture(renumber));
        used
    }
}

/// Changes to every texture of a material.
trait ForEachTexture {
    fn for_each_texture(&mut self, change: impl FnMut(&mut TextureRef));
}

impl ForEachTexture for Material {
    fn for_each_texture(&mut self, change: impl FnMut(&mut TextureRef)) {
        let mut all = vec![&mut self.base_color.texture];
        if let Surface::MetallicRoughness { metallic, roughness, dielectric } = &mut self.surface {
            all.extend([&mut metallic.texture, &mut roughness.texture]);
            all.extend(dielectric.transmission.as_mut().map(|it| &mut it.texture));
            if let Some(specular) = &mut dielectric.specular {
                all.extend([&mut specular.strength.texture, &mut specular.color.texture]);
            }
        }
        all.extend(self.emission.as_mut().map(|it| &mut it.radiance.texture));
        let normal = self.normal_map.as_mut().map(|it| &mut it.texture);
        all.into_iter().flatten().chain(normal).for_each(change);
    }
}

fn read(material: &gltf::json::Material, place: &Place, textures: &mut Textures) -> Result<Material, Fault> {
    let pbr = &material.pbr_metallic_roughness;
    let extensions = material.extensions.as_ref();
    let mut reader = Reader { place, textures };
    let mirror = read_mirror(&Fields::of_extras(&material.extras), place)?;
    let unlit = extensions.is_some_and(|it| it.unlit.is_some());
    let base_color = match mirror {
        Some(_) => Textured::constant(Vec4::ONE),
        None => Textured {
            factor: Vec4::from_array(reader.fractions(pbr.base_color_factor.0, "baseColorFactor")?),
            texture: reader.texture(pbr.base_color_texture.as_ref(), true)?,
        },
    };
    let surface = match mirror {
        Some(mirror) => Surface::Mirror(mirror),
        None if unlit => Surface::Unlit,
        None => reader.metallic_roughness(material)?,
    };
    let lit = matches!(surface, Surface::MetallicRoughness { .. });
    let transmissive =
        matches!(surface, Surface::MetallicRoughness { dielectric, .. } if dielectric.transmission.is_some());
    Ok(Material {
        name: material.name.clone().unwrap_or_default(),
        base_color,
        surface,
        volume: if transmissive { reader.volume(material)? } else { None },
        normal_map: match &material.normal_texture {
            Some(normal) if !unlit => reader.normal_map(normal)?,
            _ => None,
        },
        emission: if lit || mirror.is_some() { reader.emission(material)? } else { None },
        alpha_mode: match material.alpha_mode {
            Checked::Valid(FileAlphaMode::Opaque) => AlphaMode::Opaque,
            Checked::Valid(FileAlphaMode::Blend) => AlphaMode::Blend,
            Checked::Valid(FileAlphaMode::Mask) => AlphaMode::Mask {
                cutoff: reader.finite(material.alpha_cutoff.map_or(0.5, |it| it.0), "alphaCutoff")?,
            },
            Checked::Invalid => return Err(place.fault("has an alphaMode other than OPAQUE, MASK or BLEND")),
        },
        double_sided: material.double_sided,
    })
}

struct Reader<'a, 'b> {
    place: &'a Place<'a>,
    textures: &'a mut Textures<'b>,
}

impl Reader<'_, '_> {
    fn texture(&mut self, info: Option<&Info>, srgb: bool) -> Result<Option<TextureRef>, Fault> {
        info.map_or(Ok(None), |info| self.textures.look_up(&info.into(), srgb, self.place))
    }

    /// Values in [0, 1]; others are moved there, with a warning.
    fn fractions<const N: usize>(&self, values: [f32; N], name: &str) -> Result<[f32; N], Fault> {
        values.iter().try_for_each(|&value| self.finite(value, name).map(|_| ()))?;
        let clamped = values.map(|value| value.clamp(0.0, 1.0));
        if clamped != values {
            self.textures.warnings.add(self.place, format!("{name} is not from 0 to 1; clamped"));
        }
        Ok(clamped)
    }

    fn fraction(&self, value: f32, name: &str) -> Result<f32, Fault> {
        self.fractions([value], name).map(|[value]| value)
    }

    fn finite(&self, value: f32, name: &str) -> Result<f32, Fault> {
        self.place.field(name).ensure(value.is_finite(), || "is too large".to_owned())?;
        Ok(value)
    }

    fn not_negative(&self, value: f32, name: &str) -> Result<f32, Fault> {
        let fits = value.is_finite() && value >= 0.0;
        self.place
            .field(name)
            .ensure(fits, || format!("is {value}, but must be a number not less than 0"))?;
        Ok(value)
    }

    fn metallic_roughness(&mut self, material: &gltf::json::Material) -> Result<Surface, Fault> {
        let pbr = &material.pbr_metallic_roughness;
        let texture = self.texture(pbr.metallic_roughness_texture.as_ref(), false)?;
        let metallic = self.fraction(pbr.metallic_factor.0, "metallicFactor")?;
        let roughness = self.fraction(pbr.roughness_factor.0, "roughnessFactor")?;
        Ok(Surface::MetallicRoughness {
            metallic: Textured { factor: metallic, texture },
            roughness: Textured { factor: roughness, texture },
            dielectric: self.dielectric(material)?,
        })
    }

    fn dielectric(&mut self, material: &gltf::json::Material) -> Result<Dielectric, Fault> {
        let extensions = material.extensions.as_ref();
        let ior = extensions.and_then(|it| it.ior.as_ref()).map_or(1.5, |it| it.ior.0);
        let known = ior == 0.0 || (ior >= 1.0 && ior.is_finite());
        self.place
            .field("KHR_materials_ior")
            .ensure(known, || format!("ior is {ior}, but must be 0 or at least 1"))?;
        let mut specular = None;
        if let Some(it) = extensions.and_then(|it| it.specular.as_ref()) {
            let [r, g, b] = it.specular_color_factor.0;
            for value in [r, g, b] {
                self.not_negative(value, "KHR_materials_specular.specularColorFactor")?;
            }
            let read = Specular {
                strength: Textured {
                    factor: self.fraction(it.specular_factor.0, "KHR_materials_specular.specularFactor")?,
                    texture: self.texture(it.specular_texture.as_ref(), false)?,
                },
                color: Textured {
                    factor: Vec3::new(r, g, b),
                    texture: self.texture(it.specular_color_texture.as_ref(), true)?,
                },
            };
            let plain = Specular { strength: Textured::constant(1.0), color: Textured::constant(Vec3::ONE) };
            specular = (read != plain).then_some(read);
        }
        let mut transmission = None;
        if let Some(it) =
            extensions.and_then(|it| it.transmission.as_ref()).filter(|it| it.transmission_factor.0 != 0.0)
        {
            transmission = Some(Textured {
                factor: self
                    .fraction(it.transmission_factor.0, "KHR_materials_transmission.transmissionFactor")?,
                texture: self.texture(it.transmission_texture.as_ref(), false)?,
            });
        }
        Ok(Dielectric { ior, specular, transmission })
    }

    /// The inside; a thickness of 0 means a thin wall, any other that the mesh itself is the boundary.
    fn volume(&self, material: &gltf::json::Material) -> Result<Option<Volume>, Fault> {
        let Some(it) = material.extensions.as_ref().and_then(|it| it.volume.as_ref()) else {
            return Ok(None);
        };
        if self.not_negative(it.thickness_factor.0, "KHR_materials_volume.thicknessFactor")? == 0.0 {
            return Ok(None);
        }
        let distance = it.attenuation_distance.0;
        self.place
            .field("KHR_materials_volume.attenuationDistance")
            .ensure(distance > 0.0, || format!("is {distance}, but must be greater than 0"))?;
        let color = self.fractions(it.attenuation_color.0, "KHR_materials_volume.attenuationColor")?;
        Ok(Some(Volume { attenuation_distance: distance, attenuation_color: Vec3::from_array(color) }))
    }

    fn normal_map(&mut self, normal: &NormalTexture) -> Result<Option<NormalMap>, Fault> {
        let transform = normal.extensions.as_ref().and_then(|it| it.others.get("KHR_texture_transform"));
        let transform: Option<TextureTransform> = transform
            .map(|value| serde_json::from_value(value.clone()))
            .transpose()
            .map_err(|err| self.place.field("normalTexture.KHR_texture_transform").fault(err.to_string()))?;
        let used = Use::new(normal.index, normal.tex_coord, transform.as_ref());
        let texture = self.textures.look_up(&used, false, self.place)?;
        let scale = self.finite(normal.scale, "normalTexture.scale")?;
        Ok(texture.map(|texture| NormalMap { texture, scale }))
    }

    fn emission(&mut self, material: &gltf::json::Material) -> Result<Option<Emission>, Fault> {
        let strength = material.extensions.as_ref().and_then(|it| it.emissive_strength.as_ref());
        let strength = strength.map_or(1.0, |it| it.emissive_strength.0);
        self.not_negative(strength, "KHR_materials_emissive_strength.emissiveStrength")?;
        for factor in material.emissive_factor.0 {
            self.not_negative(factor, "emissiveFactor")?;
        }
        let factor = Vec3::from_array(material.emissive_factor.0) * strength;
        self.place.field("emissiveFactor").ensure(factor.is_finite(), || "is too large".to_owned())?;
        if factor == Vec3::ZERO {
            return Ok(None);
        }
        let texture = self.texture(material.emissive_texture.as_ref(), true)?;
        Ok(Some(Emission { radiance: Textured { factor, texture } }))
    }
}

/// `extras.mirror {reflectance, roughness, centered}`.
fn read_mirror(extras: &Fields, place: &Place) -> Result<Option<Mirror>, Fault> {
    let Some(mirror) = extras.object("mirror", place)? else { return Ok(None) };
    let place = place.field("extras.mirror");
    let [r, g, b] = mirror.numbers("reflectance", &place)?.unwrap_or([1.0; 3]);
    let fits = [r, g, b].iter().all(|value| (0.0..=1.0).contains(value));
    place.field("reflectance").ensure(fits, || "must have values from 0 to 1".to_owned())?;
    Ok(Some(Mirror {
        reflectance: Vec3::new(r, g, b),
        roughness: mirror.not_negative("roughness", &place)?.unwrap_or(0.0),
        centered: mirror.boolean("centered", &place)?.unwrap_or(true),
    }))
}
