//! What is rendered in every simulation: small, but with edge tiles, several rounds and more than one frame.

use farm_film::{Film, FrameIndex, Resolution, Rgb, WorkUnit};
use farm_job::{FrameRange, JobId, JobSpec, Stop};
use farm_proto::convert::{Grant, UnitResult};
use farm_render::{PreparedScene, render};
use farm_scene::{Filter, Integrator, Scene, SceneId, Settings, encode};
use farm_worker::frames::partial_header;
use farm_worker::render_pool::{Assignment, Ended, ReadyFrame, run};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, LazyLock, Mutex};
use std::time::Duration;

/// The job of every simulation.
pub const JOB: JobId = JobId(1);

/// What a unit takes, unless whoever renders it says otherwise.
const NOMINAL: Duration = Duration::from_millis(400);

/// The picture, and what it must look like.
pub struct Picture {
    pub scene: SceneId,
    pub snapshot: Vec<u8>,
    pub spec: JobSpec,
    /// Pixels of each frame, as one process renders them.
    pub expected: BTreeMap<FrameIndex, Vec<Rgb>>,
    frames: BTreeMap<FrameIndex, Arc<ReadyFrame>>,
}

pub static PICTURE: LazyLock<Picture> = LazyLock::new(Picture::new);

impl Picture {
    fn new() -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.gltf");
        let imported =
            farm_import::import(&path, &farm_import::ImportOptions::default()).expect("the scene imports");
        let snapshot = encode(&imported.scene);
        let scene = SceneId::of(&snapshot);
        let settings = Settings {
            camera: 0,
            width: 20,
            height: 14,
            integrator: Integrator::Path,
            filter: Filter::BlackmanHarris,
            max_depth: 4,
            seed: 5,
            fps: 24.0,
            clamp: None,
        };
        let spec = JobSpec {
            name: "simulation".to_owned(),
            scene,
            settings,
            frames: FrameRange::new(1, 3, 1).expect("frames"),
            spp: 84,
            stop: Stop::default(),
            variance: false,
            tile_side: 8,
            priority: 0,
        };
        let shared = Arc::new(imported.scene);
        let frames: BTreeMap<_, _> =
            spec.frames.iter().map(|frame| (frame, ready(&shared, &spec, frame))).collect();
        let expected = frames.iter().map(|(frame, ready)| (*frame, alone(&ready.prepared, &spec))).collect();
        Self { scene, snapshot, spec, expected, frames }
    }

    pub fn resolution(&self) -> Resolution {
        self.spec.resolution().expect("the job is a good one")
    }

    /// Samples over all pixels of a frame.
    pub fn samples(&self) -> u64 {
        self.resolution().area() as u64 * self.spec.spp
    }
}

fn ready(scene: &Arc<Scene>, spec: &JobSpec, frame: FrameIndex) -> Arc<ReadyFrame> {
    let prepared = PreparedScene::new(scene, &spec.settings, frame).expect("it is fit to render");
    let header = partial_header(prepared.resolution(), spec.scene, &spec.settings, frame);
    Arc::new(ReadyFrame { prepared, header })
}

/// One frame, rendered by one process in as few pieces as can be.
fn alone(prepared: &PreparedScene, spec: &JobSpec) -> Vec<Rgb> {
    let mut film = Film::new(prepared.resolution(), 64, spec.spp).expect("samples");
    for block in film.roots().to_vec() {
        for tile in prepared.resolution().tiles(64) {
            let rendered = render(prepared, tile, block, &|| false).expect("nobody stops it");
            film.add(rendered.tile).expect("it belongs to the frame");
        }
    }
    film.pixels()
}

/// The result of a unit. Units are pure: each is rendered once for all simulations.
pub fn rendered(grant: &Grant) -> UnitResult {
    static RENDERED: Mutex<BTreeMap<WorkUnit, UnitResult>> = Mutex::new(BTreeMap::new());
    let mut rendered = RENDERED.lock().expect("nothing panics in here");
    let result = rendered.entry(grant.unit).or_insert_with(|| {
        let frame = PICTURE.frames[&grant.unit.frame].clone();
        match run(&Assignment { grant: *grant, frame, stop: Arc::default() }) {
            Ended::Rendered(result) => *result,
            other => unreachable!("a unit that nobody stopped is rendered: {other:?}"),
        }
    });
    // What the clock on the wall says differs from run to run.
    let (render, cpu) = (NOMINAL, NOMINAL);
    UnitResult { lease: grant.lease, job: grant.job, render, cpu, ..result.clone() }
}
