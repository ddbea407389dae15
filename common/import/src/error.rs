//! What is wrong, and where: places are the path through the file that led there.

use std::fmt;
use std::path::Path;

/// A file that cannot become a scene.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {}{fault}", .place.as_ref().map(|place| format!("{place}: ")).unwrap_or_default())]
pub struct ImportError {
    /// The file that was to be imported.
    pub file: String,
    /// Where in it, such as `node 3 "wheel" / mesh 2 "tyre" / primitive 0 / accessor 7`; none means all of it.
    pub place: Option<String>,
    /// What is wrong, and what to do.
    pub fault: String,
}

/// An [`ImportError`] before it knows its file.
#[derive(Debug)]
pub(crate) struct Fault {
    pub place: Option<String>,
    pub what: String,
}

impl Fault {
    /// A fault of the file as a whole.
    pub fn whole(what: impl Into<String>) -> Self {
        Self { place: None, what: what.into() }
    }

    /// A fault at a place that is already text.
    pub fn at(place: impl Into<String>, what: impl Into<String>) -> Self {
        Self { place: Some(place.into()), what: what.into() }
    }

    /// The same, with the file's name.
    pub fn in_file(self, file: &Path) -> ImportError {
        ImportError { file: file.display().to_string(), place: self.place, fault: self.what }
    }
}

/// One step of the path to a place; the steps before it are borrowed, so that a path costs nothing until it is shown.
#[derive(Clone, Copy)]
pub(crate) struct Place<'a> {
    before: Option<&'a Self>,
    kind: &'a str,
    index: Option<usize>,
    name: Option<&'a str>,
}

impl<'a> Place<'a> {
    /// The first step, such as `node 3 "wheel"`.
    pub fn new(kind: &'a str, index: usize, name: Option<&'a str>) -> Self {
        Self { before: None, kind, index: Some(index), name }
    }

    /// A first step of which there is only one, such as `extensionsRequired`.
    pub fn only(kind: &'a str) -> Self {
        Self { before: None, kind, index: None, name: None }
    }

    /// The next step.
    pub fn then(&'a self, kind: &'a str, index: usize, name: Option<&'a str>) -> Self {
        Self { before: Some(self), kind, index: Some(index), name }
    }

    /// The next step into a property, such as `extras.motionVector`.
    pub fn field(&'a self, kind: &'a str) -> Self {
        Self { before: Some(self), kind, index: None, name: None }
    }

    /// A fault here.
    pub fn fault(&self, what: impl Into<String>) -> Fault {
        Fault::at(self.to_string(), what)
    }

    /// A fault here unless `holds`.
    pub fn ensure(&self, holds: bool, what: impl FnOnce() -> String) -> Result<(), Fault> {
        if holds { Ok(()) } else { Err(self.fault(what())) }
    }
}

impl fmt::Display for Place<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(before) = self.before {
            write!(f, "{before} / ")?;
        }
        f.write_str(self.kind)?;
        if let Some(index) = self.index {
            write!(f, " {index}")?;
        }
        match self.name {
            Some(name) if !name.is_empty() => write!(f, " {name:?}"),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_names_file_and_path_to_the_fault() {
        let node = Place::new("node", 3, Some("wheel"));
        let mesh = node.then("mesh", 2, None);
        let fault = mesh.then("accessor", 7, Some("")).fault("reaches past its buffer view");
        let error = fault.in_file(Path::new("car.glb"));
        let text = "car.glb: node 3 \"wheel\" / mesh 2 / accessor 7: reaches past its buffer view";
        assert_eq!(error.to_string(), text);
        assert_eq!(Fault::whole("is empty").in_file(Path::new("a.glb")).to_string(), "a.glb: is empty");
    }
}
