//! The limits of this machine, kept once they are measured.

use planagent_files::{cache_folder, write_whole};
use planagent_mllm::{Instructions, Limits};
use planagent_runs::runner::cpu;
use serde::{Deserialize, Serialize};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Largest file of kept limits, bytes.
const MAX_BYTES: u64 = 4096;

/// How limits are measured; another number makes kept ones worthless. 2: no product of a probe is
/// computed once for several sums.
const MEASUREMENT: u32 = 2;

/// Kept limits, and for which processor they hold.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    measurement: u32,
    processor: String,
    threads: usize,
    limits: Limits,
}

/// The limits of this machine with its present threads: those of the cache folder, else measured,
/// a third of a second, and kept there. A cache that cannot be written keeps nothing.
pub fn machine_limits() -> &'static Limits {
    static LIMITS: OnceLock<Limits> = OnceLock::new();
    LIMITS.get_or_init(|| {
        let path = path();
        if let Some(kept) = path.as_deref().and_then(read) {
            return kept;
        }
        let limits = Limits::measure();
        if let Some(path) = path {
            let _ = keep(&path, &limits);
        }
        limits
    })
}

/// Keeps the middle of the limits that a bench measured: it had the machine for longer.
pub(super) fn keep_middle(measured: &[Limits]) {
    let middle = |limit: fn(&Limits) -> f64| {
        let mut limits: Vec<f64> = measured.iter().map(limit).collect();
        limits.sort_by(f64::total_cmp);
        limits.get(limits.len() / 2).copied()
    };
    let (Some(path), Some(first)) = (path(), measured.first()) else {
        return;
    };
    let (Some(operations_per_s), Some(read_bytes_per_s)) = (
        middle(|all| all.operations_per_s),
        middle(|all| all.read_bytes_per_s),
    ) else {
        return;
    };
    let limits = Limits {
        kernels: first.kernels.clone(),
        operations_per_s,
        read_bytes_per_s,
    };
    let _ = keep(&path, &limits);
}

fn path() -> Option<PathBuf> {
    cache_folder().map(|folder| folder.join("limits.json"))
}

/// Kept limits of this processor, its kernels and number of threads. What cannot be read is measured
/// again.
fn read(path: &Path) -> Option<Limits> {
    let text = planagent_files::read_text(path, MAX_BYTES).ok()?;
    let kept: Kept = serde_json::from_str(&text).ok()?;
    let is_usable = |limit: f64| limit.is_finite() && limit > 0.0;
    let same = kept.measurement == MEASUREMENT
        && kept.processor == cpu()
        && kept.threads == rayon::current_num_threads()
        // Processors of several generations have one name in virtual machines.
        && kept.limits.kernels == Instructions::best().name()
        && is_usable(kept.limits.operations_per_s)
        && is_usable(kept.limits.read_bytes_per_s);
    same.then_some(kept.limits)
}

fn keep(path: &Path, limits: &Limits) -> io::Result<()> {
    let kept = Kept {
        measurement: MEASUREMENT,
        processor: cpu(),
        threads: rayon::current_num_threads(),
        limits: limits.clone(),
    };
    let folder = path.parent().unwrap_or(Path::new(""));
    std::fs::create_dir_all(folder)?;
    write_whole(path, serde_json::to_string(&kept)?.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kept_limits_are_those_of_the_same_processor_kernels_and_threads() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cache/limits.json");
        assert_eq!(read(&path), None);
        let limits = Limits {
            kernels: Instructions::best().name().into(),
            operations_per_s: 1e12,
            read_bytes_per_s: 1e10,
        };
        keep(&path, &limits).unwrap();
        assert_eq!(read(&path), Some(limits));
        let text = std::fs::read_to_string(&path).unwrap();
        for (from, to) in [
            ("\"measurement\":", "\"measurement\":9"),
            ("\"threads\":", "\"threads\":9"),
            ("\"processor\":\"", "\"processor\":\"another "),
            ("\"kernels\":\"", "\"kernels\":\"other "),
            ("1000000000000.0", "-1.0"),
            ("{", "["),
        ] {
            assert!(text.contains(from), "{text}");
            std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
            assert_eq!(read(&path), None, "{to}");
        }
    }
}
