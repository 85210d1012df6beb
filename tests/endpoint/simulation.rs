//! Whole simulations with a model behind a server, through the program.

use super::server::{Reaction, Server, completion, error, models, response, stream};
use crate::cli::{planagent, read_json};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A generated scene of 15 s; a planning call every 2 s.
pub(super) const SCENE: &str = "generated/high_magnitude_speed/1";
/// An answer that parses in every round.
pub(super) const ANSWER: &str = "Longitudinal: maintain, because the road is free\nLateral: keep, because it serves\n\
    Generate_IDM_Planner(c=ego_lane, la=None, v0=8, acc=1.0, dec=3.0)";
/// The API key, which no file and no message may contain.
const KEY: &str = "sk-test-3f9a-secret";

/// A run folder with its inputs.
pub(super) struct Run {
    folder: TempDir,
    pub(super) code: i32,
    pub(super) stderr: String,
}

impl Run {
    /// Simulates the scene with this description and configuration.
    pub(super) fn with(description: &str, config: &str) -> Self {
        let folder = TempDir::new().unwrap();
        let model = folder.path().join("server.toml");
        fs::write(&model, description).unwrap();
        Self::finished(folder, model.to_str().unwrap(), config)
    }

    pub(super) fn finished(folder: TempDir, model: &str, config: &str) -> Self {
        let path = folder.path().join("planagent.toml");
        fs::write(&path, config).unwrap();
        let output = planagent()
            .env("TEST_API_KEY", KEY)
            .args([
                "--config",
                path.to_str().unwrap(),
                "simulate",
                "--scenario",
                SCENE,
                "--model",
                model,
                "--out",
            ])
            .arg(folder.path().join("run"))
            .output()
            .unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        Self {
            code: output.status.code().unwrap(),
            stderr,
            folder,
        }
    }

    pub(super) fn path(&self) -> PathBuf {
        self.folder.path().join("run")
    }

    pub(super) fn summary(&self) -> Value {
        read_json(&self.path().join("summary.json"))
    }

    pub(super) fn calls(&self) -> Vec<Value> {
        let text = fs::read_to_string(self.path().join("calls.jsonl")).unwrap();
        text.lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect()
    }

    /// All text of the run's files and messages.
    fn everything(&self) -> String {
        fn walk(folder: &Path, text: &mut String) {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    walk(&path, text);
                } else {
                    text.push_str(&String::from_utf8_lossy(&fs::read(path).unwrap()));
                }
            }
        }
        let mut text = self.stderr.clone();
        walk(&self.path(), &mut text);
        text
    }
}

pub(super) fn description(server: &Server, more: &str) -> String {
    format!(
        "name = 'server'\nprompt_set = 'compact'\nsource = {{ endpoint = '{}', model = 'm', grammar = 'gbnf', \
         key_env = 'TEST_API_KEY', first_wait_ms = 1{more} }}\n",
        server.url()
    )
}

#[test]
fn a_simulation_continues_over_failures_of_every_kind() {
    // Each of these failures ends a planning call; the next request begins the next call.
    let server = Server::start(|number, _| match number {
        3 => Reaction::Hang(Vec::new()),
        4 => Reaction::Send(Vec::new()),
        5 => Reaction::Send(response("200 OK", "", "<html>")),
        6 => error("429 Too Many Requests", "", &format!("slow down, {KEY}")),
        7 => error(
            "503 Service Unavailable",
            "Retry-After: 900\r\n",
            "come back later",
        ),
        8 => stream(&["le"], false),
        _ => completion(ANSWER),
    });
    let run = Run::with(
        &description(&server, ", retries = 0, timeout_ms = 2000"),
        "[reflection]\nenabled = false\n",
    );
    assert_eq!(run.code, 1, "{}", run.stderr);
    let calls = run.calls();
    assert_eq!(calls.len(), 8);
    let decision = |call: &Value| call["decision"].clone();
    let expected = [
        "",
        "complete answer",
        "the connection ended",
        "not a chat completion",
        "status 429",
        "status 503: come back later",
        "stream ended",
        "",
    ];
    for (call, why) in calls.iter().zip(expected) {
        if why.is_empty() {
            assert_eq!(decision(call)["kind"], "execute", "{call}");
        } else {
            assert_eq!(
                (&decision(call)["kind"], &decision(call)["cause"]),
                (&"keep_active_plan".into(), &"model".into())
            );
            assert!(
                decision(call)["why"].as_str().unwrap().contains(why),
                "{why}: {}",
                decision(call)
            );
        }
    }
    let row = &run.summary()["scenarios"][0];
    assert_eq!(
        (&row["succeeded"], &row["failed_calls"], &row["deadlines"]),
        (&true.into(), &6.into(), &0.into())
    );
    assert!(row["score"].as_f64().is_some());
    assert!(
        run.stderr.contains("6 of 8 planning calls got no answer"),
        "{}",
        run.stderr
    );
    // The answers violate every round's grammar but parse, and the record says so.
    assert_eq!(
        calls[0]["attempts"][0]["rounds"][0]["constraint"],
        "violated"
    );
    assert!(!run.everything().contains(KEY) && server.received()[0].head.contains(KEY));
}

