//! Lights as seen from a point: which one, towards where, with which density; and the density of a direction that met one by
//! chance.
//!
//! Both answers come from the same numbers, so that weights of multiple importance sampling add up. Geometry is computed in double
//! precision from single-precision positions and compared by ratios only: a scene scaled by a power of two gives the same bits.
//! Emitters without area, black ones and unsound ones are left out while building, and counted.
//!
//! A scene pays for what it has: a single light is not chosen, a few are compared, many have a tree; an environment and
//! directional lights are strategies beside that, and cost a comparison only where there is more than one strategy.

mod bounds;
mod builder;
mod chooser;
mod disk;
mod environment;
mod geometry;
mod local;
mod punctual;
mod rectangle;
mod report;
mod shape;
mod sphere;
mod suns;
mod table;
#[cfg(test)]
mod testing;
mod tree;
mod triangle;

pub use builder::{LightsBuilder, TriangleEmitter};
pub use geometry::{EmitterGeometry, EmitterTriangle, Placement};
pub use report::LightsReport;

use chooser::Chooser;
use environment::EnvironmentLight;
use geometry::View;
use glam::{DVec3, Vec3};
use local::{LocalKind, LocalLight};
use suns::{Shares, Sun};
use table::TriangleTable;
use triangle::TriangleView;

/// A point that asks for light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Receiver {
    /// World space, metres.
    pub point: Vec3,
    /// Unit normal whose cosine weighs the light that arrives, on the side from which it can arrive; light from below it may get no
    /// chance. None where light from all sides counts, as on transmissive surfaces.
    pub normal: Option<Vec3>,
    /// Time of the ray, in the unit in which [`EmitterGeometry`] is asked.
    pub time: f32,
}

/// What a light sample landed on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Emitter {
    /// An emissive triangle at `corner 0 + u (corner 1 - corner 0) + v (corner 2 - corner 0)`; its radiance is the caller's to
    /// look up.
    Triangle {
        /// Instance in the prepared scene.
        instance: u32,
        /// Triangle of its mesh.
        primitive: u32,
        /// Weight of the second corner.
        u: f32,
        /// Weight of the third corner.
        v: f32,
    },
    /// A sphere, rectangle or disk.
    Shape {
        /// Index in `Scene::lights`.
        light: u32,
        /// Towards the receiver, W/sr/m^2.
        radiance: Vec3,
    },
    /// The environment.
    Environment {
        /// From that direction, W/sr/m^2.
        radiance: Vec3,
    },
    /// A light without extent.
    Punctual {
        /// Index in `Scene::lights`.
        light: u32,
        /// On a plane that faces the light at the receiver's distance, W/m^2: takes the place of radiance over density.
        irradiance: Vec3,
    },
}

/// A direction from which light may arrive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// Unit length, world space, away from the receiver.
    pub direction: Vec3,
    /// Metres to the emitter; infinite for the environment and directional lights.
    pub distance: f32,
    /// Per steradian and with the probability of choosing the light; for `delta` only that probability. Positive and finite.
    pub pdf: f32,
    /// Whether no other technique can find this light.
    pub delta: bool,
    /// What is there.
    pub emitter: Emitter,
}

/// All lights of a scene; made by [`LightsBuilder`].
#[derive(Debug)]
pub struct Lights {
    /// Emissive triangles: the first numbers of the chooser.
    triangles: TriangleTable,
    /// Lights of the scene's list that have a place: the chooser's numbers after those, by ascending index.
    local: Vec<LocalLight>,
    chooser: Chooser,
    /// What the chooser's powers were divided by.
    unit: f64,
    suns: Vec<Sun>,
    environment: Option<EnvironmentLight>,
    /// Ways to choose: each directional light, the environment, all others together.
    strategies: usize,
    report: LightsReport,
}

impl Receiver {
    fn view(&self) -> View {
        View { point: self.point.as_dvec3(), normal: self.normal.map(Vec3::as_dvec3) }
    }
}

impl Lights {
    fn assemble(
        triangles: TriangleTable,
        local: Vec<LocalLight>,
        chooser: Chooser,
        unit: f64,
        suns: Vec<Sun>,
        environment: Option<EnvironmentLight>,
        report: LightsReport,
    ) -> Self {
        let strategies = suns.len() + usize::from(environment.is_some()) + usize::from(!chooser.is_empty());
        Self { triangles, local, chooser, unit, suns, environment, strategies, report }
    }

