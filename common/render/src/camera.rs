//! From a point on the picture, a point on the lens and a time to a ray.

use crate::accel::Ray;
use crate::math;
use crate::sampling::Aperture;
use crate::transform::MotionTransform;
use farm_scene::{Lens, Projection};
use glam::Vec3;

/// A finite aperture and the plane that is in focus.
struct ThinLens {
    aperture: Aperture,
    /// Metres.
    radius: f32,
    /// Metres along the view axis; may be infinite.
    focus_distance: f32,
}

/// A camera placed in the renderer's space.
pub(crate) struct Camera {
    motion: MotionTransform,
    /// Half the picture's width and height: at distance one for central projection, in metres for parallel.
    half: [f32; 2],
    parallel: bool,
    lens: Option<ThinLens>,
    size: [f64; 2],
}

impl Camera {
    pub fn new(
        projection: Projection,
        lens: Option<Lens>,
        motion: MotionTransform,
        width: u32,
        height: u32,
    ) -> Self {
        let (half_height, parallel) = match projection {
            Projection::Perspective { yfov } => (math::tan(yfov * 0.5), false),
            Projection::Orthographic { ymag } => (ymag, true),
        };
        let aspect = width as f32 / height as f32;
        let size = [f64::from(width), f64::from(height)];
        let lens = lens.map(|lens| ThinLens {
            aperture: Aperture::new(lens.blades, lens.rotation, lens.anamorphic_ratio),
            radius: lens.aperture_radius,
            focus_distance: lens.focus_distance,
        });
        Self { motion, half: [half_height * aspect, half_height], parallel, lens, size }
    }

    /// Whether rays start on a finite aperture.
    pub fn has_lens(&self) -> bool {
        self.lens.is_some()
    }

    /// Whether the camera itself moves while the shutter is open.
    pub fn is_moving(&self) -> bool {
        self.motion.as_fixed().is_none()
    }

    /// The ray through `film` (pixels from the top left corner of the frame, fractional) at `time` in [0, 1]. `lens` in
    /// [0, 1)^2 chooses the point on the aperture and is not looked at without one.
    ///
    /// Thin lens after Cook, Porter, Carpenter 1984: every ray of one film point meets in the plane in focus, which lies at
    /// the focus distance along the view axis.
    pub fn ray(&self, film: [f64; 2], lens: [f32; 2], time: f32) -> Ray {
        let x = (2.0 * film[0] / self.size[0] - 1.0) as f32 * self.half[0];
        let y = (1.0 - 2.0 * film[1] / self.size[1]) as f32 * self.half[1];
        let (mut origin, mut direction) = if self.parallel {
            (Vec3::new(x, y, 0.0), Vec3::NEG_Z)
        } else {
            (Vec3::ZERO, Vec3::new(x, y, -1.0))
        };
        if let Some(thin_lens) = &self.lens {
            let shift = (thin_lens.aperture.sample(lens) * thin_lens.radius).extend(0.0);
            #[cfg(feature = "mutations")]
            let shift = crate::mutations::lens_point(shift, thin_lens.radius);
            // The point in focus is origin + focus * direction, for direction.z = -1; seen from the lens point, and divided by
            // the focus distance so that an infinite one needs no case of its own.
            origin += shift;
            direction -= shift / thin_lens.focus_distance;
        }
        let place = self.motion.at(time);
        Ray {
            origin: place.point(origin),
            direction: place.vector(direction).normalize(),
            time,
            t_max: f32::INFINITY,
        }
    }
}
