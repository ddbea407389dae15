//! From a sample's address to its radiance.

mod distribution;
mod path;
mod vertex;

use crate::PreparedScene;
use crate::accel::Ray;
use crate::interaction::Interaction;
use crate::sampler::Sampler;
use farm_film::Counters;
use farm_scene::Integrator;
use glam::Vec3;
use vertex::{Carried, Passes};

/// 4-D sets of a sample's dimensions. Each set is stratified by itself; sets are independent of each other.
mod dimension {
    /// Film x, film y, lens, lens.
    pub const CAMERA: u32 = 0;
    /// Time; the rest is free.
    pub const TIME: u32 = 1;
    /// First set of the path; every vertex takes two.
    pub const PATH: u32 = 2;

    /// Point on a light twice (the best pair of a set), choice of the light, roulette.
    pub const fn light(vertex: u32) -> u32 {
        PATH + 2 * vertex
    }

    /// Direction twice, choice of a lobe, choice of a part of the material.
    pub const fn scatter(vertex: u32) -> u32 {
        PATH + 2 * vertex + 1
    }
}

/// One sample of one pixel: where it is on the film and where its randomness comes from.
pub(crate) struct Sampling {
    pub x: u32,
    pub y: u32,
    pub sampler: Sampler,
}

impl Sampling {
    pub fn at(scene: &PreparedScene, x: u32, y: u32, index: u64) -> Self {
        Self { x, y, sampler: scene.sampler(x, y, index) }
    }

    /// The camera ray. Film point, lens point and time are drawn once, here; time is inherited by every later ray.
    fn camera_ray(&self, scene: &PreparedScene) -> Ray {
        let [film_u, film_v, lens_u, lens_v] = self.sampler.set(dimension::CAMERA);
        let [dx, dy] = scene.filter.sample([film_u, film_v]);
        #[cfg(feature = "mutations")]
        let [dx, dy] = crate::mutations::filtered([dx, dy], [film_u, film_v], scene.filter.radius());
        let film = [f64::from(self.x) + 0.5 + f64::from(dx), f64::from(self.y) + 0.5 + f64::from(dy)];
        let time = if scene.is_moving { self.sampler.set(dimension::TIME)[0] } else { 0.0 };
        #[cfg(feature = "mutations")]
        let time = crate::mutations::camera_time(time);
        scene.camera.ray(film, [lens_u, lens_v], time)
    }
}

/// Radiance that one sample finds, W/sr/m^2 in linear Rec. 709.
pub(crate) fn radiance(scene: &PreparedScene, sampling: Sampling, counters: &mut Counters) -> Vec3 {
    let ray = sampling.camera_ray(scene);
    counters.rays_camera += 1;
    // One compiled kernel per combination of what the scene uses.
    match (scene.settings.integrator, scene.has_cutouts) {
        (Integrator::Path, false) => path::radiance::<false>(scene, ray, &sampling.sampler, counters),
        (Integrator::Path, true) => path::radiance::<true>(scene, ray, &sampling.sampler, counters),
        (Integrator::Distribution, false) => {
            distribution::radiance::<false>(scene, ray, &sampling.sampler, counters)
        }
        (Integrator::Distribution, true) => {
            distribution::radiance::<true>(scene, ray, &sampling.sampler, counters)
        }
    }
}

/// What a ray finds at its end: the light that comes from there, and the surface if there is one that scatters.
fn arrive<'a, const CUTOUTS: bool>(
    scene: &'a PreparedScene,
    ray: &Ray,
    passes: &Passes,
    carried: &mut Carried,
) -> (Vec3, Option<Interaction<'a>>) {
    let Some(hit) = vertex::closest::<CUTOUTS>(scene, ray, passes) else {
        return (vertex::environment(scene, ray, carried), None);
    };
    carried.travel(hit.t);
    let at = scene.shape_light(&hit).is_none().then(|| Interaction::new(scene, ray, &hit));
    (vertex::emission(scene, ray, &hit, at.as_ref(), carried), at)
}
