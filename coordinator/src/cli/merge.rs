//! Partials that were rendered on machines that never met become one picture.

use super::{print, print_json};
use crate::check::check_header;
use crate::forecast::Cause;
use crate::outputs::{FinishedFrame, FrameNames, FrameSummary, OutputPlan, write_resolved};
use farm_film::{Counters, Film, FilmTile, SampleRange, Tile};
use farm_image::{PartialHeader, PartialLimits, decode_partial};
use farm_worker::cli::Fault;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Merge partials of one frame into a picture
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Refuses overlaps, gaps, and partials of another scene, of other settings or of another renderer.

Examples:
  coordinator merge a.exr b.exr -o scene.exr
  coordinator merge parts/*.exr -o scene.exr --preview")]
pub struct MergeArgs {
    /// Partials, in any order
    #[arg(required = true, value_name = "PART.exr")]
    parts: Vec<PathBuf>,
    /// Where to write the picture
    #[arg(short, long, env = "FARM_OUTPUT", value_name = "OUT.exr")]
    output: PathBuf,
    /// Write a tone-mapped PNG beside it
    #[arg(long, env = "FARM_PREVIEW")]
    preview: bool,
    /// Print one JSON object
    #[arg(long, env = "FARM_JSON")]
    json: bool,
}

struct Part {
    path: PathBuf,
    tile: FilmTile,
    header: PartialHeader,
}

/// Reads, checks, merges, writes.
pub fn run(args: &MergeArgs) -> Result<(), Fault> {
    let names = FrameNames::new(&args.output, false).map_err(Fault::input)?;
    let parts: Vec<Part> = args.parts.iter().map(|path| read(path)).collect::<Result<_, _>>()?;
    let summary = merge(parts, &names, args.preview)?;
    for warning in summary.counters.warnings() {
        eprintln!("warning: {warning}");
    }
    if args.json {
        print_json(&summary)
    } else {
        let outputs: Vec<_> = summary.outputs.iter().map(|path| path.display().to_string()).collect();
        print(&format!("wrote {}\ndigest {}", outputs.join(", "), summary.digest))
    }
}

fn read(path: &Path) -> Result<Part, Fault> {
    let fault = |what: &dyn std::fmt::Display| Fault::input(format!("{}: {what}", path.display()));
    let bytes = std::fs::read(path).map_err(|err| fault(&err))?;
    let (tile, header) = decode_partial(&bytes, PartialLimits::default()).map_err(|err| fault(&err))?;
    if !tile.is_finite() {
        return Err(fault(&"it has pixels that are not finite: render it again"));
    }
    Ok(Part { path: path.to_owned(), tile, header })
}

fn merge(parts: Vec<Part>, names: &FrameNames, preview: bool) -> Result<FrameSummary, Fault> {
    let first = parts.first().expect("at least one partial is required");
    let header = first.header.clone();
    for part in &parts {
        check_header(&part.header, &header).map_err(|defect| {
            let (path, first) = (part.path.display(), first.path.display());
            Fault::input(format!("{path} does not belong to {first}: {defect}"))
        })?;
    }
    check_cover(&parts, &header)?;
    let end =
        parts.iter().map(|part| part.tile.block().end()).max().expect("at least one partial is required");
    let samples = SampleRange::new(0..end).map_err(Fault::input)?;
    let tiles: Vec<Tile> = by_tile(&parts).into_keys().collect();
    let mut film = Film::with_tiles(header.resolution, tiles, samples).map_err(Fault::input)?;
    let counters = parts.iter().fold(Counters::default(), |sum, part| sum.plus(part.header.counters));
    for part in parts {
        film.add(part.tile).map_err(|err| Fault::input(format!("{}: {err}", part.path.display())))?;
    }
    if !film.is_complete() {
        return Err(Fault::input("the partials do not make up a whole picture"));
    }
    let plan = OutputPlan { names: names.clone(), preview, scene_name: String::new(), reference: None };
    let finished = FinishedFrame {
        frame: header.frame,
        spp: film.spp(),
        ended: Cause::Samples,
        adaptive: None,
        error: film.error_estimate(),
        film,
        counters,
        render: Duration::ZERO,
        checkpoints: Vec::new(),
        variance: None,
        notes: serde_json::Map::new(),
    };
    write_resolved(&header, &plan, &finished).map_err(Fault::failed)
}

fn by_tile(parts: &[Part]) -> BTreeMap<Tile, Vec<&Part>> {
    let mut tiles: BTreeMap<Tile, Vec<&Part>> = BTreeMap::new();
    for part in parts {
        tiles.entry(part.tile.tile()).or_default().push(part);
    }
    for same in tiles.values_mut() {
        same.sort_by_key(|part| (part.tile.block().start(), part.tile.block().end()));
    }
    tiles
}

/// Windows must be disjoint and cover the frame, and each must have the same samples, from the first one on.
fn check_cover(parts: &[Part], header: &PartialHeader) -> Result<(), Fault> {
    let tiles = by_tile(parts);
    let end = parts.iter().map(|part| part.tile.block().end()).max().unwrap_or(0);
    for (tile, same) in &tiles {
        check_samples(*tile, same, end)?;
    }
    let list: Vec<(&Tile, &&Part)> = tiles.iter().map(|(tile, same)| (tile, &same[0])).collect();
    for (index, (tile, part)) in list.iter().enumerate() {
        // Sorted by row: only those that begin above this one's end can meet it.
        let mut below = list[index + 1..].iter().take_while(|(other, _)| other.y0() < tile.y1());
        if let Some((_, other)) = below.find(|(other, _)| other.overlaps(**tile)) {
            let (a, b) = (part.path.display(), other.path.display());
            return Err(Fault::input(format!(
                "{a} and {b} overlap: {} and {}",
                part.tile.tile(),
                other.tile.tile()
            )));
        }
    }
    let covered: usize = tiles.keys().map(|tile| tile.area()).sum();
    let missing = header.resolution.area() - covered;
    if missing > 0 {
        return Err(Fault::input(format!(
            "{missing} of the {} pixels are in none of the partials",
            header.resolution.area()
        )));
    }
    Ok(())
}

fn check_samples(tile: Tile, same: &[&Part], end: u64) -> Result<(), Fault> {
    let mut next = 0;
    for (index, part) in same.iter().enumerate() {
        let block = part.tile.block();
        if block.start() < next {
            let before = same[index - 1].path.display();
            return Err(Fault::input(format!(
                "{before} and {} overlap: both hold sample {} of tile {tile}",
                part.path.display(),
                block.start()
            )));
        }
        if block.start() > next {
            return Err(Fault::input(format!(
                "samples {next}..{} of tile {tile} are missing: no partial holds them, though {} goes on from there",
                block.start(),
                part.path.display()
            )));
        }
        next = block.end();
    }
    if next < end {
        return Err(Fault::input(format!(
            "samples {next}..{end} of tile {tile} are missing: other tiles have them"
        )));
    }
    Ok(())
}

#[cfg(test)]
#[path = "merge_tests.rs"]
mod tests;
