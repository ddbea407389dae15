//! Small documents, written by hand, for what sample files seldom do.

use base64::Engine;
use farm_import::{ImportOptions, Imported, import};
use farm_scene::{Interpolation, Path as ChannelPath, Pixels, Surface, Transform, Wrap};
use glam::{DQuat, DVec3, Mat2, Vec2, Vec3, Vec4};
use std::time::{Duration, Instant};

/// Imports a document that lies alone in a folder.
fn import_text(json: &str) -> Result<Imported, String> {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("scene.gltf");
    std::fs::write(&file, json).expect("a file");
    import(&file, &ImportOptions::default()).map_err(|err| err.to_string())
}

fn imported(json: &str) -> Imported {
    import_text(json).unwrap_or_else(|err| panic!("{err}\n{json}"))
}

fn data_uri(bytes: &[u8]) -> String {
    format!(
        "data:application/octet-stream;base64,{}",
        base64::engine::general_purpose::STANDARD.encode(bytes)
    )
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// A document that grows: each piece of data becomes a buffer, a view and an accessor of its own.
#[derive(Default)]
struct Writer {
    buffers: Vec<String>,
    views: Vec<String>,
    accessors: Vec<String>,
}

impl Writer {
    fn view(&mut self, bytes: &[u8], more: &str) -> usize {
        self.buffers.push(format!(r#"{{"byteLength": {}, "uri": "{}"}}"#, bytes.len(), data_uri(bytes)));
        let buffer = self.buffers.len() - 1;
        self.views.push(format!(r#"{{"buffer": {buffer}, "byteLength": {} {more}}}"#, bytes.len()));
        buffer
    }

    /// `layout` is the rest of the accessor: component type, type, count.
    fn accessor(&mut self, bytes: &[u8], layout: &str) -> usize {
        let view = self.view(bytes, "");
        self.accessors.push(format!(r#"{{"bufferView": {view}, {layout}}}"#));
        self.accessors.len() - 1
    }

    fn vec3(&mut self, values: &[f32]) -> usize {
        let layout = format!(r#""componentType": 5126, "type": "VEC3", "count": {}"#, values.len() / 3);
        self.accessor(&floats(values), &layout)
    }

    fn scalars(&mut self, values: &[f32]) -> usize {
        let layout = format!(r#""componentType": 5126, "type": "SCALAR", "count": {}"#, values.len());
        self.accessor(&floats(values), &layout)
    }

    fn document(&self, rest: &str) -> String {
        format!(
            r#"{{"asset": {{"version": "2.0"}}, "buffers": [{}], "bufferViews": [{}], "accessors": [{}], {rest}}}"#,
            self.buffers.join(", "),
            self.views.join(", "),
            self.accessors.join(", ")
        )
    }

    /// One node with one mesh of one primitive.
    fn single(&self, primitive: &str) -> String {
        self.document(&format!(
            r#""scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}], "meshes": [{{"primitives": [{{{primitive}}}]}}]"#
        ))
    }
}

const TRIANGLE: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];

#[test]
fn indices_of_all_widths_give_the_same_mesh() {
    let mut meshes = vec![];
    for (component, bytes) in [
        (5121, vec![2_u8, 1, 0]),
        (5123, [2_u16, 1, 0].iter().flat_map(|index| index.to_le_bytes()).collect()),
        (5125, [2_u32, 1, 0].iter().flat_map(|index| index.to_le_bytes()).collect()),
    ] {
        let mut writer = Writer::default();
        writer.vec3(&TRIANGLE);
        writer.accessor(&bytes, &format!(r#""componentType": {component}, "type": "SCALAR", "count": 3"#));
        let scene = imported(&writer.single(r#""attributes": {"POSITION": 0}, "indices": 1"#)).scene;
        assert_eq!(scene.meshes[0].triangles, [[2, 1, 0]]);
        meshes.push(scene.meshes[0].clone());
    }
    assert!(meshes.windows(2).all(|pair| pair[0] == pair[1]));
}

#[test]
fn interleaved_attributes_are_taken_apart() {
    let mut vertices = vec![];
    for corner in TRIANGLE.chunks_exact(3) {
        vertices.extend(floats(corner));
        vertices.extend([255, 0, 51, 7]);
    }
    let mut writer = Writer::default();
    let view = writer.view(&vertices, r#", "byteStride": 16"#);
    writer.accessors = vec![
        format!(r#"{{"bufferView": {view}, "componentType": 5126, "type": "VEC3", "count": 3}}"#),
        format!(
            r#"{{"bufferView": {view}, "byteOffset": 12, "componentType": 5121, "type": "VEC3", "count": 3}}"#
        ),
    ];
    let mesh =
        imported(&writer.single(r#""attributes": {"POSITION": 0, "COLOR_0": 1}"#)).scene.meshes.remove(0);
    assert_eq!(mesh.positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
    assert_eq!(mesh.colors, Some(vec![Vec4::new(1.0, 0.0, 0.2, 1.0); 3]));
    assert_eq!((mesh.normals, mesh.uvs.len()), (None, 0));
}

#[test]
fn sparse_accessors_replace_elements_of_what_may_not_be_there() {
    let sparse = |indices: [u16; 2]| {
        let mut writer = Writer::default();
        let values = writer.view(&floats(&TRIANGLE[3..]), "");
        let bytes: Vec<u8> = indices.iter().flat_map(|index| index.to_le_bytes()).collect();
        let at = writer.view(&bytes, "");
        writer.accessors = vec![format!(
            r#"{{"componentType": 5126, "type": "VEC3", "count": 3, "sparse": {{"count": 2,
            "indices": {{"bufferView": {at}, "componentType": 5123}}, "values": {{"bufferView": {values}}}}}}}"#
        )];
        import_text(&writer.single(r#""attributes": {"POSITION": 0}"#))
    };
    assert_eq!(sparse([1, 2]).expect("valid").scene.meshes[0].positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
    for wrong in [[2, 1], [1, 1], [1, 3]] {
        let error = sparse(wrong).expect_err("indices must increase and exist");
        assert!(
            error.contains("node 0 / mesh 0")
                || error.contains("mesh 0 / primitive 0 / POSITION / accessor 0 / sparse"),
            "{error}"
        );
    }
}

#[test]
fn quantized_attributes_keep_their_meaning() {
    let mut writer = Writer::default();
    let shorts: Vec<u8> =
        [0_i16, 0, 0, 0, 100, 0, 0, 0, 0, -100, 0, 0].iter().flat_map(|it| it.to_le_bytes()).collect();
    let view = writer.view(&shorts, r#", "byteStride": 8"#);
    let normals = writer.view(&[0, 0, 127, 0, 0, 0, 129, 0, 0, 0, 128, 0], r#", "byteStride": 4"#);
    writer.accessors = vec![
        format!(r#"{{"bufferView": {view}, "componentType": 5122, "type": "VEC3", "count": 3}}"#),
        format!(
            r#"{{"bufferView": {normals}, "componentType": 5120, "normalized": true, "type": "VEC3", "count": 3}}"#
        ),
    ];
    let mesh =
        imported(&writer.single(r#""attributes": {"POSITION": 0, "NORMAL": 1}"#)).scene.meshes.remove(0);
    assert_eq!(mesh.positions, [Vec3::ZERO, Vec3::new(100.0, 0.0, 0.0), Vec3::new(0.0, -100.0, 0.0)]);
    assert_eq!(mesh.normals, Some(vec![Vec3::Z, -Vec3::Z, -Vec3::Z]));
}

#[test]
fn a_primitive_pays_only_for_the_vertices_it_uses() {
    let mut writer = Writer::default();
    let many: Vec<f32> = (0..30_000).map(|value| value as f32).collect();
    writer.vec3(&many);
    writer.accessor(&[9, 5, 7], r#""componentType": 5121, "type": "SCALAR", "count": 3"#);
    let mesh =
        imported(&writer.single(r#""attributes": {"POSITION": 0}, "indices": 1"#)).scene.meshes.remove(0);
    assert_eq!(mesh.triangles, [[2, 0, 1]]);
    assert_eq!(mesh.positions, [15.0, 21.0, 27.0].map(|x| Vec3::new(x, x + 1.0, x + 2.0)));
}

#[test]
fn normals_of_no_length_are_replaced_by_the_surface() {
    let mut writer = Writer::default();
    writer.vec3(&TRIANGLE);
    writer.vec3(&[0.0, 0.0, 0.0, f32::NAN, 0.0, 0.0, 0.0, 2.0, 0.0]);
    let mesh =
        imported(&writer.single(r#""attributes": {"POSITION": 0, "NORMAL": 1}"#)).scene.meshes.remove(0);
    assert_eq!(mesh.normals, Some(vec![Vec3::Z, Vec3::Z, Vec3::Y]));
}

#[test]
fn odd_vertices_are_let_through_and_counted() {
    let mut writer = Writer::default();
    let mut positions = TRIANGLE.to_vec();
    positions.extend([f32::NAN, 0.0, 0.0, 1.0, f32::INFINITY, 0.0, 0.0, 1.0, 0.0]);
    positions.extend([2.0; 9]);
    writer.vec3(&positions);
    let report = imported(&writer.single(r#""attributes": {"POSITION": 0}"#)).report;
    assert_eq!((report.triangles_stored, report.triangles_degenerate, report.vertices_not_finite), (3, 1, 2));
}

/// A square with two sets of texture coordinates, and a white image.
fn textured(material: &str) -> Imported {
    let mut writer = Writer::default();
    writer.vec3(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
    let uv = r#""componentType": 5126, "type": "VEC2", "count": 3"#;
    writer.accessor(&floats(&[0.0, 1.0, 1.0, 1.0, 0.0, 0.0]), uv);
    writer.accessor(&floats(&[0.5; 6]), uv);
    let image =
        image::ImageBuffer::<image::Luma<u16>, _>::from_raw(1, 2, vec![1000_u16, 65535]).expect("two pixels");
    let mut png = std::io::Cursor::new(vec![]);
    image.write_to(&mut png, image::ImageFormat::Png).expect("a picture");
    let rest = format!(
        r#""scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0, "TEXCOORD_0": 1, "TEXCOORD_1": 2}}, "material": 0}}]}}],
        "images": [{{"uri": "{}"}}], "samplers": [{{"wrapS": 33071, "wrapT": 33648, "magFilter": 9728}}],
        "textures": [{{"source": 0}}, {{"source": 0, "sampler": 0}}], "materials": [{{{material}}}]"#,
        data_uri(png.get_ref())
    );
    imported(&writer.document(&rest))
}

#[test]
fn a_texture_used_as_colour_and_as_data_shares_its_image() {
    let scene = textured(
        r#""pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 0}},
        "emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 1}"#,
    )
    .scene;
    assert_eq!(scene.images.len(), 1);
    assert_eq!(scene.images[0].pixels, Pixels::Unorm16 { channels: 1, data: vec![1000, 65535] });
    let lookups: Vec<(bool, Wrap, Wrap)> =
        scene.textures.iter().map(|it| (it.srgb, it.wrap_u, it.wrap_v)).collect();
    let (repeat, clamp, mirrored) = (Wrap::Repeat, Wrap::ClampToEdge, Wrap::MirroredRepeat);
    assert_eq!(lookups, [(true, repeat, repeat), (false, repeat, repeat), (true, clamp, mirrored)]);
}

#[test]
fn only_texture_coordinates_that_a_material_uses_are_kept() {
    let plain = textured(r#""name": "plain""#).scene;
    assert!(plain.meshes[0].uvs.is_empty() && plain.images.is_empty());
    let second =
        textured(r#""pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 1}}"#).scene;
    assert_eq!(second.meshes[0].uvs, [vec![Vec2::splat(0.5); 3]]);
    assert_eq!(second.materials[0].base_color.texture.map(|texture| texture.uv_set), Some(0));
    assert!(second.meshes[0].tangents.is_none());
}

#[test]
fn a_normal_map_without_tangents_gets_them() {
    let scene = textured(
        r#""normalTexture": {"index": 0, "scale": 0.5,
        "extensions": {"KHR_texture_transform": {"scale": [2, 3], "offset": [0.25, 0]}}}"#,
    )
    .scene;
    assert_eq!(scene.meshes[0].tangents, Some(vec![Vec4::new(1.0, 0.0, 0.0, 1.0); 3]));
    let normal_map = scene.materials[0].normal_map.expect("a normal map");
    assert_eq!((normal_map.scale, normal_map.texture.offset), (0.5, Vec2::new(0.25, 0.0)));
    assert_eq!(normal_map.texture.matrix, Mat2::from_diagonal(Vec2::new(2.0, 3.0)));
}

#[test]
fn places_may_mirror_and_shear() {
    let scene = imported(
        r#"{"asset": {"version": "2.0"}, "scene": 1, "scenes": [{"nodes": [2]}, {"nodes": [0]}],
        "nodes": [{"children": [1], "scale": [-1, 2, 1e-30], "rotation": [0, 0, 2, 0]},
        {"matrix": [1, 0, 0, 0, 0.5, 1, 0, 0, 0, 0, 1, 0, 3, 4, 5, 1]}, {"name": "of another scene"}]}"#,
    )
    .scene;
    assert_eq!(scene.nodes.len(), 3, "two of the default scene, and that of the framing camera");
    let mirrored = Transform::Trs {
        translation: DVec3::ZERO,
        rotation: DQuat::from_xyzw(0.0, 0.0, 1.0, 0.0),
        scale: DVec3::new(-1.0, 2.0, 1e-30),
    };
    assert_eq!((scene.nodes[0].transform, scene.nodes[1].parent), (mirrored, Some(0)));
    assert!(
        matches!(scene.nodes[1].transform, Transform::Matrix(matrix) if matrix.y_axis.x == 0.5 && matrix.w_axis.z == 5.0)
    );
}

#[test]
fn joints_outside_the_scene_come_along_with_what_is_above_them() {
    let mut writer = Writer::default();
    writer.vec3(&TRIANGLE);
    writer.accessor(
        &[1, 9, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0],
        r#""componentType": 5121, "type": "VEC4", "count": 3"#,
    );
    let weights = [3.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    writer.accessor(&floats(&weights), r#""componentType": 5126, "type": "VEC4", "count": 3"#);
    let scene = imported(&writer.document(
        r#""scenes": [{"nodes": [3]}], "nodes": [{"children": [1], "translation": [1, 0, 0]}, {"children": [2]},
        {"name": "tip", "mesh": 0}, {"mesh": 0, "skin": 0}], "skins": [{"joints": [1, 2]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}}]}]"#,
    ))
    .scene;
    let skin = &scene.skins[0];
    let tip = &scene.nodes[skin.joints[1] as usize];
    assert!(tip.name == "tip" && tip.instances.is_empty(), "its mesh is not part of the scene");
    let above = tip.parent.and_then(|parent| scene.nodes[parent as usize].parent).expect("a grandparent");
    assert!(matches!(scene.nodes[above as usize].transform, Transform::Trs { translation: DVec3::X, .. }));
    let skinning = scene.meshes[0].skinning.as_ref().expect("a skin uses it");
    assert_eq!(skinning.weights, [1.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
    assert_eq!(skinning.joints, [1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0], "a joint of no weight need not exist");
}

#[test]
fn all_interpolations_and_paths_are_read() {
    let mut writer = Writer::default();
    writer.vec3(&TRIANGLE);
    let times = writer.scalars(&[0.0, 1.0]);
    let steps = writer.vec3(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    let spline: Vec<f32> =
        [[0.0, 0.0, 0.0, 9.0], [0.0, 0.0, 0.0, 2.0], [0.0, 0.0, 0.0, 8.0]].concat().repeat(2);
    let spline = writer.accessor(&floats(&spline), r#""componentType": 5126, "type": "VEC4", "count": 6"#);
    let weights = writer.accessor(
        &[0, 255, 51, 0],
        r#""componentType": 5121, "type": "SCALAR", "count": 4, "normalized": true"#,
    );
    let scene = imported(&writer.document(&format!(
        r#""scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}, "targets": [{{"POSITION": 0}}, {{}}]}}]}}],
        "animations": [{{"samplers": [{{"input": {times}, "output": {steps}, "interpolation": "STEP"}},
        {{"input": {times}, "output": {spline}, "interpolation": "CUBICSPLINE"}}, {{"input": {times}, "output": {weights}}}],
        "channels": [{{"sampler": 0, "target": {{"node": 0, "path": "translation"}}}},
        {{"sampler": 1, "target": {{"node": 0, "path": "rotation"}}}},
        {{"sampler": 2, "target": {{"node": 0, "path": "weights"}}}}]}}]"#
    )))
    .scene;
    let kinds: Vec<Interpolation> = scene.channels.iter().map(|channel| channel.interpolation).collect();
    assert_eq!(kinds, [Interpolation::Step, Interpolation::CubicSpline, Interpolation::Linear]);
    let ChannelPath::Rotation(rotations) = &scene.channels[1].path else { panic!("a rotation") };
    assert_eq!(
        [rotations[0].w, rotations[1].w, rotations[2].w],
        [9.0, 1.0, 8.0],
        "values are unit, tangents as they are"
    );
    let weights = ChannelPath::MorphWeights { targets: 2, values: vec![0.0, 1.0, 0.2, 0.0] };
    assert_eq!(scene.channels[2].path, weights);
    assert_eq!((scene.nodes[0].morph_weights.len(), scene.meshes[0].morph_targets.len()), (2, 2));
}

#[test]
fn morph_targets_that_nothing_moves_are_left_out() {
    let mut writer = Writer::default();
    writer.vec3(&TRIANGLE);
    let primitive = r#""attributes": {"POSITION": 0}, "targets": [{"POSITION": 0}]"#;
    let scene = imported(&writer.single(primitive)).scene;
    assert!(scene.meshes[0].morph_targets.is_empty() && scene.nodes[0].morph_weights.is_empty());
}

#[test]
fn extras_are_read_and_their_faults_name_the_node() {
    let scene = imported(
        r#"{"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}],
        "nodes": [{"extras": {"motionVector": [1, 2, 3], "other": {}}}]}"#,
    )
    .scene;
    assert_eq!(scene.nodes[0].motion_vector, Some(Vec3::new(1.0, 2.0, 3.0)));
    let error = import_text(
        r#"{"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "ball", "extras": {"motionVector": [1, 2]}}]}"#,
    )
    .expect_err("two of three");
    assert!(
        error.ends_with("scene.gltf: node 0 \"ball\" / extras.motionVector: must be an array of 3 numbers"),
        "{error}"
    );
    let mirror =
        textured(r#""extras": {"mirror": {"reflectance": [0.9, 0.8, 0.7], "roughness": 0.1}}"#).scene;
    let Surface::Mirror(mirror) = mirror.materials[0].surface else { panic!("a mirror") };
    assert_eq!(
        (mirror.reflectance, mirror.roughness, mirror.centered),
        (Vec3::new(0.9, 0.8, 0.7), 0.1, true)
    );
}

#[test]
fn the_environment_is_read_beside_the_scene() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut sky = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n".to_vec();
    sky.extend([128, 64, 32, 129]);
    std::fs::write(folder.path().join("sky.hdr"), sky).expect("a file");
    std::fs::write(folder.path().join("sky.exr"), b"\x76\x2f\x31\x01").expect("a file");
    let file = folder.path().join("scene.gltf");
    let read = |environment: &str| {
        let json = format!(
            r#"{{"asset": {{"version": "2.0"}}, "scenes": [{{"extras": {{"environment": {environment}}}}}]}}"#
        );
        std::fs::write(&file, json).expect("a file");
        import(&file, &ImportOptions::default()).map_err(|err| err.to_string())
    };
    let loaded =
        read(r#"{"uri": "sky.hdr", "intensity": 2, "rotation": 1.5707963, "visibleToCamera": false}"#)
            .expect("valid");
    assert_eq!(loaded.report.files, ["scene.gltf", "sky.hdr"]);
    let environment = loaded.scene.environment.expect("an environment");
    assert_eq!(environment.image.pixels, Pixels::Float(vec![[1.0, 0.5, 0.25]]));
    assert_eq!((environment.intensity, environment.visible_to_camera), (2.0, false));
    assert!((environment.rotation * Vec3::X).abs_diff_eq(-Vec3::Z, 1e-6), "counter-clockwise about +Y");
    let exr = read(r#"{"uri": "sky.exr"}"#).expect("valid").exr_environment.expect("to be decoded");
    assert!(exr.path.ends_with("sky.exr") && exr.intensity == 1.0 && exr.visible_to_camera);
    for (environment, expected) in [
        (r#"{"uri": "../sky.hdr"}"#, "extras.environment"),
        (r#"{"uri": "none.hdr"}"#, "none.hdr"),
        (r#"{"uri": "scene.gltf"}"#, "Radiance"),
        (r#"{"uri": "sky.hdr", "intensity": -1}"#, "extras.environment / intensity"),
        (r#"{}"#, "no uri"),
    ] {
        let error = read(environment).expect_err(environment);
        assert!(error.contains("scene 0") && error.contains(expected), "{error}");
    }
}

#[test]
fn data_that_lies_about_its_size_is_refused_at_once() {
    let accessor = |layout: &str, view: &str| {
        format!(
            r#"{{"asset": {{"version": "2.0"}}, "scenes": [{{"nodes": [0]}}], "nodes": [{{"name": "n", "mesh": 0}}],
            "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}}}]}}],
            "buffers": [{{"byteLength": 36, "uri": "{}"}}], "bufferViews": [{{"buffer": 0, {view}}}],
            "accessors": [{{"componentType": 5126, "type": "VEC3", {layout}}}]}}"#,
            data_uri(&[0; 36])
        )
    };
    let whole = r#""byteLength": 36"#;
    for (json, expected) in [
        (accessor(r#""bufferView": 0, "count": 4"#, whole), "reach past the 36 bytes of the buffer view"),
        (accessor(r#""bufferView": 0, "count": 3, "byteOffset": 1"#, whole), "reach past"),
        (accessor(r#""bufferView": 0, "count": 18446744073709551615"#, whole), "reach past"),
        (accessor(r#""bufferView": 0, "count": 3, "byteOffset": 18446744073709551615"#, whole), "reach past"),
        (accessor(r#""count": 18446744073709551615"#, whole), "more than 2^32"),
        (accessor(r#""count": 4000000000"#, whole), "far more data"),
        (
            accessor(r#""bufferView": 0, "count": 3"#, r#""byteLength": 36, "byteOffset": 1"#),
            "past the 36 bytes of buffer 0",
        ),
        (
            accessor(
                r#""bufferView": 0, "count": 3"#,
                r#""byteLength": 36, "byteOffset": 18446744073709551615"#,
            ),
            "past the 36",
        ),
        (accessor(r#""bufferView": 0, "count": 3"#, r#""byteLength": 36, "byteStride": 4"#), "byteStride 4"),
        (
            accessor(r#""bufferView": 0, "count": 1"#, r#""byteLength": 36, "byteStride": 1000"#),
            "byteStride 1000",
        ),
        (accessor(r#""bufferView": 0, "count": 3"#, whole).replace("5126", "5127"), "component type"),
        (
            accessor(r#""bufferView": 0, "count": 3"#, whole).replace("VEC3", "VEC2"),
            "is of type VEC2, but VEC3 is wanted",
        ),
        (
            accessor(r#""bufferView": 0, "count": 3"#, whole)
                .replace("\"byteLength\": 36, \"uri\"", "\"byteLength\": 99, \"uri\""),
            "cut short",
        ),
    ] {
        let started = Instant::now();
        let error = import_text(&json).expect_err(expected);
        assert!(error.contains(expected), "{expected}: {error}");
        assert!(started.elapsed() < Duration::from_secs(5), "{error}");
    }
    let fine = accessor(r#""bufferView": 0, "count": 3"#, whole);
    assert_eq!(imported(&fine).report.triangles_degenerate, 1);
}

#[test]
fn what_is_no_scene_gets_a_sentence() {
    let folder = tempfile::tempdir().expect("a folder");
    let missing =
        import(&folder.path().join("none.glb"), &ImportOptions::default()).expect_err("missing").to_string();
    assert!(missing.contains("none.glb") && missing.contains("cannot be read"), "{missing}");
    let is_folder = import(folder.path(), &ImportOptions::default()).expect_err("a folder").to_string();
    assert!(is_folder.contains("is a folder"), "{is_folder}");
    assert!(import_text("").expect_err("empty").contains("not valid JSON"));
    let lost = r#"{"asset": {"version": "2.0"}, "buffers": [{"byteLength": 4, "uri": "lost.bin"}]}"#;
    let lost = import_text(lost).expect_err("missing buffer");
    assert!(lost.contains("buffer 0") && lost.contains("lost.bin"), "{lost}");
    let deep = format!(
        r#"{{"asset": {{"version": "2.0"}}, "scenes": [{{"nodes": [0]}}], "nodes": [{}, {{}}]}}"#,
        (1..50_000).map(|child| format!(r#"{{"children": [{child}]}}"#)).collect::<Vec<_>>().join(", ")
    );
    assert_eq!(imported(&deep).scene.nodes.len(), 50_001, "a long chain of nodes is deep, but valid");
}
