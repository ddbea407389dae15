//! The files of a scene: the only place that reads. Nothing outside the scene's folder is opened.

use crate::error::{Fault, Place};
use base64::Engine;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use std::cell::{Cell, RefCell};
use std::fs::{self, File};
use std::io::Read;
use std::path::{Component, Path, PathBuf};

/// No file of a scene is larger; what a coordinator could hold.
const FILE_BYTES_MAX: u64 = 16 << 30;

/// Some exporters leave out the padding or do not clear the last bits.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &base64::alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// A scene's folder, and what was read from it.
pub(crate) struct Source {
    folder: PathBuf,
    files: RefCell<Vec<String>>,
    bytes_read: Cell<u64>,
}

impl Source {
    /// Reads the scene file itself; everything else is read relative to its folder.
    pub fn open(scene: &Path) -> Result<(Self, Vec<u8>), Fault> {
        let bytes = read_file(scene, FILE_BYTES_MAX).map_err(Fault::whole)?;
        let folder = match scene.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let folder =
            folder.canonicalize().map_err(|err| Fault::whole(format!("folder cannot be read: {err}")))?;
        let name = scene.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let source =
            Self { folder, files: RefCell::new(vec![name]), bytes_read: Cell::new(bytes.len() as u64) };
        Ok((source, bytes))
    }

    /// The bytes that `uri` stands for, at most `bytes_max` of them: those of a file in the scene's folder, or those that a
    /// `data:` URI holds.
    pub fn fetch(&self, uri: &str, bytes_max: u64, place: &Place) -> Result<Vec<u8>, Fault> {
        if let Some(data) = data_of(uri) {
            return decode_data(data).map_err(|what| place.fault(what));
        }
        let path = self.path_of(uri, place)?;
        let read = read_file(&path, bytes_max.min(FILE_BYTES_MAX));
        let bytes = read.map_err(|what| place.fault(format!("file {uri:?} {what}")))?;
        self.files.borrow_mut().push(uri.to_owned());
        self.bytes_read.set(self.bytes_read.get() + bytes.len() as u64);
        Ok(bytes)
    }

    /// Where the file is that a relative `uri` stands for.
    pub fn path_of(&self, uri: &str, place: &Place) -> Result<PathBuf, Fault> {
        let refuse =
            |why: &str| place.fault(format!("URI {uri:?} {why}; only files in the scene's folder are read"));
        if has_scheme(uri) {
            return Err(refuse("is absolute"));
        }
        let decoded = percent_encoding::percent_decode_str(uri).decode_utf8();
        let relative = decoded.map_err(|_| refuse("is not UTF-8 once it is percent-decoded"))?;
        if relative.is_empty() || relative.contains('\0') {
            return Err(refuse("names no file"));
        }
        if relative.starts_with(['/', '\\']) {
            return Err(refuse("is absolute"));
        }
        let mut depth = 0_usize;
        for component in Path::new(&*relative).components() {
            match component {
                Component::Normal(_) => depth += 1,
                Component::CurDir => {}
                Component::ParentDir if depth > 0 => depth -= 1,
                _ => return Err(refuse("leads out of the scene's folder")),
            }
        }
        // A link inside the folder may still point anywhere.
        let path = self.folder.join(&*relative);
        let real =
            path.canonicalize().map_err(|err| place.fault(format!("file {uri:?} cannot be read: {err}")))?;
        if real.starts_with(&self.folder) {
            Ok(real)
        } else {
            Err(refuse("is a link out of the scene's folder"))
        }
    }

    /// What was read: names and bytes.
    pub fn into_files(self) -> (Vec<String>, u64) {
        (self.files.into_inner(), self.bytes_read.get())
    }
}

/// The file's bytes, at most `bytes_max` of them; what is wrong otherwise.
pub(crate) fn read_file(path: &Path, bytes_max: u64) -> Result<Vec<u8>, String> {
    let cannot = |err: std::io::Error| format!("cannot be read: {err}");
    // Asked before it is opened: opening a pipe waits for a writer.
    let meta = fs::metadata(path).map_err(cannot)?;
    if meta.is_dir() {
        return Err("is a folder; name the file in it".to_owned());
    }
    if !meta.is_file() {
        return Err("is no regular file".to_owned());
    }
    if meta.len() > FILE_BYTES_MAX {
        return Err(format!("has {} bytes; at most {FILE_BYTES_MAX} are read", meta.len()));
    }
    let mut bytes = Vec::new();
    File::open(path).map_err(cannot)?.take(bytes_max).read_to_end(&mut bytes).map_err(cannot)?;
    Ok(bytes)
}

