//! The real programs, always freshly built, and a small scene for them.

use rustix::process::Signal;
use serde_json::Value;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, ExitStatus, Stdio};
use std::sync::{Arc, LazyLock, Mutex};
use std::time::{Duration, Instant};

/// Nothing in these stories takes longer, even on a busy machine.
const PATIENCE: Duration = Duration::from_secs(180);

/// Folder of the programs: built once per run, in the profile of this test.
static PROGRAMS: LazyLock<PathBuf> = LazyLock::new(|| {
    let test = std::env::current_exe().unwrap();
    let folder = test.parent().and_then(Path::parent).unwrap().to_owned();
    let profile = match folder.file_name().and_then(|name| name.to_str()).unwrap() {
        "debug" => "dev",
        other => other,
    };
    let mut build = Command::new(env!("CARGO"));
    // What cargo tells tests of their package would have crates built again that look at it.
    for (variable, _) in std::env::vars_os() {
        if variable.to_string_lossy().starts_with("CARGO_PKG_") || variable == "CARGO_MANIFEST_DIR" {
            build.env_remove(variable);
        }
    }
    let built = build
        .args([
            "build",
            "--quiet",
            "--bins",
            "-p",
            "farm-coordinator",
            "-p",
            "farm-worker",
            "--profile",
            profile,
        ])
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .status()
        .unwrap();
    assert!(built.success(), "the programs build");
    folder
});

/// A program without settings from this shell.
fn program(name: &str) -> Command {
    let mut command = Command::new(PROGRAMS.join(name));
    for (variable, _) in std::env::vars_os() {
        if variable.to_string_lossy().starts_with("FARM_") {
            command.env_remove(variable);
        }
    }
    // Nothing is remembered from one test to the next: this is no folder.
    command.env("XDG_STATE_HOME", "none");
    command.stdin(Stdio::null());
    command
}

pub fn coordinator() -> Command {
    program("coordinator")
}

pub fn worker() -> Command {
    program("worker")
}

/// The command as further arguments of one that runs it.
pub fn wrapped(mut wrapper: Command, command: &Command) -> Command {
    wrapper.arg(command.get_program()).args(command.get_args());
    for (name, value) in command.get_envs() {
        match value {
            Some(value) => wrapper.env(name, value),
            None => wrapper.env_remove(name),
        };
    }
    wrapper
}

/// A folder with the test's scene in it.
pub struct Place(tempfile::TempDir);

impl Place {
    pub fn new() -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        std::fs::write(place.scene(), scene_text()).unwrap();
        place
    }

    pub fn scene(&self) -> PathBuf {
        self.path("lamp.gltf")
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Names of all files but the scene.
    pub fn files(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.0.path()).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<_> = names.filter(|name| name != "lamp.gltf").collect();
        names.sort();
        names
    }
}

/// How a program ended, and what it said.
pub struct Said {
    pub status: ExitStatus,
    pub stdout: String,
    pub stderr: String,
}

impl Said {
    pub fn json(&self) -> Value {
        assert!(self.status.success(), "{}\n{}", self.status, self.stderr);
        serde_json::from_str(&self.stdout).unwrap_or_else(|err| panic!("{err} in {:?}", self.stdout))
    }

    pub fn digest(&self) -> String {
        self.json()["digest"].as_str().unwrap().to_owned()
    }
}

/// A program under way; killed when the story ends early.
pub struct Running {
    child: Child,
    stderr: Arc<Mutex<String>>,
}

impl Running {
    pub fn start(mut command: Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let stderr = Arc::new(Mutex::new(String::new()));
        collect(child.stderr.take().unwrap(), stderr.clone());
        Self { child, stderr }
    }

    pub fn stderr(&self) -> String {
        self.stderr.lock().unwrap().clone()
    }

