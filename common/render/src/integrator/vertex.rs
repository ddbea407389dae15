//! What both integrators do at a vertex of a path.

use crate::accel::{Hit, Ray};
use crate::bsdf::{Bsdf, BsdfSample};
use crate::interaction::Interaction;
use crate::light::{Emitter, LightSample, Receiver};
use crate::math::{self, Frame};
use crate::prepared::{PreparedScene, absorption};
use crate::sampler::Sampler;
use crate::sampling::power_heuristic;
use farm_film::Counters;
use glam::Vec3;

/// Where a ray was scattered: what multiple importance sampling has to ask the lights again.
#[derive(Clone, Copy)]
struct Origin {
    receiver: Receiver,
    /// Density of the ray's direction, 1/sr.
    pdf: f32,
}

/// What a path carries along.
pub(super) struct Carried {
    /// Throughput so far.
    beta: Vec3,
    /// Where the ray was scattered; none if light sampling could not have found what it meets (camera, mirrors).
    origin: Option<Origin>,
    /// Whether the ray comes straight from the camera.
    from_camera: bool,
    /// Product of squared relative indices of refraction: what `beta` has gained by entering denser media.
    eta_squared: f32,
    /// Absorption of the medium around the ray, 1/m.
    absorption: Vec3,
}

impl Carried {
    pub fn from_camera() -> Self {
        Self { beta: Vec3::ONE, origin: None, from_camera: true, eta_squared: 1.0, absorption: Vec3::ZERO }
    }

    /// Passes `distance` metres of the medium (Beer-Lambert).
    pub fn travel(&mut self, distance: f32) {
        self.beta *= transmittance(self.absorption, distance);
    }

    /// Russian roulette: survivors are made up for those that are not.
    pub fn survives(&mut self, u: f32) -> bool {
        let survival = (self.beta.max_element() * self.eta_squared).min(1.0);
        if u >= survival {
            return false;
        }
        #[cfg(feature = "mutations")]
        let survival = crate::mutations::survival(survival);
        self.beta /= survival;
        true
    }
}

/// What a channel that is not absorbed loses is nothing, over an infinite distance too: rays leave volumes that are not closed.
fn transmittance(absorption: Vec3, distance: f32) -> Vec3 {
    let channel = |absorption: f32| if absorption > 0.0 { math::exp(-absorption * distance) } else { 1.0 };
    absorption.to_array().map(channel).into()
}

/// The surface of a vertex, and how it scatters.
pub(super) struct Surface<'a> {
    at: &'a Interaction<'a>,
    bsdf: Bsdf,
    /// Around the shading normal; it points out of solid bodies and towards the viewer otherwise.
    frame: Frame,
    wo_local: Vec3,
}

/// Which part of a surface's light the next ray looks for as well.
pub(super) enum Followed {
    /// None of it.
    Nothing,
    /// That of a part of the surface.
    Part(Bsdf),
    /// All.
    All,
}

impl<'a> Surface<'a> {
    pub fn new(at: &'a Interaction<'a>, bsdf: Bsdf) -> Self {
        let inside = !at.front && matches!(bsdf, Bsdf::Dielectric(_));
        let frame = if inside { Frame::from_z(-at.frame.z) } else { at.frame };
        Self { at, bsdf, frame, wo_local: frame.to_local(at.wo) }
    }

    /// The direction that the surface scatters into, chosen by three numbers in [0, 1).
    pub fn sample(&self, u: [f32; 3]) -> Option<BsdfSample> {
        self.bsdf.sample(self.wo_local, u)
    }

    /// Whether `wi` leaves the real surface on the side on which it leaves the shading frame. Where it does not, light would
    /// leak through.
    fn agrees(&self, wi: Vec3, wi_local: Vec3) -> bool {
        (wi.dot(self.at.normal_geometric) > 0.0) == (wi_local.z * self.wo_local.z > 0.0)
    }

    /// The point that asks for light. Its orientation is not said where light passes through.
    fn receiver(&self, time: f32) -> Receiver {
        let normal = (!self.bsdf.transmits()).then_some(self.frame.z);
        Receiver { point: self.at.point, normal, time }
    }
}

