//! The finished document, as text or as GLB.

use super::Gltf;
use base64::Engine;
use serde_json::{Map, Value, json};

impl Gltf {
    fn document(&self, buffer: Value) -> Map<String, Value> {
        let mut scene = json!({ "nodes": (0..self.nodes.len()).collect::<Vec<_>>() });
        if !self.scene_extras.is_empty() {
            scene["extras"] = self.scene_extras.clone().into();
        }
        let lists = [
            ("nodes", &self.nodes),
            ("cameras", &self.cameras),
            ("meshes", &self.meshes),
            ("materials", &self.materials),
            ("animations", &self.animations),
            ("accessors", &self.accessors),
            ("bufferViews", &self.views),
        ];
        let mut document = Map::new();
        document.insert("asset".to_owned(), json!({ "version": "2.0", "generator": "farm-tests scenes" }));
        document.insert("extensionsUsed".to_owned(), json!(self.extensions));
        document.insert("scene".to_owned(), 0.into());
        document.insert("scenes".to_owned(), json!([scene]));
        for (name, list) in lists.into_iter().filter(|(_, list)| !list.is_empty()) {
            document.insert(name.to_owned(), list.clone().into());
        }
        document.insert("buffers".to_owned(), json!([buffer]));
        document
    }

    /// The document as a text with its buffer inside, one line per entry of its lists.
    pub fn into_text(self) -> String {
        let data = base64::engine::general_purpose::STANDARD.encode(&self.bin);
        let uri = format!("data:application/octet-stream;base64,{data}");
        let document = self.document(json!({ "byteLength": self.bin.len(), "uri": uri }));
        let entries = document.into_iter().map(|(name, value)| match value {
            Value::Array(list) if list.iter().all(Value::is_object) => {
                let lines: Vec<_> = list.iter().map(|entry| format!("    {entry}")).collect();
                format!("  \"{name}\": [\n{}\n  ]", lines.join(",\n"))
            }
            value => format!("  \"{name}\": {value}"),
        });
        format!("{{\n{}\n}}\n", entries.collect::<Vec<_>>().join(",\n"))
    }

    /// The document as a GLB.
    pub fn into_glb(mut self) -> Vec<u8> {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let mut json =
            Value::from(self.document(json!({ "byteLength": self.bin.len() }))).to_string().into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let mut glb = b"glTF".to_vec();
        let word = |value: usize, glb: &mut Vec<u8>| {
            glb.extend(u32::try_from(value).expect("a scene of less than 4 GB").to_le_bytes());
        };
        word(2, &mut glb);
        word(12 + 8 + json.len() + 8 + self.bin.len(), &mut glb);
        word(json.len(), &mut glb);
        glb.extend(b"JSON");
        glb.extend(json);
        word(self.bin.len(), &mut glb);
        glb.extend(b"BIN\0");
        glb.extend(self.bin);
        glb
    }
}
