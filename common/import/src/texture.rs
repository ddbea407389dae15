//! Images and the ways they are looked up: each image is decoded once, and only when a material uses it.

use crate::accessor::Accessors;
use crate::error::{Fault, Place};
use crate::references::source_of;
use crate::report::Warnings;
use crate::source::Source;
use farm_scene::{Image, MagFilter, Pixels, Texture, TextureRef, Wrap};
use glam::{Mat2, Vec2};
use gltf::json::extensions::texture::TextureTransform;
use gltf::json::texture::{Info, MagFilter as FileFilter, MinFilter, Sampler, WrappingMode};
use gltf::json::validation::Checked;
use gltf::json::{Index, Root};
use image::{DynamicImage, ImageDecoder, ImageReader, Limits};
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;

/// No image is wider or higher.
const IMAGE_SIDE_MAX: u32 = 1 << 15;

/// Bytes that decoding an image may take: a square of 2^14 pixels, 8 bits each of RGBA.
const IMAGE_BYTES_MAX: u64 = 1 << 30;

/// Bytes that all images of a scene may take together, however small their files.
const IMAGES_BYTES_FREE: u64 = 4 << 30;

/// Bytes beyond that, per byte of their files: photographs are compressed to a tenth, flat colour to a thousandth.
const DECODED_PER_BYTE: u64 = 64;

/// The textures that materials have asked for so far.
pub(crate) struct Textures<'a> {
    pub root: &'a Root,
    pub accessors: &'a Accessors<'a>,
    pub source: &'a Source,
    pub warnings: &'a Warnings,
    textures: Vec<Texture>,
    images: Vec<Encoded<'a>>,
    numbers: BTreeMap<(u32, [u8; 3], bool), u32>,
    image_numbers: BTreeMap<Origin<'a>, u32>,
}

/// Where an image's bytes are.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Origin<'a> {
    Uri(&'a str),
    View(usize),
}

/// An image that is still to be decoded.
struct Encoded<'a> {
    name: String,
    place: String,
    bytes: Cow<'a, [u8]>,
}

/// A texture as a material's property names it.
pub(crate) struct Use<'a> {
    index: Index<gltf::json::Texture>,
    uv_set: u32,
    transform: Option<&'a TextureTransform>,
}

impl<'a> From<&'a Info> for Use<'a> {
    fn from(info: &'a Info) -> Self {
        let transform = info.extensions.as_ref().and_then(|it| it.texture_transform.as_ref());
        Self { index: info.index, uv_set: info.tex_coord, transform }
    }
}

impl<'a> Use<'a> {
    /// A use whose transform was found elsewhere.
    pub fn new(
        index: Index<gltf::json::Texture>,
        uv_set: u32,
        transform: Option<&'a TextureTransform>,
    ) -> Self {
        Self { index, uv_set, transform }
    }
}

impl<'a> Textures<'a> {
    /// No textures yet.
    pub fn new(
        root: &'a Root,
        accessors: &'a Accessors<'a>,
        source: &'a Source,
        warnings: &'a Warnings,
    ) -> Self {
        let (textures, images) = (vec![], vec![]);
        let (numbers, image_numbers) = (BTreeMap::new(), BTreeMap::new());
        Self { root, accessors, source, warnings, textures, images, numbers, image_numbers }
    }

    /// The texture that `used` names, with colours that are sRGB or linear; none when it has no image.
    pub fn look_up(&mut self, used: &Use, srgb: bool, place: &Place) -> Result<Option<TextureRef>, Fault> {
        let texture = &self.root.textures[used.index.value()];
        let place = place.then("texture", used.index.value(), texture.name.as_deref());
        let Some(source) = source_of(texture) else {
            self.warnings.add(&place, "has no PNG or JPEG image; the factor alone counts");
            return Ok(None);
        };
        let image = self.image(source.value(), &place)?;
        let sampler = texture.sampler.map(|sampler| &self.root.samplers[sampler.value()]);
        let (wrap_u, wrap_v, filter) =
            sampler.map(|sampler| lookup_of(sampler, &place)).transpose()?.unwrap_or_default();
        let key = (image, [wrap_u as u8, wrap_v as u8, filter as u8], srgb);
        let number = *self.numbers.entry(key).or_insert_with(|| {
            self.textures.push(Texture { image, wrap_u, wrap_v, filter, srgb });
            (self.textures.len() - 1) as u32
        });
        let (matrix, offset, uv_set) = transform_of(used, &place)?;
        Ok(Some(TextureRef { texture: number, uv_set, matrix, offset }))
    }

