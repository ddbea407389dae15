//! Warps from the unit square to the domains that rendering integrates over, with their densities beside them.
//!
//! All warps are continuous almost everywhere and keep neighbours together, so that stratified numbers stay stratified.

use crate::math::{self, INV_PI};
use glam::{Vec2, Vec3};

/// The unit disk, uniform in area (Shirley and Chiu 1997, "A Low Distortion Map Between Disk and Square").
pub fn concentric_disk(u: [f32; 2]) -> Vec2 {
    let (radius, cos, sin) = concentric(u);
    Vec2::new(radius * cos, radius * sin)
}

/// Density of [`concentric_disk`] over area.
pub const fn concentric_disk_pdf() -> f32 {
    INV_PI
}

/// Signed radius and cosine and sine of the angle of the concentric map.
fn concentric(u: [f32; 2]) -> (f32, f32, f32) {
    let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    if a == 0.0 && b == 0.0 {
        return (0.0, 1.0, 0.0);
    }
    if a.abs() > b.abs() {
        let (sin, cos) = math::sin_cos_octant(math::FRAC_PI_4 * (b / a));
        (a, cos, sin)
    } else {
        let (sin, cos) = math::sin_cos_octant(math::FRAC_PI_4 * (a / b));
        (b, sin, cos)
    }
}

/// The upper hemisphere (z >= 0), proportional to the cosine (Malley's method).
pub fn cosine_hemisphere(u: [f32; 2]) -> Vec3 {
    let (radius, cos, sin) = concentric(u);
    // (1-r)(1+r) keeps the digits of directions near the horizon.
    Vec3::new(radius * cos, radius * sin, math::safe_sqrt((1.0 - radius) * (1.0 + radius)))
}

/// Density of [`cosine_hemisphere`] over solid angle.
pub fn cosine_hemisphere_pdf(cos_theta: f32) -> f32 {
    cos_theta.max(0.0) * INV_PI
}

/// The whole sphere, uniform in solid angle.
pub fn uniform_sphere(u: [f32; 2]) -> Vec3 {
    let z = 1.0 - 2.0 * u[0];
    let radius = 2.0 * math::safe_sqrt(u[0] * (1.0 - u[0]));
    math::polar(radius, u[1]).extend(z)
}

/// Density of [`uniform_sphere`] over solid angle.
pub const fn uniform_sphere_pdf() -> f32 {
    INV_PI / 4.0
}

/// 1 - cos of the half angle of a cone whose squared sine is given, without cancellation for narrow cones.
pub fn one_minus_cos(sin2: f32) -> f32 {
    sin2 / (1.0 + math::safe_sqrt(1.0 - sin2))
}

/// Directions about +z inside a cone, uniform in solid angle. The cone is given by 1 - cos of its half angle, which unlike the
/// cosine itself stays accurate for cones of a millionth of a radian.
pub fn uniform_cone(u: [f32; 2], one_minus_cos_max: f32) -> Vec3 {
    let one_minus_cos = u[0] * one_minus_cos_max;
    let sin = math::safe_sqrt(one_minus_cos * (2.0 - one_minus_cos));
    math::polar(sin, u[1]).extend(1.0 - one_minus_cos)
}

/// Density of [`uniform_cone`] over solid angle.
pub fn uniform_cone_pdf(one_minus_cos_max: f32) -> f32 {
    1.0 / (math::TAU * one_minus_cos_max)
}

/// Barycentric coordinates, uniform in area (Heitz 2019, "A Low-Distortion Map Between Triangle and Square"). The density over
/// area is one over the triangle's area.
pub fn uniform_triangle(u: [f32; 2]) -> [f32; 3] {
    let (a, b) = if u[1] > u[0] {
        let a = 0.5 * u[0];
        (a, u[1] - a)
    } else {
        let b = 0.5 * u[1];
        (u[0] - b, b)
    };
    [a, b, (1.0 - a - b).max(0.0)]
}

