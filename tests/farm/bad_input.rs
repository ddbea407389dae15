//! Bad usage and input: one sentence, exit code 2, nothing left behind.

use crate::harness::{Place, Said, coordinator, render, run, serving, worker};

/// Says one sentence, ends with `code`, leaves nothing behind.
fn refused(place: &Place, said: &Said, code: i32, words: &[&str]) {
    assert_eq!(said.status.code(), Some(code), "{}", said.stderr);
    assert!(!said.stderr.contains("panicked"), "{}", said.stderr);
    for word in words {
        assert!(said.stderr.contains(word), "{word:?} is not in {:?}", said.stderr);
    }
    assert_eq!(place.files(), [""; 0], "nothing is left behind");
}

#[test]
fn flags_that_make_no_sense_are_refused_before_anything_starts() {
    let place = Place::new();
    let cases: [(&[&str], &str); 20] = [
        (&["--resolution", "0x10"], "--resolution"),
        (&["--resolution", "99999999x10"], "--resolution"),
        (&["--resolution", "wide"], "960x540"),
        (&["--spp", "0"], "--spp"),
        (&["--spp", "-1"], "--spp"),
        (&["--frames", "9-1"], "9-1"),
        (&["--frames", "1-5x0"], "--frames"),
        (&["--tile", "0"], "--tile"),
        (&["--threads", "0"], "--threads"),
        (&["--fps", "0"], "--fps"),
        (&["--focus-distance", "0"], "--focus-distance"),
        (&["--focus-distance", "-2"], "--focus-distance"),
        (&["--aperture-radius", "-1"], "--aperture-radius"),
        (&["--shutter", "-0.5"], "--shutter"),
        (&["--shutter-position", "end"], "--shutter"),
        (&["--no-local-worker"], "--listen"),
        (&["--filter", "tent"], "--filter"),
        (&["--clamp", "0"], "--clamp"),
        (&["--clamp", "1e39"], "--clamp"),
        (&["--bogus"], "--bogus"),
    ];
    for (flags, word) in cases {
        refused(&place, &run(render(&place, "out.exr", flags)), 2, &[word]);
    }
}

#[test]
fn input_that_is_not_there_or_not_right_is_named() {
    let place = Place::new();
    refused(&place, &run(render(&place, "out.exr", &["--camera", "door"])), 2, &["\"door\"", "\"eye\""]);
    refused(
        &place,
        &run(render(&place, "out.exr", &["--environment", "/no/such.hdr"])),
        2,
        &["/no/such.hdr"],
    );
    refused(
        &place,
        &run(render(&place, "out.exr", &["--environment-intensity", "2"])),
        2,
        &["--environment"],
    );
    refused(&place, &run(render(&place, "out.png", &[])), 2, &["out.png", ".exr"]);
    refused(&place, &run(render(&place, "none/out.exr", &[])), 2, &["none", "does not exist"]);
    let scene = |scene: &str| {
        let mut command = coordinator();
        command.args(["render", scene, "-o"]).arg(place.path("out.exr"));
        run(command)
    };
    refused(&place, &scene("/no/such/scene.glb"), 2, &["/no/such/scene.glb"]);
    refused(&place, &scene("/tmp"), 2, &["/tmp", "folder"]);
    refused(&place, &scene("/dev/null"), 2, &["/dev/null"]);
}

#[test]
fn pictures_that_cannot_be_read_are_named() {
    let place = Place::new();
    let text = tempfile::NamedTempFile::with_suffix(".exr").unwrap();
    std::fs::write(&text, "no picture").unwrap();
    let path = text.path().to_str().unwrap();
    let mut compare = coordinator();
    compare.args(["compare", path, path]);
    refused(&place, &run(compare), 2, &[path]);
    let mut merge = coordinator();
    merge.args(["merge", path, "-o"]).arg(place.path("out.exr"));
    refused(&place, &run(merge), 2, &[path]);
}

#[test]
fn addresses_that_cannot_be_used_are_refused() {
    let place = Place::new();
    let (_holder, address) = serving(&place, &["--resolution", "8x8"]);
    refused(&place, &run(render(&place, "out.exr", &["--listen", &address])), 1, &[&address, "in use"]);
    let open = ["--listen", "0.0.0.0:0", "--insecure"];
    refused(&place, &run(render(&place, "out.exr", &open)), 2, &["0.0.0.0", "--insecure=public"]);
    refused(&place, &run(render(&place, "out.exr", &["--listen", "0.0.0.0:0"])), 2, &["--trust"]);
    let joining = |address: &str| {
        let mut command = worker();
        command.args(["--connect", address, "--retry-for", "0s"]);
        run(command)
    };
    refused(&place, &joining("127.0.0.1:1"), 1, &["no coordinator at 127.0.0.1:1"]);
    refused(&place, &joining("192.0.2.1:7878"), 2, &["192.0.2.1:7878", "--ca-fingerprint"]);
    refused(&place, &joining("no address"), 2, &["no address"]);
    refused(&place, &run(worker()), 2, &["--connect"]);
}
