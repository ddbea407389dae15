//! Programs for benchmarks, freshly built.

use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

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

/// A coordinator that serves on this machine, for as long as this is there.
pub struct Served {
    program: PathBuf,
    child: Child,
    address: String,
}

impl Served {
    /// Starts `program` with its store in a folder, and waits until it listens. What it has to complain of is shown.
    ///
    /// # Panics
    ///
    /// When it does not start.
    pub fn start(program: &Path, store: &Path) -> Self {
        let mut child = Command::new(program)
            .args(["serve", "--listen", "127.0.0.1:0", "--store"])
            .arg(store)
            .env("FARM_LOG", "warn")
            .stderr(Stdio::piped())
            .spawn()
            .expect("the coordinator runs");
        let mut lines =
            BufReader::new(child.stderr.take().expect("it is piped")).lines().map_while(Result::ok);
        let address = lines
            .find_map(|line| line.strip_prefix("listening on ").map(str::to_owned))
            .expect("the coordinator listens");
        std::thread::spawn(move || lines.for_each(|line| eprintln!("coordinator: {line}")));
        Self { program: program.to_owned(), child, address }
    }

    /// Where it listens: `HOST:PORT`.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Of its process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Submits a scene of the tests with further flags; the job's number.
    ///
    /// # Panics
    ///
    /// When it is refused.
    pub fn submit(&self, scene: &str, flags: &[&str]) -> u64 {
        let scene = root().join("tests/scenes").join(scene);
        let mut what = vec!["submit", scene.to_str().expect("a name that can be read")];
        what.extend(flags);
        self.ask(&what)["job"].as_u64().expect("a number")
    }

    /// Asks something, as a user does; the answer.
    ///
    /// # Panics
    ///
    /// When it is refused.
    pub fn ask(&self, what: &[&str]) -> Value {
        let said = Command::new(&self.program)
            .args(what)
            .args(["--json", "--to", &self.address])
            .output()
            .expect("the coordinator runs");
        serde_json::from_slice(&said.stdout)
            .unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&said.stderr)))
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
