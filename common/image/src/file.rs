//! Files that are either whole or not there.

use crate::ImageError;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Writes `bytes` under `path`, replacing what was there. See [`write_file_with`].
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), ImageError> {
    write_file_with(path, |out| out.write_all(bytes).map_err(|err| err.to_string()))
}

/// Lets `fill` write a temporary file beside `path`, makes it durable and only then gives it its name. When anything fails,
/// whatever was called `path` before is untouched and nothing else is left behind.
pub fn write_file_with(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<&mut std::fs::File>) -> Result<(), String>,
) -> Result<(), ImageError> {
    let fault = |err: String| ImageError::write(path, err);
    let folder = folder_of(path).map_err(fault)?;
    let mut temporary = new_beside(path, &folder).map_err(fault)?;
    let mut out = BufWriter::new(temporary.as_file_mut());
    fill(&mut out).map_err(fault)?;
    out.flush().map_err(|err| fault(err.to_string()))?;
    drop(out);
    temporary.as_file().sync_all().map_err(|err| fault(err.to_string()))?;
    temporary.persist(path).map_err(|err| fault(err.error.to_string()))?;
    sync_folder(&folder);
    Ok(())
}

/// The folder that `path` lies in, or why nothing can be written there.
fn folder_of(path: &Path) -> Result<PathBuf, String> {
    if path.file_name().is_none() {
        return Err("it names no file".to_owned());
    }
    match std::fs::metadata(path) {
        Ok(found) if found.is_dir() => return Err("it is a directory".to_owned()),
        Ok(found) if !found.is_file() => return Err("it is there already and is no regular file".to_owned()),
        _ => {}
    }
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent.to_owned(),
        _ => PathBuf::from("."),
    };
    match std::fs::metadata(&folder) {
        Ok(found) if found.is_dir() => Ok(folder),
        Ok(_) => Err(format!("{} is no directory", folder.display())),
        Err(err) if err.kind() == std::io::ErrorKind::NotFound => {
            Err(format!("the directory {} does not exist; create it first", folder.display()))
        }
        Err(err) => Err(format!("the directory {}: {err}", folder.display())),
    }
}

fn new_beside(path: &Path, folder: &Path) -> Result<tempfile::NamedTempFile, String> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let prefix = format!(".{name}.");
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(".part");
    // Temporary files are private by default; this one becomes an ordinary file.
    #[cfg(unix)]
    builder.permissions(<std::fs::Permissions as std::os::unix::fs::PermissionsExt>::from_mode(0o666));
    builder.tempfile_in(folder).map_err(|err| format!("the directory {}: {err}", folder.display()))
}

/// Makes the new name durable. Not every file system can; the file itself is already safe under one name or the other.
fn sync_folder(folder: &Path) {
    if let Ok(folder) = std::fs::File::open(folder) {
        let _ = folder.sync_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_failure_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frame.exr");
        write_file(&path, b"old").unwrap();
        let outcome = write_file_with(&path, |out| {
            out.write_all(&[0; 100_000]).unwrap();
            Err("the disk is full".to_owned())
        });
        assert!(outcome.unwrap_err().to_string().ends_with("frame.exr: the disk is full"));
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["frame.exr"]);
        write_file(&path, b"new").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(names(folder.path()), ["frame.exr"]);
    }

    #[test]
    fn places_that_cannot_be_written_get_a_sentence() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        write_file(&file, b"").unwrap();
        let refusal = |path: &Path| write_file(path, b"x").unwrap_err().to_string();
        assert!(refusal(&folder.path().join("no/such/frame.exr")).contains("does not exist"));
        assert!(refusal(folder.path()).contains("is a directory"));
        assert!(refusal(&file.join("frame.exr")).contains("is no directory"));
        assert!(refusal(Path::new("/dev/null")).contains("no regular file"));
        assert!(refusal(Path::new("/")).contains("names no file"));
        assert_eq!(names(folder.path()), ["file"]);
    }

    #[cfg(unix)]
    #[test]
    fn others_may_read_what_was_written() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frame.exr");
        write_file(&path, b"x").unwrap();
        std::fs::write(folder.path().join("plain"), b"x").unwrap();
        let mode = |name: &str| std::fs::metadata(folder.path().join(name)).unwrap().permissions().mode();
        assert_eq!(mode("frame.exr"), mode("plain"));
    }
}
