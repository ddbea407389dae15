//! What travels: bytes to wire types to the farm's own.

use farm_film::{Counters, FrameIndex, SampleBlock, Tile, WorkUnit};
use farm_job::{Digest, JobId, JobSpec, LeaseId, WorkerId};
use farm_proto::convert::{FromWorker, Grant, Heartbeat, Hello, JobView, ToWorker, UnitResult, WorkerView};
use farm_proto::v1;
use farm_scene::SceneId;
use prost::Message;
use std::path::Path;
use std::time::Duration;

fn unit() -> WorkUnit {
    WorkUnit {
        frame: FrameIndex(7),
        tile: Tile::new(64, 0, 100, 36).expect("a rectangle"),
        block: SampleBlock::new(32..64).expect("a block"),
    }
}

fn from_worker() -> Vec<FromWorker> {
    vec![
        FromWorker::Hello(Hello {
            protocol: 1,
            name: "spare".into(),
            slots: 4,
            fingerprint: "tessera".into(),
        }),
        FromWorker::Result(UnitResult {
            lease: LeaseId(5),
            job: JobId(1),
            unit: unit(),
            digest: Digest([1; 32]),
            partial_exr: vec![0; 100].into(),
            render: Duration::from_millis(250),
            cpu: Duration::from_millis(125),
            counters: Counters { samples: 1024, ..Counters::default() },
        }),
        FromWorker::UnitFailed { lease: LeaseId(5), reason: "out of memory".into() },
        FromWorker::Prepared {
            job: JobId(1),
            frame: FrameIndex(2),
            fetch: Duration::ZERO,
            build: Duration::ZERO,
        },
        FromWorker::Returned(LeaseId(4)),
        FromWorker::JobRefused { job: JobId(2), reason: "needs 80 GB".into() },
    ]
}

fn to_worker() -> Vec<ToWorker> {
    let grant =
        Grant { lease: LeaseId(5), job: JobId(1), unit: unit(), attempt: 2, ttl: Duration::from_secs(300) };
    vec![
        ToWorker::Welcome { worker: WorkerId(3), heartbeat: Duration::from_secs(1), session: 11 },
        ToWorker::Grant(grant),
        ToWorker::Reject { lease: LeaseId(5), reason: "digest differs".into() },
        ToWorker::Farewell("all frames are done".into()),
    ]
}

/// Which kind the bytes behind are.
const KINDS: u8 = 8;

pub(super) fn corpus() -> Vec<Vec<u8>> {
    let tagged = |kind: u8, bytes: Vec<u8>| [vec![kind], bytes].concat();
    let mut corpus: Vec<Vec<u8>> = Vec::new();
    corpus.extend(from_worker().into_iter().map(|it| tagged(0, v1::WorkerMessage::from(it).encode_to_vec())));
    corpus.extend(
        to_worker().into_iter().map(|it| tagged(1, v1::CoordinatorMessage::from(it).encode_to_vec())),
    );
    let spec = job();
    corpus.push(tagged(2, spec.encode_to_vec()));
    let beat = v1::Heartbeat { worker: 7, leases: vec![1, 9, 300], round_trip_us: Some(250) };
    corpus.push(tagged(3, beat.encode_to_vec()));
    let digest = v1::Digest { blake3: vec![7; 32].into() };
    corpus.push(tagged(
        4,
        v1::PutSceneRequest { scene: Some(digest.clone()), pieces: vec![digest; 3] }.encode_to_vec(),
    ));
    let status = v1::JobStatus {
        job: 3,
        spec: Some(spec),
        state: v1::JobState::Running.into(),
        samples_total: 1 << 40,
        eta_seconds: Some(12.5),
        ..v1::JobStatus::default()
    };
    corpus.push(tagged(5, status.encode_to_vec()));
    let worker = v1::WorkerStatus { worker: 3, name: "ann".into(), slots: 4, ..v1::WorkerStatus::default() };
    corpus.push(tagged(6, worker.encode_to_vec()));
    let enrol = v1::EnrolRequest { token: "tessera-..".into(), signing_request: vec![0x30; 40].into() };
    corpus.push(tagged(7, enrol.encode_to_vec()));
    corpus
}

fn job() -> v1::JobSpec {
    v1::JobSpec {
        name: "box".into(),
        scene: Some(v1::Digest { blake3: vec![3; 32].into() }),
        settings: Some(v1::Settings {
            camera: 1,
            width: 640,
            height: 360,
            integrator: v1::Integrator::Path.into(),
            filter: v1::Filter::Box.into(),
            max_depth: 8,
            seed: u64::MAX,
            fps: 23.976,
            ..v1::Settings::default()
        }),
        frames: Some(v1::FrameRange { first: 1, last: 24, step: 2 }),
        spp: 100,
        tile_side: 64,
        priority: -3,
        ..v1::JobSpec::default()
    }
}

pub(super) fn decode(bytes: &[u8], _: &Path) -> bool {
    let Some((kind, bytes)) = bytes.split_first() else { return false };
    match kind % KINDS {
        0 => v1::WorkerMessage::decode(bytes).is_ok_and(|wire| FromWorker::try_from(wire).is_ok()),
        1 => v1::CoordinatorMessage::decode(bytes).is_ok_and(|wire| ToWorker::try_from(wire).is_ok()),
        2 => v1::JobSpec::decode(bytes)
            .is_ok_and(|wire| JobSpec::try_from(wire).is_ok_and(|spec| planned(&spec))),
        3 => v1::Heartbeat::decode(bytes).is_ok_and(|wire| !Heartbeat::from(wire).leases.is_empty()),
        4 => v1::PutSceneRequest::decode(bytes).is_ok_and(|wire| {
            wire.scene.is_some_and(|scene| SceneId::try_from(scene).is_ok())
                && wire.pieces.into_iter().all(|piece| Digest::try_from(piece).is_ok())
        }),
        5 => v1::JobStatus::decode(bytes).is_ok_and(|wire| JobView::try_from(wire).is_ok()),
        6 => v1::WorkerStatus::decode(bytes).is_ok_and(|wire| WorkerView::try_from(wire).is_ok()),
        _ => v1::EnrolRequest::decode(bytes).is_ok(),
    }
}

/// What a coordinator asks of every job before it takes it.
fn planned(spec: &JobSpec) -> bool {
    spec.resolution().is_ok() && spec.frames.count() > 0
}
