//! Files of the world: each becomes a scene, or is refused by the name of what it requires.

use farm_import::{ImportOptions, Imported, import};
use farm_scene::Transform;
use std::path::{Path, PathBuf};

/// The folder with scenes: `$TESSERA_DATA`, or `shared/data` beside the project; none when it is not there.
fn data() -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let folder = std::env::var_os("TESSERA_DATA").map_or_else(beside, PathBuf::from);
    let found = folder.join("scenes").is_dir();
    if !found {
        println!("SKIPPED: there are no scenes in {}; set TESSERA_DATA", folder.display());
    }
    found.then_some(folder)
}

/// The scene at `path` below `scenes`; none when there are no scenes.
fn scene(path: &str) -> Option<Imported> {
    let file = data()?.join("scenes").join(path);
    Some(import(&file, &ImportOptions::default()).unwrap_or_else(|err| panic!("{err}")))
}

#[test]
fn every_scene_is_imported_or_refused_by_the_name_of_its_extension() {
    let Some(data) = data() else { return };
    let refused = [
        ("AnisotropyBarnLamp-KTX2", "KHR_texture_basisu"),
        ("Box-Draco", "KHR_draco_mesh_compression"),
        ("BoxMeshopt", "EXT_meshopt_compression"),
        ("CarbonSphere-Draco", "KHR_draco_mesh_compression"),
        ("ClearCoatCarPaint", "KHR_materials_clearcoat"),
        ("IridescenceSuzanne", "KHR_materials_iridescence"),
        ("JapaneseBridgeGarden", "EXT_meshopt_compression"),
        ("JetFighter-KTX2-Draco", "KHR_draco_mesh_compression, KHR_texture_basisu"),
    ];
    let mut count = 0;
    for folder in
        std::fs::read_dir(data.join("scenes")).expect("a folder").map(|entry| entry.expect("an entry").path())
    {
        let name = folder.file_name().expect("a name").to_string_lossy().into_owned();
        for file in std::fs::read_dir(&folder).expect("a folder").map(|entry| entry.expect("an entry").path())
        {
            if !file.extension().is_some_and(|extension| extension == "gltf" || extension == "glb") {
                continue;
            }
            count += 1;
            let started = std::time::Instant::now();
            let outcome = import(&file, &ImportOptions::default());
            println!("{name}: {:?} {:?}", started.elapsed(), outcome.as_ref().map(|it| &it.report));
            match refused.iter().find(|(refused, _)| *refused == name) {
                Some((_, extension)) => {
                    let error = outcome.err().unwrap_or_else(|| panic!("{name} must be refused")).to_string();
                    assert!(error.contains(extension), "{error}");
                }
                None => assert!(
                    outcome.unwrap_or_else(|err| panic!("{err}")).report.triangles_drawn > 0,
                    "{name}"
                ),
            }
        }
    }
    assert!(count >= 36, "{count} files");
}

#[test]
fn counts_cameras_and_lights_are_those_of_the_files() {
    for (path, triangles, stored) in [
        ("Box/Box.glb", 12, 12),
        ("Box/Box.gltf", 12, 12),
        ("CornellBox/CornellBox.glb", 36, 36),
        ("ToyCar/ToyCar.gltf", 108_936, 108_936),
        ("WaterBottle/WaterBottle.gltf", 4_510, 4_510),
        ("MeshPrimitiveModes/MeshPrimitiveModes.gltf", 16, 16),
        ("BoxAnimated/BoxAnimated.glb", 254, 254),
        ("SimpleInstancing/SimpleInstancing.glb", 12 * 125, 12),
        ("AnisotropyStrengthTest/AnisotropyStrengthTest.glb", 97_240, 2_008),
    ] {
        let Some(imported) = scene(path) else { return };
        assert_eq!(
            (imported.report.triangles_drawn, imported.report.triangles_stored),
            (triangles, stored),
            "{path}"
        );
        assert_eq!(imported.report.vertices_not_finite, 0, "{path}");
    }
    let names = |path: &str| {
        scene(path).map(|it| it.scene.cameras.iter().map(|camera| camera.name.clone()).collect::<Vec<_>>())
    };
    let toy_car: Vec<String> = (1..=8).map(|number| format!("Camera00{number}")).collect();
    assert_eq!(names("ToyCar/ToyCar.gltf"), Some(toy_car));
    assert_eq!(names("Cameras/Cameras.gltf"), Some(vec!["camera 0".to_owned(), "camera 1".to_owned()]));
    assert_eq!(names("Box/Box.glb"), Some(vec!["framing".to_owned()]));
}

