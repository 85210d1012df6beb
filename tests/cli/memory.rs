//! Memories of language agents: written where the user says, read as a stranger's.

use super::{refused, run};
use std::fs;
use std::path::Path;
use std::process::Command;

fn pipe(path: &Path) {
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

fn fill(out: &Path) -> [&str; 7] {
    let out = out.to_str().unwrap();
    [
        "memory",
        "fill",
        "agent-driver",
        "--scenarios",
        "1",
        "--out",
        out,
    ]
}

#[test]
fn a_memory_is_written_through_the_users_link_and_over_no_pipe() {
    let work = tempfile::tempdir().unwrap();
    let (file, link) = (work.path().join("file.json"), work.path().join("link.json"));
    std::os::unix::fs::symlink(&file, &link).unwrap();
    let (code, _, stderr) = run(&fill(&link));
    assert_eq!(code, 0, "{stderr}");
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert!(fs::read_to_string(&file).unwrap().contains("agent-driver"));
    let (place, nowhere) = (work.path().join("pipe"), work.path().join("no/file.json"));
    pipe(&place);
    for (out, why) in [
        (place.as_path(), "pipe"),
        (work.path(), "folder"),
        (&nowhere, "there is no folder"),
    ] {
        let said = refused(&fill(out));
        assert!(said.contains(why), "{said}");
    }
    assert!(!fs::symlink_metadata(&place).unwrap().is_file());
}

#[test]
fn a_memory_of_a_stranger_is_read_within_limits_and_shown_not_obeyed() {
    let work = tempfile::tempdir().unwrap();
    let (memory, config) = (
        work.path().join("memory.json"),
        work.path().join("own.toml"),
    );
    let said = |text: Option<&str>| {
        let _ = fs::remove_file(&memory);
        match text {
            Some(text) => fs::write(&memory, text).unwrap(),
            None => pipe(&memory),
        }
        let setting = format!("language_agents.dilu.memory = '{}'\n", memory.display());
        fs::write(&config, setting).unwrap();
        let out = work.path().join("run");
        refused(&[
            "simulate",
            "--planner",
            "dilu",
            "--config",
            config.to_str().unwrap(),
            "--out",
            out.to_str().unwrap(),
        ])
    };
    let escapes = r#"{"format": 1, "agent": "\u001b[31mred\u202e", "source": "", "items": []}"#;
    let error = said(Some(escapes));
    assert!(
        error.contains("memory.json") && !error.contains(['\u{1b}', '\u{202e}']),
        "{error:?}"
    );
    let long = format!(
        r#"{{"format": 1, "agent": "dilu", "source": "", "items": [{{"description": "{}", "answer": "", "action": "idle", "comment": ""}}]}}"#,
        "far ".repeat(1 << 15)
    );
    let error = said(Some(&long));
    assert!(
        error.contains("description of item 1 has 131072 bytes"),
        "{error}"
    );
    let error = said(None);
    assert!(error.contains("pipe"), "{error}");
}
