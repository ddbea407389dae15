//! Film tiles as partial EXRs: what travels on the wire, lies in the store and is merged.
//!
//! Data window = the tile, display window = the frame, channels R, G, B = f32 sums (not means) over the tile's samples,
//! uncompressed scanlines, one JSON attribute. The same tile and header give the same bytes, always.

mod decode;

use crate::attribute;
pub use decode::{PartialLimits, decode_partial};
use exr::block::chunk::{Chunk, CompressedBlock, CompressedScanLineBlock};
use exr::block::writer::ChunksWriter;
use exr::math::Vec2;
use exr::meta::BlockDescription;
use exr::meta::attribute::{ChannelDescription, Compression, IntegerBounds, LineOrder, SampleType};
use exr::meta::header::{Header, LayerAttributes};
use exr::prelude::SmallVec;
use farm_film::{Counters, Differences, FilmTile, FrameIndex, Resolution, Rgb, SampleRange};
use serde::{Deserialize, Serialize};
use std::io::Cursor;

/// Version of the JSON attribute; another one is refused.
const VERSION: u32 = 3;

/// Channels in the order of the file, which is that of their names, with their place in [`Rgb`].
const CHANNELS: [(&str, usize); 3] = [("B", 2), ("G", 1), ("R", 0)];

/// Bytes of one pixel: three f32.
const PIXEL_BYTES: usize = 12;

/// Facts that travel with a film tile and hold wherever it goes: nothing in here names a job, a worker or a time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PartialHeader {
    /// Of the frame that the tile is part of.
    pub resolution: Resolution,
    /// Which picture of the sequence.
    pub frame: FrameIndex,
    /// Digest of the scene.
    pub scene: [u8; 32],
    /// Digest of the settings.
    pub settings: [u8; 32],
    /// Seed of the job's samples.
    pub seed: u64,
    /// Fingerprint of the renderer: version and arithmetic.
    pub renderer: String,
    /// What was traced for this tile.
    pub counters: Counters,
}

/// The JSON attribute.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Facts {
    version: u32,
    frame: FrameIndex,
    samples: SampleRange,
    #[serde(with = "crate::digest::hex")]
    scene: [u8; 32],
    #[serde(with = "crate::digest::hex")]
    settings: [u8; 32],
    seed: u64,
    renderer: String,
    counters: Counters,
    differences: Differences,
}

/// The partial EXR of `tile`, which must lie inside the frame.
pub fn encode_partial(tile: &FilmTile, header: &PartialHeader) -> Vec<u8> {
    assert!(header.resolution.contains(tile.tile()), "a tile lies inside its frame");
    let bytes = tile.tile().area() * PIXEL_BYTES + tile.tile().height() as usize * 16 + 2048;
    let mut out = Cursor::new(Vec::with_capacity(bytes));
    let headers = SmallVec::from_iter([exr_header(tile, header)]);
    exr::block::write(&mut out, headers, true, |_, writer| {
        let rows = tile.sums().chunks_exact(tile.tile().width() as usize);
        for (index, row) in rows.enumerate() {
            writer.write_chunk(index, chunk(tile.tile().y0() as i32 + index as i32, row))?;
        }
        Ok(())
    })
    .expect("a valid header and all its rows can be written to memory");
    out.into_inner()
}

fn exr_header(tile: &FilmTile, header: &PartialHeader) -> Header {
    let facts = Facts {
        version: VERSION,
        frame: header.frame,
        samples: tile.block().into(),
        scene: header.scene,
        settings: header.settings,
        seed: header.seed,
        renderer: header.renderer.clone(),
        counters: header.counters,
        differences: tile.differences().clone(),
    };
    let window = tile.tile();
    let mut attributes = LayerAttributes {
        layer_position: Vec2(window.x0() as i32, window.y0() as i32),
        ..LayerAttributes::default()
    };
    attribute::insert(&mut attributes, &facts);
    let channels = CHANNELS.iter().map(|(name, _)| ChannelDescription::new(*name, SampleType::F32, false));
    let size = Vec2(window.width() as usize, window.height() as usize);
    let frame = Vec2(header.resolution.width() as usize, header.resolution.height() as usize);
    Header::new("".into(), size, channels.collect())
        .with_encoding(Compression::Uncompressed, BlockDescription::ScanLines, LineOrder::Increasing)
        .with_display_window(IntegerBounds::from_dimensions(frame))
        .with_attributes(attributes)
}

