//! glTF 2.0 files to [`Scene`](farm_scene::Scene)s. Whatever the bytes are, the answer is a scene whose parts fit together or
//! one sentence that names the place at fault: no panic, no memory that the file's size does not justify, and no look outside
//! the scene's folder.

mod accessor;
mod animation;
mod camera;
mod container;
mod document;
mod environment;
mod error;
mod fields;
mod framing;
mod import;
mod light;
mod material;
mod mesh;
mod node;
mod pose;
mod references;
mod report;
mod source;
mod studio;
mod tangents;
mod texture;
mod topology;

pub use environment::{EnvironmentReport, ExrEnvironment, environment_from_pixels, load_environment};
pub use error::ImportError;
pub use import::{ImportOptions, Imported, import};
pub use report::ImportReport;
pub use studio::{is_lit, studio_environment};
