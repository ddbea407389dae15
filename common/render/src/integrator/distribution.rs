//! Distribution ray tracing as of 1984 (Cook, Porter, Carpenter): direct light from area lights at every surface, and one
//! further ray through mirror, glossy and transmissive surfaces. Light that has bounced off a diffuse surface lights nothing.

use super::vertex::{self, Carried, Followed, Passes, Surface};
use super::{arrive, dimension};
use crate::PreparedScene;
use crate::accel::Ray;
use crate::sampler::Sampler;
use farm_film::Counters;
use glam::Vec3;

/// Radiance along `ray`. `CUTOUTS`: whether any surface lets rays pass by its alpha.
pub(super) fn radiance<const CUTOUTS: bool>(
    scene: &PreparedScene,
    mut ray: Ray,
    sampler: &Sampler,
    counters: &mut Counters,
) -> Vec3 {
    let mut radiance = Vec3::ZERO;
    let mut carried = Carried::from_camera();
    for depth in 0..=scene.settings.max_depth {
        let passes = Passes::at(sampler, depth);
        let (found, at) = arrive::<CUTOUTS>(scene, &ray, &passes, &mut carried);
        radiance += found;
        let Some(at) = at.filter(|_| depth < scene.settings.max_depth) else { break };
        let [u, v, lobe, pick] = sampler.set(dimension::scatter(depth));
        let scatter = [u, v, lobe];
        let Some(bsdf) = scene.bsdf(&at, pick) else { break };
        let surface = Surface::new(&at, bsdf);

        // Direct light. What is diffuse is lit by the lights alone, what shines also by what the next ray meets.
        let shiny = bsdf.without_diffuse();
        let followed = shiny.map_or(Followed::Nothing, Followed::Part);
        let [u, v, choice, _] = sampler.set(dimension::light(depth));
        let light = [u, v, choice];
        radiance += vertex::direct::<CUTOUTS>(
            scene, &surface, &carried, ray.time, light, &followed, &passes, counters,
        );

        // Only what shines is followed further.
        let Some(shiny) = shiny.map(|bsdf| Surface::new(&at, bsdf)) else { break };
        let Some(sample) = shiny.sample(scatter) else { break };
        let Some(next) = vertex::scatter(&shiny, &sample, &mut carried, ray.time) else { break };
        ray = next;
        counters.rays_extension += 1;
    }
    radiance
}
