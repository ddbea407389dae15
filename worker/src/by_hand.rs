//! One partial rendered without a farm, to be merged with others by hand.

use crate::cli::{Fault, PictureArgs};
use crate::frames::partial_header;
use crate::render_pool::panic_text;
use crate::renderer::{PreparedScene, Rendered, render};
use farm_film::{
    Counters, Differences, FilmTile, FrameIndex, Resolution, Rgb, SampleBlock, SampleBlockError, SampleRange,
    Tile,
};
use farm_image::{PartialHeader, encode_partial, write_file};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Side of the pieces that threads take in turn.
const PIECE_SIDE: u32 = 32;

/// Render one partial without a coordinator; `coordinator merge` puts partials together
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Examples:
  worker render scene.glb --samples 0..64 -o a.exr
  worker render scene.glb --samples 64..128 -o b.exr
  coordinator merge a.exr b.exr -o scene.exr")]
pub struct RenderArgs {
    #[command(flatten)]
    picture: PictureArgs,

    /// Sample indices per pixel: a block of the merge tree, such as 0..64 or 64..128
    #[arg(long, env = "FARM_SAMPLES", value_name = "A..B", value_parser = samples)]
    samples: SampleRange,

    /// Pixels to render, from the top left: X0,Y0,X1,Y1 with X1 and Y1 one past the last; the whole frame if not given
    #[arg(long, env = "FARM_TILE_WINDOW", value_name = "X0,Y0,X1,Y1", value_parser = window)]
    tile_window: Option<Tile>,

    /// Which frame; its time is N / fps
    #[arg(long, env = "FARM_FRAME", value_name = "N", default_value_t = 0)]
    frame: u32,

    /// Render threads; one per processor if not given
    #[arg(long, env = "FARM_THREADS", value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    threads: Option<u32>,

    /// Where to write the partial
    #[arg(short, long, env = "FARM_OUTPUT", value_name = "PART.exr")]
    output: PathBuf,
}

fn samples(text: &str) -> Result<SampleRange, String> {
    let parts = text.split_once("..").and_then(|(start, end)| Some((start.parse().ok()?, end.parse().ok()?)));
    let (start, end) = parts.ok_or("write FIRST..LAST, for example 0..64")?;
    SampleRange::new(start..end).map_err(|err| err.to_string())
}

fn window(text: &str) -> Result<Tile, String> {
    let numbers: Result<Vec<u32>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    match numbers.as_deref() {
        Ok(&[x0, y0, x1, y1]) => Tile::new(x0, y0, x1, y1).map_err(|err| err.to_string()),
        _ => Err("write X0,Y0,X1,Y1 in pixels".to_owned()),
    }
}

/// Render threads: as many as asked for, else one per processor.
pub fn thread_count(asked: Option<u32>) -> usize {
    match asked {
        Some(threads) => threads as usize,
        None => std::thread::available_parallelism().map_or(1, usize::from),
    }
}

/// Renders and writes one partial.
pub fn run(args: &RenderArgs) -> Result<(), Fault> {
    let block = block(args.samples)?;
    let loaded = args.picture.load()?;
    for warning in &loaded.report.warnings {
        eprintln!("warning: {warning}");
    }
    let resolution = args.picture.resolution;
    let window = args.tile_window.unwrap_or(resolution.full());
    if !resolution.contains(window) {
        return Err(Fault::input(format!("--tile-window {window} is not inside the frame of {resolution}")));
    }
    let frame = FrameIndex(args.frame);
    let prepared = PreparedScene::new(&loaded.scene, &loaded.settings, frame).map_err(Fault::input)?;
    let (tile, counters) = render_window(&prepared, window, block, thread_count(args.threads))?;
    for warning in counters.warnings() {
        eprintln!("warning: {warning}");
    }
    let header = PartialHeader { counters, ..partial_header(resolution, loaded.id, &loaded.settings, frame) };
    write_file(&args.output, &encode_partial(&tile, &header)).map_err(Fault::failed)
}

/// A partial holds one node of the merge tree; other ranges are several partials.
fn block(samples: SampleRange) -> Result<SampleBlock, Fault> {
    SampleBlock::try_from(samples).map_err(|err| match (err, samples.blocks()) {
        (SampleBlockError::NotABlock { .. }, Ok(blocks)) => {
            let list: Vec<_> = blocks.iter().map(ToString::to_string).collect();
            Fault::input(format!("{err}; render {} instead, one partial each", list.join(", ")))
        }
        _ => Fault::input(err),
    })
}