    /// Waits until the program has said something that `find` finds.
    pub fn wait_for<T>(&mut self, what: &str, find: impl Fn(&str) -> Option<T>) -> T {
        let begun = Instant::now();
        loop {
            if let Some(found) = find(&self.stderr()) {
                return found;
            }
            let ended = self.child.try_wait().unwrap();
            assert!(ended.is_none(), "ended ({ended:?}) before {what}:\n{}", self.stderr());
            assert!(begun.elapsed() < PATIENCE, "no {what} in time:\n{}", self.stderr());
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// What other users of the host see of it: its arguments, one line each.
    pub fn arguments(&self) -> String {
        let line = std::fs::read(format!("/proc/{}/cmdline", self.child.id())).unwrap();
        String::from_utf8(line).unwrap().replace('\0', "\n")
    }

    /// By how much it lets others go first.
    pub fn nice(&self) -> i32 {
        nice(&self.child.id().to_string())
    }

    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// SIGKILL: no chance to say or save anything.
    pub fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// SIGTERM: finish what is being rendered, and leave.
    pub fn terminate(&self) {
        self.signal(Signal::TERM);
    }

    /// SIGSTOP: as a machine that hangs, or whose network is gone.
    pub fn freeze(&self) {
        self.signal(Signal::STOP);
    }

    /// SIGCONT.
    pub fn thaw(&self) {
        self.signal(Signal::CONT);
    }

    fn signal(&self, signal: Signal) {
        let id = rustix::process::Pid::from_child(&self.child);
        rustix::process::kill_process(id, signal).unwrap();
    }

    pub fn wait(mut self) -> Said {
        let mut stdout = self.child.stdout.take().unwrap();
        let reader = std::thread::spawn(move || {
            let mut text = String::new();
            stdout.read_to_string(&mut text).map(|_| text)
        });
        let begun = Instant::now();
        let status = loop {
            match self.child.try_wait().unwrap() {
                Some(status) => break status,
                None => assert!(begun.elapsed() < PATIENCE, "does not end:\n{}", self.stderr()),
            }
            std::thread::sleep(Duration::from_millis(10));
        };
        let stdout = reader.join().unwrap().unwrap();
        // The last lines may still be on their way.
        std::thread::sleep(Duration::from_millis(20));
        Said { status, stdout, stderr: self.stderr() }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// By how much a process lets others go first.
pub fn nice(process: &str) -> i32 {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap();
    stat.rsplit(')').next().unwrap().split_whitespace().nth(16).unwrap().parse().unwrap()
}

fn collect(stderr: ChildStderr, text: Arc<Mutex<String>>) {
    std::thread::spawn(move || {
        for line in BufReader::new(stderr).lines().map_while(Result::ok) {
            let mut text = text.lock().unwrap();
            text.push_str(&line);
            text.push('\n');
        }
    });
}

/// Runs a program to its end.
pub fn run(command: Command) -> Said {
    Running::start(command).wait()
}

/// `coordinator render` of the test's scene with further flags.
pub fn render(place: &Place, output: &str, flags: &[&str]) -> Command {
    let mut command = coordinator();
    command.arg("render").arg(place.scene()).arg("-o").arg(place.path(output)).arg("--json").args(flags);
    command
}

/// A coordinator that leaves all rendering to workers that join.
pub fn serving(place: &Place, flags: &[&str]) -> (Running, String) {
    let mut command = render(place, "out.exr", &["--listen", "127.0.0.1:0", "--no-local-worker"]);
    command.args(flags).env("FARM_LOG", "info,farm_coordinator=debug");
    let mut running = Running::start(command);
    let address = running.wait_for("an address", |said| {
        let line = said.lines().find(|line| line.starts_with("listening on "))?;
        Some(line["listening on ".len()..].to_owned())
    });
    (running, address)
}

/// A worker of one thread.
pub fn joining(address: &str, name: &str) -> Running {
    joining_on(address, name, &[])
}

/// A worker of one thread with further flags.
pub fn joining_on(address: &str, name: &str, flags: &[&str]) -> Running {
    joining_with(address, name, &[&["--threads", "1"], flags].concat())
}

/// A worker.
pub fn joining_with(address: &str, name: &str, flags: &[&str]) -> Running {
    let mut command = worker();
    command.args(["--connect", address, "--name", name]).args(flags);
    Running::start(command)
}

/// A floor under a lamp, seen from the side: small, but with soft shadows, a lens and a moving block.
fn scene_text() -> String {
    // Two triangles of side 2 in the plane y = 0, wound upwards.
    let positions: [[f32; 3]; 4] = [[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0]];
    let mut bytes: Vec<u8> = positions.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
    bytes.extend([0u16, 1, 2, 0, 2, 3].iter().flat_map(|index| index.to_le_bytes()));
    let data = base64::Engine::encode(&base64::engine::general_purpose::STANDARD, &bytes);
    let primitive = |material: u32| serde_json::json!({"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": material}]});
    serde_json::json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1, 2, 3]}],
        "nodes": [
            {"name": "floor", "mesh": 0, "scale": [3, 1, 3]},
            {"name": "lamp", "mesh": 1, "translation": [0, 3, 0], "rotation": [1, 0, 0, 0], "scale": [0.5, 1, 0.5]},
            {"name": "block", "mesh": 2, "translation": [0.3, 1, 0], "scale": [0.6, 1, 0.4],
             "extras": {"motionVector": [0.5, 0, 0]}},
            {"name": "eye", "camera": 0, "translation": [0, 2, 6], "rotation": [-0.1305, 0, 0, 0.9914]}
        ],
        "cameras": [{"name": "eye", "type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1},
                     "extras": {"apertureRadius": 0.05, "focusDistance": 6}}],
        "materials": [
            {"pbrMetallicRoughness": {"baseColorFactor": [0.7, 0.6, 0.5, 1], "metallicFactor": 0}},
            {"emissiveFactor": [1, 0.9, 0.8],
             "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 10}}},
            {"pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.8, 0.9, 1], "roughnessFactor": 0.3}, "doubleSided": true}
        ],
        "extensionsUsed": ["KHR_materials_emissive_strength"],
        "meshes": [primitive(0), primitive(1), primitive(2)],
        "buffers": [{"byteLength": bytes.len(), "uri": format!("data:application/octet-stream;base64,{data}")}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [-1, 0, -1], "max": [1, 0, 1]},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}
        ]
    })
    .to_string()
}
