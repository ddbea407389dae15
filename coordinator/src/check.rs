//! Whether a result is what it claims to be. Takes bytes of any origin.

use farm_film::{Counters, FilmTile};
use farm_image::{ImageError, PartialHeader, PartialLimits, decode_partial};
use farm_job::JobSpec;
use farm_proto::PARTIAL_BYTES_MAX;
use farm_proto::convert::UnitResult;
use farm_worker::frames::partial_header;

/// A result that is not taken.
#[derive(Debug, thiserror::Error)]
pub enum Defect {
    /// Other bytes than were sent.
    #[error("the result's digest differs: it was damaged on the way")]
    Digest,
    /// No partial EXR.
    #[error("the result cannot be read: {0}")]
    Unreadable(#[from] ImageError),
    /// The partial of something else.
    #[error("the result is of another {what}: {found} instead of {expected}")]
    Other {
        /// Which fact differs.
        what: &'static str,
        /// In the file.
        found: String,
        /// As it should be.
        expected: String,
    },
    /// The file counts otherwise than the message.
    #[error("the result's counters differ from those in its file")]
    Counters,
    /// Holds what no healthy renderer returns.
    #[error("the result has pixels that are not finite")]
    NotFinite,
}

/// A result that is what it claims to be.
pub struct Checked {
    /// Its sums.
    pub tile: FilmTile,
    /// What was traced, as the partial itself says.
    pub counters: Counters,
}

/// Compares digest, window, samples, frame, scene, settings and renderer with what was asked, and looks at every pixel.
pub fn check(result: &UnitResult, spec: &JobSpec) -> Result<Checked, Defect> {
    if blake3::hash(&result.partial_exr).as_bytes() != &result.digest.0 {
        return Err(Defect::Digest);
    }
    let limits = PartialLimits { pixels_max: PARTIAL_BYTES_MAX / 12 };
    let (tile, header) = decode_partial(&result.partial_exr, limits)?;
    let unit = &result.unit;
    same("tile", &tile.tile(), &unit.tile)?;
    same("sample block", &tile.block(), &unit.block)?;
    let resolution = spec.resolution().map_err(|err| ImageError::Partial(err.to_string()))?;
    check_header(&header, &partial_header(resolution, spec.scene, &spec.settings, unit.frame))?;
    if header.counters != result.counters {
        return Err(Defect::Counters);
    }
    if !tile.is_finite() {
        return Err(Defect::NotFinite);
    }
    Ok(Checked { tile, counters: header.counters })
}

/// Everything but the counters must agree.
pub fn check_header(found: &PartialHeader, expected: &PartialHeader) -> Result<(), Defect> {
    same("renderer", &found.renderer, &expected.renderer)?;
    same("frame", &found.frame, &expected.frame)?;
    same("resolution", &found.resolution, &expected.resolution)?;
    same("scene", &hex(found.scene), &hex(expected.scene))?;
    same("seed", &found.seed, &expected.seed)?;
    same("set of settings", &hex(found.settings), &hex(expected.settings))
}

fn hex(digest: [u8; 32]) -> blake3::Hash {
    blake3::Hash::from_bytes(digest)
}

fn same<T: PartialEq + ToString>(what: &'static str, found: &T, expected: &T) -> Result<(), Defect> {
    if found == expected {
        return Ok(());
    }
    Err(Defect::Other { what, found: found.to_string(), expected: expected.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytes::Bytes;
    use farm_film::{FrameIndex, SampleBlock, Tile, WorkUnit};
    use farm_image::encode_partial;
    use farm_job::{Digest, FrameRange, JobId, LeaseId, Stop};
    use farm_scene::{Filter, Integrator, SceneId, Settings};
    use std::time::Duration;

    fn spec() -> JobSpec {
        let settings = Settings {
            camera: 0,
            width: 16,
            height: 8,
            integrator: Integrator::Path,
            filter: Filter::Box,
            max_depth: 4,
            seed: 9,
            fps: 24.0,
            clamp: None,
        };
        JobSpec {
            name: "box".into(),
            scene: SceneId([1; 32]),
            settings,
            frames: FrameRange::single(0),
            spp: 64,
            stop: Stop::default(),
            variance: false,
            tile_side: 8,
            priority: 0,
        }
    }

    fn unit() -> WorkUnit {
        WorkUnit {
            frame: FrameIndex(0),
            tile: Tile::new(8, 0, 16, 8).unwrap(),
            block: SampleBlock::new(16..32).unwrap(),
        }
    }

    fn result(change: impl FnOnce(&mut PartialHeader), value: f32) -> UnitResult {
        let spec = spec();
        let mut header = partial_header(spec.resolution().unwrap(), spec.scene, &spec.settings, unit().frame);
        header.counters.samples = 1024;
        change(&mut header);
        let tile = FilmTile::new(unit().tile, unit().block, vec![[value; 3]; 64]);
        let partial_exr = Bytes::from(encode_partial(&tile, &header));
        UnitResult {
            lease: LeaseId(1),
            job: JobId(1),
            unit: unit(),
            digest: Digest(*blake3::hash(&partial_exr).as_bytes()),
            partial_exr,
            render: Duration::ZERO,
            cpu: Duration::ZERO,
            counters: header.counters,
        }
    }

    #[test]
    fn an_honest_result_is_taken() {
        let checked = check(&result(|_| {}, 1.5), &spec()).ok().unwrap();
        assert_eq!(checked.counters.samples, 1024);
        assert_eq!(checked.tile.sums()[0], [1.5; 3]);
    }

    #[test]
    fn results_of_something_else_are_refused_by_name() {
        let refusal = |result: UnitResult| check(&result, &spec()).err().unwrap().to_string();
        assert!(refusal(result(|header| header.scene = [2; 32], 1.0)).contains("another scene"));
        assert!(refusal(result(|header| header.settings = [2; 32], 1.0)).contains("set of settings"));
        assert!(refusal(result(|header| header.seed = 1, 1.0)).contains("another seed: 1 instead of 9"));
        assert!(
            refusal(result(|header| header.renderer = "old".into(), 1.0)).contains("another renderer: old")
        );
        assert!(refusal(result(|header| header.frame = FrameIndex(3), 1.0)).contains("another frame"));
        let mut moved = result(|_| {}, 1.0);
        moved.unit.tile = Tile::new(0, 0, 8, 8).unwrap();
        assert!(refusal(moved).contains("another tile"));
        let mut later = result(|_| {}, 1.0);
        later.unit.block = SampleBlock::new(0..16).unwrap();
        assert!(refusal(later).contains("another sample block"));
    }

    #[test]
    fn damaged_results_are_refused() {
        let mut damaged = result(|_| {}, 1.0);
        damaged.partial_exr = damaged.partial_exr.slice(..damaged.partial_exr.len() - 1);
        assert!(matches!(check(&damaged, &spec()), Err(Defect::Digest)));
        damaged.digest = Digest(*blake3::hash(&damaged.partial_exr).as_bytes());
        assert!(matches!(check(&damaged, &spec()), Err(Defect::Unreadable(_))));
        let mut boasting = result(|_| {}, 1.0);
        boasting.counters.rays_shadow = 1 << 40;
        assert!(matches!(check(&boasting, &spec()), Err(Defect::Counters)));
        assert!(matches!(check(&result(|_| {}, f32::NAN), &spec()), Err(Defect::NotFinite)));
    }
}
