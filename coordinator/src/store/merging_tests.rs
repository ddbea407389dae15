use super::*;
use crate::store::{Patience, Shelf, StoreLocation};
use farm_film::{Counters, Film, Resolution, SampleRange};

const FRAME: FrameIndex = FrameIndex(2);
const JOB: JobId = JobId(1);
const SPP: u64 = 1024;

fn resolution() -> Resolution {
    Resolution::new(32, 16).unwrap()
}

fn tiles() -> Vec<Tile> {
    resolution().tiles(4).collect()
}

fn rounds() -> Vec<SampleBlock> {
    [0..16, 16..32, 32..64, 64..128, 128..256, 256..512, 512..1024]
        .map(|range| SampleBlock::new(range).unwrap())
        .into()
}

/// Every leaf of every tile, layer by layer, with values that show every rounding.
fn leaves() -> Vec<Partial> {
    let mut random = fastrand::Rng::with_seed(5);
    let mut leaves = Vec::new();
    for start in (0..SPP).step_by(16) {
        for tile in tiles() {
            let sums = (0..16).map(|_| [random.f32(), random.f32() * 1e-3, random.f32() * 1e4]).collect();
            let block = SampleBlock::new(start..start + 16).unwrap();
            let header = PartialHeader {
                resolution: resolution(),
                frame: FRAME,
                scene: [1; 32],
                settings: [2; 32],
                seed: 9,
                renderer: "test".into(),
                counters: Counters { samples: 256, ..Counters::default() },
            };
            leaves.push((FilmTile::new(tile, block, sums), header));
        }
    }
    leaves
}

fn bits(partials: &[Partial]) -> Vec<[u32; 3]> {
    let mut film = Film::with_tiles(resolution(), tiles(), SampleRange::new(0..SPP).unwrap()).unwrap();
    for (tile, _) in partials {
        film.add(tile.clone()).unwrap();
    }
    assert!(film.is_complete());
    film.pixels().iter().map(|pixel| pixel.map(f32::to_bits)).collect()
}

async fn open(place: &tempfile::TempDir) -> Store {
    Store::open(&StoreLocation::Folder(place.path().to_owned()), Patience::Leave).await.unwrap()
}

/// Puts partials, some in one object, the way a keeper does.
async fn put(store: &Store, shelf: &mut Shelf, partials: &[Partial]) {
    for some in partials.chunks(100) {
        let unit = |tile: &FilmTile| WorkUnit { frame: FRAME, tile: tile.tile(), block: tile.block() };
        let units: Vec<_> = some.iter().map(|(tile, _)| unit(tile)).collect();
        let files = some.iter().map(|(tile, header)| Bytes::from(encode_partial(tile, header)));
        let files: Vec<_> = units.iter().zip(files).collect();
        shelf.add(store.put_partials(JOB, FRAME, &files).await.unwrap());
    }
}

/// What a coordinator finds that starts now, and what of it is superfluous.
async fn found(store: &Store) -> (Vec<Partial>, Vec<object_store::path::Path>) {
    let objects = store.partials(JOB, FRAME).await.unwrap();
    let mut shelf = Shelf::new(rounds());
    objects.iter().for_each(|object| shelf.add(object.holding()));
    let partials = objects.into_iter().flat_map(|object| object.partials);
    let partials = partials.map(|partial| (partial.tile, partial.header)).collect();
    (largest(partials), shelf.take_superfluous())
}

fn copy(from: &std::path::Path, to: &std::path::Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, to.join(path.file_name().unwrap())).unwrap();
    }
}

fn objects(folder: &std::path::Path) -> usize {
    std::fs::read_dir(folder).unwrap().count()
}

async fn merge(store: &Store, shelf: &mut Shelf) -> bool {
    let Some(crowd) = shelf.crowd(true) else { return false };
    let parents = store.merge(JOB, FRAME, rounds().into(), &crowd).await.unwrap().unwrap();
    shelf.replaced(&crowd, parents);
    true
}

#[tokio::test]
async fn a_tile_never_has_many_partials_and_their_sum_is_the_same() {
    let place = tempfile::tempdir().unwrap();
    let (store, mut shelf, leaves) = (open(&place).await, Shelf::new(rounds()), leaves());
    let (folder, mut merges) = (place.path().join("jobs/1/partials/2"), 0);
    for some in leaves.chunks(8) {
        put(&store, &mut shelf, some).await;
        while merge(&store, &mut shelf).await {
            merges += 1;
        }
        assert!(objects(&folder) < 80, "{} objects of {}", objects(&folder), leaves.len() / 8);
    }
    assert!(merges > 3, "{merges}");
    let (partials, superfluous) = found(&store).await;
    assert!(partials.len() < 2 * tiles().len() * rounds().len() + 64, "{} partials", partials.len());
    assert!(superfluous.is_empty());
    assert_eq!(partials.iter().map(|(_, header)| header.counters.samples).sum::<u64>(), SPP * 512);
    assert!(bits(&partials) == bits(&leaves), "other bits");
}

#[tokio::test]
async fn killed_between_parents_and_the_removal_of_their_children_nothing_is_counted_twice() {
    let place = tempfile::tempdir().unwrap();
    let (store, mut shelf, leaves) = (open(&place).await, Shelf::new(rounds()), leaves());
    put(&store, &mut shelf, &leaves).await;
    let (folder, before) = (place.path().join("jobs/1/partials/2"), place.path().join("before"));
    copy(&folder, &before);
    let children = objects(&folder);
    while merge(&store, &mut shelf).await {}
    let parents = objects(&folder);
    copy(&before, &folder);
    drop(store);

    let store = open(&place).await;
    let (partials, superfluous) = found(&store).await;
    assert_eq!(partials.len(), tiles().len() * rounds().len(), "one per round");
    assert_eq!(partials.iter().map(|(_, header)| header.counters.samples).sum::<u64>(), SPP * 512);
    assert!(bits(&partials) == bits(&leaves), "other bits");
    assert_eq!(superfluous.len(), children, "all children can go");
    store.remove_superfluous(superfluous).await;
    assert_eq!(objects(&folder), parents);
    let (rest, superfluous) = found(&store).await;
    assert!(bits(&rest) == bits(&leaves) && superfluous.is_empty());
}

#[tokio::test]
async fn what_is_damaged_or_grows_too_large_stays_as_it_is() {
    let place = tempfile::tempdir().unwrap();
    let (store, mut shelf, mut leaves) = (open(&place).await, Shelf::new(rounds()), leaves());
    let (folder, last) = (place.path().join("jobs/1/partials/2"), leaves.len() - 1);
    let (tile, block) = (leaves[last].0.tile(), leaves[last].0.block());
    leaves[last].0 = FilmTile::new(tile, block, vec![[f32::MAX; 3]; 16]);
    leaves[last - tiles().len()].0 = FilmTile::new(tile, block.sibling().unwrap(), vec![[f32::MAX; 3]; 16]);
    put(&store, &mut shelf, &leaves).await;
    let (before, crowd) = (objects(&folder), shelf.crowd(true).unwrap());
    assert!(
        store.merge(JOB, FRAME, rounds().into(), &crowd).await.unwrap().is_none(),
        "it would be infinite"
    );
    let victim = place.path().join(crowd.0[0].as_ref());
    let bytes = std::fs::read(&victim).unwrap();
    std::fs::write(&victim, &bytes[..bytes.len() / 2]).unwrap();
    let refused = store.merge(JOB, FRAME, rounds().into(), &crowd).await.unwrap_err();
    assert!(refused.to_string().contains("holds no longer what was put there"), "{refused}");
    assert_eq!(objects(&folder), before);
}