    /// Decodes the images, several at a time: that is most of what importing takes.
    pub fn decode(self) -> Result<(Vec<Texture>, Vec<Image>), Fault> {
        let sizes = self.images.iter().map(|encoded| {
            let size = decoded_bytes(&encoded.bytes);
            let size = size.map_err(|what| Fault::at(encoded.place.clone(), what))?;
            Ok((size, encoded.bytes.len() as u64))
        });
        let sizes: Vec<(u64, u64)> = sizes.collect::<Result<_, Fault>>()?;
        let (decoded, encoded) = sizes.iter().fold((0, 0), |sum, size| (sum.0 + size.0, sum.1 + size.1));
        if decoded > IMAGES_BYTES_FREE + DECODED_PER_BYTE * encoded {
            let what = format!("take {decoded} bytes from {encoded} in their files; make them smaller");
            return Err(Fault::at("images", what));
        }
        let decode = |encoded: Encoded| {
            let Encoded { name, place, bytes } = encoded;
            let decoded = decode(&bytes).map_err(|what| Fault::at(place, what))?;
            let (width, height) = (decoded.width(), decoded.height());
            Ok(Image { name, width, height, pixels: pixels_of(decoded) })
        };
        let images: Vec<Result<Image, Fault>> = self.images.into_par_iter().map(decode).collect();
        Ok((self.textures, images.into_iter().collect::<Result<_, _>>()?))
    }

    fn image(&mut self, index: usize, place: &Place) -> Result<u32, Fault> {
        let root = self.root;
        let image = &root.images[index];
        let place = place.then("image", index, image.name.as_deref());
        let origin = match (&image.uri, image.buffer_view) {
            (_, Some(view)) => Origin::View(view.value()),
            (Some(uri), None) => Origin::Uri(uri),
            (None, None) => {
                return Err(place.fault("has neither a URI nor a buffer view; add the image's data"));
            }
        };
        if let Some(&number) = self.image_numbers.get(&origin) {
            return Ok(number);
        }
        let bytes = match origin {
            Origin::Uri(uri) => Cow::Owned(self.source.fetch(uri, IMAGE_BYTES_MAX, &place)?),
            Origin::View(view) => Cow::Borrowed(self.accessors.view(Index::new(view as u32), &place)?),
        };
        let uri = image.uri.as_deref().filter(|uri| !uri.starts_with("data:"));
        let name = image.name.as_deref().or(uri).unwrap_or_default().to_owned();
        let number = self.images.len() as u32;
        self.images.push(Encoded { name, place: place.to_string(), bytes });
        self.image_numbers.insert(origin, number);
        Ok(number)
    }
}

/// What an image takes once it is decoded, as its header says.
fn decoded_bytes(bytes: &[u8]) -> Result<u64, String> {
    let decoder = reader(bytes)?.into_decoder();
    decoder.map(|decoder| decoder.total_bytes()).map_err(|err| format!("cannot be decoded: {err}"))
}

/// Decodes a PNG or JPEG.
fn decode(bytes: &[u8]) -> Result<DynamicImage, String> {
    let image = reader(bytes)?.decode().map_err(|err| format!("cannot be decoded: {err}"))?;
    if image.width() == 0 || image.height() == 0 {
        return Err("has no pixels".to_owned());
    }
    Ok(image)
}

