//! Measures error against run time on the benchmark set and prints its tables.

use clap::Parser;
use farm_film::{ADAPTIVE_SPP_MIN, BIAS_OVER_NOISE};
use farm_scene::Filter;
use farm_tests::convergence::{Effort, adaptive, measure, plot, report};
use farm_tests::scenes::{Named, SCENES};
use indicatif::{ProgressBar, ProgressStyle};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

/// Error against run time: true and estimated, of the sequence and of independent samples, from 1 sample per pixel on. Exit code 1 if a
/// goal is missed.
#[derive(Parser)]
#[command(name = "convergence")]
struct Settings {
    /// Scenes to measure, such as slit,sun-sky; the benchmark set unless given.
    #[arg(long, value_delimiter = ',', value_parser = parse_scene)]
    scenes: Vec<Named>,
    /// Samples per pixel of the last point; a power of two.
    #[arg(long, default_value_t = 256, value_parser = parse_spp)]
    spp_max: u64,
    /// Independent pictures per point.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u64).range(2..=1000))]
    seeds: u64,
    /// Measures frames that end for their error instead, at about a quarter of --spp-max, which is at least 1024 then: how well their
    /// end is predicted, what it gains that tiles end on their own, and its bias.
    #[arg(long, conflicts_with = "plot")]
    adaptive: bool,
    /// Threads; as many as the machine has unless given.
    #[arg(long)]
    threads: Option<usize>,
    /// Also writes everything as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Also writes a table of one line per scene as Markdown.
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// Also draws error over CPU time as a PNG.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

fn parse_scene(name: &str) -> Result<Named, String> {
    Named::find(name).ok_or_else(|| {
        let known: Vec<_> = SCENES.iter().map(|scene| scene.name).collect();
        format!("no such scene; there are {}", known.join(", "))
    })
}

fn parse_spp(text: &str) -> Result<u64, String> {
    match text.parse::<u64>() {
        Ok(spp) if spp.is_power_of_two() && (16..=1 << 20).contains(&spp) => Ok(spp),
        _ => Err("a power of two from 16 to 1048576 is wanted".to_owned()),
    }
}

fn main() -> ExitCode {
    match try_main(&Settings::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(reason) => {
            eprintln!("convergence: {reason}");
            ExitCode::from(2)
        }
    }
}

fn try_main(settings: &Settings) -> Result<bool, String> {
    let begun = Instant::now();
    let threads = rayon::ThreadPoolBuilder::new().num_threads(settings.threads.unwrap_or(0));
    let threads = threads.build().map_err(|err| err.to_string())?;
    let scenes = if settings.scenes.is_empty() { SCENES[1..].to_vec() } else { settings.scenes.clone() };
    if settings.adaptive {
        return threads.install(|| try_adaptive(settings, &scenes));
    }
    let effort = Effort { resolution: [128, 72], spp_max: settings.spp_max, seeds: settings.seeds };
    let filters = [Filter::Box, Filter::Gaussian];
    let bar = progress(effort.samples() * (filters.len() * scenes.len()) as u64);
    let mut outcomes = Vec::new();
    for (scene, filter) in scenes.iter().flat_map(|scene| filters.map(|filter| (*scene, filter))) {
        bar.set_message(scene.name);
        let outcome = threads.install(|| measure(scene, filter, effort, &|spp| bar.inc(spp)))?;
        bar.suspend(|| println!("{}", report::text(&outcome)));
        outcomes.push(outcome);
    }
    bar.finish_and_clear();
    print!("{}", report::markdown(&outcomes));
    let misses: Vec<_> = outcomes.iter().flat_map(|outcome| outcome.misses()).collect();
    println!("\n{} goals missed, {:.0} s", misses.len(), begun.elapsed().as_secs_f64());
    misses.iter().for_each(|miss| println!("missed: {miss}"));
    if let Some(path) = &settings.json {
        write(path, &serde_json::to_string_pretty(&outcomes).map_err(|err| err.to_string())?)?;
    }
    if let Some(path) = &settings.markdown {
        write(path, &report::markdown(&outcomes))?;
    }
    if let Some(path) = &settings.plot {
        plot::draw(path, &outcomes)?;
    }
    Ok(misses.is_empty())
}

/// Whether the bias is below what every adaptive frame says of itself.
fn try_adaptive(settings: &Settings, scenes: &[Named]) -> Result<bool, String> {
    let effort = adaptive::Effort {
        resolution: [96, 64],
        tile_side: 16,
        spp_max: settings.spp_max.max(16 * ADAPTIVE_SPP_MIN),
        seeds: settings.seeds,
    };
    let bar = progress(effort.samples() * scenes.len() as u64);
    let mut outcomes = Vec::new();
    for scene in scenes {
        bar.set_message(scene.name);
        let outcome = adaptive::measure(*scene, effort, &|spp| bar.inc(spp))?;
        outcomes.push(outcome);
    }
    bar.finish_and_clear();
    let table = adaptive::markdown(&outcomes);
    print!("{table}");
    if let Some(path) = &settings.json {
        write(path, &serde_json::to_string_pretty(&outcomes).map_err(|err| err.to_string())?)?;
    }
    if let Some(path) = &settings.markdown {
        write(path, &table)?;
    }
    Ok(outcomes.iter().all(|outcome| outcome.bias_over_noise <= BIAS_OVER_NOISE))
}

fn progress(samples: u64) -> ProgressBar {
    let style = "{msg:18} {wide_bar} {percent} %, {elapsed} of about {duration}";
    ProgressBar::new(samples).with_style(ProgressStyle::with_template(style).expect("a template in order"))
}

fn write(path: &Path, text: &str) -> Result<(), String> {
    std::fs::write(path, text).map_err(|err| format!("cannot write {}: {err}", path.display()))
}
