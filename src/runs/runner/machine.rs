//! The machine and the build, for records of measurements.

use std::sync::OnceLock;

/// Name of the processor, or of its architecture where the system does not name it.
pub fn cpu() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info
        .lines()
        .find_map(|line| line.strip_prefix("model name"))
        .and_then(|rest| rest.split_once(':'));
    model.map_or_else(
        || std::env::consts::ARCH.to_owned(),
        |(_, name)| name.trim().to_owned(),
    )
}

/// Memory of the machine, bytes.
pub fn memory() -> Option<u64> {
    let info = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = info
        .lines()
        .find_map(|line| line.strip_prefix("MemTotal:"))?;
    line.trim()
        .strip_suffix("kB")?
        .trim()
        .parse::<u64>()
        .ok()
        .map(|kibibytes| kibibytes * 1024)
}

/// Set once by the program that runs.
static COMMIT: OnceLock<&'static str> = OnceLock::new();

/// Tells records which commit the program was built from, with `+changes` for changed files. The
/// program calls it before all else; a second call changes nothing.
pub fn set_build_commit(commit: &'static str) {
    COMMIT.get_or_init(|| commit);
}

/// The commit of [`set_build_commit`]; `None` for a build without git and for programs that did
/// not call it.
pub fn build_commit() -> Option<&'static str> {
    COMMIT.get().copied()
}
