//! `planagent bench`: output, result folder, and failures of single models.

#[cfg(unix)]
mod openvino;

use crate::cli::{planagent, read_json, refused, run};
use crate::outside::{Needy, llama_python};
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

fn rows(folder: &Path) -> Vec<Value> {
    let text = fs::read_to_string(folder.join("rows.jsonl")).unwrap();
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

/// Runs a benchmark on one thread; returns the exit code and the statistics.
fn bench(arguments: &[&str], out: &Path) -> (i32, Value) {
    let out = ["--threads", "1", "--json", "--out", out.to_str().unwrap()];
    let (code, stdout, stderr) = run(&[&["bench"], arguments, &out].concat());
    (
        code,
        serde_json::from_str(&stdout).unwrap_or_else(|_| panic!("{stdout}{stderr}")),
    )
}

#[test]
fn a_model_of_a_server_is_refused_before_any_is_measured() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("bench");
    let said = refused(&[
        "bench",
        "nano",
        "http://127.0.0.1:9/v1",
        "--out",
        out.to_str().unwrap(),
    ]);
    assert!(said.contains("models in this process"), "{said}");
    assert!(said.contains("planagent models check"), "{said}");
    assert!(!out.exists());
}

#[test]
fn a_model_is_measured_by_its_steps() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("bench");
    let (code, figures) = bench(&["nano", "--warm-up", "1", "--iterations", "2"], &out);
    assert_eq!(code, 0);
    let model = &figures["models"][0];
    assert_eq!(
        (&model["model"], &model["engine"], &model["calls"]),
        (&"nano".into(), &"planagent".into(), &2.into())
    );
    for key in [
        "image_encode_ms",
        "prefill_tokens_per_s",
        "first_token_ms",
        "decode_tokens_per_s",
    ] {
        assert!(model[key].as_f64().unwrap() > 0.0, "{key}: {model}");
    }
    assert!(model["call_ms"]["p95"].as_f64() >= model["call_ms"]["p50"].as_f64());
    assert_eq!(model["loaded"]["image_tokens"], 64);
    assert!(model["peak_memory"].as_u64().unwrap() > 1 << 20);

    let rows = rows(&out);
    let kinds: Vec<(&str, bool)> = rows
        .iter()
        .map(|row| (row["row"].as_str().unwrap(), row["warm_up"] == true))
        .collect();
    assert_eq!(
        kinds,
        [
            ("iteration", true),
            ("iteration", false),
            ("iteration", false),
            ("model", false)
        ]
    );
    // Only tokens before a sampled token are computed; those at the end of an answer wait for the
    // next prompt.
    let steps = rows[1]["steps"].as_array().unwrap();
    let (mut pending, mut expected, mut computed) = (0, 0, 0);
    for timed in steps {
        let tokens = |key: &str| timed["step"][key].as_u64();
        if timed["step"] == "image" {
            pending += 64;
        } else if tokens("keep").is_some() {
            pending = 0;
        } else if let Some(sampled) = tokens("sampled") {
            expected += pending + sampled - 1;
            pending = 1;
        } else {
            pending += tokens("text").or(tokens("fast_forwarded")).unwrap_or(0);
        }
        computed += ["batch", "single"]
            .map(|kind| timed["time"][kind]["tokens"].as_u64().unwrap())
            .iter()
            .sum::<u64>();
    }
    assert_eq!(computed, expected);
    assert!(computed > 64);

    let metadata = read_json(&out.join("metadata.json"));
    assert!(
        metadata["cpu"].is_string() && metadata["settings"]["threads"] == 1,
        "{metadata}"
    );
    let table = fs::read_to_string(out.join("table.md")).unwrap();
    assert!(table.contains("| nano |"), "{table}");
}

#[test]
fn calls_of_several_prompt_sets_are_measured_with_and_without_drafts() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("bench");
    let arguments = [
        "--random-weights",
        "nano",
        "--calls",
        "brief,compact",
        "--speculation",
    ];
    let (code, figures) = bench(
        &[&arguments[..], &["--warm-up", "0", "--iterations", "1"]].concat(),
        &out,
    );
    assert_eq!(code, 0, "{figures}");
    let models = figures["models"].as_array().unwrap();
    let names: Vec<&str> = models
        .iter()
        .map(|model| model["model"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["nano brief", "nano compact"]);
    for model in models {
        let calls = model["drafted_calls"].as_array().unwrap();
        let rates: Vec<f64> = calls
            .iter()
            .map(|call| call["acceptance"].as_f64().unwrap())
            .collect();
        assert_eq!(rates, [0.25, 0.5, 0.75]);
        assert!(calls.iter().all(|call| call["ms"].as_f64().unwrap() > 0.0));
    }
    let passes = |workload: &str| {
        let row = rows(&out)
            .into_iter()
            .find(|row| row["model"] == "nano compact" && row["workload"] == workload);
        let steps = row.unwrap()["steps"].as_array().unwrap().clone();
        steps
            .iter()
            .filter(|timed| timed["time"]["first_token_ms"].is_number())
            .count()
    };
    assert!(
        passes("call") >= passes("call-accepted-0.25")
            && passes("call-accepted-0.25") > passes("call-accepted-0.75")
    );
    let table = fs::read_to_string(out.join("table.md")).unwrap();
    assert!(table.contains("| 0.75 (three quarters) |"), "{table}");
}

