//! How much light rough microfacets lose because each ray is followed through one reflection only.

use super::ggx::{Ggx, reflect};
use crate::math;
use glam::Vec3;
use std::sync::OnceLock;

/// Nodes along sqrt(cos) and along perceptual roughness.
const NODES: usize = 32;

/// Shares of light that a white rough surface loses.
#[derive(Clone, Copy, Debug)]
pub struct Compensation {
    /// Seen from `wo`.
    pub at_wo: f32,
    /// Mean over all directions, weighed by the cosine.
    pub mean: f32,
}

/// What has to be given back; `None` where next to nothing is lost.
pub fn compensation(ggx: &Ggx, cos_o: f32) -> Option<Compensation> {
    const NEGLIGIBLE: f32 = 1e-5;
    let roughness = ggx.alpha().sqrt();
    let mean = lerp_nodes(&table().mean, roughness);
    (mean > NEGLIGIBLE).then(|| Compensation { at_wo: lost(ggx, cos_o), mean })
}

/// Share of light lost at a cosine.
pub fn lost(ggx: &Ggx, cos: f32) -> f32 {
    let at = node(ggx.alpha().sqrt());
    let rows = &table().at_cos;
    let along = |row: usize| lerp_nodes(&rows[row], cos.sqrt());
    along(at.0) * (1.0 - at.1) + along(at.0 + 1) * at.1
}

struct Table {
    /// By roughness, then by sqrt(cos).
    at_cos: [[f32; NODES]; NODES],
    /// By roughness.
    mean: [f32; NODES],
}

/// Made at first use by quadrature: the same values on every machine, and not a byte in programs that do not ask.
fn table() -> &'static Table {
    static TABLE: OnceLock<Table> = OnceLock::new();
    TABLE.get_or_init(|| {
        let at = |i: usize| i as f32 / (NODES - 1) as f32;
        let at_cos = core::array::from_fn(|row| {
            let ggx = Ggx::from_roughness(at(row));
            core::array::from_fn(|column| integrate_lost(&ggx, at(column) * at(column)))
        });
        let mean = core::array::from_fn(|row: usize| mean_of(&at_cos[row]));
        Table { at_cos, mean }
    })
}

/// Lower node and position between it and the next.
fn node(x: f32) -> (usize, f32) {
    let scaled = x.clamp(0.0, 1.0) * (NODES - 1) as f32;
    let lower = (scaled as usize).min(NODES - 2);
    (lower, scaled - lower as f32)
}

fn lerp_nodes(nodes: &[f32; NODES], x: f32) -> f32 {
    let (lower, t) = node(x);
    nodes[lower] * (1.0 - t) + nodes[lower + 1] * t
}

/// One minus the albedo of single scattering, by the midpoint rule over the numbers that visible normals are drawn by.
fn integrate_lost(ggx: &Ggx, cos: f32) -> f32 {
    const TURNS: u32 = 24;
    const HEIGHTS: u32 = 64;
    /// Stands for the limit at the horizon.
    const COS_MIN: f32 = 1e-4;
    let cos = cos.max(COS_MIN);
    let wo = Vec3::new(math::safe_sqrt(1.0 - cos * cos), 0.0, cos);
    let mut kept = 0.0_f64;
    for i in 0..TURNS * HEIGHTS {
        // Both halves of the circle give the same.
        let u =
            [0.5 * ((i % TURNS) as f32 + 0.5) / TURNS as f32, ((i / TURNS) as f32 + 0.5) / HEIGHTS as f32];
        let wi = reflect(wo, ggx.sample(wo, u));
        if wi.z > 0.0 {
            kept += f64::from(ggx.masking(wo, wi));
        }
    }
    (1.0 - kept / f64::from(TURNS * HEIGHTS)).max(0.0) as f32
}

/// Integral of 2 mu lost(mu), with mu = t^2, of exactly what interpolation gives.
fn mean_of(nodes: &[f32; NODES]) -> f32 {
    const STEPS: u32 = 1024;
    let sum: f64 = (0..STEPS)
        .map(|i| (i as f32 + 0.5) / STEPS as f32)
        .map(|t| f64::from(4.0 * t * t * t * lerp_nodes(nodes, t)))
        .sum();
    (sum / f64::from(STEPS)) as f32
}
