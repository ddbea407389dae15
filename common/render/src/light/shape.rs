//! Analytic emitters as one family: sphere, rectangle, disk.

use super::{
    disk::{Disk, DiskView},
    geometry::{Placement, Toward},
    rectangle::{self, RectangleView},
    sphere::SphereView,
};
use glam::DVec3;

/// A surface that emits and scatters nothing. Rectangles and disks emit along the node's -Z, spheres outwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    Sphere { radius: f32 },
    Rectangle { width: f32, height: f32 },
    Disk { radius: f32 },
}

/// A shape of which a point sees the lit side.
#[expect(clippy::large_enum_variant, reason = "lives on the stack for the length of one sample")]
pub(super) enum ShapeView {
    Sphere(SphereView),
    Rectangle(RectangleView),
    Disk(DiskView),
}

impl Shape {
    /// The shape as seen from a point; none where it gives no light.
    pub fn view(&self, point: DVec3, placement: &Placement) -> Option<ShapeView> {
        Some(match *self {
            Self::Sphere { radius } => ShapeView::Sphere(SphereView::new(
                point,
                placement.origin.as_dvec3(),
                f64::from(radius) * placement.scale(),
            )?),
            Self::Rectangle { width, height } => {
                ShapeView::Rectangle(RectangleView::new(point, rectangle::corners(placement, width, height))?)
            }
            Self::Disk { radius } => ShapeView::Disk(DiskView::new(point, Disk::new(placement, radius))?),
        })
    }

    /// Area as seen along its brightest direction, m^2: what radiance times it is the brightest radiant intensity.
    pub fn cross_section(&self, placement: &Placement) -> f64 {
        match *self {
            Self::Sphere { radius } => {
                let radius = f64::from(radius) * placement.scale();
                core::f64::consts::PI * radius * radius
            }
            Self::Rectangle { width, height } => {
                placement.facing().length() * f64::from(width) * f64::from(height)
            }
            Self::Disk { radius } => {
                core::f64::consts::PI * placement.facing().length() * f64::from(radius) * f64::from(radius)
            }
        }
    }

    /// Points that have the shape within their box, and that move with it.
    pub fn outline(&self, placement: &Placement) -> [DVec3; 4] {
        match *self {
            Self::Sphere { radius } => {
                let centre = placement.origin.as_dvec3();
                let reach = DVec3::splat(f64::from(radius) * placement.scale());
                [centre - reach, centre + reach, centre - reach, centre + reach]
            }
            Self::Rectangle { width, height } => rectangle::corners(placement, width, height),
            Self::Disk { radius } => rectangle::corners(placement, 2.0 * radius, 2.0 * radius),
        }
    }
}

impl ShapeView {
    /// Density of a unit direction that hits the shape, 1/sr.
    pub fn pdf(&self, direction: DVec3) -> f64 {
        match self {
            Self::Sphere(view) => view.pdf(),
            Self::Rectangle(view) => view.pdf(direction),
            Self::Disk(view) => view.pdf(direction),
        }
    }

    /// A direction for two uniform numbers.
    pub fn sample(&self, u: [f64; 2]) -> Toward {
        match self {
            Self::Sphere(view) => view.sample(u),
            Self::Rectangle(view) => view.sample(u),
            Self::Disk(view) => view.sample(u),
        }
    }
}
