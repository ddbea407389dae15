//! Work units and what was counted on the way to their results.

use super::ConvertError;
use crate::v1;
use farm_film::{Counters, FrameIndex, SampleBlock, Tile, WorkUnit};
use farm_job::Digest;

impl From<Tile> for v1::Tile {
    fn from(tile: Tile) -> Self {
        Self { x0: tile.x0(), y0: tile.y0(), x1: tile.x1(), y1: tile.y1() }
    }
}

impl TryFrom<v1::Tile> for Tile {
    type Error = ConvertError;

    fn try_from(tile: v1::Tile) -> Result<Self, ConvertError> {
        Ok(Self::new(tile.x0, tile.y0, tile.x1, tile.y1)?)
    }
}

impl From<SampleBlock> for v1::SampleBlock {
    fn from(block: SampleBlock) -> Self {
        Self { start: block.start(), end: block.end() }
    }
}

impl TryFrom<v1::SampleBlock> for SampleBlock {
    type Error = ConvertError;

    fn try_from(block: v1::SampleBlock) -> Result<Self, ConvertError> {
        Ok(Self::new(block.start..block.end)?)
    }
}

impl From<WorkUnit> for v1::WorkUnit {
    fn from(unit: WorkUnit) -> Self {
        Self { frame: unit.frame.0, tile: Some(unit.tile.into()), block: Some(unit.block.into()) }
    }
}

impl TryFrom<v1::WorkUnit> for WorkUnit {
    type Error = ConvertError;

    fn try_from(unit: v1::WorkUnit) -> Result<Self, ConvertError> {
        Ok(Self {
            frame: FrameIndex(unit.frame),
            tile: unit.tile.ok_or(ConvertError::Missing("tile"))?.try_into()?,
            block: unit.block.ok_or(ConvertError::Missing("sample block"))?.try_into()?,
        })
    }
}

impl From<Digest> for v1::Digest {
    fn from(digest: Digest) -> Self {
        Self { blake3: digest.0.to_vec().into() }
    }
}

impl TryFrom<v1::Digest> for Digest {
    type Error = ConvertError;

    fn try_from(digest: v1::Digest) -> Result<Self, ConvertError> {
        let bytes = <[u8; 32]>::try_from(&digest.blake3[..])
            .map_err(|_| ConvertError::DigestLength(digest.blake3.len()))?;
        Ok(Self(bytes))
    }
}

impl From<Counters> for v1::Counters {
    fn from(counters: Counters) -> Self {
        Self {
            samples: counters.samples,
            rays_camera: counters.rays_camera,
            rays_extension: counters.rays_extension,
            rays_shadow: counters.rays_shadow,
            nan: counters.nan,
            infinite: counters.infinite,
            negative: counters.negative,
            dropped: counters.dropped,
            clamped: counters.clamped,
            clamped_radiance: counters.clamped_radiance,
            triangles_not_finite: counters.triangles_not_finite,
            triangles_without_area: counters.triangles_without_area,
            instances_flattened: counters.instances_flattened,
        }
    }
}

impl From<v1::Counters> for Counters {
    fn from(counters: v1::Counters) -> Self {
        // A worker's counts are added up for years of work at most: cut them where sums could overflow.
        let cut = |count: u64| count.min(1 << 44);
        let finite = |sum: f64| if sum.is_finite() { sum.clamp(0.0, 1e100) } else { 0.0 };
        Self {
            samples: cut(counters.samples),
            rays_camera: cut(counters.rays_camera),
            rays_extension: cut(counters.rays_extension),
            rays_shadow: cut(counters.rays_shadow),
            nan: cut(counters.nan),
            infinite: cut(counters.infinite),
            negative: cut(counters.negative),
            dropped: cut(counters.dropped),
            clamped: cut(counters.clamped),
            clamped_radiance: finite(counters.clamped_radiance),
            triangles_not_finite: cut(counters.triangles_not_finite),
            triangles_without_area: cut(counters.triangles_without_area),
            instances_flattened: cut(counters.instances_flattened),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit() -> WorkUnit {
        WorkUnit {
            frame: FrameIndex(7),
            tile: Tile::new(64, 0, 100, 36).unwrap(),
            block: SampleBlock::new(32..64).unwrap(),
        }
    }

    #[test]
    fn a_unit_survives_the_journey() {
        assert_eq!(WorkUnit::try_from(v1::WorkUnit::from(unit())).unwrap(), unit());
    }

    #[test]
    fn impossible_units_are_refused() {
        let good = v1::WorkUnit::from(unit());
        let no_tile = v1::WorkUnit { tile: None, ..good };
        assert_eq!(WorkUnit::try_from(no_tile).unwrap_err().to_string(), "message has no tile");
        let empty = v1::WorkUnit { tile: Some(v1::Tile { x0: 1, y0: 0, x1: 1, y1: 5 }), ..good };
        assert!(WorkUnit::try_from(empty).is_err());
        let askew = v1::WorkUnit { block: Some(v1::SampleBlock { start: 8, end: 24 }), ..good };
        assert!(WorkUnit::try_from(askew).unwrap_err().to_string().contains("8..24"));
    }

    #[test]
    fn a_digest_has_32_bytes() {
        let digest = Digest([9; 32]);
        assert_eq!(Digest::try_from(v1::Digest::from(digest)).unwrap(), digest);
        let short = v1::Digest { blake3: vec![0; 31].into() };
        assert!(Digest::try_from(short).unwrap_err().to_string().contains("31 bytes"));
    }

    #[test]
    fn absurd_counts_cannot_overflow_a_sum() {
        let counters = Counters::from(v1::Counters { samples: u64::MAX, ..v1::Counters::default() });
        let sum = (0..1000).fold(Counters::default(), |sum, _| sum.plus(counters));
        assert!(sum.samples > 0);
    }
}
