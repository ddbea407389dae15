//! Images and how surfaces look them up.

use glam::{Mat2, Vec2};
use serde::{Deserialize, Serialize};

/// Decoded pixels, rows from the top.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Image {
    /// For messages.
    pub name: String,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Interleaved channels.
    pub pixels: Pixels,
}

/// Interleaved channels of an image; `channels` is 1 (grey), 2 (grey, alpha), 3 (RGB) or 4 (RGBA).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Pixels {
    /// 0..=255 stands for 0..=1.
    Unorm8 {
        /// Channels per pixel.
        channels: u8,
        /// `width * height * channels` values.
        data: Vec<u8>,
    },
    /// 0..=65535 stands for 0..=1.
    Unorm16 {
        /// Channels per pixel.
        channels: u8,
        /// `width * height * channels` values.
        data: Vec<u16>,
    },
    /// Linear values as they are, three channels.
    Float(Vec<[f32; 3]>),
}

/// What a coordinate outside [0, 1) means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Wrap {
    /// Start again.
    #[default]
    Repeat,
    /// Run backwards every other time.
    MirroredRepeat,
    /// Stay at the edge.
    ClampToEdge,
}

/// How values between pixel centres are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum MagFilter {
    /// Bilinear.
    #[default]
    Linear,
    /// The nearest pixel.
    Nearest,
}

/// An image with the way it is looked up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Texture {
    /// Index into `Scene::images`.
    pub image: u32,
    /// Across.
    pub wrap_u: Wrap,
    /// Down.
    pub wrap_v: Wrap,
    /// Between pixels.
    pub filter: MagFilter,
    /// Colour channels are sRGB-encoded (alpha never is).
    pub srgb: bool,
}

/// A texture as a material uses it. `uv' = matrix * uv + offset`; v runs downwards, as in glTF.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TextureRef {
    /// Index into `Scene::textures`.
    pub texture: u32,
    /// Which of the mesh's texture coordinate sets; a mesh without it looks up (0, 0).
    pub uv_set: u32,
    /// Scale and rotation.
    pub matrix: Mat2,
    /// Shift.
    pub offset: Vec2,
}
