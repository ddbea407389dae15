//! Laws that every member obeys.

use super::*;
use crate::math::{self, Frame};
use crate::sampler::{Sampler, Sequence};

fn at_cos(cos: f32) -> Vec3 {
    let sin = ((1.0 - f64::from(cos) * f64::from(cos)).sqrt()) as f32;
    let (s, c) = math::sin_cos(0.7);
    Vec3::new(sin * c, sin * s, cos)
}

fn white_metal(roughness: f32) -> Bsdf {
    Bsdf::Conductor(Conductor::new(Vec3::ONE, roughness))
}

fn mixed(roughness: f32, metallic: f32) -> Bsdf {
    let base_color = Vec3::new(1.0, 0.6, 0.2);
    Bsdf::MetallicRoughness(MetallicRoughness::new(&Surface {
        base_color,
        metallic,
        roughness,
        ..Surface::default()
    }))
}

/// One of each kind that is rough enough for a histogram.
fn rough_members() -> Vec<(&'static str, Bsdf)> {
    let frame = Frame::from_z(Vec3::new(0.48, -0.6, 0.64));
    vec![
        ("lambert", Bsdf::Lambert(Lambert::new(Vec3::new(0.9, 0.5, 0.1)))),
        ("conductor", Bsdf::Conductor(Conductor::new(Vec3::new(1.0, 0.8, 0.4), 0.6))),
        ("compensated conductor", Bsdf::Conductor(Conductor::new(Vec3::ONE, 0.9).compensated(true))),
        ("plastic", mixed(0.5, 0.0)),
        ("half metal", mixed(0.7, 0.5)),
        ("dielectric", Bsdf::Dielectric(Dielectric::new(Vec3::ONE, 0.7, 1.5))),
        ("thin", Bsdf::Thin(Thin::new(Vec3::new(0.9, 0.8, 0.7), 0.6, 1.5))),
        ("mirror", Bsdf::Mirror(Mirror::new(Vec3::splat(0.9), 0.8, true, &frame))),
        ("shifted mirror", Bsdf::Mirror(Mirror::new(Vec3::splat(0.9), 0.5, false, &frame))),
    ]
}

fn numbers(index: u64) -> [f32; 3] {
    let [a, b, c, _] = Sampler::with_sequence(Sequence::Independent, 11, 0, 0, 0, index).set(0);
    [a, b, c]
}

/// Mean weight of `n` well-spread samples: the share of a constant environment that is seen.
fn furnace(bsdf: &Bsdf, wo: Vec3, n: u64) -> Vec3 {
    let mut sum = glam::DVec3::ZERO;
    for index in 0..n {
        let [a, b, c, _] = Sampler::new(5, 0, 0, 0, index).set(0);
        if let Some(sample) = bsdf.sample(wo, [a, b, c]) {
            assert!(
                sample.weight.is_finite() && sample.weight.min_element() >= 0.0,
                "{bsdf:?} {wo} {sample:?}"
            );
            // Inside a medium of index eta an environment of radiance 1 is one of radiance eta^2.
            sum += (sample.weight * sample.eta * sample.eta).as_dvec3();
        }
    }
    (sum / n as f64).as_vec3()
}

const COLUMNS: usize = 12;
const ROWS: usize = 16;

/// Share of samples in each cell of a grid over the sphere, and in none.
fn histogram(bsdf: &Bsdf, wo: Vec3, n: u64) -> Vec<f64> {
    let mut counts = vec![0.0; ROWS * COLUMNS + 1];
    for index in 0..n {
        let cell = bsdf.sample(wo, numbers(index)).map_or(ROWS * COLUMNS, |sample| {
            let row = (math::acos(sample.wi.z) / math::PI * ROWS as f32) as usize;
            let turn = math::atan2(sample.wi.y, sample.wi.x) / math::TAU + 0.5;
            row.min(ROWS - 1) * COLUMNS + ((turn * COLUMNS as f32) as usize).min(COLUMNS - 1)
        });
        counts[cell] += 1.0;
    }
    counts
}

/// Integral of the density over each cell, and what is missing from 1.
fn integrated(bsdf: &Bsdf, wo: Vec3) -> Vec<f64> {
    const FINE: usize = 60;
    let mut cells = vec![0.0; ROWS * COLUMNS];
    for row in 0..ROWS * FINE {
        let (sin_theta, cos_theta) = math::sin_cos((row as f32 + 0.5) / (ROWS * FINE) as f32 * math::PI);
        for column in 0..COLUMNS * FINE {
            let (sin, cos) =
                math::sin_cos(((column as f32 + 0.5) / (COLUMNS * FINE) as f32 - 0.5) * math::TAU);
            let pdf = bsdf.pdf(wo, Vec3::new(sin_theta * cos, sin_theta * sin, cos_theta));
            cells[row / FINE * COLUMNS + column / FINE] += f64::from(pdf * sin_theta);
        }
    }
    let area = 2.0 * std::f64::consts::PI.powi(2) / (ROWS * COLUMNS * FINE * FINE) as f64;
    cells.iter_mut().for_each(|cell| *cell *= area);
    cells.push(1.0 - cells.iter().sum::<f64>());
    cells
}

