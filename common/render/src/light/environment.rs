//! Light from infinitely far: a latitude-longitude image, looked up and sampled as a function that is constant in each pixel.
//!
//! Lookup does not interpolate. So the importance-sampled density is proportional to the radiance's luminance everywhere, a single
//! bright pixel is found without variance, and the energy is exactly the sum over pixels. Within a pixel directions are uniform in
//! solid angle: uniform in longitude and in height y, since a band of the sphere has an area proportional to its height.

use crate::math::{PI, atan2, cos_f64, sin_cos_turns};
use farm_scene::{Environment, Pixels};
use glam::{DVec3, Vec3};

/// Pixels per stored prefix sum of a row; within a block they are summed anew. A sixteenth of the memory, and a block is three
/// cache lines of the image.
const BLOCK: usize = 16;

/// The environment as a light.
#[derive(Debug)]
pub(super) struct EnvironmentLight {
    width: usize,
    height: usize,
    /// Radiance with the intensity in it; finite, not negative.
    pixels: Vec<[f32; 3]>,
    /// Rows of the rotation from environment to world space.
    rotation: [DVec3; 3],
    /// y at the rows' upper edges, from 1 down to -1; one more than rows.
    heights: Vec<f64>,
    /// Luminance times solid angle summed over the rows above; one more than rows.
    rows: Vec<f64>,
    /// Luminance summed over the blocks to the left within a row, unscaled.
    blocks: Vec<f64>,
    /// How it is sampled.
    sampling: Sampling,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Sampling {
    /// Every pixel is the same: by the receiver's cosine.
    Constant,
    /// By luminance.
    Image,
}

/// Luminance of linear Rec. 709 in double precision: a light of 1e-40 is still a light.
pub(super) fn luminance(rgb: [f32; 3]) -> f64 {
    0.2126 * f64::from(rgb[0]) + 0.7152 * f64::from(rgb[1]) + 0.0722 * f64::from(rgb[2])
}

impl EnvironmentLight {
    /// None where it is black. The count is of pixels that had to be repaired.
    pub fn new(environment: Environment) -> (Option<Self>, u64) {
        let (width, height) = (environment.image.width as usize, environment.image.height as usize);
        let Pixels::Float(mut pixels) = environment.image.pixels else { return (None, 0) };
        assert_eq!(pixels.len(), width * height, "a validated scene: one value per pixel of the environment");
        let repaired = apply_intensity(&mut pixels, environment.intensity);
        if pixels.iter().all(|&pixel| luminance(pixel) == 0.0) {
            return (None, repaired);
        }
        let sampling = if pixels.iter().all(|pixel| *pixel == pixels[0]) {
            pixels.truncate(1);
            Sampling::Constant
        } else {
            Sampling::Image
        };
        let (width, height) = if sampling == Sampling::Constant { (1, 1) } else { (width, height) };
        let heights = (0..=height).map(|row| cos_f64(core::f64::consts::PI * row as f64 / height as f64));
        let mut light = Self {
            width,
            height,
            pixels,
            rotation: rotation_rows(environment.rotation.as_dquat()),
            heights: heights.collect(),
            rows: Vec::with_capacity(height + 1),
            blocks: Vec::with_capacity(height * width.div_ceil(BLOCK)),
            sampling,
        };
        light.heights[height] = -1.0;
        light.sum();
        (Some(light), repaired)
    }

    fn sum(&mut self) {
        let mut total = 0.0;
        self.rows.push(total);
        for row in 0..self.height {
            let mut left = 0.0;
            for block in self.pixels[row * self.width..(row + 1) * self.width].chunks(BLOCK) {
                self.blocks.push(left);
                left = block.iter().fold(left, |sum, &pixel| sum + luminance(pixel));
            }
            total += left * self.pixel_angle(row);
            self.rows.push(total);
        }
    }

    /// Solid angle of each pixel of a row.
    fn pixel_angle(&self, row: usize) -> f64 {
        core::f64::consts::TAU * (self.heights[row] - self.heights[row + 1]) / self.width as f64
    }

    /// Luminance integrated over the sphere.
    fn total(&self) -> f64 {
        self.rows[self.height]
    }

    /// Irradiance, in units of luminance, that it would give if it were as bright everywhere as it is in the mean.
    pub fn mean_irradiance(&self) -> f64 {
        0.25 * self.total()
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        size_of_val(self.pixels.as_slice())
            + size_of::<f64>() * (self.heights.len() + self.rows.len() + self.blocks.len())
    }