/// The randomness by which one ray passes surfaces that are there with a probability only.
pub(super) struct Passes(u64);

impl Passes {
    pub fn at(sampler: &Sampler, vertex: u32) -> Self {
        Self(sampler.key(super::dimension::scatter(vertex)))
    }

    /// Uniform in [0, 1), for one primitive.
    pub fn draw(&self, hit: &Hit) -> f32 {
        let primitive = u64::from(hit.instance) << 32 | u64::from(hit.primitive);
        math::unit_f32_from_u64(crate::sampler::mix(self.0 ^ crate::sampler::mix(primitive)))
    }
}

/// The nearest surface along the ray.
pub(super) fn closest<const CUTOUTS: bool>(scene: &PreparedScene, ray: &Ray, passes: &Passes) -> Option<Hit> {
    if CUTOUTS {
        scene.world.accel.closest(ray, |hit| scene.is_there(hit, || passes.draw(hit)))
    } else {
        scene.world.accel.closest(ray, |_| true)
    }
}

fn is_occluded<const CUTOUTS: bool>(
    scene: &PreparedScene,
    ray: &Ray,
    passes: &Passes,
    light: &LightSample,
) -> bool {
    #[cfg(feature = "mutations")]
    if crate::mutations::is_on(crate::mutations::Mutation::NoShadows) {
        return false;
    }
    // A point on an emitter is never hidden by the very surface that it lies on.
    let other = |hit: &Hit| match light.emitter {
        Emitter::Triangle { instance, primitive, .. } => {
            (instance, primitive) != (hit.instance, hit.primitive)
        }
        Emitter::Shape { light, .. } => scene.shape_light(hit) != Some(light),
        Emitter::Environment { .. } | Emitter::Punctual { .. } => true,
    };
    if CUTOUTS {
        scene.world.accel.occluded(ray, |hit| other(hit) && scene.is_there(hit, || passes.draw(hit)))
    } else {
        scene.world.accel.occluded(ray, other)
    }
}

/// Light of the environment along a ray that met nothing.
pub(super) fn environment(scene: &PreparedScene, ray: &Ray, carried: &Carried) -> Vec3 {
    if carried.from_camera && !scene.environment_is_visible {
        return Vec3::ZERO;
    }
    let radiance = scene.lights.environment_radiance(ray.direction);
    let weight = carried.origin.map_or(1.0, |origin| {
        let light_pdf = scene.lights.pdf_environment(&origin.receiver, &scene.world, ray.direction);
        power_heuristic(origin.pdf, light_pdf)
    });
    carried.beta * radiance * weight
}

/// Light that a surface gives off towards the ray that met it.
pub(super) fn emission(
    scene: &PreparedScene,
    ray: &Ray,
    hit: &Hit,
    at: Option<&Interaction<'_>>,
    carried: &Carried,
) -> Vec3 {
    let shape = scene.shape_light(hit);
    let radiance = match (at, shape) {
        (Some(at), _) => scene.emitted(at),
        (None, Some(light)) => scene.shape_emission(light, hit, ray),
        (None, None) => Vec3::ZERO,
    };
    if radiance == Vec3::ZERO {
        return Vec3::ZERO;
    }
    let weight = carried.origin.map_or(1.0, |origin| {
        let (receiver, lights) = (&origin.receiver, &scene.lights);
        let light_pdf = match shape {
            Some(light) => lights.pdf_shape(receiver, &scene.world, light, ray.direction),
            None => lights.pdf_triangle(receiver, &scene.world, hit.instance, hit.primitive, ray.direction),
        };
        power_heuristic(origin.pdf, light_pdf)
    });
    #[cfg(feature = "mutations")]
    let weight = crate::mutations::chance_weight(weight);
    carried.beta * radiance * weight
}