/// A reader of a PNG or JPEG; its first bytes, not its name or type, tell which.
fn reader(bytes: &[u8]) -> Result<ImageReader<Cursor<&[u8]>>, String> {
    if bytes.starts_with(b"\xabKTX 20\xbb") {
        let what = "is a KTX2 image (KHR_texture_basisu), which cannot be read; convert it to PNG or JPEG";
        return Err(what.to_owned());
    }
    let mut limits = Limits::default();
    limits.max_image_width = Some(IMAGE_SIDE_MAX);
    limits.max_image_height = Some(IMAGE_SIDE_MAX);
    limits.max_alloc = Some(IMAGE_BYTES_MAX);
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format();
    let mut reader = reader.map_err(|err| format!("cannot be read: {err}"))?;
    if !matches!(reader.format(), Some(image::ImageFormat::Png | image::ImageFormat::Jpeg)) {
        return Err("is neither PNG nor JPEG; convert it to one of them".to_owned());
    }
    reader.limits(limits);
    Ok(reader)
}

fn pixels_of(image: DynamicImage) -> Pixels {
    match image {
        DynamicImage::ImageLuma8(image) => Pixels::Unorm8 { channels: 1, data: image.into_raw() },
        DynamicImage::ImageLumaA8(image) => Pixels::Unorm8 { channels: 2, data: image.into_raw() },
        DynamicImage::ImageRgb8(image) => Pixels::Unorm8 { channels: 3, data: image.into_raw() },
        DynamicImage::ImageLuma16(image) => Pixels::Unorm16 { channels: 1, data: image.into_raw() },
        DynamicImage::ImageLumaA16(image) => Pixels::Unorm16 { channels: 2, data: image.into_raw() },
        DynamicImage::ImageRgb16(image) => Pixels::Unorm16 { channels: 3, data: image.into_raw() },
        DynamicImage::ImageRgba16(image) => Pixels::Unorm16 { channels: 4, data: image.into_raw() },
        other => Pixels::Unorm8 { channels: 4, data: other.into_rgba8().into_raw() },
    }
}

fn lookup_of(sampler: &Sampler, place: &Place) -> Result<(Wrap, Wrap, MagFilter), Fault> {
    let wrap = |mode: Checked<WrappingMode>| match mode {
        Checked::Valid(WrappingMode::Repeat) => Ok(Wrap::Repeat),
        Checked::Valid(WrappingMode::MirroredRepeat) => Ok(Wrap::MirroredRepeat),
        Checked::Valid(WrappingMode::ClampToEdge) => Ok(Wrap::ClampToEdge),
        Checked::Invalid => Err(place.fault("has a sampler with a wrap mode that glTF 2.0 does not know")),
    };
    let nearest_min = matches!(
        sampler.min_filter,
        Some(Checked::Valid(
            MinFilter::Nearest | MinFilter::NearestMipmapNearest | MinFilter::NearestMipmapLinear
        ))
    );
    let filter = match sampler.mag_filter {
        Some(Checked::Valid(FileFilter::Nearest)) => MagFilter::Nearest,
        None if nearest_min => MagFilter::Nearest,
        _ => MagFilter::Linear,
    };
    Ok((wrap(sampler.wrap_s)?, wrap(sampler.wrap_t)?, filter))
}

/// KHR_texture_transform: scale, then rotation counter-clockwise as seen in the image (whose v runs down), then offset.
fn transform_of(used: &Use, place: &Place) -> Result<(Mat2, Vec2, u32), Fault> {
    let Some(transform) = used.transform else { return Ok((Mat2::IDENTITY, Vec2::ZERO, used.uv_set)) };
    let angle = f64::from(transform.rotation.0);
    let (sin, cos) = (libm::sin(angle) as f32, libm::cos(angle) as f32);
    let [x, y] = transform.scale.0;
    let matrix = Mat2::from_cols(Vec2::new(cos, -sin) * x, Vec2::new(sin, cos) * y);
    let offset = Vec2::from_array(transform.offset.0);
    let finite = matrix.is_finite() && offset.is_finite();
    place.field("KHR_texture_transform").ensure(finite, || "has values that are too large".to_owned())?;
    Ok((matrix, offset, transform.tex_coord.unwrap_or(used.uv_set)))
}
