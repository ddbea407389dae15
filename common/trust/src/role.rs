//! What the holder of a certificate is there for.

/// What the holder of a certificate may do; which calls that means is the coordinator's decision.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Renders.
    Worker,
    /// Submits jobs, watches them and fetches their frames.
    Submitter,
    /// Everything.
    Admin,
}

/// A text that is no role.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no role: it is worker, submitter or admin")]
pub struct UnknownRole(String);

impl Role {
    const ALL: [(Self, &str); 3] =
        [(Self::Worker, "worker"), (Self::Submitter, "submitter"), (Self::Admin, "admin")];

    /// The role's name.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(role, _)| *role == self).expect("every role has a name").1
    }
}

impl std::fmt::Display for Role {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for Role {
    type Err = UnknownRole;

    fn from_str(text: &str) -> Result<Self, UnknownRole> {
        let found = Self::ALL.iter().find(|(_, name)| *name == text);
        found.map(|(role, _)| *role).ok_or_else(|| UnknownRole(text.chars().take(100).collect()))
    }
}
