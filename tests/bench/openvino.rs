//! `planagent bench --vs openvino`: a stub behind the worker's protocol, refusals, and OpenVINO.

use super::{bench, fixture, rows, steps_by};
use crate::cli::{planagent, read_json, refused, run};
use crate::outside::{Needy, openvino_python, python};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use tempfile::TempDir;

/// An engine without a model: the protocol is the worker's own.
const STUB: &str = r#"
import sys
exec(sys.argv[1].removesuffix("main(Engine)\n"))

def prepare(request):
    if request["weights"] == "bf16":
        raise Problem("stub 1.0 refuses to export " + request["folder"])

class Engine(Sequence):
    def __init__(self, request):
        super().__init__(request["seed"])
        self.like, self.vocabulary = request["like"], 320

    def describe(self):
        return {"parameters": 0, "weight_format": "int8", "image_side": self.like["image_side"],
            "image_tokens": self.like["image_tokens"], "vocabulary": self.vocabulary, "context": self.like["context"],
            "layout": "prefix_first", "load_s": 0.5, "version": "1.0 (a stub)"}

    def keep(self, tokens):
        self.pending = []

    def encode(self):
        pass

    def append_image(self, step):
        self.append(self.like["image_tokens"])

    def compute(self, step):
        step.add_pass(len(self.pending), 0.25 * len(self.pending))

    def likeliest(self):
        return 7

    def logits(self):
        return [0.0] * self.vocabulary

    def features_of(self, pixels, side):
        return [[1.0] * 32] * self.like["image_tokens"]

main(Engine)
"#;

/// An interpreter in a folder that runs `command` in place of the worker.
fn interpreter(folder: &Path, command: &str) -> String {
    let path = folder.join("python");
    fs::write(&path, format!("#!/bin/sh\n{command}\n")).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    path.to_str().unwrap().to_owned()
}

/// An interpreter with [`STUB`] in place of OpenVINO.
fn stub(folder: &Path, python: &str) -> String {
    let file = folder.join("stub.py");
    fs::write(&file, STUB).unwrap();
    interpreter(folder, &format!("exec {python} {} \"$2\"", file.display()))
}

/// The options of a short run beside OpenVINO in an interpreter.
fn beside<'a>(python: &'a str, weights: &'a str) -> [&'a str; 12] {
    [
        "--vs",
        "openvino",
        "--openvino-python",
        python,
        "--openvino-weights",
        weights,
        "--calls",
        "compact",
        "--warm-up",
        "0",
        "--iterations",
        "1",
    ]
}

#[test]
fn a_stub_of_openvino_runs_the_same_steps() -> Needy {
    let work = TempDir::new().unwrap();
    let python = stub(work.path(), &python(&[])?);
    let model = fixture("tiny_smolvlm");
    let out = work.path().join("bench");
    let arguments = [&[model.as_str()][..], &beside(&python, "int8")].concat();
    let (code, figures) = bench(&arguments, &out);
    assert_eq!(code, 0, "{figures}");
    let rows = rows(&out);
    let ours = steps_by(&rows, "planagent");
    assert!(ours.len() >= 2);
    assert_eq!(ours, steps_by(&rows, "openvino"));
    let theirs = &figures["models"][1];
    assert_eq!(theirs["engine"], "openvino");
    assert_eq!(theirs["loaded"]["version"], "1.0 (a stub)");
    assert_eq!(theirs["loaded"]["weight_format"], "int8");
    let metadata = read_json(&out.join("metadata.json"));
    assert_eq!(
        metadata["settings"]["vs_openvino"],
        serde_json::json!(["int8", "bf16"])
    );
    let table = fs::read_to_string(out.join("table.md")).unwrap();
    assert!(
        table.contains("openvino = that of openvino 1.0 (a stub)"),
        "{table}"
    );
    Ok(())
}

