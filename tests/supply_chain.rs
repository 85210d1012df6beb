//! The exceptions of `deny.toml` have reasons and crates, and CI looks for advisories.

use std::fs;
use std::path::Path;

fn read(name: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap()
}

#[test]
fn an_advisory_is_ignored_for_a_reason_and_a_crate_that_is_used() {
    let deny: toml::Table = read("deny.toml").parse().unwrap();
    let lock: toml::Table = read("Cargo.lock").parse().unwrap();
    let packages = lock["package"].as_array().unwrap();
    let ignored = deny["advisories"]["ignore"].as_array().expect("deny.toml ignores advisories with reasons");
    for one in ignored {
        let (id, reason) = (one["id"].as_str().unwrap(), one["reason"].as_str().unwrap());
        assert!(id.starts_with("RUSTSEC-") && reason.len() > 40, "{id}: {reason}");
        let name = reason.split(' ').next().unwrap();
        let is_used = packages.iter().any(|package| package["name"].as_str() == Some(name));
        assert!(is_used, "{id}: {name} is no dependency any more; remove the exception");
    }
    assert!(read(".ci/run").contains("cargo deny check advisories"));
}

#[test]
fn the_promises_name_everything_that_comes_from_elsewhere() {
    let promises = read("SECURITY.md");
    for word in ["model folder", "nuPlan log", "run folder", "server", "`exec:` planner", "How to report"] {
        assert!(promises.contains(word), "SECURITY.md says nothing of {word}");
    }
}
