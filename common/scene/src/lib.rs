//! What is rendered, as plain data: no files, no acceleration structures, no decisions about how.
//!
//! Lengths are metres, angles radians, times seconds, radiance W/sr/m^2 in linear Rec. 709. Indices between the lists of a
//! [`Scene`] are checked once, by [`Scene::validate`]; past that line they are trusted.

mod animation;
mod camera;
mod light;
mod material;
mod mesh;
mod node;
mod scene;
mod settings;
mod snapshot;
mod texture;
mod validate;

pub use animation::{Channel, Interpolation, Keyframes, Path};
pub use camera::{Camera, Lens, Projection, Shutter};
pub use light::{Environment, Light, LightKind};
pub use material::{
    AlphaMode, Dielectric, Emission, Material, Mirror, NormalMap, Specular, Surface, Textured, Volume,
};
pub use mesh::{Mesh, MorphTarget, Skinning};
pub use node::{Instance, Node, Skin, Transform};
pub use scene::Scene;
pub use settings::{Filter, Integrator, Settings};
pub use snapshot::{SceneId, SnapshotError, decode, encode, settings_digest};
pub use texture::{Image, MagFilter, Pixels, Texture, TextureRef, Wrap};
pub use validate::SceneError;