/// Divides the window among threads and joins the pieces; the bits do not depend on the division.
fn render_window(
    prepared: &PreparedScene,
    window: Tile,
    block: SampleBlock,
    threads: usize,
) -> Result<(FilmTile, Counters), Fault> {
    let pieces = pieces(window);
    let (next, failed) = (AtomicUsize::new(0), AtomicBool::new(false));
    let canvas = Mutex::new(Canvas {
        sums: vec![[0.0; 3]; window.area()],
        differences: vec![Differences::default(); pieces.len()],
        counters: vec![Counters::default(); pieces.len()],
        fault: None,
    });
    let work = || {
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(&piece) = pieces.get(index) else { return };
            let stop = || failed.load(Ordering::Relaxed);
            let rendered = catch_unwind(AssertUnwindSafe(|| render(prepared, piece, block, &stop)));
            let mut canvas = canvas.lock().unwrap_or_else(PoisonError::into_inner);
            match rendered {
                Ok(Some(Rendered { tile, counters })) => {
                    paste(&tile, window, &mut canvas.sums);
                    canvas.differences[index] = tile.differences().clone();
                    canvas.counters[index] = counters;
                }
                Ok(None) => return,
                Err(panic) => {
                    failed.store(true, Ordering::Relaxed);
                    canvas.fault = Some(format!("tile {piece}: {}", panic_text(panic.as_ref())));
                    return;
                }
            }
        }
    };
    std::thread::scope(|scope| (0..threads).for_each(|_| drop(scope.spawn(work))));
    let canvas = canvas.into_inner().unwrap_or_else(PoisonError::into_inner);
    if let Some(fault) = canvas.fault {
        return Err(Fault::failed(fault));
    }
    let mut differences = Differences::default();
    canvas.differences.iter().for_each(|piece| differences.add_all(piece));
    let counters = canvas.counters.iter().fold(Counters::default(), |sum, piece| sum.plus(*piece));
    Ok((FilmTile::new(window, block, canvas.sums).with_differences(differences), counters))
}

/// What the threads fill together.
struct Canvas {
    sums: Vec<Rgb>,
    /// By piece, so that their sum does not depend on who was first.
    differences: Vec<Differences>,
    counters: Vec<Counters>,
    fault: Option<String>,
}

fn pieces(window: Tile) -> Vec<Tile> {
    let shape = Resolution::new(window.width(), window.height()).expect("a window lies inside a frame");
    let moved = |tile: Tile| {
        let (x, y) = (window.x0(), window.y0());
        Tile::new(tile.x0() + x, tile.y0() + y, tile.x1() + x, tile.y1() + y)
            .expect("a moved tile keeps its size")
    };
    shape.tiles(PIECE_SIDE).map(moved).collect()
}

fn paste(tile: &FilmTile, window: Tile, sums: &mut [[f32; 3]]) {
    let piece = tile.tile();
    let left = (piece.x0() - window.x0()) as usize;
    let rows = tile.sums().chunks_exact(piece.width() as usize);
    for (y, row) in (piece.y0() - window.y0()..).zip(rows) {
        let start = y as usize * window.width() as usize + left;
        sums[start..start + row.len()].copy_from_slice(row);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_that_is_no_block_names_the_blocks_it_is_made_of() {
        let fault = block(SampleRange::new(0..100).unwrap()).unwrap_err().to_string();
        assert!(fault.contains("0..64, 64..96, 96..100"), "{fault}");
        assert!(block(SampleRange::new(64..128).unwrap()).is_ok());
        assert!(block(SampleRange::new(8..24).unwrap()).is_err());
    }

    #[test]
    fn pieces_cover_the_window() {
        let window = Tile::new(5, 7, 105, 50).unwrap();
        let mut sums = vec![[0.0; 3]; window.area()];
        for piece in pieces(window) {
            let leaf = SampleBlock::new(0..16).unwrap();
            let values = piece.pixels().map(|(x, y)| [x as f32, y as f32, 1.0]).collect();
            paste(&FilmTile::new(piece, leaf, values), window, &mut sums);
        }
        assert!(window.pixels().zip(&sums).all(|((x, y), sum)| *sum == [x as f32, y as f32, 1.0]));
    }
}
