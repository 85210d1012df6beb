//! What tests need from outside the repository. A test that lacks something shows as ignored, with
//! the reason.

use std::path::{Path, PathBuf};
use std::process::Command;

/// What a test returns that needs more than the repository.
pub(crate) type Needy = Result<(), Missing>;

/// What a test lacks on this machine, and how to provide it.
#[derive(Debug, Clone)]
pub(crate) struct Missing(pub String);

/// The data folder: `$PLANAGENT_DATA`, else `../shared/data`.
fn data_folder() -> PathBuf {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    std::env::var_os("PLANAGENT_DATA").map_or_else(beside, PathBuf::from)
}

/// A file or folder of the data folder.
pub(crate) fn data(path: &str) -> Result<PathBuf, Missing> {
    let found = data_folder().join(path);
    let missing = || Missing(format!("needs {path} in $PLANAGENT_DATA"));
    found.exists().then_some(found).ok_or_else(missing)
}

/// A Python that imports the packages: `$PLANAGENT_PYTHON`, else `python3`.
pub(crate) fn python(packages: &[&str]) -> Result<String, Missing> {
    interpreter("PLANAGENT_PYTHON", packages)
}

/// A Python with llama.cpp: `$PLANAGENT_LLAMA_PYTHON`, else `python3`.
pub(crate) fn llama_python(packages: &[&str]) -> Result<String, Missing> {
    interpreter("PLANAGENT_LLAMA_PYTHON", packages)
}

/// A Python with OpenVINO: `$PLANAGENT_OPENVINO_PYTHON`, else `python3`.
#[cfg(unix)]
pub(crate) fn openvino_python(packages: &[&str]) -> Result<String, Missing> {
    interpreter("PLANAGENT_OPENVINO_PYTHON", packages)
}

fn interpreter(variable: &str, packages: &[&str]) -> Result<String, Missing> {
    let named = std::env::var(variable).unwrap_or_else(|_| "python3".to_owned());
    let imports: Vec<String> = packages
        .iter()
        .map(|package| format!("import {package}"))
        .collect();
    let output = Command::new(&named)
        .args(["-c", &imports.join("\n")])
        .output();
    let with = if packages.is_empty() {
        String::new()
    } else {
        format!(" with {}", packages.join(", "))
    };
    let missing = || Missing(format!("needs a Python{with}; ${variable} names one"));
    output
        .is_ok_and(|output| output.status.success())
        .then_some(named)
        .ok_or_else(missing)
}

/// A program on the path, under the first of its names that is there.
pub(crate) fn program(names: &[&str]) -> Result<PathBuf, Missing> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders: Vec<PathBuf> = std::env::split_paths(&path).collect();
    let mut places = names
        .iter()
        .flat_map(|name| folders.iter().map(move |folder| folder.join(name)));
    places
        .find(|place| place.is_file())
        .ok_or_else(|| Missing(format!("needs {} on the path", names[0])))
}

/// A clone of nuplan-devkit: `$PLANAGENT_DEVKIT`.
pub(crate) fn devkit() -> Result<PathBuf, Missing> {
    let named = std::env::var_os("PLANAGENT_DEVKIT").map(PathBuf::from);
    named.ok_or_else(|| {
        Missing("needs a clone of nuplan-devkit; $PLANAGENT_DEVKIT names one".to_owned())
    })
}
