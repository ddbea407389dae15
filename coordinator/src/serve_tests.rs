use super::*;
use bytes::Bytes;
use farm_film::{SampleBlock, WorkUnit};
use farm_job::Digest;
use farm_scheduler::Reputation;

const JOB: JobId = JobId(1);

fn tile(x: u32) -> Tile {
    Tile::new(x, 0, x + 8, 8).unwrap()
}

fn names(origins: &[Origin]) -> Vec<(u32, Option<u32>, &str)> {
    let x = |origin: &Origin| origin.part.map(|(unit, _)| unit.tile.x0());
    let mut names: Vec<_> =
        origins.iter().map(|origin| (origin.frame.0, x(origin), origin.name.as_str())).collect();
    names.sort();
    names
}

#[tokio::test]
async fn what_liars_left_behind_goes_when_the_coordinator_was_killed_before() {
    let place = tempfile::tempdir().unwrap();
    let location = StoreLocation::Folder(place.path().to_owned());
    let store = Store::open(&location, Patience::Leave).await.unwrap();
    let (done, open) = (FrameIndex(1), FrameIndex(2));
    store.put_frame(JOB, done, Bytes::from("exr")).await.unwrap();
    let block = SampleBlock::new(0..16).unwrap();
    let units = [0, 8].map(|x| WorkUnit { frame: open, tile: tile(x), block });
    for unit in &units {
        store.put_partials(JOB, open, &[(unit, Bytes::from("exr"))]).await.unwrap();
    }
    let origin = |frame, x, name: &str| {
        let unit = WorkUnit { frame, tile: tile(x), block };
        Origin { frame, name: name.to_owned(), part: Some((unit, Digest([7; 32]))) }
    };
    store.put_origins(JOB, done, &[origin(done, 0, "ann"), origin(done, 8, "liar")]).await.unwrap();
    store.put_origins(JOB, done, &[origin(done, 8, "ann")]).await.unwrap();
    store.settle_origins(JOB, done).await.unwrap();
    store.put_origins(JOB, open, &[origin(open, 0, "ann"), origin(open, 8, "ann")]).await.unwrap();
    store.put_origins(JOB, open, &[origin(open, 8, "liar")]).await.unwrap();
    let all =
        [(1, None, "ann"), (1, None, "liar"), (2, Some(0), "ann"), (2, Some(8), "ann"), (2, Some(8), "liar")];
    assert_eq!(names(&honest_origins(&store, JOB).await.unwrap()), all, "nobody is a liar yet");
    assert_eq!(store.origins(JOB).await.unwrap()[2], origin(open, 0, "ann"));
    // Killed between the verdict and what follows from it.
    let distrusted = BTreeSet::from(["liar".to_owned()]);
    store.put_reputation(&Reputation { distrusted, quarantined: Vec::new() }).await.unwrap();
    for _ in 0..2 {
        let origins = honest_origins(&store, JOB).await.unwrap();
        assert_eq!(names(&origins), [(2, Some(0), "ann")]);
        assert!(store.finished_frames(JOB).await.unwrap().is_empty());
        assert!(place.path().join("jobs/1/partials/2/0-0-0-16.exr").exists());
        assert!(!place.path().join("jobs/1/partials/2/8-0-0-16.exr").exists());
    }
}
