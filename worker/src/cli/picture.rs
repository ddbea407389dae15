//! Flags that say what is seen, from where, and how it is computed.

use super::parse::{brightness, distance, positive, real, resolution};
use farm_film::Resolution;
use std::path::PathBuf;

/// Where the open shutter lies relative to the frame's time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum ShutterPosition {
    /// Opens at the frame's time.
    Start,
    /// Is half over at the frame's time.
    #[default]
    Center,
    /// Closes at the frame's time.
    End,
}

/// Algorithms of light transport, as flags spell them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum IntegratorArg {
    /// Unbiased path tracing
    #[default]
    Path,
    /// Distribution ray tracing of 1984
    Distribution,
}

/// Pixel filters, as flags spell them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum FilterArg {
    /// The pixel's own area
    Box,
    /// Standard deviation of 0.5 pixels
    Gaussian,
    /// Radius of 1.5 pixels
    #[default]
    BlackmanHarris,
}

/// What is seen, from where, and how it is computed.
#[derive(Clone, Debug, clap::Args)]
pub struct PictureArgs {
    /// The scene: a glTF 2.0 file, .gltf or .glb
    pub scene: PathBuf,

    /// Name of the camera; the scene's first one if not given
    #[arg(long, env = "FARM_CAMERA", value_name = "NAME", help_heading = "Picture")]
    pub camera: Option<String>,

    /// Name of the animation to play; the scene's first one if not given
    #[arg(long, env = "FARM_ANIMATION", value_name = "NAME", help_heading = "Picture")]
    pub animation: Option<String>,

    /// Width and height in pixels
    #[arg(long, env = "FARM_RESOLUTION", value_name = "WxH", default_value = "960x540", value_parser = resolution, help_heading = "Picture")]
    pub resolution: Resolution,

    /// Algorithm of light transport
    #[arg(long, env = "FARM_INTEGRATOR", value_enum, default_value_t, help_heading = "Picture")]
    pub(crate) integrator: IntegratorArg,

    /// Pixel filter; importance-sampled, so that tiles stay independent
    #[arg(long, env = "FARM_FILTER", value_enum, default_value_t, help_heading = "Picture")]
    pub(crate) filter: FilterArg,

    /// Most surfaces that scatter a path's light: 0 shows emitters only, 1 direct light
    #[arg(
        long,
        env = "FARM_MAX_DEPTH",
        allow_negative_numbers = true,
        value_name = "N",
        default_value_t = 8,
        help_heading = "Picture"
    )]
    pub max_depth: u32,

    /// Darkens samples that are brighter than this, in W/sr/m^2, to it; biases the picture, and the light that it took is reported. Off
    /// unless given
    #[arg(long, env = "FARM_CLAMP", allow_negative_numbers = true, value_name = "X", value_parser = brightness, help_heading = "Picture")]
    pub clamp: Option<f32>,

    /// Chooses one of 2^64 independent pictures; the same seed gives the same bits
    #[arg(
        long,
        env = "FARM_SEED",
        allow_negative_numbers = true,
        value_name = "N",
        default_value_t = 0,
        help_heading = "Picture"
    )]
    pub seed: u64,

    /// Radius of the lens in metres: larger means less depth of field, 0 makes everything sharp
    #[arg(long, env = "FARM_APERTURE_RADIUS", allow_negative_numbers = true, value_name = "M", value_parser = real(0.0..), help_heading = "Lens and shutter")]
    pub aperture_radius: Option<f64>,

    /// Distance of the plane in focus along the view axis, in metres, or inf
    #[arg(long, env = "FARM_FOCUS_DISTANCE", allow_negative_numbers = true, value_name = "M", value_parser = distance, help_heading = "Lens and shutter")]
    pub focus_distance: Option<f32>,

    /// Frames per second; frame N shows the scene at N / fps seconds
    #[arg(long, env = "FARM_FPS", allow_negative_numbers = true, value_name = "N", default_value_t = 24.0, value_parser = positive, help_heading = "Lens and shutter")]
    pub fps: f64,

    /// Part of a frame's duration that the shutter is open: 0.5 is a 180-degree shutter, 0 takes a still
    #[arg(long, env = "FARM_SHUTTER", allow_negative_numbers = true, value_name = "X", value_parser = real(0.0..), help_heading = "Lens and shutter")]
    pub shutter: Option<f64>,

    /// Where the open shutter lies relative to the frame's time
    #[arg(
        long,
        env = "FARM_SHUTTER_POSITION",
        value_enum,
        default_value_t,
        requires = "shutter",
        help_heading = "Lens and shutter"
    )]
    pub shutter_position: ShutterPosition,

    /// Light from all around: a lat-long picture, .hdr or .exr
    #[arg(long, env = "FARM_ENVIRONMENT", value_name = "FILE", help_heading = "Environment")]
    pub environment: Option<PathBuf>,

    /// Turns the environment about the vertical axis, in degrees
    #[arg(long, env = "FARM_ENVIRONMENT_ROTATION", value_name = "DEG", allow_negative_numbers = true, value_parser = real(f64::MIN..), help_heading = "Environment")]
    pub environment_rotation: Option<f64>,

    /// Factor on the environment's radiance
    #[arg(long, env = "FARM_ENVIRONMENT_INTENSITY", allow_negative_numbers = true, value_name = "X", value_parser = real(0.0..), help_heading = "Environment")]
    pub environment_intensity: Option<f64>,
}