#[test]
fn samples_follow_their_density() {
    const N: u64 = 60_000;
    for (name, bsdf) in rough_members() {
        let below: &[f32] = if bsdf.transmits() { &[0.9, 0.4, -0.7] } else { &[0.9, 0.4] };
        for &cos in below {
            let wo = at_cos(cos);
            let (counts, expected) = (histogram(&bsdf, wo, N), integrated(&bsdf, wo));
            // Cells with few samples are taken together.
            let (mut chi2, mut cells, mut rest) = (0.0, 0.0, (0.0, 0.0));
            for (count, share) in counts.iter().zip(&expected) {
                let mean = share * N as f64;
                if mean < 20.0 {
                    rest = (rest.0 + count, rest.1 + mean);
                } else {
                    chi2 += (count - mean).powi(2) / mean;
                    cells += 1.0;
                }
            }
            chi2 += (rest.0 - rest.1).powi(2) / rest.1.max(20.0);
            let bound = cells + 5.0 * (2.0_f64 * cells).sqrt() + 20.0;
            assert!(
                chi2 < bound,
                "{name} at cosine {cos}: chi-square {chi2} with {cells} cells, rest {rest:?}"
            );
            assert!(
                expected.last().is_some_and(|&lost| lost > -2e-3),
                "{name} at cosine {cos}: density exceeds 1"
            );
        }
    }
}

#[test]
fn a_sample_says_what_eval_and_pdf_say_of_its_direction() {
    for (name, bsdf) in rough_members() {
        for cos in [0.95, 0.5, 0.1] {
            let wo = at_cos(cos);
            for sample in (0..500).filter_map(|index| bsdf.sample(wo, numbers(index))) {
                let pdf = bsdf.pdf(wo, sample.wi);
                let weight = bsdf.eval(wo, sample.wi) * (sample.wi.z.abs() / pdf);
                let on_the_rim = name.contains("mirror") && pdf == 0.0;
                assert!(
                    on_the_rim || (pdf - sample.pdf).abs() <= 2e-3 * pdf,
                    "{name}: pdf {pdf}, {sample:?}"
                );
                assert!(
                    on_the_rim
                        || (weight - sample.weight).abs().max_element() <= 2e-3 * sample.weight.max_element(),
                    "{name} at {cos}: weight {weight}, {sample:?}"
                );
                assert_eq!(sample.transmission, sample.wi.z * wo.z < 0.0, "{name}");
                assert!((sample.wi.length() - 1.0).abs() < 1e-5, "{name}");
            }
        }
    }
}

#[test]
fn scattering_is_the_same_both_ways() {
    for (name, bsdf) in rough_members().into_iter().filter(|(name, _)| !name.contains("mirror")) {
        for (a, b) in [(0.9, 0.3), (0.5, 0.5), (0.05, 0.8), (0.01, 0.02)] {
            let (wo, wi) = (at_cos(a), Vec3::new(-1.0, 0.3, 1.0) * at_cos(b));
            let wi = Vec3::new(wi.x, wi.y, 0.0).normalize_or(Vec3::X) * (1.0 - b * b).sqrt() + Vec3::Z * b;
            let (there, back) = (bsdf.eval(wo, wi), bsdf.eval(wi, wo));
            assert!(
                (there - back).abs().max_element() <= 1e-5 * there.max_element(),
                "{name}: {there} and {back}"
            );
        }
    }
}

#[test]
fn a_white_metal_reflects_as_much_as_quadrature_says() {
    let table = [
        (1.0, 1.0, 1.0 - std::f32::consts::LN_2, 2e-4),
        (1.0, 0.5, 0.4507, 2e-4),
        (1.0, 0.1, 0.7602, 2e-4),
        (0.5, 1.0, 0.6878, 2e-4),
        (0.5, 0.5, 0.6983, 2e-4),
        (0.5, 0.1, 0.8601, 2e-4),
        (0.25, 1.0, 0.9158, 2e-4),
        (0.25, 0.5, 0.8573, 2e-4),
        (0.25, 0.1, 0.8916, 2e-4),
        (0.01, 1.0, 1.0, 2e-4),
        (0.01, 0.5, 0.9998, 2e-4),
        (0.01, 0.1, 0.9942, 2e-4),
    ];
    for (alpha, cos, expected, tolerance) in table {
        let albedo = furnace(&white_metal(f32::sqrt(alpha)), at_cos(cos), 1 << 14).x;
        assert!(
            (albedo - expected).abs() <= tolerance,
            "alpha {alpha}, cosine {cos}: {albedo}, not {expected}"
        );
    }
}

