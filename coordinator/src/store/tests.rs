use super::*;
use farm_film::{Counters, SampleBlock, Tile};
use farm_image::{PartialHeader, encode_partial};
use farm_job::{FrameRange, Stop};
use farm_scene::{Filter, Integrator, Settings};

fn job(number: u64) -> StoredJob {
    let settings = Settings {
        camera: 0,
        width: 8,
        height: 8,
        integrator: Integrator::Path,
        filter: Filter::Box,
        max_depth: 4,
        seed: 9,
        fps: 24.0,
    };
    let spec = JobSpec {
        name: "fox".into(),
        scene: SceneId([1; 32]),
        settings,
        frames: FrameRange::new(1, 3, 1).unwrap(),
        spp: 32,
        stop: Stop::default(),
        variance: false,
        tile_side: 8,
        priority: 5,
    };
    StoredJob { job: JobId(number), spec, state: JobState::Paused, reason: None }
}

fn unit(start: u64) -> WorkUnit {
    let tile = Tile::new(0, 0, 8, 8).unwrap();
    WorkUnit { frame: FrameIndex(2), tile, block: SampleBlock::new(start..start + 16).unwrap() }
}

fn partial(unit: &WorkUnit) -> Vec<u8> {
    let header = PartialHeader {
        resolution: farm_film::Resolution::new(8, 16).unwrap(),
        frame: unit.frame,
        scene: [1; 32],
        settings: [2; 32],
        seed: 9,
        renderer: "test".into(),
        counters: Counters::default(),
    };
    encode_partial(&FilmTile::new(unit.tile, unit.block, vec![[1.5; 3]; 64]), &header)
}

#[test]
fn what_was_put_is_there_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let session = {
        let store = Store::open(folder.path()).unwrap();
        store.put_job(&job(10)).unwrap();
        store.put_job(&job(9)).unwrap();
        store.put_scene(SceneId::of(b"scene"), b"scene").unwrap();
        store.put_partial(JobId(9), &unit(0), &partial(&unit(0))).unwrap();
        store.put_partial(JobId(9), &unit(16), &partial(&unit(16))).unwrap();
        store.session()
    };
    let store = Store::open(folder.path()).unwrap();
    assert_eq!(store.session(), session);
    assert_eq!(store.jobs().unwrap(), [job(9), job(10)]);
    assert_eq!(store.scene(SceneId::of(b"scene")).unwrap(), b"scene");
    let blocks: Vec<_> =
        store.partials(JobId(9), FrameIndex(2)).iter().map(|(tile, _)| tile.block().start()).collect();
    assert_eq!(blocks, [0, 16]);
    store.remove_partials(JobId(9), FrameIndex(2));
    assert!(store.partials(JobId(9), FrameIndex(2)).is_empty());
}

#[test]
fn tiles_are_forgotten_alone() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path()).unwrap();
    let other = WorkUnit { tile: Tile::new(0, 8, 8, 16).unwrap(), ..unit(0) };
    for unit in [unit(0), unit(16), other] {
        store.put_partial(JobId(1), &unit, &partial(&unit)).unwrap();
    }
    store.remove_tiles(JobId(1), FrameIndex(2), &[unit(0).tile]).unwrap();
    store.remove_tiles(JobId(1), FrameIndex(3), &[unit(0).tile]).unwrap();
    let left: Vec<_> = store.partials(JobId(1), FrameIndex(2)).iter().map(|(tile, _)| tile.tile()).collect();
    assert_eq!(left, [other.tile]);
}

#[test]
fn two_coordinators_never_write_to_one_store() {
    let folder = tempfile::tempdir().unwrap();
    let first = Store::open(folder.path()).unwrap();
    assert!(matches!(Store::open(folder.path()), Err(StoreError::InUse(_))));
    drop(first);
    assert!(Store::open(folder.path()).is_ok());
}

#[test]
fn damage_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path()).unwrap();
    let scene = SceneId::of(b"scene");
    store.put_scene(scene, b"scene").unwrap();
    std::fs::write(folder.path().join("scenes").join(scene.to_string()), b"other").unwrap();
    assert!(store.scene(scene).is_none());
    store.put_partial(JobId(1), &unit(0), &partial(&unit(0))[..100]).unwrap();
    assert!(store.partials(JobId(1), FrameIndex(2)).is_empty());
    store.put_job(&job(1)).unwrap();
    std::fs::write(folder.path().join("jobs/1/job.json"), b"{").unwrap();
    assert!(store.jobs().unwrap_err().to_string().contains("job.json"));
}
