//! The card of a model.

use super::{read_json, refused, run};
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Makes a card of nano on one scene of each suite.
fn make(out: &Path, more: &[&str]) -> String {
    let arguments = [
        "card",
        "--limit",
        "1",
        "--quiet",
        "--out",
        out.to_str().unwrap(),
    ];
    let (code, stdout, stderr) = run(&[&arguments[..], more].concat());
    assert_eq!(code, 0, "{stderr}");
    stdout
}

#[test]
fn a_card_is_complete_and_the_same_bytes_with_the_times_of_another() {
    let work = TempDir::new().unwrap();
    let (first, second) = (work.path().join("first"), work.path().join("second"));
    let printed: Value = serde_json::from_str(&make(&first, &["--json"])).unwrap();
    let card = read_json(&first.join("card.json"));
    assert_eq!(printed, card);
    let text = fs::read_to_string(first.join("card.md")).unwrap();
    let page = fs::read_to_string(first.join("card.html")).unwrap();
    let plot = fs::read_to_string(first.join("calibration.svg")).unwrap();
    assert!(page.contains(plot.trim_end()) && text.contains("](calibration.svg)"));
    assert!(
        text.contains("$ planagent card --model nano --limit 1\n"),
        "{text}"
    );
    assert!(!text.contains("Not available"), "{text}");
    for part in ["calibration", "twins", "reasoning", "measured"] {
        assert!(
            card[part].is_object() && card[part].get("not_available").is_none(),
            "{part}"
        );
    }
    assert_eq!(card["states"]["asked"], 4);
    let rows = card["scores"].as_array().unwrap();
    let of_control = |row: &&Value| row["source"] == "fixed-code" && row["model_minus"].is_object();
    // One scene of two suites: three panels.
    assert_eq!(
        (rows.len(), rows.iter().filter(of_control).count()),
        (21, 3),
        "{rows:?}"
    );
    assert_eq!(card["measured"]["late"].as_array().unwrap().len(), 3);

    let earlier = first.join("card.json");
    make(&second, &["--latency-of", earlier.to_str().unwrap()]);
    for file in ["card.json", "card.md", "card.html", "calibration.svg"] {
        let bytes = |folder: &Path| fs::read(folder.join(file)).unwrap();
        assert!(bytes(&first) == bytes(&second), "{file} differs");
    }
    // A card that is complete is written again from its runs.
    make(&second, &[]);
    let without_times = |folder: &Path| {
        let mut card = read_json(&folder.join("card.json"));
        card.as_object_mut().unwrap().remove("measured");
        card
    };
    assert_eq!(without_times(&first), without_times(&second));
}

#[test]
fn what_no_card_can_be_made_of_is_refused_before_the_model_loads() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("card");
    let out = out.to_str().unwrap();
    let file = work.path().join("other.json");
    fs::write(&file, "{}").unwrap();
    for (arguments, told) in [
        (&["--limit", "0"][..], "--limit"),
        (&["--set", "agent.latency=20"], "agent.latency is set"),
        (
            &["--set", "agent.deadline_ms=20"],
            "agent.deadline_ms is set",
        ),
        (&["--latency-of", "nowhere"], "nowhere"),
        (
            &["--latency-of", file.to_str().unwrap()],
            "it has no block measured",
        ),
        (&["--model", "no_such_model"], "no_such_model"),
    ] {
        let error = refused(&[&["card", "--out", out][..], arguments].concat());
        assert!(error.contains(told), "{told}: {error}");
        assert!(!Path::new(out).exists(), "{told}");
    }
}