#[test]
fn the_cornell_box_is_lit_by_its_emitter_and_looked_into() {
    let Some(imported) = scene("CornellBox/CornellBox.glb") else { return };
    let emitters: Vec<_> = imported.scene.materials.iter().filter_map(|material| material.emission).collect();
    assert_eq!(emitters.len(), 1);
    assert_eq!(emitters[0].radiance.factor, glam::Vec3::splat(100.0));
    assert!(imported.scene.meshes.iter().all(|mesh| mesh.uvs.is_empty() && mesh.tangents.is_none()));
    let camera = &imported.scene.nodes[imported.scene.cameras[0].node as usize];
    let Transform::Trs { translation, .. } = camera.transform else { panic!("a framing camera has a place") };
    assert!(
        translation.z > 300.0 && (translation.x + 278.0).abs() < 50.0,
        "in front of the open side: {translation}"
    );
}

#[test]
fn meshes_that_share_accessors_share_memory() {
    let Some(imported) = scene("MetalRoughSpheresNoTextures/MetalRoughSpheresNoTextures.glb") else { return };
    assert_eq!(imported.report.triangles_drawn, 1_040_409);
    assert!(imported.report.triangles_stored < 13_000, "{}", imported.report.triangles_stored);
    let drawn: usize = imported.scene.nodes.iter().map(|node| node.instances.len()).sum();
    assert!(drawn > 98 && imported.scene.meshes.len() < 30, "{drawn} of {}", imported.scene.meshes.len());
    assert_eq!(imported.scene.materials.len(), 98 + 1, "and the default of the letters");
}

#[test]
fn the_fox_has_a_skin_and_three_animations() {
    let Some(imported) = scene("Fox/Fox.glb") else { return };
    assert_eq!(imported.report.animations, ["Survey", "Walk", "Run"]);
    assert!(
        imported
            .report
            .warnings
            .iter()
            .any(|warning| warning.contains("Survey") && warning.contains("Walk, Run"))
    );
    assert_eq!(imported.scene.skins.len(), 1);
    assert_eq!(imported.scene.skins[0].joints.len(), 24);
    assert!(imported.scene.nodes.iter().any(|node| node.skin == Some(0)));
    assert!(imported.scene.meshes[0].skinning.is_some());
    let run = ImportOptions { animation: Some("Run".to_owned()) };
    let file = data().expect("found before").join("scenes/Fox/Fox.glb");
    let run = import(&file, &run).expect("an animation it has");
    assert!(run.scene.channels != imported.scene.channels && !run.scene.channels.is_empty());
    let fly = ImportOptions { animation: Some("Fly".to_owned()) };
    let error = import(&file, &fly).expect_err("it cannot fly").to_string();
    assert!(error.contains("\"Fly\"") && error.contains("Survey, Walk, Run"), "{error}");
}

#[test]
fn texture_transforms_are_those_of_the_file() {
    let Some(imported) = scene("TextureTransformTest/TextureTransformTest.gltf") else { return };
    let of = |name: &str| {
        let material = imported.scene.materials.iter().find(|material| material.name == name);
        let texture = material.and_then(|material| material.base_color.texture);
        texture.unwrap_or_else(|| panic!("no texture of {name}"))
    };
    assert_eq!(of("Offset U").offset, glam::Vec2::new(0.5, 0.0));
    assert_eq!(of("Offset V").offset, glam::Vec2::new(0.0, 0.5));
    assert!(of("Scale").matrix.abs_diff_eq(glam::Mat2::from_diagonal(glam::Vec2::splat(1.5)), 0.0));
    // Counter-clockwise as seen: with v downwards, u turns towards -v.
    let angle = std::f32::consts::FRAC_PI_8;
    let turned = glam::Mat2::from_cols_array(&[angle.cos(), -angle.sin(), angle.sin(), angle.cos()]);
    assert!(of("Rotation").matrix.abs_diff_eq(turned, 1e-4), "{:?}", of("Rotation"));
}

#[test]
fn malformed_files_are_refused_with_file_and_place() {
    let Some(data) = data() else { return };
    for (name, expected) in [
        ("integer-out-of-bounds.gltf", "bufferViews[0].byteLength"),
        ("invalid-buffer-index.gltf", "bufferView 1: refers to buffer 1"),
        ("invalid-buffer-view-index.gltf", "bufferView 0: refers to buffer 0"),
        ("invalid-primitive-indices.gltf", "bufferView"),
    ] {
        let error =
            import(&data.join("invalid").join(name), &ImportOptions::default()).expect_err(name).to_string();
        assert!(error.contains(name) && error.contains(expected), "{error}");
    }
    let valid =
        import(&data.join("invalid/zero-sized-bin-chunk.glb"), &ImportOptions::default()).expect("valid");
    assert_eq!(valid.report.triangles_drawn, 1);
}
