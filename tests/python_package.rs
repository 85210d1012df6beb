//! `python/` is a workspace of its own. It shares what is compiled only while profiles and versions are those of the root.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

fn read(name: &str) -> toml::Table {
    let text = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap();
    text.parse().unwrap()
}

/// The versions of each package of a lock file.
fn locked(lock: &toml::Table) -> BTreeMap<&str, BTreeSet<&str>> {
    let mut versions: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for package in lock["package"].as_array().unwrap() {
        versions.entry(package["name"].as_str().unwrap()).or_default().insert(package["version"].as_str().unwrap());
    }
    versions
}

#[test]
fn the_python_package_has_the_profiles_of_the_program() {
    let (root, python) = (read("Cargo.toml"), read("python/Cargo.toml"));
    assert_eq!(root["workspace"]["lints"], python["lints"]);
    assert_eq!(root["workspace"]["package"]["version"], python["package"]["version"]);
    let lock = read("python/Cargo.lock");
    let used = locked(&lock);
    let mut expected = root["profile"].clone();
    for (_, profile) in expected.as_table_mut().unwrap().iter_mut() {
        if let Some(packages) = profile.get_mut("package").and_then(toml::Value::as_table_mut) {
            // Cargo complains of packages that are not used.
            packages.retain(|name, _| name == "*" || used.contains_key(name));
        }
    }
    assert_eq!(expected, python["profile"], "python/Cargo.toml has other profiles than Cargo.toml");
}

#[test]
fn the_python_package_has_the_versions_of_the_program() {
    let (root, python) = (read("Cargo.lock"), read("python/Cargo.lock"));
    let (root, python) = (locked(&root), locked(&python));
    let other: Vec<_> = python
        .iter()
        .filter_map(|(name, versions)| Some((name, versions, root.get(name)?)))
        .filter(|(_, versions, known)| !versions.is_subset(known))
        .collect();
    assert!(other.is_empty(), "python/Cargo.lock has other versions than Cargo.lock: {other:?}");
    assert!(python.contains_key("pyo3") && !root.contains_key("pyo3"), "the library is free of PyO3");
}
