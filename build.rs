//! The build script of the program and of the Python package: tells the compiler which commit is
//! built. No library crate has it, so a new commit compiles none of them again.
#![allow(
    clippy::print_stdout,
    reason = "Cargo reads its instructions from stdout"
)]

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

fn main() {
    let package = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default());
    let root = package
        .ancestors()
        .find(|folder| folder.join("Cargo.lock").is_file());
    if let Some(commit) = root.and_then(commit) {
        println!("cargo::rustc-env=PLANAGENT_COMMIT={commit}");
    }
}

/// The commit of the sources, with `+changes` where they differ from it; `None` outside a
/// repository.
fn commit(root: &Path) -> Option<String> {
    // `git archive` writes the commit into this file.
    if let Some(text) = std::fs::read_to_string(root.join(".commit"))
        .ok()
        .filter(|text| text.trim().len() == 40)
    {
        return Some(short(text.trim()));
    }
    for path in ["HEAD", "logs/HEAD"] {
        println!(
            "cargo::rerun-if-changed={}",
            root.join(git(root, &["rev-parse", "--git-path", path])?)
                .display()
        );
    }
    println!("cargo::rerun-if-changed={}", root.join("src").display());
    let head = git(root, &["rev-parse", "HEAD"])?;
    let changes = git(
        root,
        &[
            "status",
            "--porcelain",
            "--untracked-files=no",
            "--",
            "src",
            "Cargo.toml",
        ],
    )?;
    Some(if changes.is_empty() {
        short(&head)
    } else {
        format!("{}+changes", short(&head))
    })
}

fn short(commit: &str) -> String {
    commit.chars().take(12).collect()
}

fn git(folder: &Path, arguments: &[&str]) -> Option<String> {
    let output = Command::new("git")
        .current_dir(folder)
        .args(arguments)
        .output()
        .ok()?;
    output
        .status
        .success()
        .then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
