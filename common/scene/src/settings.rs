//! How a scene is to be rendered.

use serde::{Deserialize, Serialize};

/// Algorithm of light transport.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Integrator {
    /// Unbiased path tracing.
    #[default]
    Path,
    /// Distribution ray tracing of 1984: direct light, and recursion through mirror, glossy and glass surfaces only.
    Distribution,
}

/// Pixel filter; sampled by importance, never splatted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Filter {
    /// The pixel's own area.
    Box,
    /// Gaussian of standard deviation 0.5 pixels, cut at 1.5 pixels.
    Gaussian,
    /// Blackman-Harris window of radius 1.5 pixels.
    BlackmanHarris,
}

/// Everything beside the scene and the frame that decides a sample's value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Index into `Scene::cameras`.
    pub camera: u32,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Transport.
    pub integrator: Integrator,
    /// Pixel filter.
    pub filter: Filter,
    /// Most surfaces that scatter a path's light: 0 shows emitters only, 1 direct light.
    pub max_depth: u32,
    /// Chooses one of 2^64 independent pictures.
    pub seed: u64,
    /// Frames per second; a frame's time is `frame / fps`.
    pub fps: f64,
    /// Largest value of any channel of a sample, W/sr/m^2: brighter ones are darkened to it, in their own colour. Positive; none leaves
    /// the picture unbiased.
    pub clamp: Option<f32>,
}