/// A lens opening inside the unit circle, sampled uniformly in area.
#[derive(Clone, Debug, PartialEq)]
pub struct Aperture {
    shape: ApertureShape,
    /// Width over height.
    ratio: f32,
}

#[derive(Clone, Debug, PartialEq)]
enum ApertureShape {
    Round,
    /// Half the diagonals towards the first and the second corner.
    Square {
        x: Vec2,
        y: Vec2,
    },
    /// Corners, counter-clockwise.
    Polygon(Vec<Vec2>),
}

impl Aperture {
    /// `blades` below 3 is round, otherwise a regular polygon whose corners lie on the unit circle and one of whose sides
    /// faces +x, turned counter-clockwise by `rotation` radians; 4 is a square that stands upright. Afterwards the opening is
    /// stretched along x by `ratio`, so that its width over its height is `ratio` times what it was.
    pub fn new(blades: u32, rotation: f32, ratio: f32) -> Self {
        let corner = |i: u32| {
            let turn =
                (f64::from(i) + 0.5) * core::f64::consts::TAU / f64::from(blades) + f64::from(rotation);
            Vec2::new(math::cos_f64(turn) as f32, math::sin_f64(turn) as f32)
        };
        let shape = match blades {
            0..=2 => ApertureShape::Round,
            4 => {
                let (first, last) = (corner(0), corner(3));
                ApertureShape::Square { x: (first + last) * 0.5, y: (first - last) * 0.5 }
            }
            _ => ApertureShape::Polygon((0..blades).map(corner).collect()),
        };
        Self { shape, ratio }
    }

    /// A point of the opening.
    pub fn sample(&self, u: [f32; 2]) -> Vec2 {
        let point = match &self.shape {
            ApertureShape::Round => concentric_disk(u),
            ApertureShape::Square { x, y } => *x * (2.0 * u[0] - 1.0) + *y * (2.0 * u[1] - 1.0),
            ApertureShape::Polygon(corners) => {
                // One blade after the other along the first axis; the rest of that number is used again inside the blade.
                let scaled = u[0] * corners.len() as f32;
                let blade = (scaled as usize).min(corners.len() - 1);
                let [a, b, _] = uniform_triangle([scaled - blade as f32, u[1]]);
                corners[blade] * a + corners[(blade + 1) % corners.len()] * b
            }
        };
        Vec2::new(point.x * self.ratio, point.y)
    }

    /// Area of the opening; the density of [`Aperture::sample`] is one over it.
    pub fn area(&self) -> f32 {
        let area = match &self.shape {
            ApertureShape::Round => math::PI,
            ApertureShape::Square { x, y } => 4.0 * x.perp_dot(*y),
            ApertureShape::Polygon(corners) => 0.5 * corners.len() as f32 * corners[0].perp_dot(corners[1]),
        };
        area * self.ratio
    }
}

/// Weight of a sample drawn with density `f` that could also have been drawn with density `g` (Veach 1997, section 9.2.4,
/// power 2). Neither overflows nor underflows, however large or small the densities are.
pub fn power_heuristic(f: f32, g: f32) -> f32 {
    if f == g {
        return 0.5;
    }
    let ratio = if f > g { g / f } else { f / g };
    let larger = 1.0 / (1.0 + ratio * ratio);
    if f > g { larger } else { ratio * ratio * larger }
}

/// A choice made by [`Discrete`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// What was chosen.
    pub index: usize,
    /// Probability of that choice.
    pub pmf: f32,
    /// Where inside its interval the number lay, uniform in [0, 1): may be used again, but is coarse for rare choices.
    pub u: f32,
}

/// Chooses one of finitely many with probability proportional to weight.
///
/// Probabilities are whole multiples of 2^-24, the step of the numbers they are chosen by, and the reported probability is the
/// one with which the choice is truly made: however lopsided the weights, estimates stay unbiased, and nothing of positive
/// weight is ever out of reach (as long as there are at most 2^24 such).
#[derive(Clone, Debug, PartialEq)]
pub struct Discrete {
    /// Upper ends of the intervals, in units of 2^-24.
    ends: Vec<u32>,
}

