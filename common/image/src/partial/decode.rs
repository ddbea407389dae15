//! Partial EXRs of unknown origin back to film tiles.

use super::{CHANNELS, Facts, PIXEL_BYTES, PartialHeader, VERSION};
use crate::attribute;
use crate::error::{ImageError, guarded};
use exr::block::chunk::{Chunk, CompressedBlock};
use exr::math::Vec2;
use exr::meta::BlockDescription;
use exr::meta::attribute::{Compression, SampleType};
use exr::meta::header::Header;
use farm_film::{FilmTile, Resolution, Rgb, SampleBlock, Tile};
use std::io::Cursor;

/// What a decoder may be made to hold.
#[derive(Clone, Copy, Debug)]
pub struct PartialLimits {
    /// Most pixels of a tile.
    pub pixels_max: usize,
}

impl Default for PartialLimits {
    /// 2^26 pixels: a tile that is a whole frame of 8192 x 8192, 0.8 GB of sums.
    fn default() -> Self {
        Self { pixels_max: 1 << 26 }
    }
}

/// The film tile that `bytes` hold, bit for bit, with its facts. Takes bytes of any origin: whatever is not exactly what
/// [`encode_partial`](super::encode_partial) writes is refused, and nothing is allocated that is larger than `bytes`.
/// Sums may still be infinite or NaN; whether to take those is the receiver's decision.
pub fn decode_partial(bytes: &[u8], limits: PartialLimits) -> Result<(FilmTile, PartialHeader), ImageError> {
    guarded(|| decode(bytes, limits))
}

fn decode(bytes: &[u8], limits: PartialLimits) -> Result<(FilmTile, PartialHeader), ImageError> {
    let reader = exr::block::read(Cursor::new(bytes), true)?;
    let [header] = reader.headers() else {
        return Err(refused(format!("it has {} parts instead of one", reader.headers().len())));
    };
    let (tile, resolution) = windows(header)?;
    check_encoding(header)?;
    if tile.area() > limits.pixels_max {
        return Err(ImageError::TooLarge { pixels: tile.area() as u64, allowed: limits.pixels_max as u64 });
    }
    if tile.area().saturating_mul(PIXEL_BYTES) > bytes.len() {
        return Err(refused("it is shorter than its tile"));
    }
    let facts = facts(header)?;
    let block = SampleBlock::try_from(facts.samples).map_err(refused)?;

    if !facts.differences.fit(tile.area(), block.samples()) {
        return Err(refused("its sibling differences are none of such a block"));
    }
    let mut rows = Rows::new(tile);
    for chunk in reader.all_chunks(true)? {
        rows.take(chunk?)?;
    }
    let header = PartialHeader {
        resolution,
        frame: facts.frame,
        scene: facts.scene,
        settings: facts.settings,
        seed: facts.seed,
        renderer: facts.renderer,
        counters: facts.counters,
    };
    Ok((FilmTile::new(tile, block, rows.finish()?).with_differences(facts.differences), header))
}

fn refused(fault: impl ToString) -> ImageError {
    ImageError::Partial(fault.to_string())
}

/// Data window and display window, which must lie in one another.
fn windows(header: &Header) -> Result<(Tile, Resolution), ImageError> {
    let display = header.shared_attributes.display_window;
    let side = |value: usize| u32::try_from(value).unwrap_or(u32::MAX);
    let resolution = Resolution::new(side(display.size.0), side(display.size.1)).map_err(refused)?;
    let Vec2(x0, y0) = header.own_attributes.layer_position;
    let (Ok(x0), Ok(y0), Vec2(0, 0)) = (u32::try_from(x0), u32::try_from(y0), display.position) else {
        return Err(refused("its windows do not start at the frame's corner or inside it"));
    };
    let (x1, y1) =
        (x0.saturating_add(side(header.layer_size.0)), y0.saturating_add(side(header.layer_size.1)));
    let tile = Tile::new(x0, y0, x1, y1).map_err(refused)?;
    if !resolution.contains(tile) {
        return Err(refused(format!("its tile {tile} is not inside its frame of {resolution}")));
    }
    Ok((tile, resolution))
}

