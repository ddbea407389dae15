//! Collects a scene's emitters and makes the table of lights.

use super::{
    EmitterGeometry, EmitterTriangle, Lights, LightsReport,
    bounds::{CONE_SLACK, Item, LightBounds, unite},
    chooser::Chooser,
    environment::{EnvironmentLight, luminance},
    geometry::Placement,
    local::{LocalKind, LocalLight},
    punctual::{PointLight, SpotCone},
    shape::Shape,
    suns::Sun,
    table::TriangleTable,
};
use crate::transform::Jumps;
use farm_scene::{Environment, LightKind};
use glam::{DVec3, Vec3};

/// Intervals of the shutter at whose ends a moving emitter is looked at.
const MOTION_STEPS: u32 = 16;

/// An emissive triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TriangleEmitter {
    /// Instance in the prepared scene.
    pub instance: u32,
    /// Triangle of its mesh.
    pub primitive: u32,
    /// Mean radiance, W/sr/m^2; steers sampling only. A triangle whose mean is black is not sampled.
    pub radiance: Vec3,
    /// Whether the back emits too.
    pub two_sided: bool,
    /// Whether it may be elsewhere at another time within the shutter.
    pub moving: bool,
}

/// Collects emitters; see [`Lights`].
#[derive(Debug, Default)]
pub struct LightsBuilder {
    times: [f32; 2],
    jumps: Jumps,
    triangles: Vec<TriangleEmitter>,
    lights: Vec<(u32, LightKind, bool)>,
    environment: Option<Environment>,
}

/// Where an emitter is at one time.
struct Pose {
    /// Points whose box holds it.
    outline: [DVec3; 4],
    /// Unit axis of emission; zero is every direction.
    axis: DVec3,
    /// Area times what the emitter's strength has to be multiplied by.
    size: f64,
}

/// Why an emitter is left out.
enum Fault {
    WithoutArea,
    Black,
    Unsound,
}

impl LightsBuilder {
    /// For a shutter that is open between two times, in the unit in which [`EmitterGeometry`] is asked.
    pub fn new(open: f32, close: f32) -> Self {
        Self { times: [open, close], ..Self::default() }
    }

    /// Emitters may jump at these times of a shutter that is open from 0 to 1.
    pub fn jumping(self, jumps: Jumps) -> Self {
        Self { jumps, ..self }
    }

    /// Adds an emissive triangle.
    pub fn triangle(&mut self, triangle: TriangleEmitter) {
        self.triangles.push(triangle);
    }

    /// Adds the light with this index in `Scene::lights`; `moving` if it may be elsewhere at another time.
    pub fn light(&mut self, index: u32, kind: LightKind, moving: bool) {
        self.lights.push((index, kind, moving));
    }

    /// Sets the environment.
    pub fn environment(&mut self, environment: Environment) {
        self.environment = Some(environment);
    }

    /// Makes the table. The order in which emitters were added does not matter.
    pub fn build(mut self, geometry: &impl EmitterGeometry) -> Lights {
        let mut report = LightsReport::default();
        let mut items = Vec::with_capacity(self.triangles.len() + self.lights.len());
        self.triangles.sort_unstable_by_key(|triangle| (triangle.instance, triangle.primitive));
        self.lights.sort_unstable_by_key(|light| light.0);
        let triangles = self.add_triangles(geometry, &mut items, &mut report);
        let (local, suns) = self.add_lights(geometry, &mut items, &mut report);
        let (environment, repaired) = self.environment.map_or((None, 0), EnvironmentLight::new);

        let unit = power_unit(&items);
        let chooser = Chooser::build(items, unit);
        report.environment = environment.is_some();
        report.environment_pixels_repaired = repaired;
        report.tree_nodes = chooser.nodes() as u64;
        report.bytes = (triangles.bytes()
            + chooser.bytes()
            + size_of_val(local.as_slice())
            + size_of_val(suns.as_slice())
            + environment.as_ref().map_or(0, EnvironmentLight::bytes)) as u64;
        Lights::assemble(triangles, local, chooser, unit, suns, environment, report)
    }

    fn add_triangles(
        &self,
        geometry: &impl EmitterGeometry,
        items: &mut Vec<Item>,
        report: &mut LightsReport,
    ) -> TriangleTable {
        let mut table = TriangleTable::default();
        for triangle in &self.triangles {
            let pose = |time| triangle_pose(geometry.triangle(triangle.instance, triangle.primitive, time));
            let bounded = strength(triangle.radiance).and_then(|strength| {
                bound(self.times(triangle.moving), pose, strength, triangle.two_sided, 0.0)
            });
            match bounded {
                Ok((bounds, power)) => {
                    let emitter = table.push(triangle.instance, triangle.primitive, triangle.two_sided);
                    items.push(Item { bounds, power, emitter });
                    report.triangles += 1;
                }
                Err(fault) => report.leave_out(&fault),
            }
        }
        table
    }

