use super::*;
use crate::pieces;
use farm_film::{Counters, FilmTile, SampleBlock, Tile, WorkUnit};
use farm_image::{PartialHeader, encode_partial};
use farm_job::{Digest, FrameRange, JobSpec, JobState, Stop};
use farm_scene::{Filter, Integrator, Settings};
use farm_scheduler::{Quarantined, Reputation};
use std::time::Duration;

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
        clamp: None,
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
    StoredJob {
        job: JobId(number),
        spec,
        owner: Some("00000000000a".parse().unwrap()),
        state: JobState::Paused,
        reason: None,
    }
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

fn halves(scene: &[u8]) -> [Digest; 2] {
    [pieces::digest(&scene[..2]), pieces::digest(&scene[2..])]
}

fn folder(place: &tempfile::TempDir) -> StoreLocation {
    StoreLocation::Folder(place.path().to_owned())
}

async fn open(place: &tempfile::TempDir) -> Store {
    Store::open(&folder(place), Patience::Leave).await.unwrap()
}

fn starts(objects: &[StoredObject]) -> Vec<u64> {
    let partials = objects.iter().flat_map(|object| &object.partials);
    let mut starts: Vec<_> = partials.map(|partial| partial.tile.block().start()).collect();
    starts.sort();
    starts
}

#[tokio::test]
async fn what_was_put_is_there_after_a_restart() {
    let place = tempfile::tempdir().unwrap();
    let (frame, scene) = (FrameIndex(2), Bytes::from("scene"));
    let session = {
        let store = open(&place).await;
        for number in [1, 2] {
            assert_eq!(store.create_job(&job(number).spec, job(number).owner).await.unwrap(), JobId(number));
            store.put_fate(JobId(number), &job(number).fate()).await.unwrap();
        }
        store.put_piece(scene.slice(..2)).await.unwrap();
        store.put_piece(scene.slice(2..)).await.unwrap();
        store.put_scene(SceneId::of(&scene), &halves(&scene)).await.unwrap();
        let keep = async |units: &[WorkUnit]| {
            let partials: Vec<_> = units.iter().map(|unit| (unit, partial(unit).into())).collect();
            store.put_partials(JobId(2), frame, &partials).await.unwrap();
        };
        keep(&[unit(0)]).await;
        keep(&[unit(16), unit(32), unit(48)]).await;
        store.put_frame(JobId(2), FrameIndex(1), Bytes::from("exr")).await.unwrap();
        store.session()
    };
    let store = open(&place).await;
    assert_eq!(store.session(), session);
    assert_eq!(store.jobs().await.unwrap(), [job(1), job(2)]);
    assert_eq!(store.scene(SceneId::of(&scene)).await, Some(scene));
    assert_eq!(store.begun_frames(JobId(2)).await.unwrap(), BTreeSet::from([frame]));
    assert_eq!(store.finished_frames(JobId(2)).await.unwrap(), BTreeSet::from([FrameIndex(1)]));
    assert_eq!(starts(&store.partials(JobId(2), frame).await.unwrap()), [0, 16, 32, 48]);
    store.remove_partials(JobId(2), frame).await;
    assert!(store.begun_frames(JobId(2)).await.unwrap().is_empty());
}

#[tokio::test]
async fn tiles_are_forgotten_alone() {
    let place = tempfile::tempdir().unwrap();
    let store = open(&place).await;
    let frame = FrameIndex(2);
    let other = |start| WorkUnit { tile: Tile::new(0, 8, 8, 16).unwrap(), ..unit(start) };
    for together in [vec![unit(0)], vec![other(0)], vec![unit(16), other(16)], vec![unit(32), unit(48)]] {
        let partials: Vec<_> = together.iter().map(|unit| (unit, partial(unit).into())).collect();
        store.put_partials(JobId(1), frame, &partials).await.unwrap();
    }
    store.remove_tiles(JobId(1), frame, &[unit(0).tile]).await.unwrap();
    store.remove_tiles(JobId(1), FrameIndex(3), &[unit(0).tile]).await.unwrap();
    let left = store.partials(JobId(1), frame).await.unwrap();
    assert!(
        left.iter().flat_map(|object| &object.partials).all(|partial| partial.tile.tile() == other(0).tile)
    );
    assert_eq!(starts(&left), [0, 16]);
    store.put_frame(JobId(1), frame, Bytes::from("exr")).await.unwrap();
    store.remove_frame(JobId(1), frame).await.unwrap();
    store.remove_frame(JobId(1), frame).await.unwrap();
    assert_eq!(store.frame(JobId(1), frame).await.unwrap(), None);
}

#[tokio::test]
async fn the_latest_state_counts() {
    let place = tempfile::tempdir().unwrap();
    for (epoch, state) in [JobState::Running, JobState::Paused, JobState::Cancelled].into_iter().enumerate() {
        let store = open(&place).await;
        if epoch == 0 {
            store.create_job(&job(1).spec, job(1).owner).await.unwrap();
        }
        for priority in [-3, 8] {
            let mut job = StoredJob { state, ..job(1) };
            job.spec.priority = priority;
            store.put_fate(job.job, &job.fate()).await.unwrap();
            assert_eq!(store.jobs().await.unwrap(), [job], "turn {epoch}");
        }
    }
}

