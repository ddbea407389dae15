//! Error against run time on the benchmark set: what the renderer promises about its own error, held against the truth.
//!
//! Every point is measured on several replicates: independent pictures of one prepared scene. A sequence of samples begins anew at
//! index `2^32 r`, so replicate `r` is the samples from there on.

pub mod adaptive;
pub mod plot;
pub mod report;
pub mod stage;
pub mod study;
pub mod summary;

use crate::scenes::Named;
use farm_render::sampler::Sequence;
use farm_scene::Filter;
use stage::Stage;
use study::{Reference, replicates};
use summary::Outcome;

/// Pictures that a reference is the mean of.
const REFERENCES: u64 = 8;

/// How much is measured.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Width and height of the pictures.
    pub resolution: [u32; 2],
    /// Samples per pixel of the last point, a power of two.
    pub spp_max: u64,
    /// Replicates per point.
    pub seeds: u64,
}

impl Effort {
    /// Samples per pixel of each picture of a reference.
    fn reference_spp(self) -> u64 {
        2 * self.spp_max
    }

    /// Samples per pixel of a scene through one filter, over everything that is rendered.
    pub fn samples(self) -> u64 {
        // Up to the leaf every number of samples is a picture of its own: 1 + 2 + 4 + 8 more.
        REFERENCES * self.reference_spp() + 2 * self.seeds * (self.spp_max + 15)
    }
}

/// Measures a scene through a filter, against independent samples as well. `done` hears of samples per pixel.
pub fn measure(
    named: Named,
    filter: Filter,
    effort: Effort,
    done: &(dyn Fn(u64) + Sync),
) -> Result<Outcome, String> {
    let scene = Stage::new(named)?.prepare(effort.resolution, filter)?;
    let reference = Reference::new(&scene, REFERENCES, effort.reference_spp(), done);
    let sobol = replicates(&scene, effort.seeds, effort.spp_max, done);
    let scene = scene.with_sequence(Sequence::Independent);
    let independent = replicates(&scene, effort.seeds, effort.spp_max, done);
    Ok(Outcome::new(named.name, filter, &reference, &sobol, &independent))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The benchmark set in short: two scenes, small pictures.
    #[test]
    fn errors_are_estimated_and_the_sequence_is_worth_it() {
        for (name, gain) in [("lens-motion", 1.2), ("cornell-diffuse", 1.5)] {
            let effort = Effort { resolution: [32, 18], spp_max: 64, seeds: 5 };
            let outcome = measure(Named::find(name).unwrap(), Filter::Box, effort, &|_| ()).unwrap();
            let end = outcome.points.last().unwrap();
            let ratio = end.ratio.unwrap();
            assert!((0.75..1.33).contains(&ratio.median), "{name}: estimated over true {ratio:?}");
            for point in outcome.points.iter().filter(|point| point.spp >= summary::SEQUENCE_FROM) {
                let independent = point.independent.unwrap();
                assert!(point.rmse.median < independent.median, "{name}: {point:?}");
            }
            let found = end.independent.unwrap().median / end.rmse.median;
            assert!(found > gain, "{name}: the sequence is worth a factor {found} only");
            assert!(outcome.slope < -0.45, "{name}: slope {}", outcome.slope);
        }
    }
}