/// Number of distinct fractions that a sampler gives.
const STEPS: u32 = 1 << 24;

impl Discrete {
    /// Prepares the weights; those that are not positive and finite are never chosen. `None` when that leaves nothing.
    pub fn new(weights: &[f32]) -> Option<Self> {
        let weight = |w: f32| if w > 0.0 && w.is_finite() { f64::from(w) } else { 0.0 };
        let total: f64 = weights.iter().map(|&w| weight(w)).sum();
        let mut positive = weights.iter().filter(|&&w| weight(w) > 0.0).count();
        if positive == 0 {
            return None;
        }
        let least = u32::from(positive <= STEPS as usize);
        let (mut sum, mut end) = (0.0, 0);
        let ends = weights.iter().map(|&w| {
            let w = weight(w);
            if w > 0.0 {
                positive -= 1;
                sum += w;
                let highest = STEPS - least * positive as u32;
                end = if positive == 0 {
                    STEPS
                } else {
                    ((sum / total * f64::from(STEPS)).round() as u32).clamp(end + least, highest)
                };
            }
            end
        });
        Some(Self { ends: ends.collect() })
    }

    /// Number of things to choose from.
    #[expect(clippy::len_without_is_empty, reason = "never empty")]
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// Chooses by a number in [0, 1).
    pub fn sample(&self, u: f32) -> Choice {
        let scaled = (u * STEPS as f32).min(STEPS as f32 - 1.0);
        let step = scaled as u32;
        let index = self.ends.partition_point(|&end| end <= step);
        let (start, width) = (self.start(index), self.width(index));
        let u = ((scaled - start as f32) / width as f32).min(math::ONE_MINUS_EPSILON);
        Choice { index, pmf: width as f32 / STEPS as f32, u }
    }

    /// Probability of choosing `index`.
    pub fn pmf(&self, index: usize) -> f32 {
        self.width(index) as f32 / STEPS as f32
    }

    fn start(&self, index: usize) -> u32 {
        if index == 0 { 0 } else { self.ends[index - 1] }
    }

