//! What an import left out or found odd.

use std::cell::RefCell;
use std::fmt::Display;

/// What was read, kept and left out.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ImportReport {
    /// One sentence per kind of oddity, with its first place and how often it came.
    pub warnings: Vec<String>,
    /// Every file that was read, relative to the scene's folder and as the scene spells it, in order; the scene itself first.
    pub files: Vec<String>,
    /// Bytes of those files.
    pub bytes_read: u64,
    /// Triangles kept in memory.
    pub triangles_stored: u64,
    /// Triangles that are drawn: those of a mesh count once per instance.
    pub triangles_drawn: u64,
    /// Stored triangles of no area.
    pub triangles_degenerate: u64,
    /// Stored vertices whose position is not finite; their triangles are never hit.
    pub vertices_not_finite: u64,
    /// Primitives of points and lines, which have no surface; not imported.
    pub primitives_skipped: u64,
    /// Names of all animations of the file; at most one of them is imported.
    pub animations: Vec<String>,
}

/// More kinds of oddity than this are only counted: such a file needs another look anyway.
const KINDS_MAX: usize = 100;

/// Collects warnings, one per kind.
#[derive(Default)]
pub(crate) struct Warnings(RefCell<Vec<Warning>>);

struct Warning {
    what: String,
    first_place: String,
    more: u64,
}

impl Warnings {
    /// Notes `what`; when it was noted before, only counts it.
    pub fn add(&self, place: &dyn Display, what: impl Into<String>) {
        let (what, mut list) = (what.into(), self.0.borrow_mut());
        if let Some(known) = list.iter_mut().find(|warning| warning.what == what) {
            known.more += 1;
        } else if let Some(last) = list.get_mut(KINDS_MAX) {
            last.more += 1;
        } else {
            let what = if list.len() == KINDS_MAX { "and other oddities".to_owned() } else { what };
            list.push(Warning { what, first_place: place.to_string(), more: 0 });
        }
    }

    /// All sentences, in the order of their first appearance.
    pub fn into_sentences(self) -> Vec<String> {
        let sentence = |warning: Warning| match warning.more {
            0 => format!("{}: {}", warning.first_place, warning.what),
            more => format!("{} and {more} more: {}", warning.first_place, warning.what),
        };
        self.0.into_inner().into_iter().map(sentence).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_oddity_is_said_once_and_counted() {
        let warnings = Warnings::default();
        for node in 0..3 {
            warnings.add(&format!("node {node}"), "is odd");
        }
        warnings.add(&"scene", "is dark");
        assert_eq!(warnings.into_sentences(), ["node 0 and 2 more: is odd", "scene: is dark"]);
    }
}