    /// What there is, what was left out and what it costs.
    pub fn report(&self) -> &LightsReport {
        &self.report
    }

    /// Whether nothing gives light.
    pub fn is_empty(&self) -> bool {
        self.strategies == 0
    }

    /// Whether an environment gives light.
    pub fn has_environment(&self) -> bool {
        self.environment.is_some()
    }

    /// A direction towards a light for three uniform numbers in [0, 1): `choice` picks the light, `u` the place on it. None where
    /// the light chosen sends nothing to the receiver.
    pub fn sample(
        &self,
        receiver: &Receiver,
        geometry: &impl EmitterGeometry,
        choice: f32,
        u: [f32; 2],
    ) -> Option<LightSample> {
        let view = receiver.view();
        let u = u.map(f64::from);
        let mut choice = f64::from(choice);
        if self.strategies == 1 {
            return match (&self.environment, self.suns.first()) {
                (Some(environment), _) => sample_environment(environment, &view, 1.0, u),
                (None, Some(sun)) => sample_sun(sun, receiver.time, geometry, 1.0),
                (None, None) => self.sample_local(&view, receiver.time, geometry, 1.0, choice, u),
            };
        }

        // Which strategy; what is left of the number picks within it.
        let shares = self.shares(&view, receiver.time, geometry);
        let local = shares.of(self.local_importance(&view));
        if choice < local {
            let choice = choice / local;
            return self.sample_local(&view, receiver.time, geometry, local, choice, u);
        }
        choice -= local;
        if let Some(environment) = &self.environment {
            let share = shares.of(environment.mean_irradiance());
            if choice < share {
                return sample_environment(environment, &view, share, u);
            }
            choice -= share;
        }
        let mut last = None;
        for sun in &self.suns {
            let share = shares.of(sun.importance(&view, receiver.time, geometry));
            if share > 0.0 {
                last = Some((sun, share));
                if choice < share {
                    break;
                }
                choice -= share;
            }
        }
        last.and_then(|(sun, share)| sample_sun(sun, receiver.time, geometry, share))
    }

    /// Density with which [`Lights::sample`] gives the unit `direction`, which meets an emissive triangle on a side that emits;
    /// 0 if it does not sample that triangle.
    pub fn pdf_triangle(
        &self,
        receiver: &Receiver,
        geometry: &impl EmitterGeometry,
        instance: u32,
        primitive: u32,
        direction: Vec3,
    ) -> f32 {
        let Some(entry) = self.triangles.find(instance, primitive) else { return 0.0 };
        let view = receiver.view();
        let triangle = geometry.triangle(instance, primitive, receiver.time);
        let pdf = TriangleView::new(view.point, &triangle, entry.two_sided)
            .map_or(0.0, |seen| seen.pdf(direction.as_dvec3()));
        self.local_pdf(&view, receiver.time, geometry, entry.emitter, pdf)
    }

    /// Density with which [`Lights::sample`] gives the unit `direction`, which meets the lit side of the analytic shape with this
    /// index in `Scene::lights`; 0 if there is no such shape.
    pub fn pdf_shape(
        &self,
        receiver: &Receiver,
        geometry: &impl EmitterGeometry,
        light: u32,
        direction: Vec3,
    ) -> f32 {
        let Ok(index) = self.local.binary_search_by_key(&light, |local| local.light) else { return 0.0 };
        let LocalKind::Shape { shape, .. } = &self.local[index].kind else { return 0.0 };
        let view = receiver.view();
        let placement = geometry.placement(light, receiver.time);
        let pdf = shape.view(view.point, &placement).map_or(0.0, |shape| shape.pdf(direction.as_dvec3()));
        let emitter = self.triangles.len() + index as u32;
        self.local_pdf(&view, receiver.time, geometry, emitter, pdf)
    }

    /// Density with which [`Lights::sample`] gives the unit `direction`, in which only the environment is.
    pub fn pdf_environment(
        &self,
        receiver: &Receiver,
        geometry: &impl EmitterGeometry,
        direction: Vec3,
    ) -> f32 {
        let Some(environment) = &self.environment else { return 0.0 };
        let view = receiver.view();
        let share = if self.strategies == 1 {
            1.0
        } else {
            self.shares(&view, receiver.time, geometry).of(environment.mean_irradiance())
        };
        (share * environment.pdf(direction, view.normal)) as f32
    }