#[test]
fn retries_complete_a_simulation() {
    let server = Server::start(|number, _| match number % 3 {
        0 => error("429 Too Many Requests", "Retry-After: 0\r\n", "slow down"),
        1 => Reaction::Send(Vec::new()),
        _ => stream(&[ANSWER], true),
    });
    let run = Run::with(&description(&server, ""), "[reflection]\nenabled = false\n");
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert_eq!(run.summary()["scenarios"][0]["failed_calls"], 0);
    assert_eq!(server.received().len(), 3 * 3 * 8);
    let time = &run.calls()[0]["time"];
    let first = &time["attempts"][0]["rounds"][0];
    assert!(
        first["first_token"].as_f64().unwrap() > 0.0 && first["prefill"] == 0.0,
        "{first}"
    );
    assert!(time["call"]["remote"].as_f64().unwrap() <= time["call"]["total"].as_f64().unwrap());
    let manifest = fs::read_to_string(run.path().join("manifest.toml")).unwrap();
    assert!(
        manifest.contains(&server.url()),
        "the record names who answered:\n{manifest}"
    );
}

#[test]
fn a_refused_key_fails_the_start_or_the_simulation_and_a_missing_one_the_start() {
    let refusal = || {
        error(
            "401 Unauthorized",
            "",
            &format!("Incorrect API key provided: {KEY}"),
        )
    };
    // The key that expires after the run began.
    let server = Server::always(refusal);
    let run = Run::with(&description(&server, ""), "");
    assert_eq!(run.code, 1, "{}", run.stderr);
    let row = &run.summary()["scenarios"][0];
    let error = row["error"].as_str().unwrap();
    assert!(
        row["succeeded"] == false
            && error.contains("status 401: Incorrect API key provided: [key]"),
        "{error}"
    );
    assert!(!run.everything().contains(KEY));

    let server = Server::probed(move |_, _| refusal());
    let run = Run::with(&description(&server, ""), "");
    assert_eq!(run.code, 2, "{}", run.stderr);
    assert!(
        run.stderr
            .contains("status 401: Incorrect API key provided: [key]"),
        "{}",
        run.stderr
    );
    assert!(!run.path().exists() && server.received().len() == 1);

    let other = description(&server, "").replace("TEST_API_KEY", "PLANAGENT_NO_SUCH_API_KEY");
    let run = Run::with(&other, "");
    assert_eq!(run.code, 2, "{}", run.stderr);
    assert!(
        run.stderr.contains("PLANAGENT_NO_SUCH_API_KEY is not set"),
        "{}",
        run.stderr
    );
    assert!(!run.path().exists());

    let away = description(&server, "").replace(&server.url(), "http://192.0.2.1/v1");
    let run = Run::with(&away, "[mllm]\noffline = true\n");
    assert_eq!(run.code, 2, "{}", run.stderr);
    assert!(
        run.stderr.contains("mllm.offline forbids"),
        "{}",
        run.stderr
    );
}

#[test]
fn a_fault_that_no_retry_mends_ends_the_run_or_the_simulation_at_once() {
    let reasoning = r#"{"choices": [{"message": {"content": null, "reasoning_content": "Hm."}, "finish_reason": "stop"}]}"#;
    let refusal = r#"{"error": "Unexpected endpoint"}"#;
    for (reply, said) in [
        (reasoning, "reasoning parser"),
        (refusal, "Unexpected endpoint"),
    ] {
        let server = Server::probed(move |_, _| Reaction::Send(response("200 OK", "", reply)));
        let run = Run::with(&description(&server, ""), "");
        assert_eq!(run.code, 2, "{}", run.stderr);
        assert!(run.stderr.contains(said), "{}", run.stderr);
        assert!(!run.path().exists() && server.received().len() == 1);
    }
    // One that appears after the run began.
    let server = Server::always(move || Reaction::Send(response("200 OK", "", refusal)));
    let run = Run::with(&description(&server, ""), "");
    assert_eq!(run.code, 1, "{}", run.stderr);
    let row = &run.summary()["scenarios"][0];
    let error = row["error"].as_str().unwrap();
    assert!(
        row["succeeded"] == false && error.contains("Unexpected endpoint"),
        "{error}"
    );
    assert_eq!(server.received().len(), 1);
}