fn check_encoding(header: &Header) -> Result<(), ImageError> {
    if header.deep || header.blocks != BlockDescription::ScanLines {
        return Err(refused("its pixels are not in scanlines"));
    }
    if header.compression != Compression::Uncompressed {
        return Err(refused(format!("its pixels are compressed ({})", header.compression)));
    }
    let found = header.channels.list.iter();
    let as_written = found.len() == CHANNELS.len()
        && found.zip(CHANNELS).all(|(channel, (name, _))| {
            channel.name == *name && channel.sample_type == SampleType::F32 && channel.sampling == Vec2(1, 1)
        });
    if as_written { Ok(()) } else { Err(refused("its channels are not R, G, B of 32-bit floats")) }
}

fn facts(header: &Header) -> Result<Facts, ImageError> {
    let facts: Facts = attribute::find(&header.own_attributes)
        .ok_or_else(|| refused("it does not say which scene, frame and samples it holds"))?
        .map_err(refused)?;
    if header.own_attributes.other.len() != 1 || !header.shared_attributes.other.is_empty() {
        return Err(refused("it has attributes that no partial has"));
    }
    if facts.version != VERSION {
        return Err(refused(format!("its version is {} instead of {VERSION}", facts.version)));
    }
    Ok(facts)
}

/// Collects rows in whatever order they come, each exactly once.
struct Rows {
    tile: Tile,
    sums: Vec<Rgb>,
    seen: Vec<bool>,
}

impl Rows {
    fn new(tile: Tile) -> Self {
        Self { tile, sums: vec![[0.0; 3]; tile.area()], seen: vec![false; tile.height() as usize] }
    }

    fn take(&mut self, chunk: Chunk) -> Result<(), ImageError> {
        let CompressedBlock::ScanLine(block) = chunk.compressed_block else {
            return Err(refused("its pixels are not in scanlines"));
        };
        let width = self.tile.width() as usize;
        let row = i64::from(block.y_coordinate) - i64::from(self.tile.y0());
        let seen = usize::try_from(row).ok().and_then(|row| self.seen.get_mut(row));
        let bytes = block.compressed_pixels_le;
        let (Some(seen @ false), true) = (seen, bytes.len() == width * PIXEL_BYTES) else {
            return Err(refused(format!("its row {} is doubled, misplaced or cut", block.y_coordinate)));
        };
        *seen = true;
        let sums = &mut self.sums[row as usize * width..][..width];
        for ((_, channel), values) in CHANNELS.iter().zip(bytes.chunks_exact(width * 4)) {
            for (sum, value) in sums.iter_mut().zip(values.chunks_exact(4)) {
                sum[*channel] = f32::from_le_bytes([value[0], value[1], value[2], value[3]]);
            }
        }
        Ok(())
    }