    /// Radiance that comes from infinitely far in a direction of about unit length, W/sr/m^2.
    pub fn environment_radiance(&self, direction: Vec3) -> Vec3 {
        self.environment.as_ref().map_or(Vec3::ZERO, |environment| environment.radiance(direction))
    }

    fn local_importance(&self, view: &View) -> f64 {
        self.chooser.importance(view) * self.unit
    }

    fn shares(&self, view: &View, time: f32, geometry: &impl EmitterGeometry) -> Shares {
        let mut shares = Shares::default();
        shares.add(self.local_importance(view));
        if let Some(environment) = &self.environment {
            shares.add(environment.mean_irradiance());
        }
        for sun in &self.suns {
            shares.add(sun.importance(view, time, geometry));
        }
        shares
    }

    fn sample_local(
        &self,
        view: &View,
        time: f32,
        geometry: &impl EmitterGeometry,
        share: f64,
        choice: f64,
        u: [f64; 2],
    ) -> Option<LightSample> {
        let (emitter, probability) = self.chooser.sample(view, choice)?;
        let chosen = share * probability;
        if emitter < self.triangles.len() {
            let entry = self.triangles.get(emitter);
            let triangle = geometry.triangle(entry.instance, entry.primitive, time);
            let (toward, [second, third]) =
                TriangleView::new(view.point, &triangle, entry.two_sided)?.sample(u);
            let (instance, primitive) = (entry.instance, entry.primitive);
            let emitter = Emitter::Triangle { instance, primitive, u: second as f32, v: third as f32 };
            return finish(toward.direction, toward.distance, chosen * toward.pdf, false, emitter);
        }
        let LocalLight { light, kind } = self.local[(emitter - self.triangles.len()) as usize];
        let placement = geometry.placement(light, time);
        match kind {
            LocalKind::Point(point) => {
                let (direction, distance, irradiance) = point.arrive(view.point, &placement)?;
                finish(direction, distance, chosen, true, Emitter::Punctual { light, irradiance })
            }
            LocalKind::Shape { shape, radiance } => {
                let toward = shape.view(view.point, &placement)?.sample(u);
                let emitter = Emitter::Shape { light, radiance };
                finish(toward.direction, toward.distance, chosen * toward.pdf, false, emitter)
            }
        }
    }

    /// Density of a direction towards a light of the chooser that has density `pdf` once that light is chosen.
    fn local_pdf(
        &self,
        view: &View,
        time: f32,
        geometry: &impl EmitterGeometry,
        emitter: u32,
        pdf: f64,
    ) -> f32 {
        let share = if self.strategies == 1 {
            1.0
        } else {
            self.shares(view, time, geometry).of(self.local_importance(view))
        };
        if pdf > 0.0 { (share * self.chooser.probability(view, emitter) * pdf) as f32 } else { 0.0 }
    }
}

fn sample_environment(
    environment: &EnvironmentLight,
    view: &View,
    share: f64,
    u: [f64; 2],
) -> Option<LightSample> {
    let (direction, pdf, radiance) = environment.sample(u, view.normal);
    finish(direction, f64::INFINITY, share * pdf, false, Emitter::Environment { radiance })
}

fn sample_sun(sun: &Sun, time: f32, geometry: &impl EmitterGeometry, share: f64) -> Option<LightSample> {
    let direction = sun.direction(time, geometry)?;
    let emitter = Emitter::Punctual { light: sun.light, irradiance: sun.irradiance };
    finish(direction, f64::INFINITY, share, true, emitter)
}

/// Rounds to single precision; none where the density is no longer a positive number there.
fn finish(direction: DVec3, distance: f64, pdf: f64, delta: bool, emitter: Emitter) -> Option<LightSample> {
    let (direction, distance, pdf) = (direction.as_vec3(), distance as f32, pdf as f32);
    let sound = direction.is_finite() && distance > 0.0 && pdf > 0.0 && pdf.is_finite();
    sound.then_some(LightSample { direction, distance, pdf, delta, emitter })
}

#[cfg(test)]
mod tests {
    use super::*;
    use farm_scene::LightKind;
    use testing::{Chance, Stage, down, environment, floor};

