//! Scenes of nothing but lights, for the tests of this folder.

use super::{
    Emitter, EmitterGeometry, EmitterTriangle, LightSample, Lights, LightsBuilder, Placement, Receiver,
    TriangleEmitter,
};
use farm_scene::{Environment, Image, LightKind, Pixels};
use glam::{Quat, Vec3};

/// Triangles of instance 0 and the lights of a list, where they are at rest, and the velocity of all of them.
#[derive(Clone, Debug, Default)]
pub struct Stage {
    pub triangles: Vec<[Vec3; 3]>,
    pub radiances: Vec<Vec3>,
    pub two_sided: bool,
    pub mirrored: bool,
    pub lights: Vec<(LightKind, Placement)>,
    pub velocity: Vec3,
    pub environment: Option<Environment>,
}

impl EmitterGeometry for Stage {
    fn triangle(&self, _instance: u32, primitive: u32, time: f32) -> EmitterTriangle {
        let corners = self.triangles[primitive as usize].map(|corner| corner + self.velocity * time);
        EmitterTriangle { corners, mirrored: self.mirrored }
    }

    fn placement(&self, light: u32, time: f32) -> Placement {
        let placement = self.lights[light as usize].1;
        Placement { origin: placement.origin + self.velocity * time, ..placement }
    }
}

/// A placement that looks along -Y: lights shine down.
pub fn down(origin: Vec3) -> Placement {
    Placement { origin, x: Vec3::X, y: Vec3::NEG_Z, z: Vec3::Y }
}

/// A receiver at rest on a floor.
pub fn floor(point: Vec3) -> Receiver {
    Receiver { point, normal: Some(Vec3::Y), time: 0.0 }
}

/// A float image as an environment.
pub fn environment(width: u32, height: u32, pixels: Vec<[f32; 3]>) -> Environment {
    let image = Image { name: "sky".to_owned(), width, height, pixels: Pixels::Float(pixels) };
    Environment { image, intensity: 1.0, rotation: Quat::IDENTITY, visible_to_camera: true }
}

impl Stage {
    pub fn with_triangle(mut self, corners: [Vec3; 3], radiance: f32) -> Self {
        self.triangles.push(corners);
        self.radiances.push(Vec3::splat(radiance));
        self
    }

    pub fn with_light(mut self, kind: LightKind, placement: Placement) -> Self {
        self.lights.push((kind, placement));
        self
    }

    pub fn with_environment(mut self, environment: Environment) -> Self {
        self.environment = Some(environment);
        self
    }

    pub fn with_disk(self, radius: f32, radiance: f32, placement: Placement) -> Self {
        self.with_light(LightKind::Disk { radiance: Vec3::splat(radiance), radius }, placement)
    }

    pub fn with_rectangle(self, width: f32, height: f32, placement: Placement) -> Self {
        self.with_light(LightKind::Rectangle { radiance: Vec3::ONE, width, height }, placement)
    }

    /// The same stage, `factor` times as large.
    pub fn scaled(&self, factor: f32) -> Self {
        let mut stage = self.clone();
        for corner in stage.triangles.iter_mut().flatten() {
            *corner *= factor;
        }
        for (_, placement) in &mut stage.lights {
            *placement = Placement {
                origin: placement.origin * factor,
                x: placement.x * factor,
                y: placement.y * factor,
                z: placement.z * factor,
            };
        }
        stage.velocity *= factor;
        stage
    }

    pub fn build(&self) -> Lights {
        let mut builder = LightsBuilder::new(0.0, 1.0);
        let moving = self.velocity != Vec3::ZERO;
        for (primitive, &radiance) in self.radiances.iter().enumerate() {
            builder.triangle(TriangleEmitter {
                instance: 0,
                primitive: primitive as u32,
                radiance,
                two_sided: self.two_sided,
                moving,
            });
        }
        for (index, (kind, _)) in self.lights.iter().enumerate() {
            builder.light(index as u32, *kind, moving);
        }
        if let Some(environment) = &self.environment {
            builder.environment(environment.clone());
        }
        builder.build(self)
    }

    /// Radiance, or for lights without extent irradiance, of the red channel.
    pub fn light_of(&self, sample: &LightSample) -> f64 {
        f64::from(match sample.emitter {
            Emitter::Triangle { primitive, .. } => self.radiances[primitive as usize].x,
            Emitter::Shape { radiance, .. } | Emitter::Environment { radiance } => radiance.x,
            Emitter::Punctual { irradiance, .. } => irradiance.x,
        })
    }

    /// The density that a ray in the sample's direction would be told.
    pub fn pdf_of(&self, lights: &Lights, receiver: &Receiver, sample: &LightSample) -> f32 {
        let direction = sample.direction;
        match sample.emitter {
            Emitter::Triangle { instance, primitive, .. } => {
                lights.pdf_triangle(receiver, self, instance, primitive, direction)
            }
            Emitter::Shape { light, .. } => lights.pdf_shape(receiver, self, light, direction),
            Emitter::Environment { .. } => lights.pdf_environment(receiver, self, direction),
            Emitter::Punctual { .. } => sample.pdf,
        }
    }

    /// Irradiance on the receiver with its standard error, from `side`^2 stratified samples of each light number.
    pub fn irradiance(&self, receiver: &Receiver, side: u32) -> (f64, f64) {
        let lights = self.build();
        let normal = receiver.normal.unwrap().as_dvec3();
        let mut chance = Chance(17);
        let (mut sum, mut squares) = (0.0, 0.0);
        let count = side * side;
        for index in 0..count {
            let (x, y) = (index % side, index / side);
            let u = [x, y].map(|cell| (cell as f32 + chance.next()) / side as f32);
            let u = u.map(|u| u.min(1.0 - f32::EPSILON / 2.0));
            let sample = lights.sample(receiver, self, chance.next(), u);
            let value = sample.map_or(0.0, |sample| {
                let cosine = sample.direction.as_dvec3().dot(normal).max(0.0);
                self.light_of(&sample) * cosine / f64::from(sample.pdf)
            });
            sum += value;
            squares += value * value;
        }
        let mean = sum / f64::from(count);
        let variance = (squares / f64::from(count) - mean * mean).max(0.0);
        (mean, (variance / f64::from(count)).sqrt())
    }

    /// Asserts that the irradiance is `expected` within `relative`.
    pub fn expect_irradiance(&self, receiver: &Receiver, expected: f64, relative: f64) {
        let (mean, error) = self.irradiance(receiver, 128);
        assert!((mean - expected).abs() <= relative * expected, "{mean} +- {error}, expected {expected}");
    }
}

/// A small generator with a seed (PCG, O'Neill 2014).
#[derive(Clone, Copy, Debug)]
pub struct Chance(pub u64);

impl Chance {
    /// In [0, 1).
    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let word = (((self.0 >> 18) ^ self.0) >> 27) as u32;
        crate::math::unit_f32(word.rotate_right((self.0 >> 59) as u32))
    }

    /// In the cube from -1 to 1.
    pub fn point(&mut self) -> Vec3 {
        Vec3::new(self.next(), self.next(), self.next()) * 2.0 - 1.0
    }

    /// A unit vector, evenly in all directions.
    pub fn direction(&mut self) -> Vec3 {
        loop {
            let point = self.point();
            if (0.01..=1.0).contains(&point.length_squared()) {
                return point.normalize();
            }
        }
    }
}
