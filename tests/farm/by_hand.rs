//! Partials rendered on machines that never met merge to the picture of one machine.

use crate::harness::{Place, Said, coordinator, render, run, worker};

const PICTURE: [&str; 2] = ["--resolution", "48x30"];

fn part(place: &Place, name: &str, flags: &[&str]) -> Said {
    let mut command = worker();
    command.arg("render").arg(place.scene()).args(PICTURE).arg("-o").arg(place.path(name)).args(flags);
    run(command)
}

fn merge(place: &Place, parts: &[&str]) -> Said {
    let mut command = coordinator();
    command.arg("merge").args(parts.iter().map(|name| place.path(name)));
    command.arg("-o").arg(place.path("merged.exr")).arg("--json");
    run(command)
}

#[test]
fn merged_partials_are_the_picture() {
    let place = Place::new();
    let made = |name, flags: &[&str]| {
        let said = part(&place, name, flags);
        assert!(said.status.success(), "{}", said.stderr);
    };
    made("top.exr", &["--samples", "0..64", "--tile-window", "0,0,48,11"]);
    made("a.exr", &["--samples", "0..32", "--tile-window", "0,11,48,30", "--threads", "1"]);
    made("b.exr", &["--samples", "32..64", "--tile-window", "0,11,48,30", "--threads", "2"]);
    let mut command = render(&place, "whole.exr", &PICTURE);
    command.args(["--spp", "64"]);
    let whole = run(command).digest();
    assert_eq!(merge(&place, &["b.exr", "top.exr", "a.exr"]).digest(), whole);

    let mut command = coordinator();
    command.arg("compare").args(["merged.exr", "whole.exr"].map(|name| place.path(name))).arg("--json");
    assert_eq!(run(command).json()["max_abs"], 0.0);
    let made_by_hand = merge(&place, &["b.exr", "top.exr", "a.exr"]).json();
    assert_eq!(made_by_hand["counters"]["dropped"], 0, "{made_by_hand}");

    let said = merge(&place, &["a.exr", "top.exr"]);
    assert_eq!(said.status.code(), Some(2));
    assert!(said.stderr.contains("samples 32..64"), "{}", said.stderr);
    made("seed.exr", &["--samples", "32..64", "--tile-window", "0,11,48,30", "--seed", "1"]);
    let said = merge(&place, &["a.exr", "top.exr", "seed.exr"]);
    assert!(said.stderr.contains("seed.exr") && said.stderr.contains("another seed"), "{}", said.stderr);
}

#[test]
fn the_level_of_the_blocks_does_not_show() {
    let place = Place::new();
    let mut command = render(&place, "whole.exr", &PICTURE);
    command.args(["--spp", "64", "--tile", "1000"]);
    let whole = run(command).digest();
    for samples in [16, 32, 64] {
        let names: Vec<_> = (0..64 / samples)
            .map(|block| {
                let name = format!("{samples}-{block}.exr");
                let range = format!("{}..{}", block * samples, (block + 1) * samples);
                let said = part(&place, &name, &["--samples", &range]);
                assert!(said.status.success(), "{}", said.stderr);
                name
            })
            .collect();
        let names: Vec<_> = names.iter().map(String::as_str).rev().collect();
        assert_eq!(merge(&place, &names).digest(), whole, "blocks of {samples} samples");
    }
}

#[test]
fn samples_that_are_no_block_are_refused_with_the_blocks_they_are_made_of() {
    let place = Place::new();
    let said = part(&place, "x.exr", &["--samples", "0..100"]);
    assert_eq!(said.status.code(), Some(2));
    assert!(said.stderr.contains("0..64, 64..96, 96..100"), "{}", said.stderr);
    let said = part(&place, "x.exr", &["--samples", "0..16", "--tile-window", "0,0,49,30"]);
    assert_eq!(said.status.code(), Some(2));
    assert_eq!(place.files(), [""; 0]);
}

#[test]
fn a_limit_on_samples_is_off_unless_asked_for_and_says_what_it_took() {
    let place = Place::new();
    let rendered = |flags: &[&str]| {
        let mut command = render(&place, "out.exr", &PICTURE);
        command.args(["--spp", "32"]).args(flags);
        run(command)
    };
    let free = rendered(&[]).json();
    assert_eq!((&free["counters"]["clamped"], &free["frames"][0]["light_clamped"]), (&0.into(), &0.0.into()));
    let said = rendered(&["--clamp", "0.2"]);
    assert!(said.stderr.contains("samples limited to 0.2"), "{}", said.stderr);
    let limited = said.json();
    let share = limited["frames"][0]["light_clamped"].as_f64().unwrap();
    assert!(limited["counters"]["clamped"].as_u64().unwrap() > 0, "{limited}");
    assert!(share > 0.0 && share < 1.0, "{share}");
    assert_ne!(free["digest"], limited["digest"]);

    // The same by hand: the partials know what was taken.
    let made = |name, samples| part(&place, name, &["--samples", samples, "--clamp", "0.2"]);
    assert!(made("a.exr", "0..16").status.success() && made("b.exr", "16..32").status.success());
    let merged = merge(&place, &["a.exr", "b.exr"]).json();
    assert_eq!(merged["digest"], limited["digest"]);
    assert_eq!(merged["counters"]["clamped"], limited["counters"]["clamped"]);
}