    /// One of everything.
    fn mixed() -> Stage {
        let pixels = (0..32).map(|index| [0.01 * index as f32; 3]).collect();
        Stage::default()
            .with_triangle(
                [Vec3::new(-2.0, 1.0, 0.0), Vec3::new(-1.0, 1.5, 0.0), Vec3::new(-1.5, 1.0, 1.0)],
                3.0,
            )
            .with_disk(0.5, 2.0, down(Vec3::new(1.0, 2.0, 0.0)))
            .with_rectangle(1.0, 2.0, down(Vec3::new(0.0, 2.0, 1.0)))
            .with_light(
                LightKind::Sphere { radiance: Vec3::ONE, radius: 0.25 },
                Placement::at(Vec3::new(1.0, 1.0, 1.0)),
            )
            .with_light(LightKind::Directional { irradiance: Vec3::ONE }, down(Vec3::ZERO))
            .with_environment(environment(8, 4, pixels))
    }

    fn with_points(stage: Stage) -> Stage {
        let cone = LightKind::Spot { intensity: Vec3::ONE, inner_cone: 0.2, outer_cone: 0.9 };
        stage
            .with_light(
                LightKind::Point { intensity: Vec3::splat(2.0) },
                Placement::at(Vec3::new(-1.0, 1.0, -1.0)),
            )
            .with_light(cone, down(Vec3::new(0.0, 2.0, 0.2)))
    }

    /// The stage's parts, each alone.
    fn parts(stage: &Stage) -> Vec<Stage> {
        let mut parts = vec![
            Stage { lights: Vec::new(), environment: None, ..stage.clone() },
            Stage { environment: stage.environment.clone(), ..Stage::default() },
        ];
        for &(kind, placement) in &stage.lights {
            parts.push(Stage::default().with_light(kind, placement));
        }
        parts
    }

    #[test]
    fn a_mixture_of_all_kinds_sums_to_what_each_gives_alone() {
        let stage = with_points(mixed());
        let receiver = floor(Vec3::new(0.1, 0.0, 0.2));
        let expected: f64 = parts(&stage).iter().map(|part| part.irradiance(&receiver, 128).0).sum();
        let (mean, error) = stage.irradiance(&receiver, 500);
        assert!(
            (mean - expected).abs() < 4.5 * error && error < 0.005 * expected,
            "{mean} +- {error}, expected {expected}"
        );
    }

    #[test]
    fn a_hit_by_chance_is_told_the_density_of_the_choice() {
        let stage = with_points(mixed());
        let lights = stage.build();
        let mut chance = Chance(2);
        let mut strays = 0;
        for _ in 0..20_000 {
            let normal = (chance.next() < 0.5).then(|| chance.direction());
            let receiver = Receiver { point: chance.point() * 2.0, normal, time: 0.0 };
            let u = [chance.next(), chance.next()];
            let Some(sample) = lights.sample(&receiver, &stage, chance.next(), u) else { continue };
            let again = stage.pdf_of(&lights, &receiver, &sample);
            strays += u32::from((again / sample.pdf - 1.0).abs() > 1e-3);
        }
        // Only directions that rounding moves across a pixel's edge.
        assert!(strays < 5, "{strays}");
    }

    #[test]
    fn a_scene_scaled_by_a_power_of_two_gives_the_same_bits() {
        let stage = mixed();
        let small_lights = stage.build();
        for exponent in [-20, 20] {
            let factor = 2.0_f32.powi(exponent);
            let scaled = stage.scaled(factor);
            let lights = scaled.build();
            let mut chance = Chance(4);
            for _ in 0..5000 {
                let normal = (chance.next() < 0.5).then(|| chance.direction());
                let receiver = Receiver { point: chance.point() * 3.0, normal, time: 0.0 };
                let far = Receiver { point: receiver.point * factor, ..receiver };
                let (choice, u) = (chance.next(), [chance.next(), chance.next()]);
                let near = small_lights.sample(&receiver, &stage, choice, u);
                let near = near.map(|sample| LightSample { distance: sample.distance * factor, ..sample });
                assert_eq!(lights.sample(&far, &scaled, choice, u), near);
                if let Some(sample) = near {
                    assert_eq!(
                        stage.pdf_of(&small_lights, &receiver, &sample),
                        scaled.pdf_of(&lights, &far, &sample)
                    );
                }
            }
        }
    }

