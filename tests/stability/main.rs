//! The short form of the stability suite: every case, with fixed seeds, in minutes.

use farm_tests::stability::bench::{Effort, FAMILY, Rule};
use farm_tests::stability::registry::CASES;
use farm_tests::stability::{run, table};
use std::path::Path;

/// The renderer's known bugs are compiled for the suite's own proof only: no manifest of the project turns their feature on by default,
/// and none but the renderer's and the suite's knows it.
#[test]
fn no_program_of_the_farm_has_the_known_bugs() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the suite lies in the workspace");
    let mut manifests = 0;
    for folder in ["", "common", "coordinator", "worker", "proto", "tests"] {
        let folder = root.join(folder);
        let below = std::fs::read_dir(&folder)
            .expect("a folder of the workspace")
            .flatten()
            .map(|entry| entry.path());
        for path in
            below.chain([folder]).map(|folder| folder.join("Cargo.toml")).filter(|path| path.is_file())
        {
            let text = std::fs::read_to_string(&path).expect("a manifest");
            manifests += 1;
            let knows = text.contains("mutations");
            let may =
                ["common/render/Cargo.toml", "tests/Cargo.toml"].iter().any(|known| path == root.join(known));
            assert!(!knows || may, "{} names the known bugs", path.display());
            let default = text.lines().find(|line| line.trim_start().starts_with("default ="));
            assert!(!default.is_some_and(|line| line.contains("mutations")), "{}", path.display());
        }
    }
    assert!(manifests > 10, "only {manifests} manifests were found");
}

#[test]
fn every_case_has_its_answer() {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let rows = run::run_cases(CASES, Effort::Short, threads, &|_, _| {});
    let statistical = rows.iter().filter(|row| matches!(row.rule, Rule::Statistical { .. })).count();
    assert!(statistical <= FAMILY as usize, "{statistical} checks share the error of {FAMILY}");
    let red: Vec<_> = rows.iter().filter(|row| !row.passed()).cloned().collect();
    assert!(red.is_empty(), "\n{}", table::text(&red));
}