    fn add_lights(
        &self,
        geometry: &impl EmitterGeometry,
        items: &mut Vec<Item>,
        report: &mut LightsReport,
    ) -> (Vec<LocalLight>, Vec<Sun>) {
        let (mut local, mut suns) = (Vec::new(), Vec::new());
        for &(light, kind, moving) in &self.lights {
            let (kind, color) = match kind {
                LightKind::Directional { irradiance } => {
                    match strength(irradiance) {
                        Ok(luminance) => suns.push(Sun { light, irradiance, luminance }),
                        Err(fault) => report.leave_out(&fault),
                    }
                    continue;
                }
                LightKind::Point { intensity } => {
                    (LocalKind::Point(PointLight { intensity, cone: None }), intensity)
                }
                LightKind::Spot { intensity, inner_cone, outer_cone } => {
                    let cone = Some(SpotCone::new(inner_cone, outer_cone));
                    (LocalKind::Point(PointLight { intensity, cone }), intensity)
                }
                LightKind::Sphere { radiance, radius } => {
                    (LocalKind::Shape { shape: Shape::Sphere { radius }, radiance }, radiance)
                }
                LightKind::Rectangle { radiance, width, height } => {
                    (LocalKind::Shape { shape: Shape::Rectangle { width, height }, radiance }, radiance)
                }
                LightKind::Disk { radiance, radius } => {
                    (LocalKind::Shape { shape: Shape::Disk { radius }, radiance }, radiance)
                }
            };
            let pose = |time| local_pose(&kind, &geometry.placement(light, time));
            let bounded = strength(color)
                .and_then(|strength| bound(self.times(moving), pose, strength, false, kind.cos_falloff()));
            match bounded {
                Ok((bounds, power)) => {
                    items.push(Item { bounds, power, emitter: items.len() as u32 });
                    report.count(&kind);
                    local.push(LocalLight { light, kind });
                }
                Err(fault) => report.leave_out(&fault),
            }
        }
        report.directionals = suns.len() as u64;
        (local, suns)
    }

    /// Times at which an emitter is looked at.
    fn times(&self, moving: bool) -> Vec<f32> {
        let [open, close] = self.times;
        let steps = if moving && close > open { MOTION_STEPS as usize } else { return vec![open] };
        let keys = (steps + 1) * self.jumps.pieces();
        (0..keys).map(|key| open + (close - open) * self.jumps.key_time(key, keys)).collect()
    }
}

impl LightsReport {
    fn leave_out(&mut self, fault: &Fault) {
        match fault {
            Fault::WithoutArea => self.without_area += 1,
            Fault::Black => self.black += 1,
            Fault::Unsound => self.unsound += 1,
        }
    }

    fn count(&mut self, kind: &LocalKind) {
        *match kind {
            LocalKind::Point(PointLight { cone: None, .. }) => &mut self.points,
            LocalKind::Point(PointLight { cone: Some(_), .. }) => &mut self.spots,
            LocalKind::Shape { shape: Shape::Sphere { .. }, .. } => &mut self.spheres,
            LocalKind::Shape { shape: Shape::Rectangle { .. }, .. } => &mut self.rectangles,
            LocalKind::Shape { shape: Shape::Disk { .. }, .. } => &mut self.disks,
        } += 1;
    }
}

/// Luminance of an emitter's colour.
fn strength(color: Vec3) -> Result<f64, Fault> {
    if !color.is_finite() || color.min_element() < 0.0 {
        return Err(Fault::Unsound);
    }
    let strength = luminance(color.to_array());
    if strength > 0.0 { Ok(strength) } else { Err(Fault::Black) }
}

/// The power of two just below the strongest power: dividing by it loses no bits.
fn power_unit(items: &[Item]) -> f64 {
    let strongest = items.iter().fold(f64::MIN_POSITIVE, |strongest, item| strongest.max(item.power));
    f64::from_bits(strongest.to_bits() & 0x7ff0_0000_0000_0000)
}

fn triangle_pose(triangle: EmitterTriangle) -> Pose {
    let [a, b, c] = triangle.corners.map(Vec3::as_dvec3);
    let normal = if triangle.mirrored { (c - a).cross(b - a) } else { (b - a).cross(c - a) };
    Pose { outline: [a, b, c, a], axis: normal.normalize_or_zero(), size: 0.5 * normal.length() }
}

fn local_pose(kind: &LocalKind, placement: &Placement) -> Pose {
    match kind {
        LocalKind::Point(light) => {
            let axis = if light.cone.is_some() { placement.forward() } else { DVec3::ZERO };
            Pose { outline: [placement.origin.as_dvec3(); 4], axis, size: 1.0 }
        }
        LocalKind::Shape { shape, .. } => {
            let axis = match shape {
                Shape::Sphere { .. } => DVec3::ZERO,
                Shape::Rectangle { .. } | Shape::Disk { .. } => placement.facing().normalize_or_zero(),
            };
            Pose { outline: shape.outline(placement), axis, size: shape.cross_section(placement) }
        }
    }
}

