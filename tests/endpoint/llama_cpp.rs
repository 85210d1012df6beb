//! A simulation with llama.cpp's server from the Python package `llama-cpp-python[server]`.
//! `$PLANAGENT_LLAMA_PYTHON` is a Python with this package and the package `gguf`.

use crate::cli::{planagent, read_json};
use crate::outside::{Needy, llama_python};
use serde_json::Value;
use std::fs::{self, File};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// The server's process; the drop of this value ends it.
struct LlamaServer(Child);

impl Drop for LlamaServer {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts the server with a random model and waits until it listens.
fn start(python: &str, folder: &Path) -> (LlamaServer, String) {
    let model = folder.join("tiny.gguf");
    let script = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/fixtures/llama_cpp/make_tiny_gguf.py"
    );
    assert!(
        Command::new(python)
            .arg(script)
            .arg(&model)
            .status()
            .unwrap()
            .success()
    );
    let port = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port();
    let log = folder.join("server.log");
    let child = Command::new(python)
        .args([
            "-m",
            "llama_cpp.server",
            "--host",
            "127.0.0.1",
            "--n_ctx",
            "8192",
            "--n_threads",
            "1",
        ])
        .args(["--port", &port.to_string(), "--model"])
        .arg(&model)
        .stdout(Stdio::null())
        .stderr(File::create(&log).unwrap())
        .spawn()
        .unwrap();
    let mut server = LlamaServer(child);
    let address = format!("127.0.0.1:{port}");
    let started = Instant::now();
    while TcpStream::connect(&address).is_err() {
        let ended = server.0.try_wait().unwrap();
        assert!(
            ended.is_none() && started.elapsed() < Duration::from_mins(2),
            "the server does not listen ({ended:?}):\n{}",
            fs::read_to_string(&log).unwrap()
        );
        std::thread::sleep(Duration::from_millis(100));
    }
    (server, format!("http://{address}/v1"))
}

#[test]
fn a_random_model_on_llama_cpps_server_drives_under_our_grammars() -> Needy {
    let python = llama_python(&["gguf", "llama_cpp.server.app"])?;
    let folder = TempDir::new().unwrap();
    let (_server, url) = start(&python, folder.path());
    for stream in [false, true] {
        let description = folder.path().join("llama.toml");
        let source =
            format!("endpoint = '{url}', model = 'tiny', grammar = 'gbnf', stream = {stream}");
        fs::write(
            &description,
            format!("name = 'llama'\nprompt_set = 'compact'\nsource = {{ {source} }}\n"),
        )
        .unwrap();
        let config = folder.path().join("planagent.toml");
        fs::write(
            &config,
            "[environment]\nbev = false\n[reflection]\nmax_exec = 2\n",
        )
        .unwrap();
        let out = folder.path().join(format!("run-{stream}"));
        let output = planagent()
            .args([
                "--config",
                config.to_str().unwrap(),
                "simulate",
                "--scenario",
                "generated/changing_lane/3",
            ])
            .args([
                "--model",
                description.to_str().unwrap(),
                "--out",
                out.to_str().unwrap(),
            ])
            .output()
            .unwrap();
        assert_eq!(
            output.status.code(),
            Some(0),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        let row = read_json(&out.join("summary.json"))["scenarios"][0].clone();
        assert_eq!(
            (
                &row["planning_calls"],
                &row["failed_calls"],
                &row["parse_errors"]
            ),
            (&8.into(), &0.into(), &0.into())
        );
        let calls = fs::read_to_string(out.join("calls.jsonl")).unwrap();
        let mut rounds = 0;
        for call in calls
            .lines()
            .map(|line| serde_json::from_str::<Value>(line).unwrap())
        {
            for attempt in call["attempts"].as_array().unwrap() {
                for round in attempt["rounds"].as_array().unwrap() {
                    rounds += 1;
                    assert_eq!(round["constraint"], "satisfied", "{round}");
                    // llama-cpp-python counts tokens only in answers that come in one piece.
                    let counted = round["tokens"]["text"].as_u64().unwrap()
                        + round["tokens"]["cached"].as_u64().unwrap();
                    assert_eq!(
                        counted > 0 && round["tokens"]["sampled"].as_u64().unwrap() > 0,
                        !stream,
                        "{round}"
                    );
                }
            }
        }
        assert!(rounds >= 24, "{rounds} rounds");
    }
    Ok(())
}
