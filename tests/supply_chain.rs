//! What comes from others is checked: the exceptions of `deny.toml` have reasons and crates, CI
//! looks for advisories, and its actions are pinned. What goes to others is what the changelog
//! says.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(name: &str) -> String {
    fs::read_to_string(root().join(name)).unwrap()
}

#[test]
fn an_advisory_is_ignored_for_a_reason_and_a_crate_that_is_used() {
    let deny: toml::Table = read("deny.toml").parse().unwrap();
    let lock: toml::Table = read("Cargo.lock").parse().unwrap();
    let packages = lock["package"].as_array().unwrap();
    let ignored = deny["advisories"]["ignore"]
        .as_array()
        .expect("deny.toml ignores advisories with reasons");
    for one in ignored {
        let (id, reason) = (one["id"].as_str().unwrap(), one["reason"].as_str().unwrap());
        assert!(
            id.starts_with("RUSTSEC-") && reason.len() > 40,
            "{id}: {reason}"
        );
        let name = reason.split(' ').next().unwrap();
        let is_used = packages
            .iter()
            .any(|package| package["name"].as_str() == Some(name));
        assert!(
            is_used,
            "{id}: {name} is no dependency any more; remove the exception"
        );
    }
    assert!(read(".ci/run").contains("cargo deny check advisories"));
}

#[test]
fn the_promises_name_everything_that_comes_from_elsewhere() {
    let promises = read("SECURITY.md");
    for word in [
        "model folder",
        "nuPlan log",
        "run folder",
        "server",
        "`exec:` planner",
        "How to report",
    ] {
        assert!(
            promises.contains(word),
            "SECURITY.md says nothing of {word}"
        );
    }
}

/// The workflows of CI.
fn workflows() -> Vec<PathBuf> {
    let entries = fs::read_dir(root().join(".github/workflows")).unwrap();
    entries.map(|entry| entry.unwrap().path()).collect()
}

#[test]
fn actions_are_pinned_to_commits() {
    let mut found = 0;
    for file in workflows() {
        for line in fs::read_to_string(&file).unwrap().lines() {
            let Some(action) = line
                .trim_start()
                .trim_start_matches("- ")
                .strip_prefix("uses: ")
            else {
                continue;
            };
            // A tag can be moved to another commit. Readers and Dependabot need the version.
            let (name, version) = action.split_once(" # v").unwrap_or_default();
            let (_, commit) = name.split_once('@').unwrap_or_default();
            let is_commit = commit.len() == 40
                && commit
                    .bytes()
                    .all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'));
            let is_pinned = is_commit && version.starts_with(|first: char| first.is_ascii_digit());
            assert!(
                is_pinned,
                "{}: write ACTION@COMMIT # vVERSION in place of {action}",
                file.display()
            );
            found += 1;
        }
    }
    assert!(found >= 8, "{found} actions");
}

/// Runs `.github/release-notes` in a folder with the changelog and a manifest of this version.
fn release_notes(version: &str, tag: &str) -> Output {
    let folder = TempDir::new().unwrap();
    fs::write(
        folder.path().join("Cargo.toml"),
        format!("[package]\nversion = \"{version}\"\n"),
    )
    .unwrap();
    fs::write(folder.path().join("CHANGELOG.md"), read("CHANGELOG.md")).unwrap();
    Command::new("sh")
        .arg(root().join(".github/release-notes"))
        .arg(tag)
        .current_dir(folder.path())
        .env("GITHUB_REPOSITORY", "someone/planagent")
        .output()
        .unwrap()
}

#[test]
fn the_notes_of_a_release_are_its_section_of_the_changelog() {
    let output = release_notes("0.2.0", "v0.2.0");
    let notes = String::from_utf8(output.stdout).unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert!(
        notes.starts_with("### Changed\n\n- `--resume` refuses") && !notes.contains("\n## "),
        "{notes}"
    );
    assert!(
        notes.ends_with("### Removed\n\n- The unused `replay` model.\n"),
        "{notes}"
    );
    // A wrapped item is one line, and a link leads to the file of the tag.
    assert!(
        notes.contains("replaces `environment.bev_of`.\n"),
        "{notes}"
    );
    assert!(
        notes.contains("](https://github.com/someone/planagent/blob/v0.2.0/docs/exec.md)"),
        "{notes}"
    );
}

#[test]
fn a_tag_without_its_version_or_its_section_has_no_notes() {
    for (version, tag, expected) in [
        (
            "9.9.9",
            "v9.9.9",
            "CHANGELOG.md has no section \"## 9.9.9 (DATE)\"",
        ),
        (
            "0.1.0",
            "v0.1.0",
            "CHANGELOG.md has no section \"## 0.1.0 (DATE)\"",
        ),
        (
            "0.2.0",
            "v0.3.0",
            "the tag is v0.3.0, but Cargo.toml has version 0.2.0",
        ),
        ("0.2.0", "0.2.0", "the tag must be v0.2.0"),
    ] {
        let output = release_notes(version, tag);
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(
            (output.status.code(), output.stdout.len()),
            (Some(2), 0),
            "{tag}: {error}"
        );
        assert!(error.contains(expected), "{tag}: {error}");
    }
}

#[test]
fn the_release_finds_the_version_of_the_program() {
    let script = root().join(".github/release-notes");
    let output = Command::new("sh")
        .arg(script)
        .arg("v0.0.0")
        .current_dir(root())
        .output()
        .unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(
        error.contains(&format!("the tag must be v{}", env!("CARGO_PKG_VERSION"))),
        "{error}"
    );
}
