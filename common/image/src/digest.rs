//! Digests: of resolved pixels, and as they are written in JSON.

use farm_film::{Resolution, Rgb};

/// BLAKE3 over width and height (u32, little-endian) and the bits of every pixel (f32, little-endian, scanline order, red
/// first). Two renders are the same picture exactly when these agree.
pub fn pixels_digest(resolution: Resolution, pixels: &[Rgb]) -> [u8; 32] {
    assert_eq!(pixels.len(), resolution.area(), "one value per pixel of the frame");
    let mut hasher = blake3::Hasher::new();
    hasher.update(&resolution.width().to_le_bytes());
    hasher.update(&resolution.height().to_le_bytes());
    let mut bytes = Vec::with_capacity(resolution.width() as usize * 12);
    for row in pixels.chunks(resolution.width() as usize) {
        bytes.clear();
        bytes.extend(row.iter().flatten().flat_map(|value| value.to_bits().to_le_bytes()));
        hasher.update(&bytes);
    }
    *hasher.finalize().as_bytes()
}

/// Serde of a 32-byte digest as 64 hexadecimal digits.
pub(crate) mod hex {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    pub(crate) fn serialize<S: Serializer>(digest: &[u8; 32], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&blake3::Hash::from_bytes(*digest).to_hex())
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[u8; 32], D::Error> {
        let text = String::deserialize(deserializer)?;
        blake3::Hash::from_hex(text.as_bytes()).map(Into::into).map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shape_and_every_bit_count() {
        let pixels = vec![[0.0f32; 3]; 6];
        let digest =
            |width, height, pixels: &[Rgb]| pixels_digest(Resolution::new(width, height).unwrap(), pixels);
        let base = digest(3, 2, &pixels);
        assert_ne!(base, digest(2, 3, &pixels));
        let mut other = pixels.clone();
        other[5][2] = -0.0;
        assert_ne!(base, digest(3, 2, &other), "negative zero has other bits");
        assert_eq!(base, digest(3, 2, &pixels));
        let mut by_hand = vec![3, 0, 0, 0, 2, 0, 0, 0];
        by_hand.extend([0; 72]);
        assert_eq!(base, *blake3::hash(&by_hand).as_bytes());
    }
}
