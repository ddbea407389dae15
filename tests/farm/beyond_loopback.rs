//! One job from the command line, with workers of other hosts: closed like a coordinator that serves.

use crate::harness::{Place, Running, Said, coordinator, joining, render, run, worker};
use farm_proto::v1::farm_client::FarmClient;

const SMALL: [&str; 6] = ["--resolution", "48x32", "--spp", "64", "--tile", "16"];

/// Renders for workers only, listening on all addresses of this host.
fn open_to_all_addresses(place: &Place, flags: &[&str]) -> std::process::Command {
    let mut command = render(place, "out.exr", &["--listen", "0.0.0.0:0", "--no-local-worker"]);
    command.args(SMALL).args(flags).arg("--trust").arg(place.path("trust"));
    command
}

/// Where others of this host reach it.
fn address(running: &mut Running) -> String {
    let port = running.wait_for("an address", |said| {
        said.lines().find_map(|line| line.strip_prefix("listening on 0.0.0.0:").map(str::to_owned))
    });
    format!("127.0.0.1:{port}")
}

fn alone(place: &Place) -> String {
    run(render(place, "alone.exr", &SMALL)).digest()
}

#[test]
fn a_render_on_all_addresses_is_joined_with_a_token() {
    let place = Place::new();
    let mut rendering = Running::start(open_to_all_addresses(&place, &[]));
    let address = address(&mut rendering);
    rendering.wait_for("the way in", |said| said.contains("coordinator token create").then_some(()));
    // In the open nobody is answered.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let spoken = runtime.block_on(async {
        let mut client =
            FarmClient::connect(format!("http://{address}")).await.map_err(|err| err.to_string())?;
        client.work(tokio_stream::empty()).await.map(drop).map_err(|status| status.to_string())
    });
    assert!(spoken.is_err());
    rendering.wait_for("a refusal", |said| said.contains("no handshake").then_some(()));
    let mut create = coordinator();
    create.args(["token", "create", "--role", "worker", "--json", "--trust"]).arg(place.path("trust"));
    let token = run(create).json();
    let mut command = worker();
    command.args(["--connect", &address, "--threads", "1", "--identity"]).arg(place.path("friend.pem"));
    command.args(["--ca-fingerprint", token["ca_fingerprint"].as_str().unwrap()]);
    command.env("FARM_TOKEN", token["token"].as_str().unwrap());
    let friend = Running::start(command);
    assert_eq!(rendering.wait().digest(), alone(&place));
    let said: Said = friend.wait();
    assert!(said.status.success() && said.stderr.contains("joined the farm"), "{}", said.stderr);
}

#[test]
fn a_render_is_open_to_everybody_only_when_that_is_spelled_out() {
    let place = Place::new();
    let said = run(open_to_all_addresses(&place, &["--insecure"]));
    assert_eq!(said.status.code(), Some(2));
    assert!(said.stderr.contains("--insecure=public"), "{}", said.stderr);
    let mut rendering = Running::start(open_to_all_addresses(&place, &["--insecure=public"]));
    let address = address(&mut rendering);
    let _anyone = joining(&address, "anyone");
    let said = rendering.wait();
    assert!(said.stderr.contains("warning: INSECURE"), "{}", said.stderr);
    assert_eq!(said.digest(), alone(&place));
}
