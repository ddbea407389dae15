//! Compiles the .proto files without an external compiler.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-changed=farm");
    let files =
        protox::compile(["farm/v1/types.proto", "farm/v1/farm.proto", "farm/v1/control.proto"], ["."])?;
    // Payloads are shared, not copied.
    tonic_prost_build::configure().bytes(".").compile_fds(files)?;
    Ok(())
}
