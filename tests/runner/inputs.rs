//! A run is resumed only with the prompts, model files and recordings that it was started with.

use super::simulations;
use crate::agent::scenario;
use crate::cli::{refused, run};
use crate::womd::written;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, serialize_to_file};
use std::fs;
use std::path::Path;
use std::time::{Duration, SystemTime};
use tempfile::TempDir;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// A folder with a copy of another one's files.
fn copied(from: &str, to: &Path) -> String {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(Path::new(ROOT).join(from)).unwrap() {
        let path = entry.unwrap().path();
        if path.is_file() {
            fs::copy(&path, to.join(path.file_name().unwrap())).unwrap();
        }
    }
    to.to_str().unwrap().to_owned()
}

/// Adds a comment to a template.
fn edit(template: &Path) {
    let text = fs::read_to_string(template).unwrap();
    fs::write(template, format!("{text}{{# another #}}")).unwrap();
}

#[test]
fn another_prompt_or_model_file_is_named_and_must_be_accepted() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    let folder = out.to_str().unwrap();
    let prompts = copied("prompts/compact", &work.path().join("prompts"));
    let model = copied("models/nano", &work.path().join("model"));
    let set = format!("reasoning.prompt_set={prompts}");
    let flags = [
        "--scenario",
        "generated/changing_lane/3",
        "--model",
        &model,
        "--set",
        &set,
    ];
    let (code, _, stderr) = run(&[
        &["simulate", "--out", folder, "--set", "agent.interval_s=100"][..],
        &flags,
    ]
    .concat());
    assert_eq!(code, 0, "{stderr}");
    let summary = fs::read(out.join("summary.json")).unwrap();

    let resume = ["simulate", "--resume", folder];
    edit(&Path::new(&prompts).join("code.jinja"));
    let prompt = refused(&resume);
    assert!(
        prompt.contains(&format!("prompt set changed: {prompts}/code.jinja")),
        "{prompt}"
    );
    assert!(
        !prompt.contains("model changed") && prompt.contains("--accept-changes"),
        "{prompt}"
    );
    edit(&Path::new(&model).join("chat_template.jinja"));
    fs::write(Path::new(&model).join("added.json"), "{}").unwrap();
    let both = refused(&resume);
    assert!(
        both.contains("prompt set changed") && both.contains("model changed"),
        "{both}"
    );
    assert!(
        both.contains("chat_template.jinja") && both.contains("added.json is new"),
        "{both}"
    );

    let (code, _, stderr) = run(&[&resume[..], &["--accept-changes"]].concat());
    assert!(
        code == 0 && stderr.contains("accepted: prompt set changed"),
        "{stderr}"
    );
    let manifest: toml::Table = fs::read_to_string(out.join("manifest.toml"))
        .unwrap()
        .parse()
        .unwrap();
    let accepted = manifest["accepted"].as_array().unwrap();
    assert_eq!(
        accepted[0]["changes"].as_array().unwrap().len(),
        3,
        "{accepted:?}"
    );
    // From now on the new files are those of the run; its tables are what they were.
    assert_eq!(run(&resume).0, 0);
    assert_eq!(fs::read(out.join("summary.json")).unwrap(), summary);
    fs::remove_file(Path::new(&prompts).join("feedback.jinja")).unwrap();
    assert!(refused(&resume).contains("feedback.jinja"));
}

/// Writes an adapter of nano that changes little, with this factor.
fn write_adapter(folder: &Path, alpha: f32) {
    const MODULE: &str = "base_model.model.model.language_model.layers.0.self_attn.q_proj";
    fs::create_dir_all(folder).unwrap();
    let settings = format!(
        r#"{{"peft_type": "LORA", "r": 1, "lora_alpha": {alpha}, "target_modules": ["q_proj"]}}"#
    );
    fs::write(folder.join("adapter_config.json"), settings).unwrap();
    let numbers: Vec<u8> = (0..192)
        .flat_map(|at: u16| (f32::from(at) * 1e-5).to_le_bytes())
        .collect();
    let view = |shape| TensorView::new(Dtype::F32, shape, &numbers).unwrap();
    let tensors = [
        (format!("{MODULE}.lora_A.weight"), view(vec![1, 192])),
        (format!("{MODULE}.lora_B.weight"), view(vec![192, 1])),
    ];
    serialize_to_file(tensors, None, &folder.join("adapter_model.safetensors")).unwrap();
}

#[test]
fn another_adapter_is_named_and_must_be_accepted() {
    let work = TempDir::new().unwrap();
    let (out, adapter) = (work.path().join("run"), work.path().join("adapter"));
    let folder = out.to_str().unwrap();
    write_adapter(&adapter, 1.0);
    let (code, _, stderr) = run(&[
        "simulate",
        "--scenario",
        "generated/changing_lane/3",
        "--model",
        "nano",
        "--adapter",
        adapter.to_str().unwrap(),
        "--set",
        "agent.interval_s=100",
        "--out",
        folder,
    ]);
    assert_eq!(code, 0, "{stderr}");
    let manifest = fs::read_to_string(out.join("manifest.toml")).unwrap();
    assert!(manifest.contains("[model.load.adapter]"), "{manifest}");
    let resume = ["simulate", "--resume", folder];
    assert_eq!(run(&resume).0, 0);
    write_adapter(&adapter, 2.0);
    let error = refused(&resume);
    assert!(
        error.contains("model description changed: adapter") && error.contains("--accept-changes"),
        "{error}"
    );
    fs::remove_dir_all(&adapter).unwrap();
    assert!(refused(&resume).contains("no such adapter"));
}

