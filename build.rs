//! Tells the compiler which commit is built.
#![allow(clippy::print_stdout, reason = "Cargo reads its instructions from stdout")]

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

fn main() {
    let package = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default());
    if let Some(commit) = commit(&package) {
        println!("cargo::rustc-env=PLANAGENT_COMMIT={commit}");
    }
}

/// The commit of the sources, with `+changes` where they differ from it; `None` outside a repository.
fn commit(package: &Path) -> Option<String> {
    // `git archive` writes the commit into this file.
    if let Ok(text) = std::fs::read_to_string(package.join(".commit")) {
        if text.trim().len() == 40 {
            return Some(short(text.trim()));
        }
    }
    for path in ["HEAD", "logs/HEAD"] {
        println!("cargo::rerun-if-changed={}", git(package, &["rev-parse", "--git-path", path])?);
    }
    println!("cargo::rerun-if-changed=src");
    let head = git(package, &["rev-parse", "HEAD"])?;
    let changes = git(package, &["status", "--porcelain", "--untracked-files=no", "--", "src", "Cargo.toml"])?;
    Some(if changes.is_empty() { short(&head) } else { format!("{}+changes", short(&head)) })
}

fn short(commit: &str) -> String {
    commit.chars().take(12).collect()
}

fn git(package: &Path, arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").current_dir(package).args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