#[tokio::test]
async fn a_forgotten_job_is_gone_and_its_number_is_not_used_again() {
    let place = tempfile::tempdir().unwrap();
    {
        let store = open(&place).await;
        for number in 1..=3 {
            assert_eq!(store.create_job(&job(number).spec, None).await.unwrap(), JobId(number));
            store.put_frame(JobId(number), FrameIndex(1), Bytes::from("exr")).await.unwrap();
        }
        store.put_partials(JobId(3), FrameIndex(2), &[(&unit(0), partial(&unit(0)).into())]).await.unwrap();
        store.forget_job(JobId(1)).await.unwrap();
        store.remove_job(JobId(1)).await.unwrap();
        assert!(!place.path().join("jobs/1").exists());
        // Killed before there was room again.
        store.forget_job(JobId(3)).await.unwrap();
    }
    let store = open(&place).await;
    let numbers = async || store.jobs().await.unwrap().iter().map(|job| job.job.0).collect::<Vec<_>>();
    assert_eq!(numbers().await, [2]);
    assert!(!place.path().join("jobs/3/frames").exists() && !place.path().join("jobs/3/partials").exists());
    assert_eq!(store.create_job(&job(4).spec, None).await.unwrap(), JobId(4));
    assert_eq!(numbers().await, [2, 4]);
    assert!(!place.path().join("jobs/3").exists(), "job 4 tells by itself which number is next");
}

#[tokio::test]
async fn two_coordinators_never_write_to_one_store() {
    let place = tempfile::tempdir().unwrap();
    let first = open(&place).await;
    let second = Store::open(&folder(&place), Patience::Leave).await;
    assert!(matches!(second.err(), Some(StoreError::InUse(_))));
    drop(first);
    open(&place).await;
}

#[tokio::test]
async fn a_coordinator_whose_turn_is_over_keeps_nothing_more() {
    let place = tempfile::tempdir().unwrap();
    let stale = open(&place).await;
    stale.put_frame(JobId(1), FrameIndex(0), Bytes::from("mine")).await.unwrap();
    // Someone took it for dead.
    let heir = br#"{"host":"elsewhere","process":7}"#;
    std::fs::write(place.path().join("epochs/0000000002.json"), heir).unwrap();
    let refused = stale.put_frame(JobId(1), FrameIndex(1), Bytes::from("late")).await.unwrap_err();
    assert!(refused.to_string().contains("taken over the store (process 7 on elsewhere)"), "{refused}");
    assert!(matches!(stale.put_fate(JobId(1), &job(1).fate()).await, Err(StoreError::TurnOver(_))));
    assert!(stale.lost().borrow().is_some());
    tokio::time::sleep(Duration::from_millis(1100)).await;
    assert!(stale.put_frame(JobId(1), FrameIndex(2), Bytes::from("later")).await.is_err());
    assert!(!place.path().join("jobs/1/frames/frame.0002.exr").exists(), "it does not even try any more");
}

#[tokio::test]
async fn what_was_being_written_at_a_crash_is_swept_away() {
    let place = tempfile::tempdir().unwrap();
    drop(open(&place).await);
    let folder = place.path().join("jobs/1/partials/2");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("0-0-0-16.exr#1"), b"half").unwrap();
    let store = open(&place).await;
    assert!(store.partials(JobId(1), FrameIndex(2)).await.unwrap().is_empty());
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 0);
}

#[tokio::test]
async fn damage_is_noticed() {
    let place = tempfile::tempdir().unwrap();
    let store = open(&place).await;
    let scene = SceneId::of(b"scene");
    let whole = [pieces::digest(b"scene")];
    store.put_piece(Bytes::from("scene")).await.unwrap();
    store.put_scene(scene, &whole).await.unwrap();
    std::fs::write(place.path().join("pieces").join(whole[0].to_string()), b"other").unwrap();
    assert!(store.scene(scene).await.is_none());
    let cut = |unit: &WorkUnit| Bytes::from(partial(unit)).slice(..100);
    store.put_partials(JobId(1), FrameIndex(2), &[(&unit(0), cut(&unit(0)))]).await.unwrap();
    let mixed = [(&unit(16), cut(&unit(16))), (&unit(32), partial(&unit(32)).into())];
    store.put_partials(JobId(1), FrameIndex(2), &mixed).await.unwrap();
    assert_eq!(starts(&store.partials(JobId(1), FrameIndex(2)).await.unwrap()), [32]);
    store.create_job(&job(1).spec, None).await.unwrap();
    std::fs::write(place.path().join("jobs/1/job.json"), b"{").unwrap();
    assert!(store.jobs().await.unwrap_err().to_string().contains("job.json"));
}

#[tokio::test]
async fn what_is_known_of_workers_outlives_a_coordinator() {
    let place = tempfile::tempdir().unwrap();
    let known = |left| Reputation {
        distrusted: BTreeSet::from(["liar".to_owned()]),
        quarantined: vec![Quarantined { name: "clumsy".into(), times: 2, left: Duration::from_secs(left) }],
    };
    {
        let store = open(&place).await;
        assert_eq!(store.reputation().await.unwrap(), Reputation::default());
        store.put_reputation(&known(0)).await.unwrap();
        store.put_reputation(&known(3600)).await.unwrap();
    }
    let store = open(&place).await;
    let found = store.reputation().await.unwrap();
    let left = found.quarantined[0].left;
    assert!(left > Duration::from_secs(3500) && left <= Duration::from_secs(3600), "{left:?}");
    assert_eq!((found.distrusted, found.quarantined[0].times), (known(0).distrusted, 2));
    store.put_reputation(&known(0)).await.unwrap();
    assert_eq!(store.reputation().await.unwrap(), known(0));
    assert_eq!(std::fs::read_dir(place.path().join("workers")).unwrap().count(), 1);
}