    /// Radiance from a world direction of about unit length.
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        Vec3::from_array(self.pixels[self.pixel_toward(direction.as_dvec3())])
    }

    /// Density with which [`EnvironmentLight::sample`] gives a unit direction, 1/sr.
    pub fn pdf(&self, direction: Vec3, normal: Option<DVec3>) -> f64 {
        match self.sampling {
            Sampling::Constant => match normal {
                Some(normal) => direction.as_dvec3().dot(normal).max(0.0) * f64::from(crate::math::INV_PI),
                None => 0.25 * f64::from(crate::math::INV_PI),
            },
            Sampling::Image => luminance(self.pixels[self.pixel_toward(direction.as_dvec3())]) / self.total(),
        }
    }

    /// A unit world direction with its density and radiance, for two uniform numbers.
    pub fn sample(&self, u: [f64; 2], normal: Option<DVec3>) -> (DVec3, f64, Vec3) {
        match self.sampling {
            Sampling::Constant => {
                let (direction, pdf) = sample_constant(u, normal);
                (direction, pdf, Vec3::from_array(self.pixels[0]))
            }
            Sampling::Image => {
                let (direction, index) = self.sample_image(u);
                let pixel = self.pixels[index];
                let pdf = luminance(pixel) / self.total();
                #[cfg(feature = "mutations")]
                let pdf = crate::mutations::environment_density(pdf, direction.y);
                (direction, pdf, Vec3::from_array(pixel))
            }
        }
    }

    fn sample_image(&self, [u0, u1]: [f64; 2]) -> (DVec3, usize) {
        // The row, and how far down in it.
        let target = u1 * self.total();
        let row = self.rows.partition_point(|&above| above <= target).clamp(1, self.height) - 1;
        let (row, down) = part(row, &self.rows, target);
        let y = self.heights[row] + (self.heights[row + 1] - self.heights[row]) * down;

        // The block, then the pixel in it, and how far right in that.
        let per_row = self.width.div_ceil(BLOCK);
        let blocks = &self.blocks[row * per_row..(row + 1) * per_row];
        let pixels = &self.pixels[row * self.width..(row + 1) * self.width];
        let row_total = (self.rows[row + 1] - self.rows[row]) / self.pixel_angle(row);
        let target = u0 * row_total;
        let block = blocks.partition_point(|&left| left <= target).max(1) - 1;
        let (column, right) = walk(pixels, block * BLOCK, blocks[block], target);
        let turn = (column as f64 + right) / self.width as f64;

        let (sin, cos) = sin_cos_turns(turn as f32);
        let radius = ((1.0 - y) * (1.0 + y)).max(0.0).sqrt();
        // u = 0.5 looks along +X, so turns are counted from -X.
        let local = DVec3::new(-radius * f64::from(cos), y, -radius * f64::from(sin));
        let [x, y, z] = self.rotation;
        (DVec3::new(x.dot(local), y.dot(local), z.dot(local)), row * self.width + column)
    }

    /// Index of the pixel seen in a world direction.
    fn pixel_toward(&self, world: DVec3) -> usize {
        if self.sampling == Sampling::Constant {
            return 0;
        }
        let [x, y, z] = self.rotation;
        let local = x * world.x + y * world.y + z * world.z;
        let turn = 0.5 + atan2(local.z as f32, local.x as f32) / (2.0 * PI);
        let column = ((turn * self.width as f32) as usize).min(self.width - 1);
        self.row_at(local) * self.width + column
    }

    /// The row whose band holds the direction: a first guess from the angle, put right by the bands' exact edges.
    fn row_at(&self, local: DVec3) -> usize {
        let y = local.y / local.length();
        // Unlike the arc sine, precise at the poles too.
        let across = (local.x * local.x + local.z * local.z).sqrt();
        let v = 0.5 - atan2(local.y as f32, across as f32) / PI;
        let mut row = ((v * self.height as f32) as usize).min(self.height - 1);
        while row > 0 && y > self.heights[row] {
            row -= 1;
        }
        while row + 1 < self.height && y <= self.heights[row + 1] {
            row += 1;
        }
        row
    }
}

/// Multiplies the pixels and replaces what is then no light by 0; counts those pixels.
fn apply_intensity(pixels: &mut [[f32; 3]], intensity: f32) -> u64 {
    let mut repaired = 0;
    for pixel in pixels {
        let scaled = pixel.map(|value| value * intensity);
        let sound = scaled.iter().all(|value| value.is_finite() && *value >= 0.0);
        repaired += u64::from(!sound);
        *pixel = if sound { scaled } else { [0.0; 3] };
    }
    repaired
}

