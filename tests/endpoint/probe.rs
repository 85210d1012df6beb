//! The two short questions that a server is asked before a run, and alone by `models check`; and
//! what a run says of calls that give no plan.

use super::server::{Reaction, Server, completion, error, is_probe, response};
use super::simulation::{ANSWER, Run, SCENE, description};
use crate::cli::planagent;
use planagent::Agent;
use planagent::planning::PlanAgentSettings;
use serde_json::{Value, json};
use std::fs;
use tempfile::TempDir;

/// One planning call a simulation.
const FEW: &str = "[reflection]\nenabled = false\n[agent]\ninterval_s = 100\n";

/// The color of the picture of a request.
fn color(request: &super::server::Received) -> &'static str {
    use base64::Engine;
    let url = request.body["messages"][1]["content"][0]["image_url"]["url"]
        .as_str()
        .unwrap();
    let png = url.strip_prefix("data:image/png;base64,").unwrap();
    let png = base64::prelude::BASE64_STANDARD.decode(png).unwrap();
    let picture = image::load_from_memory(&png).unwrap().to_rgb8();
    if picture.get_pixel(0, 0).0[0] > 128 {
        "red"
    } else {
        "blue"
    }
}

/// A server whose model sees, and answers every other question with `answer`.
fn seeing(answer: &'static str) -> Server {
    Server::probed(move |_, request| {
        if is_probe(request) {
            completion(color(request))
        } else {
            completion(answer)
        }
    })
}

/// Exit code, stdout and stderr of `models check` for a described server.
fn checked(server: &Server) -> (i32, String, String) {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("server.toml");
    fs::write(&path, description(server, "")).unwrap();
    let output = planagent()
        .env("TEST_API_KEY", "sk-any")
        .args(["models", "check"])
        .arg(&path)
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (
        output.status.code().unwrap(),
        text(output.stdout),
        text(output.stderr),
    )
}

#[test]
fn two_questions_come_before_a_run_and_change_nothing_of_it() {
    let server = seeing(ANSWER);
    let run = Run::with(&description(&server, ""), FEW);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let received = server.received();
    let probes: Vec<bool> = received.iter().map(is_probe).collect();
    assert_eq!(&probes[..3], [true, true, false], "{probes:?}");
    assert_eq!(probes.iter().filter(|probe| **probe).count(), 2);
    assert!(
        received[0].body["grammar"].is_string(),
        "the grammar is tried, too"
    );
    assert!(!run.stderr.contains("picture"), "{}", run.stderr);
    let hidden = Server::always(|| completion(ANSWER));
    let other = Run::with(&description(&hidden, ""), FEW);
    let calls = |run: &Run| {
        let mut calls = run.calls();
        for call in &mut calls {
            call.as_object_mut().unwrap().remove("time");
        }
        calls
    };
    assert_eq!(calls(&run), calls(&other));
    // A run whose simulations are completed asks nothing.
    let before = server.received().len();
    let described = run.path().with_file_name("server.toml");
    let output = planagent()
        .env("TEST_API_KEY", "sk-any")
        .args(["simulate", "--model"])
        .arg(described)
        .arg("--resume")
        .arg(run.path())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0));
    assert_eq!(server.received().len(), before);
}

#[test]
fn a_server_that_is_not_there_ends_the_run_before_it_begins() {
    let folder = TempDir::new().unwrap();
    let port = std::net::TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port();
    let text = format!(
        "name = 'gone'\nprompt_set = 'compact'\nsource = {{ endpoint = 'http://127.0.0.1:{port}/v1', model = 'm', \
         grammar = 'none', retries = 1, first_wait_ms = 1 }}\n"
    );
    let path = folder.path().join("gone.toml");
    fs::write(&path, text).unwrap();
    let run = Run::finished(folder, path.to_str().unwrap(), "");
    assert_eq!(run.code, 2, "{}", run.stderr);
    assert!(
        run.stderr.contains("'gone' cannot be asked") && run.stderr.contains("cannot connect"),
        "{}",
        run.stderr
    );
    assert!(!run.path().exists());
}

#[test]
fn the_library_asks_a_server_before_an_agent_depends_on_it() {
    let folder = TempDir::new().unwrap();
    let described = |url: &str| {
        let path = folder.path().join("server.toml");
        let text = format!(
            "name = 'server'\nprompt_set = 'compact'\nsource = {{ endpoint = '{url}', model = 'm', grammar = 'gbnf', \
             retries = 0 }}\n"
        );
        fs::write(&path, text).unwrap();
        Agent::builder().model(path.to_str().unwrap())
    };
    let blind = Server::probed(|_, _| completion("red"));
    let agent = described(&blind.url()).build().unwrap();
    assert_eq!(blind.received().len(), 2);
    let [remark] = agent.remarks() else {
        panic!("{:?}", agent.remarks())
    };
    assert!(remark.contains("may not look at pictures"), "{remark}");
    let mut settings = PlanAgentSettings::default();
    settings.environment.bev = false;
    let builder = described(&blind.url()).settings(settings);
    assert!(builder.build().unwrap().remarks().is_empty());
    assert_eq!(blind.received().len(), 3);
    let broken = Server::probed(|_, _| error("404 Not Found", "", "no such model"));
    let problem = described(&broken.url()).build().unwrap_err().to_string();
    assert!(problem.contains("no such model"), "{problem}");
    assert!(Agent::builder().build().unwrap().remarks().is_empty());
}

