//! `ask`: a free question about a scene.

use super::{SCENE, refused, run};
use crate::endpoint::server::{Server, stream};
use serde_json::Value;
use std::fs;
use tempfile::TempDir;

const TINY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/tiny_llava");

#[test]
fn a_local_model_answers_on_stdout_and_the_rest_goes_to_stderr() {
    let work = TempDir::new().unwrap();
    let picture = work.path().join("asked.png");
    let flags = [
        "ask",
        "Who is ahead?",
        "--scenario",
        SCENE,
        "--model",
        TINY,
        "--prompt-set",
        "compact",
        "--max-tokens",
        "6",
    ];
    let (code, stdout, stderr) =
        run(&[&flags[..], &["--image", picture.to_str().unwrap()]].concat());
    assert_eq!(code, 0, "{stderr}");
    assert!(stdout.ends_with('\n'), "{stdout:?}");
    assert!(
        stderr.contains("trained on the prompts of its own set alone")
            && stderr.contains("tokens in "),
        "{stderr}"
    );
    assert!(image::open(&picture).unwrap().width() > 0);
    let (code, json, stderr) = run(&[&flags[..], &["--json", "--quiet"]].concat());
    assert_eq!((code, stderr.as_str()), (0, ""));
    let record: Value = serde_json::from_str(&json).unwrap();
    // What was printed piece by piece is the answer.
    assert_eq!(
        record["answer"].as_str().unwrap(),
        stdout.strip_suffix('\n').unwrap()
    );
    let tokens = record["tokens"]["sampled"].as_u64().unwrap();
    assert!(
        tokens <= 6 && record["seconds"].as_f64().unwrap() > 0.0,
        "{record}"
    );
    assert_eq!(record["prompt"], "Who is ahead?");
    let (_, with_text, _) = run(&[&flags[..], &["--json", "--quiet", "--lane-graph"]].concat());
    let with_text: Value = serde_json::from_str(&with_text).unwrap();
    assert!(
        with_text["prompt"]
            .as_str()
            .unwrap()
            .ends_with("\nWho is ahead?"),
        "{with_text}"
    );
}

#[test]
fn a_server_is_asked_with_the_picture_and_answers_in_pieces() {
    let server = Server::always(|| stream(&["The light ", "is red."], true));
    let work = TempDir::new().unwrap();
    let description = work.path().join("server.toml");
    let text = format!(
        "name = 'server'\nprompt_set = 'paper'\n[source]\nendpoint = '{}'\nmodel = 'm'\ngrammar = 'none'\nimage_size = 336\n",
        server.url()
    );
    fs::write(&description, text).unwrap();
    let flags = [
        "ask",
        "Is the light red?",
        "--scenario",
        SCENE,
        "--lane-graph",
        "--max-tokens",
        "20",
        "--model",
    ];
    let (code, stdout, stderr) = run(&[&flags[..], &[description.to_str().unwrap()]].concat());
    assert_eq!(
        (code, stdout.as_str()),
        (0, "The light is red.\n"),
        "{stderr}"
    );
    assert!(!stderr.contains("own set alone"), "{stderr}");
    let asked = &server.received()[0].body;
    assert!(
        asked["messages"][0]["content"]
            .as_str()
            .unwrap()
            .contains("A red arrow shows"),
        "{asked}"
    );
    let content = asked["messages"][1]["content"].as_array().unwrap();
    assert!(
        content[0]["image_url"]["url"]
            .as_str()
            .unwrap()
            .starts_with("data:image/png")
    );
    let prompt = content[1]["text"].as_str().unwrap();
    assert!(
        prompt.starts_with("Ego: ") && prompt.ends_with("\nIs the light red?"),
        "{prompt}"
    );
    assert!(asked.to_string().contains("20"), "{asked}");
}

#[test]
fn what_cannot_be_asked_says_why() {
    assert!(refused(&["ask", " "]).contains("the question is empty"));
    assert!(refused(&["ask", "What?", "--max-tokens", "0"]).contains("--max-tokens"));
    assert!(refused(&["ask", "What?", "--at", "99"]).contains("--at 99 lies outside"));
    let folder = refused(&["ask", "What?", "--image", "no/such/folder/a.png"]);
    assert!(
        folder.contains("there is no folder no/such/folder"),
        "{folder}"
    );
}
