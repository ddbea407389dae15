//! What a scene's lights are, in numbers.

/// Emitters by kind, what was left out, and what it costs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LightsReport {
    /// Emissive triangles.
    pub triangles: u64,
    /// Analytic spheres.
    pub spheres: u64,
    /// Analytic rectangles.
    pub rectangles: u64,
    /// Analytic disks.
    pub disks: u64,
    /// Point lights.
    pub points: u64,
    /// Spot lights.
    pub spots: u64,
    /// Directional lights.
    pub directionals: u64,
    /// Whether there is an environment that is not black.
    pub environment: bool,
    /// Emitters without area, which no ray can meet.
    pub without_area: u64,
    /// Emitters that give no light.
    pub black: u64,
    /// Emitters whose position or strength is negative or not finite.
    pub unsound: u64,
    /// Environment pixels that were negative or not finite, and became 0.
    pub environment_pixels_repaired: u64,
    /// Nodes of the light tree; 0 where there are too few lights for one.
    pub tree_nodes: u64,
    /// Bytes held by the tables, the tree and the environment.
    pub bytes: u64,
}
