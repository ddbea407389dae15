//! Every render knows how wrong it is, and can be told when it is good enough.

use crate::harness::{Place, Running, Said, coordinator, joining, render, run, serving};
use crate::server::Server;
use farm_film::{Counters, FrameIndex, Resolution};
use farm_image::{Frame, FrameMetadata, SampleFormat, read_image, write_frame};
use serde_json::Value;
use std::time::{Duration, Instant};

const PICTURE: [&str; 4] = ["--resolution", "60x40", "--tile", "16"];

fn rendered(place: &Place, output: &str, flags: &[&str]) -> Value {
    let mut command = render(place, output, &PICTURE);
    command.args(flags);
    run(command).json()
}

fn refused(place: &Place, flags: &[&str], words: &[&str]) {
    let mut command = render(place, "refused.exr", &PICTURE);
    command.args(flags);
    let said = run(command);
    assert_eq!(said.status.code(), Some(2), "{}", said.stderr);
    for word in words {
        assert!(said.stderr.contains(word), "{word:?} is not in {:?}", said.stderr);
    }
    assert!(!place.path("refused.exr").exists());
}

fn compare(place: &Place, files: [&str; 2], flags: &[&str]) -> Said {
    let mut command = coordinator();
    command.arg("compare").args(files.map(|name| place.path(name))).arg("--json").args(flags);
    run(command)
}

#[test]
fn a_frame_ends_at_its_error_with_the_same_bits_whoever_rendered_it() {
    let place = Place::new();
    let stopped = rendered(&place, "a.exr", &["--error", "1e-4", "--threads", "1"]);
    let spp = stopped["spp"].as_u64().unwrap();
    let error = |what: &str| stopped["frames"][0]["error"][what].as_f64().unwrap();
    let cautious = error("rel_mse") * error("rel_mse_band").sqrt();
    assert!(cautious <= 1e-4 && cautious > 5e-5, "a margin, and no more rounds than needed: {stopped}");
    assert!((32..4096).contains(&spp) && spp.is_multiple_of(16), "{spp}");
    let plain = rendered(&place, "b.exr", &["--spp", &spp.to_string()]);
    assert_eq!(stopped["digest"], plain["digest"], "the bits of --spp {spp}");

    let mut flags = PICTURE.to_vec();
    flags.extend(["--error", "1e-4"]);
    let (coordinator, address) = serving(&place, &flags);
    let _workers = ["one", "two"].map(|name| joining(&address, name));
    let farm = coordinator.wait().json();
    assert_eq!((&farm["digest"], &farm["spp"]), (&plain["digest"], &plain["spp"]), "two workers");
    assert_eq!(what_samples_decide(&farm), what_samples_decide(&stopped));

    let limited = rendered(&place, "c.exr", &["--error", "1e-9", "--spp", "48"]);
    assert_eq!(limited["spp"], 48);
    let ended = [&stopped, &plain, &limited].map(|report| report["frames"][0]["ended"].as_str().unwrap());
    assert_eq!(ended, ["error", "samples", "samples"]);
}

/// Of every checkpoint, all that is the same whoever rendered it.
fn what_samples_decide(report: &Value) -> Vec<Vec<Value>> {
    let names = ["spp", "samples", "rays_camera", "rays_extension", "rays_shadow", "estimate"];
    let checkpoints = report["frames"][0]["checkpoints"].as_array().unwrap();
    checkpoints.iter().map(|at| names.map(|name| at[name].clone()).to_vec()).collect()
}

#[test]
fn a_served_job_tells_its_error_while_it_runs_and_ends_at_it() {
    let place = Place::new();
    let server = Server::start(&place, "127.0.0.1:0");
    let mut flags = PICTURE.to_vec();
    flags.extend(["--error", "1e-5", "--aov", "variance"]);
    let job = server.submit(&place, &flags);
    let worker = joining(&server.address, "one");
    let known = server.wait_until(&job, "a forecast", |status| !status["eta_high_s"].is_null());
    let number = |name: &str| known[name].as_f64().unwrap();
    assert!(number("rel_mse") > 0.0 && number("error") > 0.0 && number("spp") >= 16.0, "{known}");
    assert!(number("eta_low_s") <= number("eta_s") && number("eta_s") <= number("eta_high_s"), "{known}");
    server.wait_until(&job, "the end", |status| status["state"] == "done");
    drop(worker);
    let fetched = place.path("fetched.exr");
    server.ask(&["fetch", &job, "-o", fetched.to_str().unwrap()]).json();
    let metadata = read_image(&fetched).unwrap().metadata.unwrap();
    assert!(metadata.error.unwrap().rel_mse <= 1e-5 && metadata.spp >= 16, "{metadata:?}");
    assert_eq!(metadata.extra["ended"], "error");
    let spp = metadata.spp.to_string();
    rendered(&place, "plain.exr", &["--spp", &spp]);
    let same = compare(&place, ["fetched.exr", "plain.exr"], &["--metrics", "rmse"]).json();
    assert_eq!(same["max_abs"], 0.0);
}

