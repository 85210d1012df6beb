//! Retired words of docs/glossary.md occur nowhere but in the glossary and the changelog.

use regex::Regex;
use std::fs;
use std::path::{Path, PathBuf};

/// Regular expressions of identifiers and phrases that have a better word.
const RETIRED: [&str; 63] = [
    r"\b(MOST|LEAST|FEWEST|USUAL)_[A-Z]",
    r"\bin force\b",
    r"\bin_force\b",
    r"\bInForce\b",
    r"\breplayed traffic\b",
    r"\breactive traffic\b",
    r"\bamong (replayed|reactive|which)\b",
    r"\b[Ss]ightings?\b",
    r"\bin_way\b",
    r"\b[Ss]takes\b",
    r"\bgarnish",
    r"\b[Dd]ice\b",
    r"\bTemper\b",
    r"\bforeign_view\b",
    r"\bBevOf\b",
    r"\bfor want of\b",
    r"\banew\b",
    r"\b[Ww]hoever\b",
    r"\b[Ww]homever\b",
    r"\bgone on with\b",
    r"\bgo(es)? on with\b",
    r"\bfor good\b",
    r"\btaken? back\b",
    r"\btake_back\b",
    r"\b[Rr]etreats?\b",
    r"\bMind\b",
    r"\b[Tt]houghts?\b",
    r"\bas_it_goes\b",
    r"\b[Ww]atche[rds]\b",
    r"\bWatch\b",
    r"\bAsWritten\b",
    r"\bas_written\b",
    r"\bKeepInForce\b",
    r"\bkeep_in_force\b",
    r"\bsaved_calls\b",
    r"\bGeneratedPlanner\b",
    r"\bpdm::Way\b",
    r"\bStorage(Plan|Share|Exception)\b",
    r"\bPanels\b",
    r"\bSight\b",
    r"\bPlacedRows\b",
    r"\bModelFacts\b",
    r"\bOpening[:,;{ ]*\{",
    r"\b[Ii]nvented\b",
    r"\bmade up\b",
    r"\bis told\b",
    r"\bare told\b",
    r"\bwhat drives\b",
    r"\bwho leads\b",
    r"\b[Ff]orced tokens?\b",
    r"\bDrive(Row|Record|Time|Timing|Entry|Parts|Choice|Progress)\b",
    r"\bDriven\b",
    r"\bAssignments?\b",
    r"\bPlannerKind\b",
    r"\bScenarioSource\b",
    r"\bdrives/",
    r"\bplanagent experiments?\b",
    r"\bruns/experiments\b",
    r"\bfn of[(<]",
    r"\bEgoWay\b",
    r"\bPass(Rules|Verdict)\b",
    r"\b(with_)?way_back\b",
    r"\bExperiments?(Request|Arguments|Outcome|Results)?\b",
];

/// Files that may name a retired word.
const EXEMPT: [&str; 7] = [
    "docs/glossary.md",
    // Marks that models write are theirs.
    "src/mllm/endpoint/reply/thinking/marks.rs",
    "src/mllm/endpoint/reply/thinking/words.rs",
    "src/mllm/endpoint/reply/thinking/tests.rs",
    "CHANGELOG.md",
    "tests/words.rs",
    "tests/proof/run_table.py",
];

#[test]
fn retired_words_are_not_used() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    for place in [
        "src",
        "tests",
        "benches",
        "examples",
        "docs",
        "models",
        "python/src",
        "python/planagent",
        "python/tests",
    ] {
        collect(&root.join(place), &mut files);
    }
    files.extend(
        [
            "README.md",
            "ARCHITECTURE.md",
            "CONTRIBUTING.md",
            "planagent.toml",
        ]
        .map(|name| root.join(name)),
    );
    let retired: Vec<Regex> = RETIRED
        .iter()
        .map(|word| Regex::new(word).unwrap())
        .collect();
    let mut found = Vec::new();
    for file in files {
        let name = file
            .strip_prefix(root)
            .unwrap()
            .to_string_lossy()
            .into_owned();
        let Ok(text) = fs::read_to_string(&file) else {
            continue;
        };
        if EXEMPT.contains(&name.as_str()) {
            continue;
        }
        for (i, line) in text.lines().enumerate() {
            for word in retired.iter().filter(|word| word.is_match(line)) {
                found.push(format!("{name}:{}: {word} in: {}", i + 1, line.trim()));
            }
        }
    }
    assert!(
        found.is_empty(),
        "{} retired words; see docs/glossary.md\n{}",
        found.len(),
        found.join("\n")
    );
}

/// Text files below a folder; fixtures are data.
fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    let Ok(entries) = fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        let path = entry.path();
        if path.is_dir() {
            if !path.ends_with("tests/fixtures") && !path.ends_with("tests/golden") {
                collect(&path, files);
            }
        } else if path.extension().is_some_and(|e| {
            ["rs", "md", "toml", "js", "html", "css", "py"]
                .iter()
                .any(|&t| e == t)
        }) {
            files.push(path);
        }
    }
}
