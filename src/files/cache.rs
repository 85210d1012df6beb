//! The folder for what can be made again.

use std::path::PathBuf;

/// `$PLANAGENT_CACHE`, else a folder of ours in the cache folder of the platform; none where
/// neither is known.
pub fn cache_folder() -> Option<PathBuf> {
    let variable = |name: &str| {
        std::env::var_os(name)
            .filter(|value| !value.is_empty())
            .map(PathBuf::from)
    };
    variable("PLANAGENT_CACHE").or_else(|| {
        let platform = if cfg!(target_os = "macos") {
            variable("HOME").map(|home| home.join("Library/Caches"))
        } else if cfg!(windows) {
            variable("LOCALAPPDATA")
        } else {
            variable("XDG_CACHE_HOME").or_else(|| variable("HOME").map(|home| home.join(".cache")))
        };
        platform.map(|folder| folder.join("planagent"))
    })
}
