//! Programs for benchmarks, freshly built.

use std::path::{Path, PathBuf};
use std::process::Command;

/// The project's folder.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Builds the coordinator as users run it; where it is.
///
/// # Panics
///
/// When it does not build.
pub fn release_coordinator() -> PathBuf {
    let built = Command::new(env!("CARGO"))
        .args(["build", "--release", "--quiet", "--bin", "coordinator"])
        .current_dir(root())
        .status()
        .expect("cargo runs");
    assert!(built.success());
    let bench = std::env::current_exe().expect("this program has a path");
    bench.parent().and_then(Path::parent).expect("target/release/deps").join("coordinator")
}