/// Bounds and power over all times at which an emitter is looked at. Between two of them a moving emitter may be off their hull by
/// as much as half the way between them (an arc of a half circle), and point anywhere between: bounds grow by the
/// longest step.
fn bound(
    times: Vec<f32>,
    pose: impl Fn(f32) -> Pose,
    strength: f64,
    two_sided: bool,
    cos_falloff: f32,
) -> Result<(LightBounds, f64), Fault> {
    let mut items: Vec<Item> = Vec::new();
    let (mut stride, mut turn) = (0.0_f64, 1.0_f64);
    let mut previous: Option<Pose> = None;
    for pose in times.into_iter().map(pose) {
        if !pose.outline.iter().all(|point| point.is_finite()) || !pose.size.is_finite() {
            return Err(Fault::Unsound);
        }
        if let Some(previous) = &previous {
            let steps = pose.outline.iter().zip(previous.outline).map(|(now, then)| (*now - then).length());
            stride = steps.fold(stride, f64::max);
            turn = turn.min(pose.axis.dot(previous.axis));
        }
        items.push(Item {
            bounds: pose_bounds(&pose, two_sided, cos_falloff),
            power: strength * pose.size,
            emitter: 0,
        });
        previous = Some(pose);
    }
    let power = items.iter().fold(0.0_f64, |power, item| power.max(item.power));
    if power <= 0.0 {
        return Err(Fault::WithoutArea);
    }
    let mut bounds = unite(&items, 1.0);
    if items.len() > 1 {
        let pad = DVec3::splat(0.5 * stride);
        bounds.min = round_down(bounds.min.as_dvec3() - pad);
        bounds.max = round_up(bounds.max.as_dvec3() + pad);
        if turn < 1.0 - CONE_SLACK {
            let spread = f64::from(bounds.cos_spread);
            let sine = |cosine: f64| (1.0 - cosine * cosine).max(0.0).sqrt();
            let wider = spread * turn - sine(spread) * sine(turn);
            bounds.cos_spread = if spread <= -turn { -1.0 } else { wider.max(-1.0) as f32 };
        }
    }
    Ok((bounds, power))
}

fn pose_bounds(pose: &Pose, two_sided: bool, cos_falloff: f32) -> LightBounds {
    let [first, rest @ ..] = pose.outline;
    let (min, max) = rest.iter().fold((first, first), |(min, max), &point| (min.min(point), max.max(point)));
    let anywhere = pose.axis == DVec3::ZERO;
    LightBounds {
        min: round_down(min),
        max: round_up(max),
        axis: pose.axis.as_vec3(),
        cos_spread: if anywhere { -1.0 } else { 1.0 - CONE_SLACK as f32 },
        cos_falloff,
        power: 0.0,
        two_sided,
    }
}

/// The nearest single-precision vector that is nowhere above.
fn round_down(v: DVec3) -> Vec3 {
    let round = |x: f64| if f64::from(x as f32) > x { (x as f32).next_down() } else { x as f32 };
    Vec3::new(round(v.x), round(v.y), round(v.z))
}

/// The nearest single-precision vector that is nowhere below.
fn round_up(v: DVec3) -> Vec3 {
    -round_down(-v)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{cos_f64, sin_f64};

    /// A triangle on an arm of length 2 that turns about the Y axis; `turns` per unit of time.
    fn turning(turns: f64) -> impl Fn(f32) -> Pose {
        move |time| {
            let angle = core::f64::consts::TAU * turns * f64::from(time);
            let turn = |p: Vec3| {
                let (sin, cos) = (sin_f64(angle) as f32, cos_f64(angle) as f32);
                Vec3::new(p.x * cos + p.z * sin, p.y, p.z * cos - p.x * sin)
            };
            let corners = [Vec3::new(2.0, 0.0, 0.0), Vec3::new(2.0, 1.0, 0.0), Vec3::new(2.0, 0.0, 1.0)];
            triangle_pose(EmitterTriangle { corners: corners.map(turn), mirrored: false })
        }
    }

    #[test]
    fn bounds_hold_a_turning_emitter_between_the_times_at_which_it_was_looked_at() {
        for turns in [0.0, 0.03, 0.25, 1.0, 3.0] {
            let builder = LightsBuilder::new(0.0, 1.0);
            let pose = turning(turns);
            let Ok((bounds, power)) = bound(builder.times(true), &pose, 2.0, false, 0.0) else {
                panic!("an emitter with area")
            };
            assert!((power - 1.0).abs() < 1e-6, "strength 2 on half a square metre, not {power}");
            for step in 0..=1000 {
                let pose = pose(step as f32 / 1000.0);
                for point in pose.outline {
                    let point = point.as_vec3();
                    assert!(point.cmpge(bounds.min).all() && point.cmple(bounds.max).all(), "{point}");
                }
                let cosine = pose.axis.dot(bounds.axis.as_dvec3());
                assert!(
                    cosine >= f64::from(bounds.cos_spread),
                    "{turns} turns: axis {cosine} outside the cone"
                );
            }
        }
    }

    #[test]
    fn an_emitter_at_rest_is_looked_at_once() {
        let builder = LightsBuilder::new(1.0, 2.0);
        assert_eq!(builder.times(false), [1.0]);
        let times = builder.times(true);
        assert_eq!((times.len(), times[0], times[MOTION_STEPS as usize]), (17, 1.0, 2.0));
    }
}
