//! From a scene's name to a scene that is ready to be traced.

use crate::scenes::{Named, Scale};
use farm_film::FrameIndex;
use farm_render::PreparedScene;
use farm_scene::{Filter, Integrator, Scene, Settings};
use std::sync::Arc;

/// A scene of the benchmark set, imported.
pub struct Stage {
    scene: Arc<Scene>,
}

impl Stage {
    /// Writes the scene to a temporary folder and imports it, as a user's scene would be.
    pub fn new(named: Named) -> Result<Self, String> {
        let folder = tempfile::tempdir().map_err(|err| format!("no temporary folder: {err}"))?;
        let write = |name: &str, bytes: &[u8]| {
            std::fs::write(folder.path().join(name), bytes)
                .map_err(|err| format!("cannot write {name}: {err}"))
        };
        write("scene.glb", &named.glb(Scale(0)))?;
        if let Some((name, bytes)) = named.companion() {
            write(name, &bytes)?;
        }
        let imported = farm_import::import(&folder.path().join("scene.glb"), &Default::default())
            .map_err(|err| format!("{}: {err}", named.name))?;
        Ok(Self { scene: Arc::new(imported.scene) })
    }

    /// The scene's first camera at a resolution, through a pixel filter.
    pub fn prepare(&self, [width, height]: [u32; 2], filter: Filter) -> Result<PreparedScene, String> {
        let settings = Settings {
            camera: 0,
            width,
            height,
            integrator: Integrator::Path,
            filter,
            max_depth: 8,
            seed: 0,
            fps: 24.0,
            clamp: None,
        };
        PreparedScene::new(&self.scene, &settings, FrameIndex(0)).map_err(|err| err.to_string())
    }
}
