//! A scene as bytes, and the name those bytes give it. The only place that knows bincode.

use crate::{Scene, SceneError, Settings};
use bincode::error::DecodeError;
use serde::{Deserialize, Serialize};

/// Most bytes that a snapshot may have: what a worker could hold.
const SNAPSHOT_BYTES_MAX: usize = 16 << 30;

/// Decodes with a limit of its own.
type Decode = fn(&[u8]) -> Result<(Scene, usize), DecodeError>;

/// How much is decoded of snapshots up to a size. Texts are allocated as long as they claim to be, so that the limit has to
/// be near the snapshot's own size; and it has to be known when this is compiled.
const DECODERS: [(usize, Decode); 6] = [
    (1 << 16, decode_within::<{ 1 << 17 }>),
    (1 << 20, decode_within::<{ 1 << 21 }>),
    (1 << 24, decode_within::<{ 1 << 25 }>),
    (1 << 28, decode_within::<{ 1 << 29 }>),
    (1 << 32, decode_within::<{ 1 << 33 }>),
    (SNAPSHOT_BYTES_MAX, decode_within::<{ 2 * SNAPSHOT_BYTES_MAX }>),
];

/// Digest (BLAKE3) of a scene's snapshot.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct SceneId(pub [u8; 32]);

/// A snapshot that is none.
#[derive(Debug, thiserror::Error)]
pub enum SnapshotError {
    /// Bytes that do not decode.
    #[error("scene snapshot cannot be decoded: {0}")]
    Decode(String),
    /// More bytes than the scene has.
    #[error("scene snapshot has {0} bytes after its end")]
    Trailing(usize),
    /// A scene whose parts do not fit together.
    #[error("scene snapshot is inconsistent: {0}")]
    Invalid(#[from] SceneError),
}

impl std::fmt::Display for SceneId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl std::fmt::Debug for SceneId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "SceneId({self})")
    }
}

impl SceneId {
    /// The name of a snapshot.
    pub fn of(snapshot: &[u8]) -> Self {
        Self(*blake3::hash(snapshot).as_bytes())
    }
}

/// The scene as bytes; equal scenes give equal bytes.
pub fn encode(scene: &Scene) -> Vec<u8> {
    bincode::serde::encode_to_vec(scene, bincode::config::standard().with_fixed_int_encoding())
        .expect("plain data encodes")
}

/// Names settings: equal settings have equal digests, and only partials of equal ones are ever merged.
pub fn settings_digest(settings: &Settings) -> [u8; 32] {
    let bytes =
        bincode::serde::encode_to_vec(settings, bincode::config::standard().with_fixed_int_encoding())
            .expect("plain data encodes");
    *blake3::hash(&bytes).as_bytes()
}

/// The scene that `snapshot` holds, checked like any other input.
pub fn decode(snapshot: &[u8]) -> Result<Scene, SnapshotError> {
    let fitting = DECODERS.iter().find(|(bytes_max, _)| snapshot.len() <= *bytes_max);
    let (_, decode) =
        fitting.ok_or_else(|| SnapshotError::Decode("it is larger than any worker".to_owned()))?;
    let (scene, read) = decode(snapshot).map_err(|err| SnapshotError::Decode(err.to_string()))?;
    if read != snapshot.len() {
        return Err(SnapshotError::Trailing(snapshot.len() - read));
    }
    scene.validate()?;
    Ok(scene)
}

fn decode_within<const LIMIT: usize>(snapshot: &[u8]) -> Result<(Scene, usize), DecodeError> {
    let config = bincode::config::standard().with_fixed_int_encoding().with_limit::<LIMIT>();
    bincode::serde::decode_from_slice(snapshot, config)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Camera, Node, Projection, Shutter, Transform};

    fn scene() -> Scene {
        let node = Node {
            name: "eye".to_owned(),
            parent: None,
            transform: Transform::IDENTITY,
            motion_vector: None,
            instances: Vec::new(),
            skin: None,
            morph_weights: Vec::new(),
        };
        let camera = Camera {
            name: "eye".to_owned(),
            node: 0,
            projection: Projection::Perspective { yfov: 1.0 },
            lens: None,
            shutter: Shutter::default(),
        };
        Scene { nodes: vec![node], cameras: vec![camera], ..Scene::default() }
    }

    #[test]
    fn a_scene_survives_the_journey() {
        let bytes = encode(&scene());
        assert_eq!(decode(&bytes).unwrap(), scene());
        assert_eq!(SceneId::of(&bytes), SceneId::of(&encode(&scene())));
    }

    #[test]
    fn broken_snapshots_are_refused() {
        let bytes = encode(&scene());
        for len in 0..bytes.len() {
            assert!(decode(&bytes[..len]).is_err(), "{len} of {} bytes", bytes.len());
        }
        let mut longer = bytes.clone();
        longer.push(0);
        assert!(matches!(decode(&longer), Err(SnapshotError::Trailing(1))));
        let mut bomb = bytes;
        bomb[..8].copy_from_slice(&u64::MAX.to_le_bytes());
        assert!(decode(&bomb).is_err());
        let mut homeless = scene();
        homeless.cameras[0].node = 7;
        assert!(matches!(decode(&encode(&homeless)), Err(SnapshotError::Invalid(_))));
    }
}
