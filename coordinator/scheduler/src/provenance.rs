//! Who delivered what of a job, so that all of it can be rendered again when its origin turns out to be a liar.
//! Finer than a tile nothing is kept: its samples are one sum.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Who delivered what of one job.
#[derive(Clone, Debug, Default)]
pub(crate) struct Provenance {
    /// By the frame's position.
    frames: BTreeMap<u32, Sources>,
}

#[derive(Clone, Debug)]
enum Sources {
    /// The frame is being rendered: who delivered something of each tile.
    Open(BTreeMap<u32, BTreeSet<Arc<str>>>),
    /// The frame is finished: who delivered something of it.
    Finished(BTreeSet<Arc<str>>),
}

/// What of a frame a worker had its hand in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Tainted {
    /// Tiles of a frame that is not finished.
    Tiles(Vec<u32>),
    /// A finished frame.
    Frame,
}

impl Provenance {
    /// Notes who delivered something of a tile.
    pub fn add(&mut self, frame: u32, tile: u32, name: Arc<str>) {
        let sources = self.frames.entry(frame).or_insert_with(|| Sources::Open(BTreeMap::new()));
        match sources {
            Sources::Open(tiles) => tiles.entry(tile).or_default().insert(name),
            Sources::Finished(names) => names.insert(name),
        };
    }

    /// Notes that a frame was finished, after which only who took part matters.
    pub fn finish(&mut self, frame: u32) {
        if let Some(sources) = self.frames.get_mut(&frame)
            && let Sources::Open(tiles) = sources
        {
            *sources = Sources::Finished(std::mem::take(tiles).into_values().flatten().collect());
        }
    }

    /// What a worker had its hand in; forgotten with this, because it is rendered again.
    pub fn take(&mut self, name: &Arc<str>) -> Vec<(u32, Tainted)> {
        let mut tainted = Vec::new();
        for (&frame, sources) in &mut self.frames {
            match sources {
                Sources::Open(tiles) => {
                    let its = tiles.iter().filter(|(_, names)| names.contains(name));
                    let its: Vec<u32> = its.map(|(tile, _)| *tile).collect();
                    tiles.retain(|_, names| !names.contains(name));
                    if !its.is_empty() {
                        tainted.push((frame, Tainted::Tiles(its)));
                    }
                }
                Sources::Finished(names) if names.contains(name) => {
                    *sources = Sources::Open(BTreeMap::new());
                    tainted.push((frame, Tainted::Frame));
                }
                Sources::Finished(_) => {}
            }
        }
        tainted
    }
}