#[test]
fn random_weights_have_the_shape_of_the_real_ones() {
    let folder = TempDir::new().unwrap();
    let quick = ["--warm-up", "0", "--iterations", "1"];
    let (_, real) = bench(
        &[&["nano"][..], &quick].concat(),
        &folder.path().join("real"),
    );
    let (_, random) = bench(
        &[&["--random-weights", "nano"][..], &quick].concat(),
        &folder.path().join("random"),
    );
    for key in ["parameters", "image_tokens", "context"] {
        assert_eq!(
            real["models"][0]["loaded"][key], random["models"][0]["loaded"][key],
            "{key}"
        );
    }
}

#[test]
fn a_benchmark_resumes_only_with_the_same_settings() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("bench");
    let arguments = ["nano", "--warm-up", "0", "--iterations", "1"];
    assert_eq!(bench(&arguments, &out).0, 0);
    let before = fs::read(out.join("rows.jsonl")).unwrap();
    let resume = ["--threads", "1", "--resume", out.to_str().unwrap()];
    let (code, _, stderr) = run(&[&["bench"], &arguments[..], &resume].concat());
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(
        fs::read(out.join("rows.jsonl")).unwrap(),
        before,
        "completed rows stay"
    );
    let otherwise = ["nano", "--warm-up", "0", "--iterations", "2"];
    let stderr = refused(&[&["bench"], &otherwise[..], &resume].concat());
    assert!(stderr.contains("iterations: was 1, is 2"), "{stderr}");
    fs::write(out.join("rows.jsonl"), "{\"row\": 3}\n").unwrap();
    let stderr = refused(&[&["bench"], &arguments[..], &resume].concat());
    assert!(
        stderr.contains("rows.jsonl") && stderr.contains("line 1"),
        "{stderr}"
    );
}

#[test]
fn a_broken_model_fails_alone() {
    let folder = TempDir::new().unwrap();
    let broken = folder.path().join("broken");
    fs::create_dir(&broken).unwrap();
    let arguments = [
        broken.to_str().unwrap(),
        "nano",
        "--warm-up",
        "0",
        "--iterations",
        "1",
    ];
    let (code, figures) = bench(&arguments, &folder.path().join("bench"));
    assert_eq!(code, 1);
    assert!(
        figures["failed"][0][1]
            .as_str()
            .unwrap()
            .contains("config.json"),
        "{figures}"
    );
    assert_eq!(figures["models"][0]["model"], "nano");
}

#[test]
fn a_benchmark_without_a_measurement_leaves_no_folder() {
    let folder = TempDir::new().unwrap();
    let broken = folder.path().join("broken");
    fs::create_dir(&broken).unwrap();
    let bench = |arguments: &[&str]| {
        let arguments = [&["bench", "--warm-up", "0", "--iterations", "1"], arguments].concat();
        let output = planagent()
            .current_dir(&folder)
            .args(arguments)
            .output()
            .unwrap();
        let left: Vec<_> = fs::read_dir(&folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .collect();
        assert_eq!(left, ["broken"]);
        (
            output.status.code(),
            String::from_utf8(output.stderr).unwrap(),
        )
    };
    let (code, stderr) = bench(&[broken.to_str().unwrap()]);
    assert!(
        code == Some(1) && stderr.contains("nothing was written"),
        "{stderr}"
    );
    let (code, stderr) = bench(&["nano", "--vs", "llama.cpp"]);
    assert!(code == Some(2) && stderr.contains("--quantize"), "{stderr}");
}

#[test]
fn a_model_is_measured_by_the_configuration_that_is_named() {
    let folder = TempDir::new().unwrap();
    // The measuring process must not read this file.
    fs::write(
        folder.path().join("planagent.toml"),
        "[mllm]\nquantize = \"q2_k\"\n",
    )
    .unwrap();
    fs::write(
        folder.path().join("named.toml"),
        "[mllm]\nquantize = \"f16\"\n",
    )
    .unwrap();
    let arguments = [
        "bench",
        "nano",
        "--config",
        "named.toml",
        "--warm-up",
        "0",
        "--iterations",
        "1",
        "--out",
        "bench",
    ];
    let output = planagent()
        .current_dir(&folder)
        .args(arguments)
        .args(["--threads", "1"])
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let rows = rows(&folder.path().join("bench"));
    assert_eq!(
        rows.last().unwrap()["loaded"]["weight_format"],
        "f16",
        "{rows:?}"
    );
}

#[test]
fn unknown_values_are_refused_with_the_known_ones() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().to_str().unwrap();
    for (arguments, expected) in [
        (&["--random-weights", "llava-9b"][..], "llava-1.5-7b"),
        (&["nano", "--quantize", "q2_k"], "q4_k"),
        (&["nano", "nano"], "two models are called nano"),
        (&["nano", "--iterations", "0"], "--iterations"),
        (&["nano", "--vs", "vllm"], "llama.cpp"),
        (&["nano", "--llama-python", "python3"], "--vs"),
    ] {
        let stderr = refused(&[&["bench", "--out", out], arguments].concat());
        assert!(stderr.contains(expected), "{stderr}");
    }
}

