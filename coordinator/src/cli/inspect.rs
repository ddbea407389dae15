//! What a scene consists of, and what rendering it uses.

use super::{print, print_json};
use farm_film::FrameIndex;
use farm_scene::{Projection, Scene};
use farm_worker::cli::{Fault, Loaded, PictureArgs};
use farm_worker::renderer::{PreparedScene, Report};
use serde::Serialize;

/// Show what a scene consists of, what rendering it uses, and what is left out
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Examples:
  coordinator inspect scene.glb
  coordinator inspect scene.glb --camera Front --frame 12 --shutter 0.5 --json")]
pub struct InspectArgs {
    #[command(flatten)]
    picture: PictureArgs,
    /// Which frame; its time is N / fps
    #[arg(long, env = "FARM_FRAME", value_name = "N", default_value_t = 0)]
    frame: u32,
    /// Print one JSON object
    #[arg(long, env = "FARM_JSON")]
    json: bool,
}

#[derive(Serialize)]
struct Inspection {
    scene_id: String,
    snapshot_bytes: usize,
    load_s: f64,
    cameras: Vec<CameraLine>,
    animations: Vec<String>,
    nodes: usize,
    meshes: usize,
    materials: usize,
    textures: usize,
    images: usize,
    lights: usize,
    skins: usize,
    channels: usize,
    environment: bool,
    primitives_skipped: u64,
    triangles_degenerate: u64,
    vertices_not_finite: u64,
    files: Vec<String>,
    bytes_read: u64,
    warnings: Vec<String>,
    frame: Report,
}

#[derive(Serialize)]
struct CameraLine {
    name: String,
    projection: &'static str,
    lens: bool,
    shutter_s: f64,
}

/// Reads the scene, prepares the frame, prints what was found.
pub fn run(args: &InspectArgs) -> Result<(), Fault> {
    let loaded = args.picture.load()?;
    let prepared =
        PreparedScene::new(&loaded.scene, &loaded.settings, FrameIndex(args.frame)).map_err(Fault::input)?;
    let inspection = Inspection::new(loaded, prepared.report().clone());
    if args.json { print_json(&inspection) } else { print(&inspection.text()) }
}

impl Inspection {
    fn new(loaded: Loaded, frame: Report) -> Self {
        let scene: &Scene = &loaded.scene;
        Self {
            scene_id: loaded.id.to_string(),
            snapshot_bytes: loaded.snapshot.len(),
            load_s: loaded.load.as_secs_f64(),
            cameras: cameras(scene),
            nodes: scene.nodes.len(),
            meshes: scene.meshes.len(),
            materials: scene.materials.len(),
            textures: scene.textures.len(),
            images: scene.images.len(),
            lights: scene.lights.len(),
            skins: scene.skins.len(),
            channels: scene.channels.len(),
            environment: scene.environment.is_some(),
            animations: loaded.report.animations,
            primitives_skipped: loaded.report.primitives_skipped,
            triangles_degenerate: loaded.report.triangles_degenerate,
            vertices_not_finite: loaded.report.vertices_not_finite,
            files: loaded.report.files,
            bytes_read: loaded.report.bytes_read,
            warnings: loaded.report.warnings,
            frame,
        }
    }

    fn text(&self) -> String {
        let mut lines = vec![
            format!("scene        {} ({} bytes as a snapshot)", self.scene_id, self.snapshot_bytes),
            format!(
                "files        {} ({} bytes), read in {:.2} s",
                self.files.join(", "),
                self.bytes_read,
                self.load_s
            ),
            format!(
                "parts        {} nodes, {} meshes, {} materials, {} textures, {} images, {} lights, {} skins, {} channels",
                self.nodes,
                self.meshes,
                self.materials,
                self.textures,
                self.images,
                self.lights,
                self.skins,
                self.channels
            ),
        ];
        for camera in &self.cameras {
            let lens = if camera.lens { ", lens" } else { "" };
            let shutter = if camera.shutter_s > 0.0 {
                format!(", shutter {} s", camera.shutter_s)
            } else {
                String::new()
            };
            lines.push(format!("camera       {:?} ({}{lens}{shutter})", camera.name, camera.projection));
        }
        lines.extend(self.animations.iter().map(|name| format!("animation    {name:?}")));
        let frame = &self.frame;
        lines.push(format!(
            "triangles    {} drawn, {} stored, {} instances, {} bytes of acceleration structure",
            frame.triangles, frame.triangles_stored, frame.instances, frame.accel_bytes
        ));
        lines.push(format!(
            "dropped      {} triangles not finite, {} without area, {} instances ({} are flattened), {} primitives of points and lines",
            frame.dropped_not_finite,
            frame.dropped_no_area,
            frame.dropped_instances,
            frame.flattened_instances,
            self.primitives_skipped
        ));
        let used: Vec<_> = frame.used().map(|usage| format!("{} ({})", usage.feature, usage.count)).collect();
        lines.push(format!("used         {}", used.join(", ")));
        lines.push(format!("left out     {}", frame.left_out().collect::<Vec<_>>().join(", ")));
        lines.extend(self.warnings.iter().map(|warning| format!("warning      {warning}")));
        lines.join("\n")
    }
}

fn cameras(scene: &Scene) -> Vec<CameraLine> {
    let line = |camera: &farm_scene::Camera| CameraLine {
        name: camera.name.clone(),
        projection: match camera.projection {
            Projection::Perspective { .. } => "perspective",
            Projection::Orthographic { .. } => "orthographic",
        },
        lens: camera.lens.is_some(),
        shutter_s: camera.shutter.close - camera.shutter.open,
    };
    scene.cameras.iter().map(line).collect()
}
