//! The card of a model behind a server.

use super::server::{Server, completion};
use super::simulation::{ANSWER, description};
use crate::cli::{planagent, read_json};
use std::fs;
use tempfile::TempDir;

#[test]
fn the_card_of_a_server_lacks_probabilities_and_gives_it_changed_answers() {
    let server = Server::always(|| completion(ANSWER));
    let work = TempDir::new().unwrap();
    let (model, out) = (work.path().join("server.toml"), work.path().join("card"));
    fs::write(&model, description(&server, "")).unwrap();
    let output = planagent()
        .env("TEST_API_KEY", "sk-test")
        .args(["card", "--quiet", "--limit", "1", "--model"])
        .arg(&model)
        .arg("--out")
        .arg(&out)
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
    let card = read_json(&out.join("card.json"));
    let missing = "the server gives no probabilities";
    assert_eq!(card["calibration"]["not_available"], missing);
    let text = fs::read_to_string(out.join("card.md")).unwrap();
    assert!(
        text.contains("Not available: the server gives no probabilities."),
        "{text}"
    );
    assert!(!out.join("calibration.svg").exists());
    assert_eq!(card["model"]["server"]["model"], "m");
    // What is changed in an answer stands in the chat of the next question, and no question asks
    // for it. This server says the same all the same.
    let asked = |words: &str| {
        let bodies = server.received();
        bodies
            .iter()
            .any(|one| one.body.to_string().contains(words))
    };
    assert!(asked("Longitudinal: decelerate") && asked("Longitudinal: maintain"));
    let changes = card["reasoning"]["changes"].as_array().unwrap();
    let slower = changes
        .iter()
        .find(|row| row["change"] == "the speed becomes decelerate")
        .unwrap();
    assert_eq!(slower["agree"]["count"], 0, "{slower}");
    assert!(slower["agree"]["of"].as_u64().unwrap() > 0, "{slower}");
}
