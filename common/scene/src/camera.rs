//! Where pictures are taken from.

use serde::{Deserialize, Serialize};

/// A camera at a node; looks along the node's -Z with +Y up. The node's scale is ignored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Chosen by `--camera`.
    pub name: String,
    /// Where it is: index into `Scene::nodes`.
    pub node: u32,
    /// How directions map to pixels.
    pub projection: Projection,
    /// Finite aperture; none means everything is sharp.
    pub lens: Option<Lens>,
    /// Open time.
    pub shutter: Shutter,
}

/// How directions map to the picture; the frame's shape gives the width.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Projection {
    /// Central projection.
    Perspective {
        /// Full vertical angle, in (0, pi).
        yfov: f32,
    },
    /// Parallel projection.
    Orthographic {
        /// Half the picture's height, metres.
        ymag: f32,
    },
}

/// Thin lens (Cook, Porter, Carpenter 1984, section 4.2).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lens {
    /// Metres, > 0. Of the circle through the corners for bladed apertures.
    pub aperture_radius: f32,
    /// Distance of the plane in focus along the view axis, metres, > 0; may be infinite.
    pub focus_distance: f32,
    /// 0 is round; n >= 3 a regular polygon; 4 a square.
    pub blades: u32,
    /// Rotation of the polygon, radians.
    pub rotation: f32,
    /// Width of the aperture over its height.
    pub anamorphic_ratio: f32,
}

/// When light is gathered, in seconds relative to the frame's time. `open == close` takes a still.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Shutter {
    /// Opens.
    pub open: f64,
    /// Closes; never before it opens.
    pub close: f64,
}
