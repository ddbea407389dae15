//! Unbiased path tracing: next-event estimation and chance hits of emitters, joined by multiple importance sampling
//! (Veach 1997, chapter 9), with Russian roulette.

use super::vertex::{self, Carried, Followed, Passes, Surface};
use super::{arrive, dimension};
use crate::PreparedScene;
use crate::accel::Ray;
use crate::sampler::Sampler;
use farm_film::Counters;
use glam::Vec3;

/// Scattering events of a path that are never cut by roulette, so that short paths stay free of its noise.
const ROULETTE_FROM: u32 = 3;

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

        // Direct light.
        let [u, v, choice, roulette] = sampler.set(dimension::light(depth));
        let light = [u, v, choice];
        radiance += vertex::direct::<CUTOUTS>(
            scene,
            &surface,
            &carried,
            ray.time,
            light,
            &Followed::All,
            &passes,
            counters,
        );

        // Choose the next direction.
        let Some(sample) = surface.sample(scatter) else { break };
        let Some(next) = vertex::scatter(&surface, &sample, &mut carried, ray.time) else { break };

        // Roulette, so that a path ends with the probability that it has become unimportant.
        if depth + 1 >= ROULETTE_FROM && !carried.survives(roulette) {
            break;
        }
        ray = next;
        counters.rays_extension += 1;
    }
    radiance
}