#[test]
fn compensated_white_metals_lose_nothing() {
    for step in 0..=20 {
        let roughness = step as f32 / 20.0;
        let plain = Conductor::new(Vec3::ONE, roughness);
        let compensated = plain.compensated(true);
        for cos in [1.0, 0.6, 0.3, 0.1, 0.02, 1e-3] {
            let wo = at_cos(cos);
            // What is given back, integrated over mu = t^2: the lobe is broad, but lies near the horizon where little is lost.
            let n = 400;
            let given_back: f32 = (0..n)
                .map(|i| (i as f32 + 0.5) / n as f32)
                .map(|t| (t, at_cos(t * t)))
                .map(|(t, wi)| {
                    (compensated.eval_pdf(wo, wi).0.x - plain.eval_pdf(wo, wi).0.x) * t * t * 2.0 * t
                })
                .sum::<f32>()
                * math::TAU
                / n as f32;
            let albedo = furnace(&Bsdf::Conductor(plain), wo, 1 << 11).x + given_back;
            assert!((albedo - 1.0).abs() <= 0.01, "roughness {roughness}, cosine {cos}: {albedo}");
        }
    }
}

#[test]
fn compensation_is_sampled_as_it_is_evaluated() {
    for roughness in [0.5, 0.8, 1.0] {
        let metal = Bsdf::Conductor(Conductor::new(Vec3::ONE, roughness).compensated(true));
        for cos in [1.0, 0.5, 0.1] {
            let albedo = furnace(&metal, at_cos(cos), 1 << 12).x;
            assert!((albedo - 1.0).abs() <= 0.01, "roughness {roughness}, cosine {cos}: {albedo}");
        }
    }
}

#[test]
fn nothing_gives_back_more_light_than_it_receives() {
    let frame = Frame::from_z(Vec3::Z);
    for roughness in [0.0, 0.02, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0] {
        let surface = |ior, metallic, specular_color| {
            let specular_color = Vec3::splat(specular_color);
            Bsdf::metallic_roughness(&Surface {
                ior,
                metallic,
                roughness,
                specular_color,
                ..Surface::default()
            })
        };
        let members = [
            white_metal(roughness),
            surface(1.5, 0.0, 1.0),
            surface(1.5, 0.5, 1.0),
            surface(1.1, 0.0, 1.0),
            surface(2.42, 0.0, 1.0),
            surface(1.5, 0.0, 10.0),
            surface(0.0, 0.0, 1.0),
            Bsdf::Dielectric(Dielectric::new(Vec3::ONE, roughness, 1.5)),
            Bsdf::Dielectric(Dielectric::new(Vec3::ONE, roughness, 1.05)),
            Bsdf::Thin(Thin::new(Vec3::ONE, roughness, 1.5)),
            Bsdf::Mirror(Mirror::new(Vec3::ONE, roughness, true, &frame)),
        ];
        for bsdf in members {
            let below: &[f32] = if bsdf.transmits() { &[-0.9, -0.3] } else { &[] };
            for &cos in [1.0, 0.8, 0.5, 0.3, 0.15, 0.05, 1e-3].iter().chain(below) {
                let albedo = furnace(&bsdf, at_cos(cos), 1 << 11).x;
                assert!(albedo <= 1.0 + 2e-3, "{bsdf:?} at cosine {cos} gives back {albedo}");
            }
        }
    }
}

#[test]
fn albedo_has_no_step_anywhere_in_roughness() {
    type Make = fn(f32) -> Bsdf;
    let members: [(&str, Make); 4] = [
        ("metal", white_metal),
        ("plastic", |roughness| mixed(roughness, 0.0)),
        ("glass", |roughness| Bsdf::Dielectric(Dielectric::new(Vec3::ONE, roughness, 1.5))),
        ("sheet", |roughness| Bsdf::Thin(Thin::new(Vec3::ONE, roughness, 1.5))),
    ];
    let sweep = (0..20).map(|i| i as f32 * 1e-3).chain((2..=98).map(|i| i as f32 * 0.01 + 0.02));
    for (name, make) in members {
        for cos in [1.0, 0.4] {
            let albedos: Vec<f32> =
                sweep.clone().map(|r| furnace(&make(r), at_cos(cos), 1 << 10).y).collect();
            for (i, pair) in albedos.windows(2).enumerate() {
                assert!((pair[1] - pair[0]).abs() <= 0.02, "{name} at cosine {cos}, step {i}: {pair:?}");
            }
        }
    }
}

