//! Tiles that end on their own do so for reasons that lie in the picture, never in the farm.

use crate::harness::{Place, Running, joining, render, run, serving};
use crate::server::{Server, difference};
use farm_image::read_image;
use serde_json::Value;

/// A picture that takes seconds, with tiles that need few samples and tiles that need many.
const PICTURE: [&str; 7] = ["--resolution", "96x64", "--tile", "16", "--error", "1e-4", "--adaptive"];

fn alone(place: &Place, flags: &[&str]) -> Value {
    let mut command = render(place, "alone.exr", &PICTURE);
    command.args(flags);
    run(command).json()
}

#[test]
fn samples_go_where_the_error_needs_them() {
    let place = Place::new();
    let folder = place.path("out");
    let adaptive = alone(&place, &["--report", folder.to_str().unwrap()]);
    let uniform = run(render(&place, "uniform.exr", &PICTURE[..6])).json();
    for render in [&adaptive, &uniform] {
        assert!(render["rel_mse"].as_f64().unwrap() <= 1e-4, "{render}");
    }
    let said = &adaptive["frames"][0]["adaptive"];
    let number = |name: &str| said[name].as_f64().unwrap();
    assert_eq!(number("spp_min"), 64.0, "most of the picture is black");
    assert!(number("tiles_ended") > 0.0 && number("tiles") == 24.0, "{said}");
    assert!(
        number("spp_mean") < 0.8 * uniform["spp"].as_f64().unwrap(),
        "{said}, uniform {}",
        uniform["spp"]
    );
    assert!(number("bias_over_noise") > 0.0);

    let metadata = read_image(&place.path("alone.exr")).unwrap().metadata.unwrap();
    assert_eq!(&metadata.extra["adaptive"], said);
    assert_eq!(
        metadata.counters.samples as f64,
        number("spp_mean") * 96.0 * 64.0,
        "what was dropped is not counted"
    );
    assert!(image::open(folder.join("samples.png")).unwrap().width() >= 800);
    let summary = std::fs::read_to_string(folder.join("summary.md")).unwrap();
    assert!(summary.contains("tiles ended on their own") && summary.contains("samples.png"), "{summary}");
}

#[test]
fn whoever_renders_it_adaptive_pictures_have_the_same_bits() {
    let place = Place::new();
    let expected = alone(&place, &["--threads", "1"])["digest"].clone();
    assert_eq!(alone(&place, &["--threads", "2"])["digest"], expected);

    let mut flags = PICTURE.to_vec();
    flags.extend(["--verify", "0.2"]);
    let (mut coordinator, address) = serving(&place, &flags);
    let mut victim = joining(&address, "victim");
    let _loyal = joining(&address, "loyal");
    coordinator.wait_for("its first unit", |said| said.contains("unit accepted").then_some(()));
    victim.kill();
    coordinator.wait_for("a decision", |said| said.contains("tiles ended").then_some(()));
    let _late = joining(&address, "late");
    assert_eq!(coordinator.wait().json()["digest"], expected);
}

#[test]
fn a_coordinator_that_is_killed_decides_the_same_again() {
    let place = Place::new();
    alone(&place, &[]);
    let start = |listen: &str| Server::start_telling(&place, listen);
    let mut server = start("127.0.0.1:0");
    let address = server.address.clone();
    let job = server.submit(&place, &PICTURE);
    let _worker: Running = joining(&address, "ann");
    let mut done = 0;
    // Before the first decision, and after it.
    done = server.wait_for_more(&job, done);
    server.running.kill();
    server = start(&address);
    server.running.wait_for("a decision", |said| said.contains("tiles ended").then_some(()));
    server.wait_for_more(&job, done);
    server.running.kill();
    server = start(&address);
    server.running.wait_for("the same decision", |said| said.contains("tiles ended").then_some(()));
    assert_eq!(difference(&server.fetched(&place, &job), &place.path("alone.exr")), 0.0);
}

#[test]
fn tiles_need_an_error_to_end_at() {
    let place = Place::new();
    let said = run(render(&place, "a.exr", &["--resolution", "16x16", "--adaptive"]));
    assert_eq!(said.status.code(), Some(2));
    assert!(said.stderr.contains("--adaptive needs --error"), "{}", said.stderr);
    assert!(!place.path("a.exr").exists());
}