    #[test]
    fn an_emitter_without_area_changes_no_bit() {
        let plain = mixed();
        let flat = [Vec3::Y, Vec3::Y * 2.0, Vec3::Y * 3.0];
        let mut with =
            plain.clone().with_disk(0.0, 5.0, down(Vec3::Y)).with_rectangle(1.0, 0.0, down(Vec3::Y));
        with = with.with_triangle(flat, 5.0);
        let (one, two) = (plain.build(), with.build());
        assert_eq!(two.report().without_area, 3);
        let mut chance = Chance(6);
        for _ in 0..2000 {
            let receiver = floor(chance.point());
            let (choice, u) = (chance.next(), [chance.next(), chance.next()]);
            assert_eq!(one.sample(&receiver, &plain, choice, u), two.sample(&receiver, &with, choice, u));
        }
    }

    #[test]
    fn what_is_black_or_no_number_is_left_out_and_counted() {
        let stage = Stage::default()
            .with_triangle([Vec3::Y, Vec3::ONE, Vec3::new(2.0, 1.0, 0.0)], 0.0)
            .with_triangle([Vec3::Y, Vec3::ONE, Vec3::new(2.0, 1.0, f32::NAN)], 1.0)
            .with_triangle([Vec3::Y, Vec3::ONE, Vec3::new(2.0, 1.0, 0.0)], f32::INFINITY)
            .with_light(LightKind::Directional { irradiance: Vec3::ZERO }, down(Vec3::ZERO));
        let report = *stage.build().report();
        assert_eq!((report.black, report.unsound, report.triangles), (2, 2, 0));
        assert!(stage.build().is_empty());
    }

    #[test]
    fn point_light_and_sun_arrive_as_they_should() {
        let lamp = LightKind::Point { intensity: Vec3::splat(100.0) };
        let stage = Stage::default().with_light(lamp, Placement::at(Vec3::new(0.0, 2.0, 0.0)));
        assert_eq!(stage.irradiance(&floor(Vec3::ZERO), 1).0, 25.0);
        let lateral = stage.irradiance(&floor(Vec3::new(2.0, 0.0, 0.0)), 1).0;
        assert!((lateral - 8.838_835).abs() < 1e-5, "{lateral}");
        let half = 0.5 * 3.0_f32.sqrt();
        let tilted = Placement { z: Vec3::new(half, 0.5, 0.0), ..down(Vec3::ZERO) };
        let sun = LightKind::Directional { irradiance: Vec3::splat(3.0) };
        let (mean, error) = Stage::default().with_light(sun, tilted).irradiance(&floor(Vec3::ZERO), 8);
        assert!((mean - 1.5).abs() < 1e-6 && error < 1e-7, "{mean} +- {error}");
    }

    #[test]
    fn faint_lights_are_still_lights() {
        let faint = Stage::default().with_disk(1.0, 1e-40, down(Vec3::Y));
        let (mean, _) = faint.irradiance(&floor(Vec3::ZERO), 64);
        assert!((mean / (0.5e-40 * core::f64::consts::PI) - 1.0).abs() < 0.01, "{mean}");
        // Beside one that is 52 orders stronger it still has a chance.
        let lights = faint.with_disk(1.0, 1e12, down(Vec3::new(5.0, 1.0, 0.0)));
        assert!(lights.build().pdf_shape(&floor(Vec3::ZERO), &lights, 0, Vec3::Y) > 0.0);
    }

    #[test]
    fn moving_lights_are_found_where_they_are() {
        let mut stage = Stage { velocity: Vec3::new(100.0, 0.0, 0.0), ..Stage::default() };
        for index in 0..20 {
            let corner = Vec3::new(0.0, 1.0, index as f32);
            stage = stage.with_triangle([corner, corner + Vec3::X, corner + Vec3::Z], 1.0);
        }
        let at_rest = Stage { velocity: Vec3::ZERO, ..stage.clone() };
        let (expected, _) = at_rest.irradiance(&floor(Vec3::ZERO), 300);
        for time in [0.0, 0.37, 1.0] {
            let receiver = Receiver { time, ..floor(Vec3::new(100.0 * time, 0.0, 0.0)) };
            let (mean, error) = stage.irradiance(&receiver, 300);
            assert!((mean / expected - 1.0).abs() < 0.05 + 4.0 * error / expected, "{mean} for {expected}");
        }
    }
}
