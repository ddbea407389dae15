//! Pixel rectangles of a frame.

use serde::{Deserialize, Serialize};

/// Longest side of a frame, in pixels: what EXR windows and 32-bit pixel addresses comfortably hold.
pub const RESOLUTION_MAX: u32 = 65_536;

/// Width and height of a frame in pixels; both in `1..=RESOLUTION_MAX`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Resolution {
    width: u32,
    height: u32,
}

/// A rectangle that cannot be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TileError {
    /// A side is zero or longer than [`RESOLUTION_MAX`].
    #[error(
        "resolution {width}x{height} is out of range: each side must be between 1 and {RESOLUTION_MAX} pixels"
    )]
    Resolution {
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The rectangle is empty or inside out.
    #[error("tile [{x0},{x1}) x [{y0},{y1}) holds no pixel")]
    Empty {
        /// First column.
        x0: u32,
        /// First row.
        y0: u32,
        /// One past the last column.
        x1: u32,
        /// One past the last row.
        y1: u32,
    },
}

impl Resolution {
    /// Checks both sides against `1..=RESOLUTION_MAX`.
    pub fn new(width: u32, height: u32) -> Result<Self, TileError> {
        let side = 1..=RESOLUTION_MAX;
        if side.contains(&width) && side.contains(&height) {
            Ok(Self { width, height })
        } else {
            Err(TileError::Resolution { width, height })
        }
    }

    /// Pixels per row.
    pub fn width(self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(self) -> u32 {
        self.height
    }

    /// Pixels of the frame.
    pub fn area(self) -> usize {
        self.width as usize * self.height as usize
    }

    /// The whole frame as one tile.
    pub fn full(self) -> Tile {
        Tile { x0: 0, y0: 0, x1: self.width, y1: self.height }
    }

    /// The frame's tiles of `side` pixels, row by row; tiles at the right and bottom edges are cut.
    /// They are disjoint and cover the frame for any `side >= 1`, also one larger than the frame.
    pub fn tiles(self, side: u32) -> impl Iterator<Item = Tile> + Clone {
        assert!(side > 0, "a tile has at least one pixel");
        let columns = self.width.div_ceil(side);
        let rows = self.height.div_ceil(side);
        (0..rows).flat_map(move |row| {
            (0..columns).map(move |column| {
                let (x0, y0) = (column * side, row * side);
                let x1 = x0.saturating_add(side).min(self.width);
                let y1 = y0.saturating_add(side).min(self.height);
                Tile { x0, y0, x1, y1 }
            })
        })
    }

    /// Whether `tile` lies inside the frame.
    pub fn contains(self, tile: Tile) -> bool {
        tile.x1 <= self.width && tile.y1 <= self.height
    }
}

/// Half-open pixel rectangle `[x0, x1) x [y0, y1)` of a frame, never empty. Row 0 is the top.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Tile {
    // Row first, so that the derived order is scanline order.
    y0: u32,
    x0: u32,
    y1: u32,
    x1: u32,
}

impl Tile {
    /// `[x0, x1) x [y0, y1)`; refuses an empty rectangle.
    pub fn new(x0: u32, y0: u32, x1: u32, y1: u32) -> Result<Self, TileError> {
        if x0 < x1 && y0 < y1 {
            Ok(Self { y0, x0, y1, x1 })
        } else {
            Err(TileError::Empty { x0, y0, x1, y1 })
        }
    }

    /// First column.
    pub fn x0(self) -> u32 {
        self.x0
    }

    /// First row.
    pub fn y0(self) -> u32 {
        self.y0
    }

    /// Columns.
    pub fn width(self) -> u32 {
        self.x1 - self.x0
    }

    /// Rows.
    pub fn height(self) -> u32 {
        self.y1 - self.y0
    }

    /// One past the last column.
    pub fn x1(self) -> u32 {
        self.x1
    }

    /// One past the last row.
    pub fn y1(self) -> u32 {
        self.y1
    }

    /// Pixels of the tile.
    pub fn area(self) -> usize {
        self.width() as usize * self.height() as usize
    }

    /// The tile's pixels `(x, y)` in scanline order.
    pub fn pixels(self) -> impl Iterator<Item = (u32, u32)> {
        (self.y0..self.y1).flat_map(move |y| (self.x0..self.x1).map(move |x| (x, y)))
    }

    /// Whether the two rectangles share a pixel.
    pub fn overlaps(self, other: Tile) -> bool {
        self.x0 < other.x1 && other.x0 < self.x1 && self.y0 < other.y1 && other.y0 < self.y1
    }
}

impl std::fmt::Display for Tile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "[{},{})x[{},{})", self.x0, self.x1, self.y0, self.y1)
    }
}

impl std::fmt::Display for Resolution {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn tiles_are_disjoint_and_cover_the_frame(width in 1u32..200, height in 1u32..200, side in 1u32..300) {
            let frame = Resolution::new(width, height).unwrap();
            let mut covered = vec![0u8; frame.area()];
            for tile in frame.tiles(side) {
                prop_assert!(frame.contains(tile));
                for (x, y) in tile.pixels() {
                    covered[(y * width + x) as usize] += 1;
                }
            }
            prop_assert!(covered.iter().all(|&times| times == 1));
        }
    }

    #[test]
    fn a_side_near_the_integer_limit_does_not_overflow() {
        let frame = Resolution::new(7, 5).unwrap();
        assert_eq!(frame.tiles(u32::MAX).collect::<Vec<_>>(), vec![frame.full()]);
    }

    #[test]
    fn an_absurd_resolution_is_refused() {
        for (width, height) in [(0, 1), (1, 0), (RESOLUTION_MAX + 1, 1), (1, u32::MAX)] {
            assert_eq!(Resolution::new(width, height), Err(TileError::Resolution { width, height }));
        }
    }
}