/// What follows `data:`, if the URI starts so.
fn data_of(uri: &str) -> Option<&str> {
    uri.get(..5).filter(|scheme| scheme.eq_ignore_ascii_case("data:")).map(|_| &uri[5..])
}

/// RFC 2397: `[type][;base64],data`.
fn decode_data(data: &str) -> Result<Vec<u8>, String> {
    let (head, body) = data.split_once(',').ok_or("data URI has no comma")?;
    let decoded = percent_encoding::percent_decode_str(body);
    if !head.ends_with(";base64") {
        return Ok(decoded.collect());
    }
    let decode = |body: &[u8]| BASE64.decode(body).map_err(|err| format!("data URI is not base64: {err}"));
    if body.contains('%') { decode(&decoded.collect::<Vec<_>>()) } else { decode(body.as_bytes()) }
}

/// RFC 3986 scheme, which also catches the drive letters of some systems.
fn has_scheme(uri: &str) -> bool {
    uri.split_once(':').is_some_and(|(scheme, _)| {
        scheme.starts_with(|c: char| c.is_ascii_alphabetic())
            && scheme.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.'))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder with a scene, `wheel äö.bin` beside it, and a secret one level up.
    fn scene() -> (tempfile::TempDir, Source) {
        let outer = tempfile::tempdir().expect("a folder");
        let folder = outer.path().join("scene");
        fs::create_dir(&folder).expect("a folder");
        fs::write(outer.path().join("secret"), b"secret").expect("a file");
        fs::write(folder.join("scene.gltf"), b"{}").expect("a file");
        fs::write(folder.join("wheel äö.bin"), b"wheel").expect("a file");
        let (source, bytes) = Source::open(&folder.join("scene.gltf")).expect("it is there");
        assert_eq!(bytes, b"{}");
        (outer, source)
    }

    fn fetch(source: &Source, uri: &str) -> Result<Vec<u8>, String> {
        source.fetch(uri, 100, &Place::only("buffer")).map_err(|fault| fault.what)
    }

    #[test]
    fn percent_encoded_and_unicode_names_are_the_same_file() {
        let (_outer, source) = scene();
        for uri in ["wheel äö.bin", "wheel%20%C3%A4%C3%B6.bin", "./wheel äö.bin", "sub/../wheel%20äö.bin"]
        {
            if uri.starts_with("sub") {
                fs::create_dir(source.folder.join("sub")).expect("a folder");
            }
            assert_eq!(fetch(&source, uri).expect(uri), b"wheel", "{uri}");
        }
        assert_eq!(source.into_files().0.len(), 5);
    }

    #[test]
    fn nothing_outside_the_folder_is_read() {
        let (outer, source) = scene();
        let absolute = outer.path().join("secret").display().to_string();
        let file_uri = format!("file://{absolute}");
        for uri in [
            "../secret",
            "a/../../secret",
            "%2e%2e/secret",
            "..%2Fsecret",
            &absolute,
            &file_uri,
            "http://a/b",
            "C:\\a",
            "",
        ] {
            let what = fetch(&source, uri).expect_err(uri);
            assert!(what.contains("only files in the scene's folder are read"), "{uri}: {what}");
        }
        assert!(fetch(&source, "missing.bin").expect_err("missing").contains("missing.bin"));
        assert!(fetch(&source, ".").expect_err("folder").contains("folder"));
    }

    #[cfg(unix)]
    #[test]
    fn a_link_does_not_lead_out_of_the_folder() {
        let (outer, source) = scene();
        std::os::unix::fs::symlink(outer.path().join("secret"), source.folder.join("link")).expect("a link");
        std::os::unix::fs::symlink("wheel äö.bin", source.folder.join("inner")).expect("a link");
        assert!(fetch(&source, "link").expect_err("link").contains("link out of"));
        assert_eq!(fetch(&source, "inner").expect("inside"), b"wheel");
    }

    #[test]
    fn data_uris_are_decoded_with_and_without_padding() {
        let (_outer, source) = scene();
        for uri in [
            "data:application/octet-stream;base64,QUI=",
            "data:;base64,QUI",
            "DATA:;base64,QUI%3D",
            "data:,A%42",
        ] {
            assert_eq!(fetch(&source, uri).expect(uri), b"AB", "{uri}");
        }
        for uri in ["data:base64", "data:;base64,Q!I="] {
            fetch(&source, uri).expect_err(uri);
        }
    }
}
