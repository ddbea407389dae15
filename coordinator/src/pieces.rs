//! A scene's snapshot in pieces that are named by their content, so that what two scenes share is sent and kept once.
//! Cuts follow the content (FastCDC): bytes that are inserted or changed leave the pieces after them as they were.

use bytes::Bytes;
use farm_job::Digest;

/// Sizes of pieces in bytes: small enough that a texture shared between scenes is some pieces of its own, large enough that
/// their number does not matter.
const PIECE_MIN: u32 = 64 << 10;
const PIECE_AVERAGE: u32 = 256 << 10;
const PIECE_MAX: u32 = 1 << 20;

/// The pieces of a snapshot in order. Nothing is copied.
pub fn cut(snapshot: &Bytes) -> Vec<(Digest, Bytes)> {
    let cuts = fastcdc::v2020::FastCDC::new(snapshot, PIECE_MIN, PIECE_AVERAGE, PIECE_MAX);
    cuts.map(|cut| {
        let piece = snapshot.slice(cut.offset..cut.offset + cut.length);
        (digest(&piece), piece)
    })
    .collect()
}

/// A piece's name.
pub fn digest(piece: &[u8]) -> Digest {
    Digest(*blake3::hash(piece).as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn a_change_changes_few_pieces() {
        let mut random = fastrand::Rng::with_seed(7);
        let texture: Vec<u8> = (0..8 << 20).map(|_| random.u8(..)).collect();
        let before = cut(&Bytes::from(texture.clone()));
        let joined: Vec<u8> = before.iter().flat_map(|(_, piece)| piece.to_vec()).collect();
        assert!(joined == texture, "the pieces make up the whole");
        // Another camera in front, so that everything moves.
        let after = cut(&Bytes::from([&b"camera"[..], &texture].concat()));
        let known: BTreeSet<Digest> = before.iter().map(|(digest, _)| *digest).collect();
        let new: usize =
            after.iter().filter(|(digest, _)| !known.contains(digest)).map(|(_, piece)| piece.len()).sum();
        assert!(new <= 2 * PIECE_MAX as usize, "{new} bytes of {} are sent again", texture.len());
        assert!(cut(&Bytes::new()).is_empty());
    }
}
