//! Makes a frame ready to trace: job, scene, acceleration structures.

use crate::agent::FrameKey;
use crate::client::{Client, FetchError};
use crate::render_pool::{ReadyFrame, panic_text};
use crate::renderer::{FINGERPRINT, PrepareError, PreparedScene};
use crate::scene_cache::SceneCache;
use farm_film::{Counters, FrameIndex, Resolution};
use farm_image::PartialHeader;
use farm_job::{JobSpec, JobSpecError};
use farm_scene::{Scene, SceneId, Settings, settings_digest};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A frame that cannot be made ready.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// Job or scene did not come.
    #[error(transparent)]
    Fetch(#[from] FetchError),
    /// Impossible numbers.
    #[error(transparent)]
    Job(#[from] JobSpecError),
    /// The renderer cannot render this.
    #[error(transparent)]
    Prepare(#[from] PrepareError),
    /// A fault of ours.
    #[error("{0}")]
    Panic(String),
}

/// A frame, and how long it took.
pub struct Prepared {
    /// Ready to trace.
    pub frame: Arc<ReadyFrame>,
    /// To get job and scene.
    pub fetch: Duration,
    /// To build what rays need.
    pub build: Duration,
}

/// Fetches what is missing and prepares the frame on a thread of its own.
pub async fn prepare(key: FrameKey, client: Client, scenes: Arc<SceneCache>) -> Result<Prepared, FrameError> {
    let begun = Instant::now();
    let spec = client.job(key.job).await?;
    let scene = scenes.get(spec.scene, &client).await?;
    let fetch = begun.elapsed();
    tokio::task::spawn_blocking(move || {
        let begun = Instant::now();
        let frame = catch_unwind(AssertUnwindSafe(|| ready_frame(&scene, &spec, key.frame)))
            .unwrap_or_else(|panic| Err(FrameError::Panic(panic_text(panic.as_ref()))))?;
        Ok(Prepared { frame: Arc::new(frame), fetch, build: begun.elapsed() })
    })
    .await
    .map_err(|_| FrameError::Panic("the worker is leaving".to_owned()))?
}

fn ready_frame(scene: &Arc<Scene>, spec: &JobSpec, frame: FrameIndex) -> Result<ReadyFrame, FrameError> {
    spec.validate()?;
    Ok(ReadyFrame {
        prepared: PreparedScene::new(scene, &spec.settings, frame)?,
        header: partial_header(spec.resolution()?, spec.scene, &spec.settings, frame),
    })
}

/// What every partial of a frame says of itself.
pub fn partial_header(
    resolution: Resolution,
    scene: SceneId,
    settings: &Settings,
    frame: FrameIndex,
) -> PartialHeader {
    PartialHeader {
        resolution,
        frame,
        scene: scene.0,
        settings: settings_digest(settings),
        seed: settings.seed,
        renderer: FINGERPRINT.to_owned(),
        counters: Counters::default(),
    }
}