/// One row of pixels as the file has it: channel after channel.
fn chunk(y_coordinate: i32, row: &[Rgb]) -> Chunk {
    let mut bytes = Vec::with_capacity(row.len() * PIXEL_BYTES);
    for (_, channel) in CHANNELS {
        bytes.extend(row.iter().flat_map(|pixel| pixel[channel].to_bits().to_le_bytes()));
    }
    let block = CompressedScanLineBlock { y_coordinate, compressed_pixels_le: bytes };
    Chunk { layer_index: 0, compressed_block: CompressedBlock::ScanLine(block) }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use farm_film::{SampleBlock, Tile};

    /// A partial with every kind of float in it.
    pub(crate) fn partial(x0: u32, y0: u32, x1: u32, y1: u32) -> (FilmTile, PartialHeader) {
        let tile = Tile::new(x0, y0, x1, y1).unwrap();
        let odd = [-0.0, f32::MIN_POSITIVE / 8.0, f32::MAX, f32::NEG_INFINITY, 1.0e-45, 0.1];
        let value = |index: usize| if index.is_multiple_of(5) { odd[index % 6] } else { index as f32 * 0.37 };
        let sums =
            (0..tile.area()).map(|pixel| [value(pixel * 3), value(pixel * 3 + 1), value(pixel * 3 + 2)]);
        let header = PartialHeader {
            resolution: Resolution::new(960, 540).unwrap(),
            frame: FrameIndex(u32::MAX),
            scene: [0xab; 32],
            settings: [7; 32],
            seed: u64::MAX,
            renderer: "tessera 0.1.0 «libm»".to_owned(),
            counters: Counters { samples: u64::MAX, rays_camera: 12, nan: 1, ..Counters::default() },
        };
        (FilmTile::new(tile, SampleBlock::new(32..64).unwrap(), sums.collect()), header)
    }

    /// Three leaves of one pixel's samples, as a tile of 2x1 pixels with everything that is known of it.
    fn observed() -> FilmTile {
        let tile = Tile::new(4, 4, 6, 5).unwrap();
        let leaf = |start: u64| {
            let mut differences = Differences::default();
            let mut pixel = |pixel: u64| {
                let mut leaf = farm_film::LeafSum::default();
                for index in start..start + 16 {
                    let value = ((index * 37 + pixel * 11) % 101) as f32 / 3.0;
                    leaf.add([value, value * value, 0.1], &mut differences);
                }
                leaf
            };
            let leaves = [pixel(0), pixel(1)];
            FilmTile::leaf(tile, SampleBlock::new(start..start + 16).unwrap(), &leaves, differences)
        };
        leaf(32).merge(leaf(48))
    }

    #[test]
    fn differences_come_back_bit_for_bit() {
        let (tile, (_, header)) = (observed(), partial(4, 4, 6, 5));
        assert!(
            tile.differences().levels().iter().all(|level| level.pairs > 0 && level.squared.value() > 0.0)
        );
        let bytes = encode_partial(&tile, &header);
        assert_eq!(decode_partial(&bytes, PartialLimits::default()).unwrap().0, tile);
    }

    #[test]
    fn differences_that_cannot_be_are_refused() {
        let (tile, (_, header)) = (observed(), partial(4, 4, 6, 5));
        let leaf = FilmTile::new(tile.tile(), SampleBlock::new(0..16).unwrap(), tile.sums().to_vec());
        let lying = encode_partial(&leaf.with_differences(tile.differences().clone()), &header);
        let refusal = decode_partial(&lying, PartialLimits::default()).unwrap_err().to_string();
        assert!(refusal.contains("sibling differences"), "{refusal}");
    }

    fn bits(tile: &FilmTile) -> Vec<u32> {
        tile.sums().iter().flatten().map(|value| value.to_bits()).collect()
    }

    #[test]
    fn a_partial_comes_back_bit_for_bit() {
        for (x0, y0, x1, y1) in
            [(64, 128, 128, 192), (0, 0, 1, 1), (959, 539, 960, 540), (0, 0, 960, 540), (3, 5, 7, 50)]
        {
            let (tile, header) = partial(x0, y0, x1, y1);
            let bytes = encode_partial(&tile, &header);
            let (tile_back, header_back) = decode_partial(&bytes, PartialLimits::default()).unwrap();
            assert_eq!(bits(&tile_back), bits(&tile));
            assert_eq!((tile_back.tile(), tile_back.block()), (tile.tile(), tile.block()));
            assert_eq!(header_back, header);
        }
    }

    #[test]
    fn the_same_partial_gives_the_same_bytes_on_every_thread() {
        let encode = || {
            let (tile, header) = partial(64, 128, 80, 150);
            encode_partial(&tile, &header)
        };
        let first = encode();
        let threads: Vec<_> = (0..4)
            .map(|_| std::thread::spawn(move || (0..25).map(|_| encode()).collect::<Vec<_>>()))
            .collect();
        for thread in threads {
            assert!(thread.join().unwrap().iter().all(|bytes| *bytes == first));
        }
    }

    #[test]
    fn any_viewer_sees_the_sums_in_their_place() {
        use exr::prelude::{ReadChannels, ReadLayers};
        let (tile, header) = partial(64, 128, 72, 130);
        let bytes = encode_partial(&tile, &header);
        let image = exr::prelude::read()
            .no_deep_data()
            .largest_resolution_level()
            .rgb_channels(
                |size, _| vec![[0.0f32; 3]; size.area()],
                |pixels: &mut Vec<Rgb>, position, (r, g, b)| pixels[position.1 * 8 + position.0] = [r, g, b],
            )
            .first_valid_layer()
            .all_attributes()
            .from_buffered(Cursor::new(bytes))
            .unwrap();
        assert_eq!(image.layer_data.channel_data.pixels, tile.sums());
        assert_eq!(image.layer_data.attributes.layer_position, Vec2(64, 128));
        assert_eq!(image.attributes.display_window.size, Vec2(960, 540));
    }
}