fn rotation_rows(rotation: glam::DQuat) -> [DVec3; 3] {
    let glam::DQuat { x, y, z, w } = rotation;
    [
        DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        DVec3::new(2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        DVec3::new(2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    ]
}

/// How far `target` is into the interval that starts at `sums[index]`; steps back over empty intervals, into which only rounding
/// at the end can lead.
fn part(mut index: usize, sums: &[f64], target: f64) -> (usize, f64) {
    while index > 0 && sums[index + 1] <= sums[index] {
        index -= 1;
    }
    let size = sums[index + 1] - sums[index];
    (index, if size > 0.0 { ((target - sums[index]) / size).clamp(0.0, 1.0) } else { 0.5 })
}

/// The pixel in which the row's running sum of luminances, `left` at pixel `first`, passes `target`, and how far into it.
fn walk(pixels: &[[f32; 3]], first: usize, left: f64, target: f64) -> (usize, f64) {
    let mut sum = left;
    let mut last_lit = None;
    for (offset, &pixel) in pixels[first..].iter().enumerate() {
        let value = luminance(pixel);
        if value > 0.0 {
            if target < sum + value {
                return (first + offset, ((target - sum) / value).clamp(0.0, 1.0));
            }
            last_lit = Some(first + offset);
        }
        sum += value;
    }
    // Rounding has led past the end: the last pixel of the row that gives light.
    let last = last_lit.or_else(|| pixels.iter().rposition(|&pixel| luminance(pixel) > 0.0));
    (last.unwrap_or(first), 0.5)
}

/// Uniform over the sphere, or by the cosine to a normal.
fn sample_constant([u0, u1]: [f64; 2], normal: Option<DVec3>) -> (DVec3, f64) {
    let (sin, cos) = sin_cos_turns(u0 as f32);
    let (sin, cos) = (f64::from(sin), f64::from(cos));
    let inv_pi = f64::from(crate::math::INV_PI);
    match normal {
        Some(normal) => {
            // 1 - u, which is never 0.
            let square = 1.0 - u1;
            let radius = u1.sqrt();
            let height = square.sqrt();
            let x = normal.any_orthonormal_vector();
            let y = normal.cross(x);
            (x * (radius * cos) + y * (radius * sin) + normal * height, height * inv_pi)
        }
        None => {
            let y = 1.0 - 2.0 * u1;
            let radius = (1.0 - y * y).max(0.0).sqrt();
            (DVec3::new(radius * cos, y, radius * sin), 0.25 * inv_pi)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::testing::{Chance, Stage, environment, floor};

    fn light(width: u32, height: u32, pixels: Vec<[f32; 3]>) -> EnvironmentLight {
        EnvironmentLight::new(environment(width, height, pixels)).0.unwrap()
    }

    #[test]
    fn one_bright_pixel_is_found_without_noise() {
        let mut pixels = vec![[0.0; 3]; 4096 * 2048];
        pixels[512 * 4096 + 1234] = [1e6; 3];
        let stage = Stage::default().with_environment(environment(4096, 2048, pixels));
        let (mean, error) = stage.irradiance(&floor(Vec3::ZERO), 4);
        assert!((mean / 1.176_547 - 1.0).abs() < 1e-3 && error < 1e-3, "{mean} +- {error}");
    }

    #[test]
    fn a_constant_sky_gives_pi_without_noise() {
        let stage = Stage::default().with_environment(environment(1, 1, vec![[1.0; 3]]));
        let (mean, error) = stage.irradiance(&floor(Vec3::ZERO), 4);
        assert!((mean - core::f64::consts::PI).abs() < 1e-5 && error < 1e-5, "{mean} +- {error}");
    }

    #[test]
    fn a_black_sky_is_no_light() {
        let stage = Stage::default().with_environment(environment(4, 2, vec![[0.0; 3]; 8]));
        let lights = stage.build();
        assert!(lights.is_empty() && !lights.has_environment());
        assert!(lights.sample(&floor(Vec3::ZERO), &stage, 0.5, [0.5; 2]).is_none());
        assert_eq!(lights.pdf_environment(&floor(Vec3::ZERO), &stage, Vec3::Y), 0.0);
        assert_eq!(lights.environment_radiance(Vec3::Y), Vec3::ZERO);
    }

    #[test]
    fn pixels_that_are_no_numbers_become_black_and_are_counted() {
        let mut pixels = vec![[1.0; 3]; 8];
        pixels[3][1] = f32::NAN;
        pixels[5][0] = f32::INFINITY;
        let stage = Stage::default().with_environment(environment(4, 2, pixels));
        assert_eq!(stage.build().report().environment_pixels_repaired, 2);
        let (mean, _) = stage.irradiance(&floor(Vec3::ZERO), 64);
        assert!((mean / (0.75 * core::f64::consts::PI) - 1.0).abs() < 1e-2, "{mean}");
    }

    #[test]
    fn samples_follow_the_density_and_the_picture() {
        // Also with dark rows and columns, a last block that is not full, and a rotation.
        let mut chance = Chance(23);
        let mut pixels: Vec<[f32; 3]> = (0..37 * 20).map(|_| [chance.next().powi(8); 3]).collect();
        pixels[..37].fill([0.0; 3]);
        for row in 0..20 {
            pixels[row * 37 + 36] = [0.0; 3];
        }
        let mut sky = environment(37, 20, pixels.clone());
        sky.rotation = glam::Quat::from_xyzw(0.1, 0.7, -0.1, 0.7).normalize();
        let light = EnvironmentLight::new(sky).0.unwrap();
        let mut counts = vec![0.0; pixels.len()];
        const COUNT: u32 = 200_000;
        let mut strays = 0;
        for _ in 0..COUNT {
            let u = [f64::from(chance.next()), f64::from(chance.next())];
            let (direction, pdf, radiance) = light.sample(u, None);
            let direction = direction.as_vec3();
            assert!((direction.length() - 1.0).abs() < 1e-6);
            let same = light.pdf(direction, None) == pdf && light.radiance(direction) == radiance;
            strays += u32::from(!same);
            counts[light.pixel_toward(direction.as_dvec3())] += 1.0;
        }
        assert!(strays < COUNT / 10_000, "{strays} samples look up another pixel than they were made for");
        let mut chi = 0.0;
        let mut degrees = 0.0;
        for (index, &pixel) in pixels.iter().enumerate() {
            let expected =
                f64::from(COUNT) * luminance(pixel) / light.total() * light.pixel_angle(index / 37);
            if expected > 5.0 {
                chi += (counts[index] - expected) * (counts[index] - expected) / expected;
                degrees += 1.0;
            }
        }
        let degrees: f64 = degrees;
        assert!(chi < degrees + 5.0 * (2.0 * degrees).sqrt(), "chi^2 {chi} for {degrees} pixels");
    }

    #[test]
    fn directions_meet_the_pixels_that_the_convention_says() {
        let pixels: Vec<[f32; 3]> = (0..8 * 4).map(|index| [index as f32; 3]).collect();
        let light = light(8, 4, pixels);
        let at = |x: f32, y: f32, z: f32| light.radiance(Vec3::new(x, y, z).normalize()).x;
        // u = 0.5 + atan2(z, x) / 2 pi: +X just right of the middle, +Z at three quarters, -X at the seam.
        assert_eq!(at(1.0, 0.1, 0.001), 8.0 + 4.0);
        assert_eq!(at(-0.001, 0.1, 1.0), 8.0 + 6.0);
        assert_eq!(at(-1.0, 0.1, -0.001), 8.0);
        assert_eq!(at(-1.0, -0.1, 0.001), 16.0 + 7.0);
        // v = 0.5 - asin(y) / pi: the top row is +Y.
        assert_eq!(at(0.001, 1.0, 0.0001), 4.0);
        assert_eq!(at(0.001, -1.0, 0.0001), 24.0 + 4.0);
        assert!(light.radiance(Vec3::Y).is_finite() && light.radiance(Vec3::NEG_Y).is_finite());
    }

    #[test]
    fn a_rotation_turns_the_sky_with_it() {
        let pixels: Vec<[f32; 3]> = (0..8 * 4).map(|index| [index as f32; 3]).collect();
        let still = light(8, 4, pixels.clone());
        let mut sky = environment(8, 4, pixels);
        sky.rotation = glam::Quat::from_axis_angle(Vec3::Y, 1.0);
        let turned = EnvironmentLight::new(sky.clone()).0.unwrap();
        let direction = Vec3::new(0.3, 0.5, 0.8).normalize();
        assert_eq!(turned.radiance(sky.rotation * direction), still.radiance(direction));
    }
}