#[test]
fn a_report_that_cannot_be_written_costs_no_frame() {
    let place = Place::new();
    let folder = place.path("out");
    let mut command = render(&place, "a.exr", &PICTURE);
    command.args(["--time", "3s", "--report"]).arg(&folder);
    command.env("FARM_LOG", "farm_coordinator=debug");
    let mut running = Running::start(command);
    running.wait_for("a round", |said| said.contains("round complete").then_some(()));
    std::fs::remove_dir(&folder).unwrap();
    std::fs::write(&folder, "in the way").unwrap();
    let said = running.wait();
    assert_eq!(said.status.code(), Some(1), "{}", said.stderr);
    assert!(said.stderr.contains("the frames are written, but not their report"), "{}", said.stderr);
    assert!(read_image(&place.path("a.exr")).unwrap().metadata.unwrap().spp >= 16);
}

#[test]
fn a_frame_ends_at_its_time_with_the_bits_of_its_samples() {
    let place = Place::new();
    // Only now: the programs may have had to be built.
    let _program = coordinator();
    let begun = Instant::now();
    let stopped = rendered(&place, "a.exr", &["--time", "2s", "--error", "1e-9"]);
    let took = begun.elapsed();
    assert!((Duration::from_millis(1800)..Duration::from_secs(5)).contains(&took), "{took:?}");
    let spp = stopped["spp"].as_u64().unwrap();
    assert_eq!(stopped["digest"], rendered(&place, "b.exr", &["--spp", &spp.to_string()])["digest"]);
    assert!(stopped["frames"][0]["render_s"].as_f64().unwrap() < 2.1, "{stopped}");
    assert_eq!(stopped["frames"][0]["ended"], "time");
}

#[test]
fn the_time_of_a_frame_goes_on_while_its_coordinator_is_dead() {
    let place = Place::new();
    let mut server = Server::start(&place, "127.0.0.1:0");
    let (address, mut flags) = (server.address.clone(), PICTURE.to_vec());
    flags.extend(["--time", "8s"]);
    let job = server.submit(&place, &flags);
    let _worker = joining(&address, "one");
    let begun = Instant::now();
    std::thread::sleep(Duration::from_secs(4));
    assert!(server.samples_done(&job) > 0);
    server.running.kill();
    server = Server::start(&place, &address);
    server.wait_until(&job, "the end", |status| status["state"] == "done");
    let took = begun.elapsed();
    // Begun anew, it would take twelve.
    assert!(took < Duration::from_secs(11), "{took:?}");
    let fetched = place.path("fetched.exr");
    server.ask(&["fetch", &job, "-o", fetched.to_str().unwrap()]).json();
    let metadata = read_image(&fetched).unwrap().metadata.unwrap();
    assert_eq!(metadata.extra["ended"], "time");
    let seconds = metadata.seconds;
    assert!((6.5..8.5).contains(&seconds), "from its first unit in the first life: {seconds}");
}

#[test]
fn a_report_tells_how_the_error_fell() {
    let place = Place::new();
    let mut reference = coordinator();
    reference.arg("reference").arg(place.scene()).arg("-o").arg(place.path("reference.exr")).args(PICTURE);
    reference.args(["--error", "1e-3", "--for-spp", "32", "--json"]);
    let reference = run(reference).json();
    assert!(reference["spp"].as_u64().unwrap() >= 16 * 32, "{reference}");

    let path = |name: &str| place.path(name).to_str().unwrap().to_owned();
    let (folder, truth) = (path("out"), path("reference.exr"));
    let flags = ["--spp", "100", "--reference", &truth, "--report", &folder, "--aov", "variance"];
    let report = rendered(&place, "a.exr", &flags);
    let checkpoints = report["frames"][0]["checkpoints"].as_array().unwrap().clone();
    let spps: Vec<_> = checkpoints.iter().map(|at| at["spp"].as_u64().unwrap()).collect();
    assert_eq!(spps, [16, 32, 64, 100]);
    for (at, spp) in checkpoints.iter().zip(&spps) {
        assert_eq!(at["samples"].as_u64().unwrap(), 60 * 40 * spp, "no sample of a later round is counted");
        assert_eq!(at["rays_camera"], at["samples"]);
        assert!(at["cpu_seconds"].as_f64().unwrap() > 0.0);
        let error = |which: &str, what: &str| at[which][what].as_f64().unwrap();
        let ratio = error("estimate", "rmse") / at["truth"]["corrected"]["rmse"].as_f64().unwrap();
        assert!((0.5..2.0).contains(&ratio), "estimate over truth at {spp} spp: {ratio}");
    }
    // How steep it is depends on what else the machine does.
    assert!(checkpoints[3]["slope"].as_f64().unwrap() < 0.0, "{}", checkpoints[3]["slope"]);

    let file = |name: &str| std::fs::read(place.path("out").join(name)).unwrap();
    let json: Value = serde_json::from_slice(&file("report.json")).unwrap();
    assert_eq!(json["digest"], report["digest"]);
    let csv = String::from_utf8(file("convergence.csv")).unwrap();
    let columns = |line: &str| line.split(',').count();
    assert_eq!(csv.lines().count(), 5);
    assert!(csv.lines().all(|line| columns(line) == columns(csv.lines().next().unwrap())), "{csv}");
    let svg = String::from_utf8(file("convergence.svg")).unwrap();
    assert!(svg.contains("true error") && svg.contains("seconds since the first unit"));
    for name in ["convergence.png", "error.png"] {
        let picture = image::load_from_memory(&file(name)).unwrap();
        assert!(picture.width() >= 800, "{name}");
    }
    assert!(String::from_utf8(file("summary.md")).unwrap().contains("| 0 | 100 |"));

    let picture = read_image(&place.path("a.exr")).unwrap();
    let metadata = picture.metadata.unwrap();
    assert_eq!((metadata.spp, metadata.counters.samples), (100, 60 * 40 * 100));
    assert!(metadata.error.unwrap().rmse > 0.0 && metadata.seconds > 0.0);
    let against = compare(&place, ["a.exr", "reference.exr"], &["--metrics", "rmse,relmse"]).json();
    let seen = &checkpoints[3]["truth"];
    assert_eq!((&against["rmse"], &against["rel_mse"]), (&seen["rmse"], &seen["rel_mse"]));
    assert_eq!(against["corrected_rmse"], seen["corrected"]["rmse"]);
    assert_eq!(against.get("flip"), None);
    let flip = compare(&place, ["a.exr", "reference.exr"], &["--metrics", "flip"]);
    match flip.status.code() {
        Some(0) => assert_eq!(flip.json()["flip"], seen["flip"]),
        _ => assert!(flip.stderr.contains("farm-coordinator/flip"), "{}", flip.stderr),
    }
    let with_variance = exr::prelude::read_all_flat_layers_from_file(place.path("a.exr")).unwrap();
    let channels = &with_variance.layer_data[0].channel_data.list;
    let variances: Vec<f32> = channels
        .iter()
        .filter(|channel| channel.name.to_string().starts_with("variance."))
        .flat_map(|channel| channel.sample_data.values_as_f32())
        .collect();
    let mean = variances.iter().map(|value| f64::from(*value)).sum::<f64>() / (60.0 * 40.0 * 3.0);
    let expected = metadata.error.unwrap().rmse.powi(2);
    assert!((mean / expected - 1.0).abs() < 1e-3, "{mean} against {expected}");
}

