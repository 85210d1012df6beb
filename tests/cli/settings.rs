//! `--set` and `config`.

use super::{planagent, read_json, refused, run};
use serde_json::Value;
use std::fs;
use tempfile::TempDir;

#[test]
fn config_prints_every_setting_with_its_origin() {
    let work = TempDir::new().unwrap();
    fs::write(
        work.path().join("planagent.toml"),
        "[reflection]\nthreshold = 0.5\nmax_exec = 2\n",
    )
    .unwrap();
    let arguments = [
        "config",
        "--set",
        "reflection.max_exec=1",
        "--seed",
        "7",
        "--offline",
    ];
    let output = planagent()
        .args(arguments)
        .current_dir(work.path())
        .output()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    insta::with_settings!({prepend_module_to_snapshot => false}, {
        insta::assert_snapshot!("config", text);
    });
    // The output is a configuration with the same values.
    fs::write(work.path().join("planagent.toml"), &text).unwrap();
    let again = planagent()
        .args(["config", "--json"])
        .current_dir(work.path())
        .output()
        .unwrap();
    let settings: Vec<Value> = String::from_utf8(again.stdout)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let value = |key: &str| {
        settings
            .iter()
            .find(|one| one["key"] == key)
            .unwrap()
            .clone()
    };
    assert_eq!(
        (
            &value("seed")["value"],
            &value("reflection.max_exec")["value"]
        ),
        (&7.into(), &1.into())
    );
    assert_eq!(value("reflection.threshold")["origin"], "planagent.toml");
    assert_eq!(value("agent.gate")["value"], Value::Null);
}

#[test]
fn a_setting_is_replaced_for_one_run() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    let out = out.to_str().unwrap();
    let flags = [
        "simulate",
        "--planner",
        "simple",
        "--quiet",
        "--set",
        "reflection.threshold=0.25",
        "--out",
        out,
    ];
    let (code, _, stderr) = run(&[&flags[..], &["--set", "mllm.model=other"]].concat());
    assert_eq!(code, 0, "{stderr}");
    let config: toml::Table = fs::read_to_string(work.path().join("run/config.toml"))
        .unwrap()
        .parse()
        .unwrap();
    assert_eq!(config["reflection"]["threshold"].as_float(), Some(0.25));
    assert_eq!(config["mllm"]["model"].as_str(), Some("other"));
    // The run keeps it.
    assert_eq!(run(&["simulate", "--resume", out, "--quiet"]).0, 0);
    let other = refused(&[
        "simulate",
        "--resume",
        out,
        "--set",
        "reflection.threshold=0.5",
    ]);
    assert!(
        other.contains("config.reflection.threshold: was 0.25, is 0.5"),
        "{other}"
    );
    assert_eq!(read_json(&work.path().join("run/summary.json"))["seed"], 0);
}

#[test]
fn the_variables_of_the_hub_switch_the_network_off() {
    let work = TempDir::new().unwrap();
    let offline = |variables: &[(&str, &str)], arguments: &[&str]| {
        let mut command = planagent();
        command
            .args(["config", "--json"])
            .args(arguments)
            .current_dir(work.path())
            .env_remove("HF_HUB_OFFLINE")
            .env_remove("TRANSFORMERS_OFFLINE")
            .envs(variables.iter().copied());
        let stdout = String::from_utf8(command.output().unwrap().stdout).unwrap();
        let settings = stdout
            .lines()
            .map(|line| serde_json::from_str::<Value>(line).unwrap());
        let setting = settings
            .into_iter()
            .find(|setting| setting["key"] == "mllm.offline")
            .unwrap();
        let origin = setting["origin"].as_str().unwrap().to_owned();
        (setting["value"].as_bool().unwrap(), origin)
    };
    let said = |value: bool, origin: &str| (value, origin.to_owned());
    assert_eq!(offline(&[], &[]), said(false, "default"));
    for value in ["1", "True", "yes", "ON"] {
        assert_eq!(
            offline(&[("HF_HUB_OFFLINE", value)], &[]),
            said(true, "HF_HUB_OFFLINE")
        );
    }
    assert_eq!(
        offline(&[("TRANSFORMERS_OFFLINE", "1")], &[]),
        said(true, "TRANSFORMERS_OFFLINE")
    );
    assert_eq!(
        offline(&[("HF_HUB_OFFLINE", "0")], &[]),
        said(false, "default")
    );
    assert_eq!(
        offline(&[("HF_HUB_OFFLINE", "1")], &["--set", "mllm.offline=false"]),
        said(false, "--set")
    );
}

#[test]
fn config_explains_settings_and_writes_the_commented_file() {
    let work = TempDir::new().unwrap();
    let config = |flags: &[&str]| {
        let output = planagent()
            .arg("config")
            .args(flags)
            .current_dir(work.path())
            .output()
            .unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        let code = output.status.code().unwrap();
        (code, text(output.stdout), text(output.stderr))
    };
    let (code, plain, _) = config(&[]);
    assert_eq!(code, 0);
    let (code, explained, _) = config(&["--explain"]);
    assert_eq!(code, 0);
    let about = explained.find("# Maximum number of attempts of a planning call.");
    assert!(about.unwrap() < explained.find("max_exec = 3").unwrap());
    assert!(
        explained.lines().all(|line| line.chars().count() <= 80
            || !line.starts_with("# ")
            || line.contains(" # ")),
        "{explained}"
    );
    let settings = |text: &str| text.parse::<toml::Table>().unwrap();
    assert_eq!(settings(&explained), settings(&plain));
    let (_, json, _) = config(&["--explain", "--json"]);
    let all: Vec<Value> = json
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert!(all.iter().all(|one| one["about"].is_string()), "{json}");

    let (code, stdout, stderr) = config(&["--init"]);
    assert_eq!((code, stdout.trim()), (0, "planagent.toml"), "{stderr}");
    let file = work.path().join("planagent.toml");
    let text = fs::read_to_string(&file).unwrap();
    assert_eq!(settings(&text), settings(&plain));
    fs::write(&file, "seed = 7\n").unwrap();
    let (code, _, stderr) = config(&["--init"]);
    assert!(code == 2 && stderr.contains("exists"), "{stderr}");
    assert_eq!(fs::read_to_string(&file).unwrap(), "seed = 7\n");
}
