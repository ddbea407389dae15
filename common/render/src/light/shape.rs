//! Analytic emitters as one family: sphere, rectangle, disk.

use super::{
    disk::{Disk, DiskView},
    geometry::{Placement, Toward},
    rectangle::{self, RectangleView},
    sphere::SphereView,
};
use glam::{DVec3, Vec3};

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

/// Where a ray meets a shape.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    pub distance: f64,
    /// Whether the side that emits was met.
    pub lit: bool,
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

    /// The first crossing of the ray with the shape ahead of its origin; `direction` need not have unit length.
    pub fn cross(&self, placement: &Placement, origin: Vec3, direction: Vec3) -> Option<Crossing> {
        let (origin, direction) = (origin.as_dvec3(), direction.as_dvec3());
        let centre = placement.origin.as_dvec3() - origin;
        let (normal, inside): (DVec3, &dyn Fn(DVec3) -> bool) = match *self {
            Self::Sphere { radius } => {
                return cross_sphere(centre, f64::from(radius) * placement.scale(), direction);
            }
            Self::Rectangle { width, height } => {
                let (width, height) = (f64::from(width), f64::from(height));
                let (x, y, normal) = (placement.x.as_dvec3(), placement.y.as_dvec3(), placement.facing());
                (normal, &move |offset| {
                    let square = normal.length_squared();
                    let frame = x.cross(y);
                    (offset.cross(y).dot(frame) / square).abs() <= 0.5 * width
                        && (x.cross(offset).dot(frame) / square).abs() <= 0.5 * height
                })
            }
            Self::Disk { radius } => {
                let disk = Disk::new(placement, radius);
                (disk.normal, &move |offset| disk.contains(offset))
            }
        };
        let slope = direction.dot(normal);
        let distance = centre.dot(normal) / slope;
        let ahead = distance > 0.0 && distance.is_finite();
        (ahead && inside(direction * distance - centre)).then_some(Crossing { distance, lit: slope < 0.0 })
    }
}

fn cross_sphere(centre: DVec3, radius: f64, direction: DVec3) -> Option<Crossing> {
    let square = direction.length_squared();
    let along = centre.dot(direction) / square;
    // The ray's nearest point to the centre, not b^2 - 4 a c, which cancels for distant spheres.
    let miss = (centre - direction * along).length_squared();
    let half = radius * radius - miss;
    if half < 0.0 || radius <= 0.0 {
        return None;
    }
    let half = (half / square).sqrt();
    let (near, far) = (along - half, along + half);
    if near > 0.0 {
        Some(Crossing { distance: near, lit: true })
    } else {
        (far > 0.0).then_some(Crossing { distance: far, lit: false })
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