#[test]
fn what_openvino_cannot_do_is_refused_before_anything_is_measured() -> Needy {
    let work = TempDir::new().unwrap();
    let real = python(&[])?;
    let model = fixture("tiny_smolvlm");
    let said = |model: &[&str], python: &str, weights: &str| {
        let out = work.path().join("bench");
        let out = ["--out", out.to_str().unwrap()];
        let said = refused(&[&["bench"], model, &beside(python, weights), &out].concat());
        assert!(!work.path().join("bench").exists(), "{said}");
        said
    };
    let model = [model.as_str()];
    let absent = work.path().join("absent");
    let found = said(&model, absent.to_str().unwrap(), "int8");
    assert!(
        found.contains("cannot start") && found.contains("--openvino-python"),
        "{found}"
    );
    let found = said(&model, &interpreter(work.path(), "exit 3"), "int8");
    assert!(
        found.contains("openvino ended without a reply") && found.contains("exit status: 3"),
        "{found}"
    );
    // Neither the packages of the system nor those of the user.
    let bare = interpreter(work.path(), &format!("exec {real} -I -S \"$@\""));
    let found = said(&model, &bare, "int8");
    assert!(
        found.contains("the Python package openvino cannot be used")
            && found.contains("pip install"),
        "{found}"
    );
    let stub = stub(work.path(), &real);
    let found = said(&model, &stub, "bf16");
    assert!(
        found.contains("stub 1.0 refuses to export") && found.contains(model[0]),
        "{found}"
    );
    // Where the program has no folder of nano, it has nano within itself.
    let alone = planagent()
        .env_remove("PLANAGENT_MODELS")
        .current_dir(work.path())
        .args(["bench", "nano"])
        .args(beside(&stub, "int8"))
        .output()
        .unwrap();
    let found = String::from_utf8(alone.stderr).unwrap();
    assert_eq!(alone.status.code(), Some(2), "{found}");
    assert!(found.contains("a file of this program alone"), "{found}");
    let pair = format!("{}/gguf", model[0]);
    let found = said(&[pair.as_str()], &stub, "int8");
    assert!(found.contains("a vision tower in GGUF"), "{found}");
    let tower = [model[0], "--openvino-tower", "int4"];
    let found = said(&tower, &stub, "int8");
    assert!(found.contains("f32, bf16 or int8"), "{found}");
    Ok(())
}

#[test]
fn an_unknown_precision_of_openvino_is_refused_with_the_known_ones() {
    let (code, _, stderr) = run(&[
        "bench",
        "nano",
        "--vs",
        "openvino",
        "--openvino-weights",
        "q4",
    ]);
    assert_eq!(code, 2, "{stderr}");
    assert!(stderr.contains("f32, bf16, int8 and int4"), "{stderr}");
}

#[test]
fn openvino_computes_what_this_program_computes() -> Needy {
    let python = openvino_python(&["openvino", "optimum", "nncf", "transformers"])?;
    let work = TempDir::new().unwrap();
    let weights = work.path().join("weights");
    let folder = ["--weights", weights.to_str().unwrap()];
    let model = ["--random-weights", "nano"];
    let of = |precision: &str| {
        let versus = beside(&python, precision);
        let quantize = [
            "--quantize",
            if precision == "f32" { "f32" } else { "q8_0" },
        ];
        let arguments = [&model[..], &folder, &quantize, &versus].concat();
        let (code, figures) = bench(&arguments, &work.path().join(precision));
        assert_eq!(code, 0, "{figures}");
        figures
    };
    let figures = of("f32");
    let found = &figures["agreements"][0];
    let numbers = ["largest", "rms"].map(|key| found[key].as_f64().unwrap());
    assert!(numbers[0] < 1e-3 && numbers[1] < 1e-4, "{found}");
    assert_eq!(found["same_tokens"], found["tokens"], "{found}");
    let picture = &found["picture"];
    assert_eq!(picture["tokens"], serde_json::json!([64, 64]), "{found}");
    assert!(picture["apart"][0].as_f64().unwrap() < 1e-3, "{found}");
    let version = figures["models"][1]["loaded"]["version"].as_str().unwrap();
    assert!(
        version.contains("f32 arithmetic") && version.contains("optimum-intel"),
        "{version}"
    );
    let compared = figures["comparisons"].as_array().unwrap();
    assert_eq!(compared.len(), 5, "{figures}");
    let figures = of("int8");
    let found = &figures["agreements"][0];
    assert!(found["largest"].as_f64().unwrap() < 0.1, "{found}");
    Ok(())
}