#[test]
fn a_server_that_loads_its_model_is_waited_for_and_that_is_said() {
    let server = Server::probed(|number, request| {
        if number < 3 {
            error("503 Service Unavailable", "", "Loading model")
        } else if is_probe(request) {
            completion(color(request))
        } else {
            completion(ANSWER)
        }
    });
    let run = Run::with(&description(&server, ""), FEW);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let told = run.stderr.matches("Loading model").count();
    assert_eq!(told, 1, "{}", run.stderr);
    let never = Server::probed(|_, _| error("503 Service Unavailable", "", "Loading model"));
    let run = Run::with(&description(&never, ", timeout_ms = 300"), FEW);
    assert_eq!(run.code, 2, "{}", run.stderr);
    assert!(
        run.stderr.contains("status 503: Loading model"),
        "{}",
        run.stderr
    );
}

#[test]
fn a_server_is_checked_alone() {
    let (code, said, stderr) = checked(&seeing(ANSWER));
    assert_eq!(code, 0, "{said}{stderr}");
    assert!(said.contains("m at http://127.0.0.1:"), "{said}");
    for (server, problem) in [
        (
            Server::probed(|_, _| completion("red")),
            "may not look at pictures",
        ),
        (
            Server::probed(|_, request| {
                completion(if color(request) == "red" {
                    "blue"
                } else {
                    "red"
                })
            }),
            "may see pictures badly",
        ),
        (Server::probed(|_, _| completion("")), "with nothing"),
        (
            Server::probed(|_, request| completion(&format!("It is {}.", color(request)))),
            "does not follow the grammar (gbnf)",
        ),
        (
            Server::probed(|_, _| {
                error(
                    "400 Bad Request",
                    "",
                    "image input is not supported by this model",
                )
            }),
            "start the server with a model that sees",
        ),
        (
            Server::probed(|_, request| {
                if request.head.starts_with("GET ") {
                    super::server::models(&["eye", "ear"], "library")
                } else {
                    error("404 Not Found", "", "model 'm' not found")
                }
            }),
            "the server offers eye, ear",
        ),
        (
            Server::probed(|_, _| Reaction::Send(response("200 OK", "", "<html>"))),
            "not a chat completion",
        ),
    ] {
        let (code, said, stderr) = checked(&server);
        assert_eq!(code, 1, "{said}{stderr}");
        assert!(said.contains(problem), "{problem}: {said}");
        let asked = server.received();
        let questions = asked.iter().filter(|request| is_probe(request)).count();
        assert!(questions <= 2, "{problem}: {questions} questions");
    }
}

#[test]
fn calls_without_a_plan_are_told_at_once_counted_by_cause_and_no_success() {
    for (answer, cause, told) in [
        (
            "I am sorry, I cannot drive.",
            "no_line",
            "it begins: \"I am sorry",
        ),
        (
            "Generate_IDM_Planner(c=the_moon, la=None, v0=8, acc=1.0, dec=3.0)",
            "wrong_line",
            "the line of the answer is wrong",
        ),
    ] {
        let server = seeing(answer);
        let run = Run::with(&description(&server, ""), "[reflection]\nmax_exec = 1\n");
        assert_eq!(run.code, 1, "{}", run.stderr);
        assert_eq!(
            run.stderr.matches("a planning call gave no plan").count(),
            1
        );
        assert!(run.stderr.contains(told), "{}", run.stderr);
        assert!(
            run.stderr
                .contains("in 1 of 1 simulations no planning call gave a plan"),
            "{}",
            run.stderr
        );
        let calls = run.calls();
        assert_eq!(calls[0]["decision"]["cause"], "unreadable");
        assert_eq!(calls[0]["decision"]["sub_cause"], cause);
        let row = &run.summary()["scenarios"][0];
        let counts = json!({cause: calls.len()});
        assert_eq!(
            (&row["unreadable_calls"], &row["without_plan"]),
            (&counts, &Value::Bool(true))
        );
        let aggregate = &run.summary()["aggregates"][0];
        assert_eq!(
            (&aggregate["failed"], &aggregate["without_plan"]),
            (&json!(0), &json!(1))
        );
    }
}

#[test]
fn a_simulation_with_one_plan_is_a_success_and_deadlines_do_not_count() {
    let server = Server::start(|number, _| completion(if number < 3 { ANSWER } else { "No." }));
    let run = Run::with(
        &description(&server, ""),
        "[reflection]\nenabled = false\nmax_exec = 1\n",
    );
    assert_eq!(run.code, 0, "{}", run.stderr);
    let row = &run.summary()["scenarios"][0];
    assert!(row.get("without_plan").is_none(), "{row}");
    let hanging = Server::start(|_, _| Reaction::Hang(Vec::new()));
    let config = "[agent]\ndeadline_ms = 50\ninterval_s = 100\n";
    let run = Run::with(&description(&hanging, ""), config);
    assert_eq!(run.code, 0, "a deadline is no failure: {}", run.stderr);
}

#[test]
fn an_empty_answer_to_a_question_is_no_success() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("server.toml");
    let server = Server::start(|_, _| completion(" \n"));
    fs::write(&path, description(&server, "")).unwrap();
    let output = planagent()
        .env("TEST_API_KEY", "sk-any")
        .args(["ask", "Is it red?", "--scenario", SCENE, "--model"])
        .arg(&path)
        .output()
        .unwrap();
    assert_ne!(output.status.code(), Some(0));
}