/// The steps of each measured round by an engine, with the name of its workload.
fn steps_by<'r>(rows: &'r [Value], engine: &str) -> Vec<(&'r Value, Vec<&'r Value>)> {
    let measured = rows
        .iter()
        .filter(|row| row["row"] == "iteration" && row["engine"] == engine);
    measured
        .map(|row| {
            let steps = row["steps"].as_array().unwrap().iter();
            (
                &row["workload"],
                steps.map(|timed| &timed["step"]).collect(),
            )
        })
        .collect()
}

#[test]
fn both_engines_run_the_same_steps() -> Needy {
    let python = llama_python(&["llama_cpp"])?;
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("bench");
    let versus = ["--vs", "llama.cpp", "--llama-python", &python];
    let arguments = [
        "--random-weights",
        "nano",
        "--quantize",
        "q8_0",
        "--warm-up",
        "1",
        "--iterations",
        "2",
    ];
    let (code, figures) = bench(&[&arguments[..], &versus].concat(), &out);
    assert_eq!(code, 0, "{figures}");
    let rows = rows(&out);
    assert_eq!(steps_by(&rows, "planagent"), steps_by(&rows, "llama.cpp"));
    let compared: Vec<&str> = figures["comparisons"]
        .as_array()
        .unwrap()
        .iter()
        .map(|row| row["what"].as_str().unwrap())
        .collect();
    assert_eq!(
        compared,
        [
            "prefill 512",
            "decode at 512",
            "image encode",
            "first token",
            "planning call"
        ]
    );
    Ok(())
}

/// A fixture's folder.
fn fixture(name: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures");
    folder.join(name).to_str().unwrap().to_owned()
}

#[test]
fn both_engines_see_the_same_picture_in_pairs_of_this_program() -> Needy {
    let python = llama_python(&["llama_cpp"])?;
    let size = ["--image-size", "64"];
    for (name, size, tokens) in [
        ("tiny_smolvlm", &[][..], 40),
        ("tiny_internvl3", &[], 4),
        ("tiny_qwen3_vl", &size, 16),
        ("tiny_qwen2_5_vl", &size, 16),
        ("tiny_qwen2_vl", &size, 16),
        ("tiny_gemma3", &[], 9),
    ] {
        let work = TempDir::new().unwrap();
        let folder = fixture(name);
        let model = [folder.as_str(), "--quantize", "f32", "--calls", "compact"];
        let once = ["--warm-up", "0", "--iterations", "1"];
        let versus = ["--vs", "llama.cpp", "--llama-python", &python];
        let arguments = [&model[..], size, &once, &versus].concat();
        let (code, figures) = bench(&arguments, &work.path().join("bench"));
        assert_eq!(code, 0, "{name}: {figures}");
        let found = &figures["agreements"][0];
        let picture = &found["picture"];
        assert_eq!(
            picture["tokens"],
            serde_json::json!([tokens, tokens]),
            "{name}: {found}"
        );
        // llama.cpp 0.3.36 gives a patch of a tower with a class token the position of the one
        // before it.
        let is_shifted = name == "tiny_internvl3";
        let apart = picture["apart"][0].as_f64().unwrap();
        assert!(is_shifted || apart < 0.01, "{name}: {found}");
        assert!(found["largest"].as_f64().unwrap() < 0.02, "{name}: {found}");
    }
    Ok(())
}

#[test]
fn a_family_without_a_pair_of_llama_cpp_is_not_compared_with_it() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("bench");
    let said = refused(&[
        "bench",
        &fixture("tiny_gemma4"),
        "--quantize",
        "f32",
        "--vs",
        "llama.cpp",
        "--weights",
        work.path().to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ]);
    assert!(said.contains("how many tokens an image becomes"), "{said}");
    assert!(
        said.contains("name a pair that llama.cpp's converter wrote"),
        "{said}"
    );
}