#[test]
fn the_first_failed_simulation_is_told_before_the_others_are_done() {
    let refusal = r#"{"error": "Unexpected endpoint"}"#;
    let server = Server::always(move || Reaction::Send(response("200 OK", "", refusal)));
    let folder = TempDir::new().unwrap();
    let model = folder.path().join("server.toml");
    fs::write(&model, description(&server, "")).unwrap();
    let output = planagent()
        .env("TEST_API_KEY", KEY)
        .args(["--threads", "1", "simulate", "--scenario", SCENE])
        .args(["generated/changing_lane/1", "generated/changing_lane/2"])
        .arg("--model")
        .arg(&model)
        .arg("--out")
        .arg(folder.path().join("run"))
        .output()
        .unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    let (during, after) = stderr.split_once("results in").unwrap();
    let told = |text: &str| text.matches("Unexpected endpoint").count();
    assert_eq!((told(during), told(after)), (1, 1), "{stderr}");
    assert!(
        during.contains(&format!("failed: {SCENE} (plan-agent")),
        "{stderr}"
    );
}

#[test]
fn a_server_is_simulated_by_its_address_alone() {
    let server = Server::start(|_, received| {
        if received.head.starts_with("GET /v1/models ") {
            models(&["eye"], "library")
        } else {
            completion(ANSWER)
        }
    });
    let config = "[reflection]\nenabled = false\n[agent]\ninterval_s = 100\n";
    for address in [server.url(), server.url().replace("/v1", "")] {
        let run = Run::finished(TempDir::new().unwrap(), &address, config);
        assert_eq!(run.code, 0, "{}", run.stderr);
        assert_eq!(run.summary()["scenarios"][0]["failed_calls"], 0);
        let manifest = fs::read_to_string(run.path().join("manifest.toml")).unwrap();
        assert!(
            manifest.contains("eye"),
            "the record names the model:\n{manifest}"
        );
    }
    assert_eq!(server.received()[1].body["model"], "eye");
    let several = Server::always(|| models(&["eye", "ear"], "library"));
    let run = Run::finished(TempDir::new().unwrap(), &several.url(), config);
    assert_eq!(run.code, 2, "{}", run.stderr);
    assert!(
        run.stderr.contains("offers eye, ear") && run.stderr.contains("/v1#NAME"),
        "{}",
        run.stderr
    );
}

#[test]
fn a_deadline_ends_the_call_and_keeps_the_active_plan() {
    let server = Server::start(|number, _| {
        if number < 3 {
            completion(ANSWER)
        } else {
            Reaction::Hang(Vec::new())
        }
    });
    let config = "[reflection]\nenabled = false\n[agent]\ndeadline_ms = 1500\n";
    let run = Run::with(&description(&server, ""), config);
    assert_eq!(run.code, 0, "a deadline is no failure: {}", run.stderr);
    let calls = run.calls();
    assert_eq!(calls[0]["decision"]["kind"], "execute");
    for call in &calls[1..] {
        assert_eq!(
            (&call["decision"]["kind"], &call["decision"]["cause"]),
            (&"keep_active_plan".into(), &"deadline".into())
        );
        assert!(call["time"]["call"]["total"].as_f64().unwrap() >= 1500.0);
    }
    let row = &run.summary()["scenarios"][0];
    assert_eq!(
        (&row["deadlines"], &row["failed_calls"]),
        (&7.into(), &0.into())
    );
    assert!(
        run.stderr
            .contains("7 of 8 planning calls ended at their deadline"),
        "{}",
        run.stderr
    );
}

/// The fixtures' LLaVA with a context for whole prompts.
fn roomy_llava(folder: &Path) -> PathBuf {
    let model = folder.join("llava");
    fs::create_dir(&model).unwrap();
    for entry in fs::read_dir(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/fixtures/tiny_llava"
    ))
    .unwrap()
    {
        let path = entry.unwrap().path();
        fs::copy(&path, model.join(path.file_name().unwrap())).unwrap();
    }
    let mut config = read_json(&model.join("config.json"));
    config["text_config"]["max_position_embeddings"] = 4096.into();
    fs::write(model.join("config.json"), config.to_string()).unwrap();
    model
}

/// The keys of an object, of its nested objects, and of the first element of each list.
fn shape(value: &Value) -> Value {
    match value {
        Value::Object(fields) => fields
            .iter()
            .map(|(name, field)| (name.clone(), shape(field)))
            .collect(),
        Value::Array(items) => items.iter().take(1).map(shape).collect(),
        _ => Value::Null,
    }
}