#[test]
fn a_nearly_smooth_metal_is_a_mirror() {
    let (wo, nearly) = (at_cos(0.3), white_metal(1e-2));
    let mirrored = Vec3::new(-wo.x, -wo.y, wo.z);
    for index in 0..1000 {
        let sample = nearly.sample(wo, numbers(index)).unwrap();
        assert!((sample.weight.x - 1.0).abs() < 1e-3 && (sample.wi - mirrored).length() < 0.02, "{sample:?}");
    }
    let smooth = white_metal(0.0).sample(wo, [0.2, 0.7, 0.1]).unwrap();
    assert_eq!((smooth.wi, smooth.weight, smooth.delta), (mirrored, Vec3::ONE, true));
}

#[test]
fn grazing_views_stay_finite() {
    for alpha in [1e-3_f32, 1.0] {
        let roughness = alpha.sqrt();
        for bsdf in [
            white_metal(roughness),
            mixed(roughness, 0.0),
            Bsdf::Dielectric(Dielectric::new(Vec3::ONE, roughness, 1.5)),
            Bsdf::Thin(Thin::new(Vec3::ONE, roughness, 1.5)),
        ] {
            let wo = at_cos(1e-6);
            let albedo = furnace(&bsdf, wo, 4096);
            assert!(albedo.is_finite() && albedo.max_element() <= 1.0 + 1e-4, "{bsdf:?}: {albedo}");
            for wi in [at_cos(1e-6), at_cos(0.5), Vec3::new(-wo.x, -wo.y, wo.z), -wo, Vec3::Z] {
                assert!(bsdf.eval(wo, wi).is_finite() && bsdf.pdf(wo, wi).is_finite(), "{bsdf:?} {wi}");
            }
        }
    }
}

#[test]
fn what_is_smooth_is_invisible_to_light_sampling() {
    let wo = at_cos(0.6);
    let mirrored = Vec3::new(-wo.x, -wo.y, wo.z);
    for bsdf in [
        white_metal(0.0),
        Bsdf::Dielectric(Dielectric::new(Vec3::ONE, 0.0, 1.5)),
        Bsdf::Thin(Thin::new(Vec3::ONE, 0.0, 1.5)),
        Bsdf::Mirror(Mirror::new(Vec3::ONE, 0.0, true, &Frame::from_z(Vec3::Z))),
    ] {
        assert!(bsdf.is_delta(), "{bsdf:?}");
        assert_eq!((bsdf.eval(wo, mirrored), bsdf.pdf(wo, mirrored)), (Vec3::ZERO, 0.0), "{bsdf:?}");
    }
    let plastic = mixed(0.0, 0.0);
    assert!(!plastic.is_delta() && plastic.eval(wo, mirrored).x > 0.0, "its base is still lit");
    assert!(matches!(plastic.without_diffuse(), Some(Bsdf::Conductor(metal)) if metal.ggx().is_delta()));
}

#[test]
fn opaque_surfaces_are_black_from_below() {
    for (name, bsdf) in rough_members().into_iter().filter(|(_, bsdf)| !bsdf.transmits()) {
        let (above, below) = (at_cos(0.5), at_cos(-0.5));
        assert_eq!(bsdf.eval(below, above), Vec3::ZERO, "{name}");
        assert_eq!(bsdf.eval(above, below), Vec3::ZERO, "{name}");
        assert_eq!(bsdf.pdf(above, below), 0.0, "{name}");
        assert_eq!(bsdf.sample(below, [0.3, 0.6, 0.2]), None, "{name}");
    }
}

#[test]
fn nothing_enters_a_medium_of_infinite_index() {
    for ior in [0.0, 1e10, f32::MAX] {
        for solid in [false, true] {
            let bsdf = Bsdf::transmissive(&Surface { ior, roughness: 0.3, ..Surface::default() }, solid);
            let sample = bsdf.sample(at_cos(0.6), [0.3, 0.8, 0.999]).expect("a reflection");
            assert!(!sample.transmission && sample.weight.max_element() <= 1.0, "index {ior}: {sample:?}");
            assert_eq!(bsdf.eval(at_cos(0.6), -at_cos(0.4)), Vec3::ZERO);
        }
    }
    let dense = Bsdf::transmissive(&Surface { ior: 1e9, roughness: 0.3, ..Surface::default() }, true);
    let sample = dense.sample(at_cos(0.6), [0.3, 0.8, 0.999]).expect("a reflection");
    assert!(sample.weight.is_finite() && sample.pdf.is_finite(), "{sample:?}");
}