#[test]
fn an_animation_has_a_line_per_frame_and_a_total() {
    let place = Place::new();
    let folder = place.path("out");
    let flags = ["--spp", "32", "--frames", "1-2", "--report", folder.to_str().unwrap()];
    rendered(&place, "a.####.exr", &flags);
    let csv = std::fs::read_to_string(folder.join("convergence.csv")).unwrap();
    let firsts: Vec<_> = csv.lines().map(|line| line.split(',').next().unwrap()).collect();
    assert_eq!(firsts, ["frame", "1", "2", "total"]);
    let lengths: Vec<_> = csv.lines().map(|line| line.split(',').count()).collect();
    assert!(lengths.iter().all(|length| *length == lengths[0]), "{lengths:?}");
}

#[test]
fn what_cannot_be_held_against_anything_is_refused() {
    let place = Place::new();
    let made = |name: &str, resolution: [u32; 2], value: f32| {
        let resolution = Resolution::new(resolution[0], resolution[1]).unwrap();
        let pixels = vec![[value; 3]; resolution.area()];
        let metadata = FrameMetadata {
            scene_name: String::new(),
            scene: [0; 32],
            settings: [0; 32],
            frame: FrameIndex(0),
            spp: 1,
            seed: 0,
            renderer: String::new(),
            counters: Counters::default(),
            error: None,
            seconds: 0.0,
            extra: serde_json::Map::new(),
        };
        let frame = Frame { resolution, pixels: &pixels, passes: &[] };
        write_frame(&place.path(name), &frame, &metadata, SampleFormat::Float).unwrap();
        place.path(name).to_str().unwrap().to_owned()
    };
    let small = made("small.exr", [6, 4], 1.0);
    let broken = made("broken.exr", [60, 40], f32::NAN);
    refused(&place, &["--reference", &small], &["small.exr", "60x40", "6x4"]);
    refused(&place, &["--reference", &broken], &["broken.exr", "not finite", "(0, 0)"]);
    refused(&place, &["--reference", "/no/such.exr"], &["/no"]);
    refused(&place, &["--error", "0"], &["--error", "above 0"]);
    refused(&place, &["--error", "-1"], &["--error", "above 0"]);
    refused(&place, &["--time", "0s"], &["--time", "no time"]);
    refused(&place, &["--report", "/dev/null/out"], &["/dev/null/out", "--report"]);
    let said = compare(&place, ["small.exr", "broken.exr"], &[]);
    assert_eq!(said.status.code(), Some(2), "{}", said.stderr);

    let mut hopeless = render(&place, "a.exr", &PICTURE);
    hopeless.args(["--error", "1e-7", "--time", "1s"]);
    let said = run(hopeless);
    assert!(
        said.status.success()
            && said.stderr.contains(
                "its time of 1 s was over, and not because of its estimated relative mean squared error"
            )
            && said.stderr.contains("where 0.0000001 was asked for"),
        "{}",
        said.stderr
    );
}