#[test]
fn another_model_changes_one_line_of_the_configuration_and_nothing_else() {
    let server = Server::always(|| completion(ANSWER));
    let folder = TempDir::new().unwrap();
    let described = folder.path().join("server.toml");
    fs::write(&described, description(&server, "")).unwrap();
    let models = [
        "nano".to_owned(),
        roomy_llava(folder.path()).to_str().unwrap().to_owned(),
        described.to_str().unwrap().to_owned(),
    ];
    let runs = models.map(|model| {
        let folder = TempDir::new().unwrap();
        let config =
            format!("[mllm]\nmodel = {model:?}\n[reasoning]\nprompt_set = 'compact'\n[reflection]\nmax_exec = 1\n");
        let path = folder.path().join("planagent.toml");
        fs::write(&path, config).unwrap();
        let out = folder.path().join("run");
        let output = planagent()
            .env("TEST_API_KEY", KEY)
            .args(["--config", path.to_str().unwrap(), "simulate", "--scenario", SCENE, "--out", out.to_str().unwrap()])
            .output()
            .unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(0), "{model}: {stderr}");
        Run { folder, code: 0, stderr }
    });
    let [nano, llava, endpoint] = runs.map(|run| {
        let calls = run.calls();
        assert_eq!(calls.len(), 8);
        let prompts: Vec<Value> = calls[0]["attempts"][0]["rounds"]
            .as_array()
            .unwrap()
            .iter()
            .map(|round| round["prompt"].clone())
            .collect();
        let manifest: toml::Table = fs::read_to_string(run.path().join("manifest.toml"))
            .unwrap()
            .parse()
            .unwrap();
        let mut config = manifest["config"].as_table().unwrap().clone();
        config["mllm"]
            .as_table_mut()
            .unwrap()
            .remove("model")
            .unwrap();
        let row = run.summary()["scenarios"][0].clone();
        assert_eq!(
            (&row["succeeded"], &row["failed_calls"]),
            (&true.into(), &0.into())
        );
        let files: Vec<String> = {
            let mut names: Vec<String> = fs::read_dir(run.path())
                .unwrap()
                .map(|entry| entry.unwrap().file_name().into_string().unwrap())
                .collect();
            names.sort();
            names
        };
        (prompts, config, shape(&row), files)
    });
    assert_eq!(nano, llava);
    assert_eq!(nano, endpoint);
    let url = &server.received()[0].body["messages"][1]["content"][0]["image_url"]["url"];
    assert!(
        url.as_str().unwrap().starts_with("data:image/png;base64,"),
        "the server sees the picture"
    );
}

#[test]
fn what_a_server_says_is_shown_and_not_obeyed() {
    let hostile = format!(
        "<img src=x onerror=alert(1)> & ![x](http://192.0.2.1/y) \u{1b}[2J\u{9b}31m {KEY}\n{ANSWER}"
    );
    let server = Server::always(move || completion(&hostile));
    let run = Run::with(
        &description(&server, ""),
        "[reflection]\nenabled = false\n[agent]\ninterval_s = 100\n",
    );
    assert_eq!(run.code, 0, "{}", run.stderr);
    let simulation = &crate::runner::simulations(&run.path())[0];
    let transcript = fs::read_to_string(simulation.join("transcript.md")).unwrap();
    assert!(
        transcript.contains("&lt;img src=x onerror=alert(1)> &amp; !\\[x]"),
        "{transcript}"
    );
    assert!(
        transcript.contains(r"\\u001b\[2J\\u009b31m \[key]") && !transcript.contains('\u{1b}'),
        "{transcript}"
    );
    assert!(!run.everything().contains(KEY));
    // The record has the answer as it was, without the key.
    let answer = run.calls()[0]["attempts"][0]["rounds"][0]["answer"]
        .as_str()
        .unwrap()
        .to_owned();
    assert!(
        answer.starts_with("<img src=x") && answer.contains("\u{1b}[2J\u{9b}31m [key]\n"),
        "{answer}"
    );
}

#[test]
fn another_description_of_the_server_is_no_way_to_resume() {
    let server = Server::always(|| completion(ANSWER));
    let run = Run::with(
        &description(&server, ""),
        "[reflection]\nenabled = false\n[agent]\ninterval_s = 100\n",
    );
    assert_eq!(run.code, 0, "{}", run.stderr);
    let resumed = |more: &str| {
        fs::write(
            run.folder.path().join("server.toml"),
            description(&server, more),
        )
        .unwrap();
        let mut command = planagent();
        command
            .env("TEST_API_KEY", KEY)
            .args(["simulate", "--resume"])
            .arg(run.path())
            .arg("--model")
            .arg(run.folder.path().join("server.toml"));
        let output = command.output().unwrap();
        (
            output.status.code().unwrap(),
            String::from_utf8(output.stderr).unwrap(),
        )
    };
    let (code, stderr) = resumed(", timeout_ms = 1234");
    assert_eq!(code, 0, "a time limit changes no answer: {stderr}");
    let (code, stderr) = resumed(", extra = { top_k = 3 }");
    assert!(
        code == 2 && stderr.contains("server description changed: extra"),
        "{stderr}"
    );
    let (code, stderr) = resumed("");
    assert_eq!(code, 0, "{stderr}");
}
