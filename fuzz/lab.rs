//! The targets whose bytes are files of the lab: studies, and the folders of benchmarks and of text
//! twins.

use super::folder;
use planagent_lab::report::{BenchFigures, BenchFolder, BenchMetadata, Records};
use planagent_lab::study;
use planagent_lab::twins::PairRecord;

/// A study.
pub(super) fn study(bytes: &[u8]) -> bool {
    let folder = folder(&[("own.toml", bytes)]);
    study::find(&folder.path().join("own.toml").to_string_lossy()).is_ok()
}

/// The first byte chooses which file of a benchmark or of text twins has the rest.
pub(super) fn lab_folder(bytes: &[u8]) -> bool {
    const FILES: [&str; 3] = ["rows.jsonl", "metadata.json", "pairs.jsonl"];
    let Some((choice, rest)) = bytes.split_first() else {
        return false;
    };
    let chosen = FILES[usize::from(*choice) % FILES.len()];
    let folder = folder(&[(chosen, rest)]);
    match chosen {
        "rows.jsonl" => BenchFolder::read(folder.path()).is_ok_and(|rows| {
            let _ = BenchFigures::from_rows(&rows);
            true
        }),
        "metadata.json" => BenchFolder::resume(folder.path(), &metadata()).is_ok(),
        name => Records::<PairRecord>::open(folder.path(), name).is_ok(),
    }
}

/// The settings with which a benchmark is resumed.
fn metadata() -> BenchMetadata {
    BenchMetadata {
        planagent: String::new(),
        commit: None,
        started: String::new(),
        command: Vec::new(),
        cpu: String::new(),
        memory: None,
        settings: serde_json::Map::new(),
    }
}
