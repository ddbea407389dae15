//! How much may travel at once.

/// Largest partial EXR: 256 MiB hold a tile of 22 million pixels (three 32-bit sums each), so that a frame of 5K may
/// travel as one tile. Larger frames have to be divided into more than one.
pub const PARTIAL_BYTES_MAX: usize = 256 << 20;

/// Largest message: a partial with everything that goes with it. The default of gRPC libraries, 4 MiB, would refuse a tile of
/// 600 x 600 pixels.
pub const MESSAGE_BYTES_MAX: usize = PARTIAL_BYTES_MAX + (1 << 20);

/// Bytes of a scene per message: large enough that the cost of a message does not show, small enough that heartbeats on
/// the same connection are not held up.
pub const SCENE_CHUNK_BYTES: usize = 1 << 20;

/// Largest message of people and scripts: a piece of a file with what goes with it, or a list of some ten thousand jobs.
pub const CONTROL_BYTES_MAX: usize = 8 << 20;

/// Largest message of a stranger: a token and a signing request.
pub const ENROL_BYTES_MAX: usize = 64 << 10;
