//! Compiles the .proto files without an external compiler.

use prost::Message;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-changed=farm");
    let files = ["types", "farm", "control", "trust"].map(|name| format!("farm/v1/{name}.proto"));
    let files = protox::compile(files, ["."])?;
    // For tools that ask a running coordinator what it understands.
    let folder = std::env::var("OUT_DIR")?;
    std::fs::write(std::path::Path::new(&folder).join("farm_descriptor.bin"), files.encode_to_vec())?;
    // Payloads are shared, not copied.
    tonic_prost_build::configure().bytes(".").compile_fds(files)?;
    Ok(())
}