/// One light, seen or not: next-event estimation. What `followed` scatters is weighed against the next ray, which may find the
/// same light.
#[expect(clippy::too_many_arguments, reason = "all that a vertex knows")]
pub(super) fn direct<const CUTOUTS: bool>(
    scene: &PreparedScene,
    surface: &Surface<'_>,
    carried: &Carried,
    time: f32,
    [u, v, choice]: [f32; 3],
    followed: &Followed,
    passes: &Passes,
    counters: &mut Counters,
) -> Vec3 {
    if surface.bsdf.is_delta() {
        return Vec3::ZERO;
    }
    let at = surface.at;
    let Some(light) = scene.lights.sample(&surface.receiver(time), &scene.world, choice, [u, v]) else {
        return Vec3::ZERO;
    };
    #[cfg(feature = "mutations")]
    let light = crate::mutations::light_sample(light);
    let (wo_local, wi_local) = (surface.wo_local, surface.frame.to_local(light.direction));
    // Light that another ray may find too is shared with it.
    let share = |pdf: f32| if light.delta { 1.0 } else { power_heuristic(light.pdf, pdf) };
    let weighted = match followed {
        Followed::Nothing => surface.bsdf.eval(wo_local, wi_local),
        Followed::All => {
            let (all, pdf) = surface.bsdf.eval_pdf(wo_local, wi_local);
            all * share(pdf)
        }
        Followed::Part(part) => {
            let (followed, pdf) = part.eval_pdf(wo_local, wi_local);
            surface.bsdf.eval(wo_local, wi_local) - followed * (1.0 - share(pdf))
        }
    };
    let scattered = weighted * wi_local.z.abs();
    #[cfg(feature = "mutations")]
    let scattered = crate::mutations::scattered(scattered, weighted);
    if scattered == Vec3::ZERO || !surface.agrees(light.direction, wi_local) {
        return Vec3::ZERO;
    }
    let radiance = match light.emitter {
        Emitter::Triangle { instance, primitive, u, v } => scene.emitted_at(instance, primitive, u, v),
        Emitter::Shape { radiance, .. } | Emitter::Environment { radiance } => radiance,
        Emitter::Punctual { irradiance, .. } => irradiance,
    };
    if radiance == Vec3::ZERO {
        return Vec3::ZERO;
    }
    counters.rays_shadow += 1;
    let ray = at.spawn_towards(light.direction, time, light.distance);
    if is_occluded::<CUTOUTS>(scene, &ray, passes, &light) {
        return Vec3::ZERO;
    }
    carried.beta * scattered * radiance * transmittance(carried.absorption, light.distance) / light.pdf
}

/// Follows a scattered direction. None where it would leave through the wrong side.
pub(super) fn scatter(
    surface: &Surface<'_>,
    sample: &BsdfSample,
    carried: &mut Carried,
    time: f32,
) -> Option<Ray> {
    let at = surface.at;
    let wi = surface.frame.to_world(sample.wi);
    if !surface.agrees(wi, sample.wi) {
        return None;
    }
    carried.beta *= sample.weight;
    carried.from_camera = false;
    carried.origin = (!sample.delta).then_some(Origin { receiver: surface.receiver(time), pdf: sample.pdf });
    if sample.transmission {
        carried.eta_squared *= sample.eta * sample.eta;
        if let Some(volume) = &at.material.volume {
            carried.absorption = if at.front { absorption(volume) } else { Vec3::ZERO };
        }
    }
    Some(at.spawn(wi, time, f32::INFINITY))
}

#[cfg(test)]
mod tests {
    use super::*;
    use farm_scene::Volume;

    #[test]
    fn a_ray_that_never_leaves_its_medium_keeps_the_channels_that_are_not_absorbed() {
        let volume = Volume { attenuation_distance: 1e-3, attenuation_color: Vec3::new(0.5, 0.95, 1.0) };
        assert_eq!(transmittance(absorption(&volume), f32::INFINITY), Vec3::new(0.0, 0.0, 1.0));
        let at_distance = transmittance(absorption(&volume), 1e-3);
        assert!((at_distance - volume.attenuation_color).abs().max_element() < 1e-6, "{at_distance}");
        assert_eq!(transmittance(Vec3::ZERO, f32::INFINITY), Vec3::ONE);
    }
}
