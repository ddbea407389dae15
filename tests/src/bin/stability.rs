//! Runs the stability suite and prints its table.

use clap::Parser;
use farm_tests::stability::bench::{Effort, Row};
use farm_tests::stability::cases::fuzz;
use farm_tests::stability::registry::{CASES, Case};
use farm_tests::stability::{run, table};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Stiff and extreme cases with a certain answer. Exit code 1 if one of them fails.
#[derive(Parser)]
#[command(name = "stability")]
struct Settings {
    /// Cases to run, such as T29,T34; all of them unless given.
    #[arg(long, value_delimiter = ',')]
    only: Vec<String>,
    /// More samples, larger inputs, 10,000 random scenes, and checks of wall time.
    #[arg(long)]
    full: bool,
    /// Threads; as many as the machine has unless given. Checks of wall time want 1.
    #[arg(long)]
    threads: Option<usize>,
    /// Renders the random scene of this seed, and nothing else.
    #[arg(long, value_name = "SEED")]
    scene: Option<u64>,
    /// Switches the renderer's known bugs on one at a time and prints which cases see them; exit code 1 if one is not seen.
    #[cfg(feature = "mutations")]
    #[arg(long)]
    mutations: bool,
    /// Also writes all rows as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Also writes a table of one line per case as Markdown.
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
}

fn main() -> ExitCode {
    match try_main(&Settings::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(reason) => {
            eprintln!("stability: {reason}");
            ExitCode::from(2)
        }
    }
}

fn try_main(settings: &Settings) -> Result<bool, String> {
    if let Some(seed) = settings.scene {
        println!("{:#?}", fuzz::scene_of(seed));
        println!("{:?}", fuzz::try_seed(seed));
        return Ok(fuzz::try_seed(seed).is_ok());
    }
    let available = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = settings.threads.unwrap_or(available).max(1);
    #[cfg(feature = "mutations")]
    if settings.mutations {
        use farm_tests::stability::mutation_proof::{self, Verdict};
        print!("{}", mutation_proof::titles());
        let print = &mut |verdict: &Verdict| print!("{}", mutation_proof::line(verdict));
        return Ok(mutation_proof::matrix(threads, print).iter().all(Verdict::is_right));
    }
    let cases = chosen(&settings.only)?;
    let effort = if settings.full { Effort::Full } else { Effort::Short };
    let rows = run::run_cases(&cases, effort, threads, &|case, rows| {
        let red = rows.iter().filter(|row| !row.passed()).count();
        let seconds: f64 = rows.iter().map(|row| row.seconds).sum();
        let verdict = if red == 0 { "ok".to_owned() } else { format!("{red} of {} failed", rows.len()) };
        eprintln!("{:5} {:32} {seconds:7.1} s  {verdict}", case.id, case.what);
    });
    print!("{}", table::text(&rows));
    if let Some(path) = &settings.json {
        let json = serde_json::to_string_pretty(&rows).map_err(|err| err.to_string())?;
        write(path, &json)?;
    }
    if let Some(path) = &settings.markdown {
        write(path, &table::markdown(&rows))?;
    }
    Ok(rows.iter().all(Row::passed))
}

fn chosen(only: &[String]) -> Result<Vec<Case>, String> {
    let find = |id: &String| {
        CASES.iter().find(|case| case.id.eq_ignore_ascii_case(id)).copied().ok_or_else(|| {
            format!("there is no case {id}; the last on the list is {}", CASES[CASES.len() - 1].id)
        })
    };
    if only.is_empty() { Ok(CASES.to_vec()) } else { only.iter().map(find).collect() }
}

fn write(path: &Path, text: &str) -> Result<(), String> {
    std::fs::write(path, text).map_err(|err| format!("cannot write {}: {err}", path.display()))
}
