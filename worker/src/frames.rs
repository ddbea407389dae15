//! Makes a frame ready to trace: job, scene, acceleration structures.

use crate::agent::FrameKey;
use crate::blocking::blocking;
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
    /// More than this worker may hold.
    #[error(
        "frame {frame} takes {bytes} bytes and this worker may use {allowed}: give it more with --memory"
    )]
    TooLarge {
        /// Which frame.
        frame: FrameIndex,
        /// About what it takes.
        bytes: u64,
        /// What may be used in all.
        allowed: u64,
    },
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

impl FrameError {
    /// Whether another worker, with more memory, could do it.
    pub fn is_for_others(&self) -> bool {
        matches!(self, Self::TooLarge { .. } | Self::Fetch(FetchError::TooLarge { .. }))
    }
}

/// A frame, and how long it took.
pub struct Prepared {
    /// Ready to trace.
    pub frame: Arc<ReadyFrame>,
    /// Whether another one like it would exceed the memory.
    pub memory_short: bool,
    /// To get job and scene.
    pub fetch: Duration,
    /// To build what rays need.
    pub build: Duration,
}

/// Fetches what is missing and prepares the frame on a thread of its own.
pub async fn prepare(key: FrameKey, client: Client, scenes: Arc<SceneCache>) -> Result<Prepared, FrameError> {
    let begun = Instant::now();
    let spec = client.job(key.job).await?;
    let held = scenes.get(spec.scene, &client).await?;
    let (scene, scene_bytes, allowed) = (held.scene, held.bytes, scenes.memory());
    let fetch = begun.elapsed();
    blocking(move || {
        let begun = Instant::now();
        let frame = catch_unwind(AssertUnwindSafe(|| ready_frame(&scene, &spec, key.frame)))
            .unwrap_or_else(|panic| Err(FrameError::Panic(panic_text(panic.as_ref()))))?;
        let own = frame.prepared.report().accel_bytes;
        let bytes = scene_bytes.saturating_add(own);
        if bytes > allowed {
            return Err(FrameError::TooLarge { frame: key.frame, bytes, allowed });
        }
        let memory_short = bytes.saturating_add(own) > allowed;
        Ok(Prepared { frame: Arc::new(frame), memory_short, fetch, build: begun.elapsed() })
    })
    .await
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