#[test]
fn another_recording_under_the_same_name_is_refused() {
    let work = TempDir::new().unwrap();
    let (out, recording) = (
        work.path().join("run"),
        work.path().join("recording.tfrecord"),
    );
    let folder = out.to_str().unwrap();
    let [one, other] = ["generated/changing_lane/3", "generated/changing_lane/2"]
        .map(|scene| written::bytes(&scenario(scene)));
    fs::write(&recording, &one).unwrap();
    let flags = [
        "simulate",
        "--planner",
        "log-replay",
        "--scenario",
        recording.to_str().unwrap(),
        "--out",
        folder,
    ];
    let (code, _, stderr) = run(&flags);
    assert_eq!(code, 0, "{stderr}");

    let resume = ["simulate", "--resume", folder];
    let touched = fs::File::options().write(true).open(&recording).unwrap();
    touched
        .set_modified(SystemTime::now() + Duration::from_mins(1))
        .unwrap();
    assert_eq!(
        run(&resume).0,
        0,
        "the same content at another time is the same recording"
    );

    fs::remove_dir_all(&simulations(&out)[0]).unwrap();
    fs::write(&recording, &other).unwrap();
    let changed = refused(&resume);
    assert!(
        changed.contains("recording changed: ") && changed.contains("recording.tfrecord"),
        "{changed}"
    );
    // With the recording back, the lost simulation is noticed and repeated.
    fs::write(&recording, &one).unwrap();
    let (code, _, stderr) = run(&resume);
    assert!(
        code == 0 && stderr.contains("1 simulations of this run, which had ended, have no folder"),
        "{stderr}"
    );
}

#[test]
fn damaged_results_are_simulated_again_and_a_damaged_manifest_is_no_dead_end() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    let folder = out.to_str().unwrap();
    let flags = [
        "simulate",
        "--scenario",
        "generated/changing_lane/3",
        "--planner",
        "log-replay",
        "--out",
        folder,
    ];
    assert_eq!(run(&flags).0, 0);
    let summary = fs::read(out.join("summary.json")).unwrap();
    let metrics = simulations(&out)[0].join("metrics.toml");
    let whole = fs::read_to_string(&metrics).unwrap();
    let last = whole.rfind("[[metrics]]").unwrap();
    for cut in ["", &whole[..last], &whole[..whole.len() / 2]] {
        fs::write(&metrics, cut).unwrap();
        let (code, _, stderr) = run(&["simulate", "--resume", folder]);
        assert!(
            code == 0 && stderr.contains("is damaged; its simulation is repeated"),
            "{stderr}"
        );
        assert_eq!(
            (
                fs::read_to_string(&metrics).unwrap(),
                fs::read(out.join("summary.json")).unwrap()
            ),
            (whole.clone(), summary.clone())
        );
    }
    let replay = simulations(&out)[0].join("replay.json.gz");
    let packed = fs::read(&replay).unwrap();
    for lost in [None, Some("x")] {
        fs::remove_file(&replay).unwrap();
        lost.map_or(Ok(()), |text| fs::write(&replay, text))
            .unwrap();
        let (code, _, stderr) = run(&["simulate", "--resume", folder]);
        assert!(
            code == 0 && stderr.contains("is damaged; its simulation is repeated"),
            "{stderr}"
        );
        assert_eq!(fs::read(&replay).unwrap(), packed);
    }
    let manifest = fs::read_to_string(out.join("manifest.toml")).unwrap();
    for cut in ["", &manifest[..manifest.find("[scenarios]").unwrap()]] {
        fs::write(out.join("manifest.toml"), cut).unwrap();
        let again = refused(&flags);
        assert!(
            again.contains("manifest.toml is damaged") && again.contains("holds simulations"),
            "{again}"
        );
    }
    fs::write(out.join("manifest.toml"), "").unwrap();
    for leftover in fs::read_dir(&out).unwrap() {
        let path = leftover.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        if path.is_dir() && name != "simulations" {
            fs::remove_dir_all(path).unwrap();
        } else if path.is_file()
            && !["manifest.toml", "config.toml", ".lock"].contains(&name.as_str())
        {
            fs::remove_file(path).unwrap();
        }
    }
    fs::remove_dir_all(&simulations(&out)[0]).unwrap();
    let begun = refused(&["simulate", "--resume", folder]);
    assert!(begun.contains("the run did not begin"), "{begun}");
    let (code, _, stderr) = run(&flags);
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(fs::read(out.join("summary.json")).unwrap(), summary);
}