    fn width(&self, index: usize) -> u32 {
        self.ends[index] - self.start(index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Midpoints of an n x n grid.
    fn grid(n: u32) -> impl Iterator<Item = [f32; 2]> {
        let at = move |i: u32| (i as f32 + 0.5) / n as f32;
        (0..n * n).map(move |i| [at(i % n), at(i / n)])
    }

    fn mean(values: impl Iterator<Item = f32>) -> f64 {
        let (sum, n) = values.fold((0.0, 0.0), |(sum, n), v| (sum + f64::from(v), n + 1.0));
        sum / n
    }

    fn assert_close(what: &str, value: f64, expected: f64, tolerance: f64) {
        assert!((value - expected).abs() <= tolerance, "{what}: {value}, not {expected}");
    }

    #[test]
    fn disk_is_filled_evenly() {
        let n = 400;
        assert_close("mean of r^2", mean(grid(n).map(|u| concentric_disk(u).length_squared())), 0.5, 1e-4);
        assert_close(
            "inner half",
            mean(grid(n).map(|u| (concentric_disk(u).length() < 0.5) as u8 as f32)),
            0.25,
            2e-3,
        );
        assert_close(
            "a quadrant",
            mean(grid(n).map(|u| (concentric_disk(u).min_element() > 0.0) as u8 as f32)),
            0.25,
            1e-3,
        );
        assert!(grid(n).all(|u| concentric_disk(u).length() <= 1.0 + 1e-6));
        assert_eq!(concentric_disk([0.5, 0.5]), Vec2::ZERO);
    }

    #[test]
    fn hemisphere_follows_the_cosine() {
        let n = 400;
        assert_close("mean of cos", mean(grid(n).map(|u| cosine_hemisphere(u).z)), 2.0 / 3.0, 1e-4);
        // A zone's share is the integral of the density over it.
        let zone = |low: f32, high: f32| {
            mean(grid(n).map(|u| (low..high).contains(&cosine_hemisphere(u).z) as u8 as f32))
        };
        for (low, high) in [(0.0, 0.1), (0.1, 0.5), (0.5, 1.0)] {
            let middle = 0.5 * (low + high);
            let integral = math::TAU * (high - low) * cosine_hemisphere_pdf(middle);
            assert_close("share of a zone", zone(low, high), f64::from(integral), 2e-3);
        }
        assert!(
            grid(n)
                .all(|u| (cosine_hemisphere(u).length() - 1.0).abs() < 1e-6 && cosine_hemisphere(u).z >= 0.0)
        );
        for u in [[0.0, 0.0], [0.0, 1.0], [math::ONE_MINUS_EPSILON, 0.3], [0.5, math::ONE_MINUS_EPSILON]] {
            assert!(cosine_hemisphere(u).is_finite() && cosine_hemisphere(u).z >= 0.0, "{u:?}");
        }
    }

    #[test]
    fn sphere_is_filled_evenly() {
        let n = 400;
        for axis in 0..3 {
            assert_close("mean", mean(grid(n).map(|u| uniform_sphere(u)[axis])), 0.0, 1e-6);
            assert_close(
                "second moment",
                mean(grid(n).map(|u| uniform_sphere(u)[axis].powi(2))),
                1.0 / 3.0,
                1e-4,
            );
        }
        assert!(grid(n).all(|u| (uniform_sphere(u).length() - 1.0).abs() < 1e-6));
    }

    #[test]
    fn narrow_cones_keep_their_shape() {
        let n = 300;
        for sin in [1e-6_f32, 1e-3, 0.5, 1.0] {
            let height = one_minus_cos(sin * sin);
            assert_close(
                "height",
                f64::from(height),
                1.0 - (1.0 - f64::from(sin * sin)).sqrt(),
                1e-6 * f64::from(sin),
            );
            let sin2 =
                mean(grid(n).map(|u| uniform_cone(u, height).truncate().length_squared() / (sin * sin)));
            // Mean of sin^2 over a cone: h - h^2/3 with h the cap's height.
            let expected = f64::from(height - height * height / 3.0) / f64::from(sin * sin);
            assert_close("mean of sin^2", sin2, expected, 1e-3);
        }
        assert_close("density", f64::from(uniform_cone_pdf(1.0)), 0.5 / std::f64::consts::PI, 1e-8);
    }

    #[test]
    fn triangle_is_filled_evenly() {
        let n = 400;
        for corner in 0..3 {
            assert_close("mean", mean(grid(n).map(|u| uniform_triangle(u)[corner])), 1.0 / 3.0, 1e-5);
            assert_close(
                "second moment",
                mean(grid(n).map(|u| uniform_triangle(u)[corner].powi(2))),
                1.0 / 6.0,
                1e-4,
            );
        }
        assert!(grid(n).all(|u| uniform_triangle(u).iter().all(|&b| (0.0..=1.0).contains(&b))));
    }

    #[test]
    fn bladed_apertures_are_filled_evenly_to_their_corners() {
        let n = 360;
        for blades in [3, 4, 5, 6, 9] {
            for (rotation, ratio) in [(0.0, 1.0), (0.3, 1.0), (1.1, 2.0)] {
                let aperture = Aperture::new(blades, rotation, ratio);
                let side = std::f64::consts::TAU / f64::from(blades);
                let area = 0.5 * f64::from(blades) * side.sin() * f64::from(ratio);
                assert_close("area", f64::from(aperture.area()), area, 1e-5);
                let points = || grid(n).map(|u| aperture.sample(u)).map(|p| Vec2::new(p.x / ratio, p.y));
                assert_close("mean of x", mean(points().map(|p| p.x)), 0.0, 2e-4);
                assert_close("mean of y", mean(points().map(|p| p.y)), 0.0, 2e-4);
                // Mean of r^2 over a regular polygon of circumradius 1.
                assert_close(
                    "mean of r^2",
                    mean(points().map(|p| p.length_squared())),
                    (2.0 + side.cos()) / 6.0,
                    2e-3,
                );
                assert!(points().all(|p| p.length() <= 1.0 + 1e-6), "{blades} blades");
            }
        }
    }

    #[test]
    fn a_square_aperture_stands_upright_unless_turned() {
        let side = std::f32::consts::FRAC_1_SQRT_2;
        let corner = Aperture::new(4, 0.0, 1.0).sample([0.0, 0.0]);
        assert!((corner - Vec2::splat(-side)).length() < 1e-6, "{corner}");
        let turned = Aperture::new(4, std::f32::consts::FRAC_PI_4, 1.0).sample([0.0, 0.0]);
        assert!((turned - Vec2::new(0.0, -1.0)).length() < 1e-6, "{turned}");
        assert_eq!(Aperture::new(0, 0.7, 1.0).sample([0.5, 0.5]), Vec2::ZERO);
    }

    #[test]
    fn equal_densities_share_equally_however_extreme() {
        for density in [1e-45, 1e-30, 1.0, 1e20, 1e38, f32::MAX] {
            assert_eq!(power_heuristic(density, density), 0.5, "density {density}");
        }
        assert_eq!(power_heuristic(1.0, 0.0), 1.0);
        assert_eq!(power_heuristic(0.0, 1.0), 0.0);
        assert_eq!(power_heuristic(1e38, 1e-38), 1.0);
        for (f, g) in [(3.0, 1.0), (1e30, 3e30), (1e-30, 7e-30)] {
            assert_close("sum", f64::from(power_heuristic(f, g) + power_heuristic(g, f)), 1.0, 1e-7);
        }
        assert_close("3 against 1", f64::from(power_heuristic(3.0, 1.0)), 0.9, 1e-7);
    }

    #[test]
    fn choices_are_made_exactly_as_often_as_they_say() {
        let discrete =
            Discrete::new(&[0.0, 3.0, f32::NAN, 1e-20, 5.0, -1.0, f32::INFINITY, 2.0, 0.0]).unwrap();
        let mut counts = vec![0_u32; discrete.len()];
        for step in 0..STEPS {
            let choice = discrete.sample(step as f32 / STEPS as f32);
            counts[choice.index] += 1;
        }
        for (index, count) in counts.iter().enumerate() {
            assert_eq!(*count as f32 / STEPS as f32, discrete.pmf(index), "choice {index}");
        }
        assert_eq!(counts[3], 1, "the faintest is within reach");
        assert_close("pmf", f64::from(discrete.pmf(1)), 0.3, 1e-6);
        assert_eq!(
            discrete.pmf(0) + discrete.pmf(2) + discrete.pmf(5) + discrete.pmf(6) + discrete.pmf(8),
            0.0
        );
    }

    #[test]
    fn the_rest_of_a_number_is_uniform_again() {
        let discrete = Discrete::new(&[1.0, 2.0, 5.0]).unwrap();
        let choice = discrete.sample(0.125 + 0.25 * 0.375);
        assert_eq!((choice.index, choice.pmf), (1, 0.25));
        assert_close("rest", f64::from(choice.u), 0.375, 1e-6);
        assert_eq!(discrete.sample(math::ONE_MINUS_EPSILON).index, 2);
        assert_eq!(discrete.sample(1.0).index, 2, "a number that should not be");
    }

    #[test]
    fn nothing_to_choose_from_is_said_so() {
        assert_eq!(Discrete::new(&[]), None);
        assert_eq!(Discrete::new(&[0.0, -0.0, f32::NAN]), None);
        assert_eq!(Discrete::new(&[0.0, 1e-45]).unwrap().sample(0.0).index, 1);
    }
}
