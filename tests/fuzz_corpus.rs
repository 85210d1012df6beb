//! The kept inputs of the fuzz targets: each goes through the function that is fuzzed, ends soon
//! and does not panic.

#[path = "../fuzz/targets.rs"]
mod targets;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Inputs of a target at least.
const MIN_INPUTS: usize = 3;
/// One input takes at most this long, also in a build without optimization.
const MAX_TIME: Duration = Duration::from_secs(20);

/// How the inputs begin that a target reads to the end.
const WHOLE: &str = "whole";

fn fuzz() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz")
}

/// The names in a folder, sorted.
fn names(folder: &Path) -> Vec<String> {
    let entries =
        fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut names: Vec<String> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn every_kept_input_ends_without_a_panic() {
    let (mut slow, mut refused) = (Vec::new(), Vec::new());
    for (name, _) in targets::TARGETS {
        let folder = fuzz().join("corpus").join(name);
        let inputs = names(&folder);
        assert!(
            inputs.len() >= MIN_INPUTS,
            "{name} has {} inputs",
            inputs.len()
        );
        assert!(
            inputs.iter().any(|input| input.starts_with(WHOLE)),
            "{name} has no whole input"
        );
        for input in inputs {
            let bytes = fs::read(folder.join(&input)).unwrap();
            let started = Instant::now();
            if !targets::run(name, &bytes) && input.starts_with(WHOLE) {
                refused.push(format!("{name}/{input}"));
            }
            if started.elapsed() > MAX_TIME {
                slow.push(format!("{name}/{input}: {:?}", started.elapsed()));
            }
        }
    }
    assert!(slow.is_empty(), "{slow:?}");
    assert!(
        refused.is_empty(),
        "these are not read to the end: {refused:?}"
    );
}

/// A target is a row of the table, a program, a part of the manifest and a folder of inputs.
#[test]
fn targets_programs_and_folders_have_the_same_names() {
    let targets: BTreeSet<String> = targets::TARGETS
        .iter()
        .map(|(name, _)| (*name).to_owned())
        .collect();
    let programs = names(&fuzz().join("fuzz_targets"));
    assert_eq!(
        programs
            .iter()
            .map(|file| file.trim_end_matches(".rs").to_owned())
            .collect::<BTreeSet<_>>(),
        targets
    );
    assert_eq!(
        names(&fuzz().join("corpus"))
            .into_iter()
            .collect::<BTreeSet<_>>(),
        targets
    );
    let manifest: toml::Table = fs::read_to_string(fuzz().join("Cargo.toml"))
        .unwrap()
        .parse()
        .unwrap();
    let programs = manifest["bin"]
        .as_array()
        .unwrap()
        .iter()
        .map(|program| program["name"].as_str().unwrap().to_owned());
    assert_eq!(programs.collect::<BTreeSet<_>>(), targets);
}
