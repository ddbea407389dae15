//! Integrals that the renderer's answers are held against; double precision, nothing of the renderer's in them.

use std::f64::consts::TAU;

/// GGX's auxiliary function: Smith's `Lambda` for cosine `mu` (Heitz 2014, equation 72).
fn lambda(alpha: f64, mu: f64) -> f64 {
    let tan2 = (1.0 - mu * mu).max(0.0) / (mu * mu);
    ((1.0 + alpha * alpha * tan2).sqrt() - 1.0) / 2.0
}

/// Directional albedo of a GGX metal that reflects all, with height-correlated masking and single scattering: the integral over
/// microfacet normals of `D cos_h G2 (o.h) / (mu cos_h)`, with `D cos_h` inverted to be uniform. Midpoint rule.
pub fn ggx_albedo(alpha: f64, mu: f64) -> f64 {
    let (n, m) = (4000, 800);
    let sin_o = (1.0 - mu * mu).max(0.0).sqrt();
    let mut sum = 0.0;
    for i in 0..n {
        // Cubed towards u = 1, where the tail of steep microfacets is.
        let v = 1.0 - (f64::from(i) + 0.5) / f64::from(n);
        let (u, weight) = (1.0 - v * v * v, 3.0 * v * v);
        let tan2 = alpha * alpha * u / (v * v * v);
        let cos_h = 1.0 / (1.0 + tan2).sqrt();
        let sin_h = (tan2 / (1.0 + tan2)).sqrt();
        for j in 0..m {
            let phi = TAU * (f64::from(j) + 0.5) / f64::from(m);
            let o_h = sin_o * sin_h * phi.cos() + mu * cos_h;
            let cos_i = 2.0 * o_h * cos_h - mu;
            if o_h > 0.0 && cos_i > 0.0 {
                let masking = 1.0 / (1.0 + lambda(alpha, mu) + lambda(alpha, cos_i));
                sum += weight * masking * o_h / (mu * cos_h);
            }
        }
    }
    sum / (f64::from(n) * f64::from(m))
}

/// Radiance that a white GGX metal floor of the given alpha shows of a rectangle of radiance 1, by the midpoint rule over the
/// rectangle: `centre +- x +- y`, emitting to the side of the origin. `mu` is the cosine of the view, which leans towards +x; the
/// floor's normal is +y.
pub fn ggx_of_rectangle(alpha: f64, mu: f64, centre: [f64; 3], x: [f64; 3], y: [f64; 3], n: u32) -> f64 {
    let wo = [(1.0 - mu * mu).sqrt(), mu, 0.0];
    let normal = cross(x, y);
    let area = 4.0 * dot(normal, normal).sqrt();
    let mut sum = 0.0;
    for i in 0..n {
        for j in 0..n {
            let (s, t) = (at(i, n), at(j, n));
            let p: [f64; 3] = std::array::from_fn(|k| centre[k] + s * x[k] + t * y[k]);
            let square = dot(p, p);
            let wi = p.map(|value| value / square.sqrt());
            let cos_light = dot(wi, normal).abs() / dot(normal, normal).sqrt();
            if wi[1] > 0.0 {
                sum += ggx(alpha, wo, wi) * wi[1] * cos_light / square;
            }
        }
    }
    sum * area / f64::from(n * n)
}

/// D G2 / (4 cos cos) for directions whose normal is +y.
fn ggx(alpha: f64, wo: [f64; 3], wi: [f64; 3]) -> f64 {
    let h: [f64; 3] = std::array::from_fn(|k| wo[k] + wi[k]);
    let cos2 = h[1] * h[1] / dot(h, h);
    let a2 = alpha * alpha;
    let density = a2 / (TAU / 2.0 * (cos2 * (a2 - 1.0) + 1.0).powi(2));
    let masking = 1.0 / (1.0 + lambda(alpha, wo[1]) + lambda(alpha, wi[1]));
    density * masking / (4.0 * wo[1] * wi[1])
}

fn at(i: u32, n: u32) -> f64 {
    2.0 * (f64::from(i) + 0.5) / f64::from(n) - 1.0
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_closed_form_is_met() {
        assert!((ggx_albedo(1.0, 1.0) - (1.0 - 2f64.ln())).abs() < 2e-6);
    }

    #[test]
    fn a_rectangle_that_fills_the_sky_is_the_even_sky() {
        // Substituting a finite rectangle for the sky leaves out a rim of 1/size.
        let found = ggx_of_rectangle(1.0, 1.0, [0.0, 1.0, 0.0], [60.0, 0.0, 0.0], [0.0, 0.0, 60.0], 3000);
        assert!((found - ggx_albedo(1.0, 1.0)).abs() < 0.02, "{found}");
    }
}
