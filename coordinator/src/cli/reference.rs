//! What pictures of a scene converge to.

use super::compare::REFERENCE_SAMPLES;
use super::render::{self, RenderArgs};
use farm_worker::cli::Fault;

/// Error of a reference that none was asked for.
const ERROR: f64 = 1e-3;

/// Part of a seed that makes references independent of the pictures of that seed.
const OTHER_SEED: u64 = 0x9e37_79b9_7f4a_7c15;

/// Render what pictures of a scene converge to, to hold them against
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Takes the flags of render. The reference has another seed than pictures rendered with the same flags, at least 16 times their samples,
and an estimated relative mean squared error of at most --error (0.001 if not given). It states its own error, which comparisons
take off.

Examples:
  coordinator reference scene.glb -o reference.exr --error 1e-4
  coordinator render scene.glb -o scene.exr --reference reference.exr --report out
  coordinator compare scene.exr reference.exr")]
pub struct ReferenceArgs {
    #[command(flatten)]
    render: RenderArgs,
    /// Samples per pixel of the pictures that will be held against it
    #[arg(long, env = "FARM_FOR_SPP", value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u64).range(1..=1 << 36))]
    for_spp: u64,
}

/// Renders and writes the reference.
pub fn run(args: ReferenceArgs) -> Result<(), Fault> {
    let mut render = args.render;
    if render.output.is_none() {
        return Err(Fault::input("a reference needs a name: give one with -o REF.exr"));
    }
    render.picture.seed ^= OTHER_SEED;
    render.work.error.get_or_insert(ERROR);
    render.work.spp_min = args.for_spp.saturating_mul(REFERENCE_SAMPLES);
    render::run(render)
}
