//! The machine and the build, for records of measurements.

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

/// The commit that the program was built from, with `+changes` for changed files; `None` for a
/// build without git.
pub fn build_commit() -> Option<&'static str> {
    option_env!("PLANAGENT_COMMIT").filter(|commit| !commit.is_empty())
}
