//! Writes the project's own scenes: `scenes [--out DIR] [--scale K] [--text] [names]`.

use clap::Parser;
use farm_tests::scenes::{Named, SCENES, Scale};
use std::path::PathBuf;

/// Writes the project's own scenes as GLB.
#[derive(Parser)]
struct Arguments {
    /// Directory to write to; made if it is not there.
    #[arg(long, default_value = "target/scenes")]
    out: PathBuf,
    /// Multiplies every length by 2^K.
    #[arg(long, default_value_t = 0, allow_negative_numbers = true, value_parser = clap::value_parser!(i32).range(-100..=100))]
    scale: i32,
    /// Writes glTF text with its buffer inside instead of GLB.
    #[arg(long)]
    text: bool,
    /// Lists the scenes instead of writing them.
    #[arg(long)]
    list: bool,
    /// Which ones; all without a name.
    #[arg(value_parser = parse_scene)]
    names: Vec<Named>,
}

fn parse_scene(name: &str) -> Result<Named, String> {
    Named::find(name).ok_or_else(|| {
        let known: Vec<_> = SCENES.iter().map(|scene| scene.name).collect();
        format!("no such scene; there are {}", known.join(", "))
    })
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments = Arguments::parse();
    let scenes = if arguments.names.is_empty() { SCENES.to_vec() } else { arguments.names };
    if arguments.list {
        for scene in scenes {
            println!("{:<20} {}", scene.name, scene.about);
        }
        return Ok(());
    }
    std::fs::create_dir_all(&arguments.out)?;
    for scene in scenes {
        let scale = Scale(arguments.scale);
        let (ending, bytes) =
            if arguments.text { ("gltf", scene.text(scale).into_bytes()) } else { ("glb", scene.glb(scale)) };
        let path = arguments.out.join(format!("{}.{ending}", scene.name));
        farm_image::write_file(&path, &bytes)?;
        println!("{}", path.display());
        if let Some((name, bytes)) = scene.companion() {
            farm_image::write_file(&arguments.out.join(name), &bytes)?;
        }
    }
    Ok(())
}