    fn finish(self) -> Result<Vec<Rgb>, ImageError> {
        if self.seen.iter().all(|seen| *seen) { Ok(self.sums) } else { Err(refused("rows are missing")) }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::partial;
    use super::super::{encode_partial, exr_header};
    use super::*;
    use exr::meta::attribute::{AttributeValue, IntegerBounds, Text};

    fn decoded(bytes: &[u8]) -> Result<(FilmTile, PartialHeader), ImageError> {
        decode_partial(bytes, PartialLimits::default())
    }

    /// An uncompressed EXR with this header and rows of zeros.
    fn foreign(header: Header) -> Vec<u8> {
        let mut out = Cursor::new(Vec::new());
        let headers = exr::prelude::SmallVec::from_iter([header]);
        exr::block::write(&mut out, headers, true, |meta, writer| {
            use exr::block::writer::ChunksWriter;
            let channels = &meta.headers[0].channels;
            let blocks = meta.collect_ordered_blocks(|index| {
                exr::block::UncompressedBlock::from_lines(channels, index, |_| {})
            });
            writer.on_progress(|_| {}).compress_all_blocks_sequential(&meta, blocks)
        })
        .unwrap();
        out.into_inner()
    }

    fn refusal(change: impl FnOnce(&mut Header)) -> String {
        let (tile, facts) = partial(8, 8, 12, 12);
        let mut header = exr_header(&tile, &facts);
        change(&mut header);
        decoded(&foreign(header)).unwrap_err().to_string()
    }

    #[test]
    fn what_no_partial_has_is_refused_by_a_sentence() {
        let channel = |name: &str, kind| exr::meta::attribute::ChannelDescription::new(name, kind, false);
        let cases = [
            refusal(|header| header.own_attributes.other.clear()),
            refusal(|header| {
                let text = AttributeValue::Text(Text::new_or_panic("second"));
                header.own_attributes.other.insert(Text::new_or_panic("another"), text);
            }),
            refusal(|header| {
                let text = AttributeValue::Text(Text::new_or_panic("{\"version\":2}"));
                header.own_attributes.other.insert(Text::new_or_panic("tessera"), text);
            }),
            refusal(|header| header.channels.list[0] = channel("B", SampleType::F16)),
            refusal(|header| header.channels.list[0] = channel("A", SampleType::F32)),
            refusal(|header| header.own_attributes.layer_position = Vec2(-1, 8)),
            refusal(|header| header.own_attributes.layer_position = Vec2(957, 8)),
            refusal(|header| {
                header.shared_attributes.display_window = IntegerBounds::new((1, 0), (960, 540))
            }),
            refusal(|header| {
                header.shared_attributes.display_window = IntegerBounds::from_dimensions((100_000, 540))
            }),
            refusal(|header| {
                *header = header.clone().with_encoding(Compression::ZIP1, header.blocks, header.line_order)
            }),
        ];
        for (sentence, part) in cases.iter().zip([
            "does not say",
            "attributes",
            "missing field",
            "channels",
            "channels",
            "windows",
            "not inside",
            "windows",
            "out of range",
            "compressed",
        ]) {
            assert!(sentence.contains(part), "{sentence:?} speaks of {part:?}");
        }
    }

    #[test]
    fn a_bomb_is_refused_before_it_is_held() {
        let (tile, facts) = partial(0, 0, 32, 32);
        let bytes = encode_partial(&tile, &facts);
        let small = PartialLimits { pixels_max: 1023 };
        assert!(matches!(
            decode_partial(&bytes, small),
            Err(ImageError::TooLarge { pixels: 1024, allowed: 1023 })
        ));
        // A header that announces far more than follows.
        let large =
            FilmTile::new(Tile::new(0, 0, 960, 540).unwrap(), tile.block(), vec![[0.0; 3]; 960 * 540]);
        let bytes = encode_partial(&large, &facts);
        assert!(decoded(&bytes[..bytes.len() / 2]).unwrap_err().to_string().contains("shorter"));
    }

    #[test]
    fn cut_or_extended_partials_are_refused() {
        let (tile, facts) = partial(0, 0, 4, 3);
        let mut bytes = encode_partial(&tile, &facts);
        for length in 0..bytes.len() {
            assert!(decoded(&bytes[..length]).is_err(), "{length} of {} bytes", bytes.len());
        }
        bytes.push(0);
        assert!(decoded(&bytes).is_err());
    }

    #[test]
    fn a_doubled_row_is_refused() {
        let (tile, facts) = partial(0, 0, 4, 3);
        let mut bytes = encode_partial(&tile, &facts);
        let row = 8 + 4 * PIXEL_BYTES;
        let last = bytes.len() - row;
        bytes.copy_within(last - row..last, last);
        assert!(decoded(&bytes).unwrap_err().to_string().contains("row 1"));
    }

    /// Small deterministic generator (Steele, Lea, Flood 2014: SplitMix64).
    fn split_mix(state: &mut u64) -> u64 {
        *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (*state ^ (*state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    #[test]
    fn damaged_partials_neither_panic_nor_stall() {
        let (tile, facts) = partial(8, 8, 16, 16);
        let good = encode_partial(&tile, &facts);
        let header_bytes = good.len() - 8 * (16 + 8 * PIXEL_BYTES);
        let started = std::time::Instant::now();
        for seed in 0..6000u64 {
            let mut state = seed;
            let mut bytes = good.clone();
            for _ in 0..=split_mix(&mut state) % 4 {
                // Mostly in the header, where the damage is interesting.
                let end = if seed % 4 == 0 { bytes.len() } else { header_bytes };
                let at = split_mix(&mut state) as usize % end;
                bytes[at] = match split_mix(&mut state) % 3 {
                    0 => 0xff,
                    1 => 0,
                    _ => split_mix(&mut state) as u8,
                };
            }
            let outcome = std::panic::catch_unwind(|| decode(&bytes, PartialLimits::default()));
            assert!(outcome.is_ok(), "seed {seed} panics");
            if let Ok((tile, _)) = decoded(&bytes) {
                assert!(tile.tile().area() * PIXEL_BYTES <= bytes.len(), "seed {seed}");
            }
        }
        assert!(started.elapsed().as_secs() < 60, "took {:?}", started.elapsed());
    }
}
