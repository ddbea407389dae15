//! The picture does not depend on the farm.

use crate::harness::{Place, coordinator, joining_with, render, run, serving};
use farm_tests::scenes::{Named, Scale};

/// Many tiles at the edges, several levels of samples, and a last leaf that is not full.
const PICTURE: [&str; 6] = ["--resolution", "100x60", "--spp", "52", "--shutter", "0.5"];

fn alone(place: &Place, flags: &[&str]) -> String {
    let mut command = render(place, "alone.exr", &PICTURE);
    command.args(flags);
    run(command).digest()
}

/// All samples of all pixels as few units as can be.
fn reference(place: &Place) -> String {
    alone(place, &["--tile", "1000", "--threads", "1"])
}

#[test]
fn threads_and_tiles_do_not_show() {
    let place = Place::new();
    let expected = reference(&place);
    for threads in ["1", "2"] {
        for tile in ["16", "64", "1000"] {
            let digest = alone(&place, &["--threads", threads, "--tile", tile]);
            assert_eq!(digest, expected, "{threads} threads, tiles of {tile}");
        }
    }
}

#[test]
fn the_seed_shows() {
    let place = Place::new();
    assert_ne!(reference(&place), alone(&place, &["--seed", "1"]));
}

#[test]
fn the_number_of_workers_does_not_show() {
    let place = Place::new();
    let expected = reference(&place);
    for workers in 1..=3 {
        for (tile, threads) in
            ["16", "64", "1000"].into_iter().zip(["1", "2"].into_iter().cycle().skip(workers))
        {
            let mut flags = PICTURE.to_vec();
            flags.extend(["--tile", tile]);
            let (coordinator, address) = serving(&place, &flags);
            let farm: Vec<_> = (0..workers)
                .map(|index| joining_with(&address, &format!("worker-{index}"), &["--threads", threads]))
                .collect();
            let said = coordinator.wait();
            assert_eq!(said.digest(), expected, "{workers} workers of {threads} threads, tiles of {tile}");
            for worker in farm {
                let said = worker.wait();
                assert!(said.status.success(), "{}", said.stderr);
            }
        }
    }
}

/// No absolute length is hidden anywhere between the file and the picture.
#[test]
fn a_scene_times_a_power_of_two_is_the_same_picture() {
    let place = Place::new();
    let digest = |name: &str, k: i32| {
        let path = place.path("scaled.glb");
        std::fs::write(&path, Named::find(name).unwrap().glb(Scale(k))).unwrap();
        let mut command = coordinator();
        command.arg("render").arg(path).arg("-o").arg(place.path("scaled.exr")).arg("--json");
        command.args(["--resolution", "64x36", "--spp", "4"]);
        run(command).digest()
    };
    for name in ["cornell", "lens-motion", "many-lights", "glass-caustic"] {
        let expected = digest(name, 0);
        for k in [20, -20] {
            assert_eq!(digest(name, k), expected, "{name} times 2^{k}");
        }
    }
}

#[test]
fn frames_of_an_animation_are_numbered_and_differ_only_where_something_moves() {
    let place = Place::new();
    let flags = ["--resolution", "32x20", "--spp", "16", "--frames", "1-5x2", "--preview"];
    let said = run(render(&place, "shot.exr", &flags));
    let json = said.json();
    let frames = json["frames"].as_array().unwrap();
    assert_eq!(frames.iter().map(|frame| frame["frame"].as_u64().unwrap()).collect::<Vec<_>>(), [1, 3, 5]);
    let names = ["0001", "0003", "0005"].map(|n| [format!("shot.{n}.exr"), format!("shot.{n}.png")]);
    assert_eq!(place.files(), names.concat());
}
