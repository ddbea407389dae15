//! Where a user's programs keep what they have to remember.

use std::path::PathBuf;

/// `$XDG_STATE_HOME/tessera`, or `~/.local/state/tessera`; none for users without a home.
pub fn state_folder() -> Option<PathBuf> {
    let set = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let state = set("XDG_STATE_HOME").or_else(|| Some(set("HOME")?.join(".local/state")))?;
    state.is_absolute().then(|| state.join("tessera"))
}
