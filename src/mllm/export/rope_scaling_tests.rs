//! Scaled rotary embeddings give the logits and tokens of transformers, in folders, in llama.cpp's
//! files and in our own (`tests/fixtures/rope_scaling`).

use super::round_trip_tests::{edit, export};
use crate::checkpoint::read_json;
use crate::decoder::Logits;
use crate::families::Families;
use crate::family::{ImageFeatures, ImageLayout, VisionLanguageModel};
use crate::gguf::FILE;
use crate::local::Sequence;
use crate::local::test_reference::{LOGIT_TOLERANCE, Reference, difference, fixture, greedy};
use crate::source::{Checkpoint, ModelPlace};
use crate::{Deadline, MllmError};
use candle_core::Tensor;
use planagent_kernels::matrix::WeightFormat;
use serde::Deserialize;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

/// A tiny model with another configuration.
#[derive(Debug, Deserialize)]
struct Case {
    name: String,
    folder: String,
    edits: Vec<(String, Value)>,
}

impl Case {
    fn is(&self, kind: &str) -> bool {
        self.name.ends_with(&format!(".{kind}"))
    }

    /// A folder of the model, with the edited configuration.
    fn folder(&self) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for entry in fs::read_dir(fixture(&self.folder)).unwrap() {
            let path = entry.unwrap().path();
            if path.is_file() {
                fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
            }
        }
        let mut config = read_json(&fixture(&self.folder).join("config.json")).unwrap();
        for (pointer, value) in &self.edits {
            let (object, key) = pointer.rsplit_once('/').unwrap();
            let object = config.pointer_mut(object).unwrap().as_object_mut().unwrap();
            object.remove(key);
            if !value.is_null() {
                object.insert(key.to_owned(), value.clone());
            }
        }
        fs::write(folder.path().join("config.json"), config.to_string()).unwrap();
        let processor = folder.path().join("preprocessor_config.json");
        if !processor.is_file() {
            fs::write(processor, r#"{"image_processor_type": "SiglipImageProcessor", "size": {"height": 32, "width": 32}}"#).unwrap();
        }
        folder
    }

    /// The keys of the rotary embedding, and the positions of the decoder.
    fn scaling(&self) -> (&Value, &Value) {
        let of = |key: &str| {
            let found = self
                .edits
                .iter()
                .find(|(pointer, _)| pointer.ends_with(key));
            &found.unwrap().1
        };
        (of("rope_parameters"), of("max_position_embeddings"))
    }
}

fn cases() -> Vec<Case> {
    let cases = read_json(&fixture("rope_scaling/cases.json")).unwrap();
    serde_json::from_value(cases).unwrap()
}

fn reference() -> Reference {
    Reference::open(&fixture("rope_scaling/reference.safetensors"))
}

fn open(place: &ModelPlace) -> Box<dyn VisionLanguageModel> {
    let mut checkpoint = Checkpoint::open(place, None, &Families::default()).unwrap();
    checkpoint.open_model().unwrap()
}

fn gguf(model: &Path) -> ModelPlace {
    ModelPlace::Gguf {
        model: model.to_path_buf(),
        mmproj: None,
    }
}

/// A prompt of the reference, in a model.
struct Run<'a> {
    model: &'a dyn VisionLanguageModel,
    ids: Vec<u32>,
    features: Option<ImageFeatures>,
}

impl<'a> Run<'a> {
    fn open(model: &'a dyn VisionLanguageModel, case: &Case, reference: &Reference) -> Self {
        let ids = reference.ids(&format!("{}.input_ids", case.name), 0);
        let features = case.name.ends_with("_image").then(|| {
            let image = image::open(fixture(&case.folder).join("image_0.png")).unwrap();
            model.encode_image(&image.into_rgb8()).unwrap()
        });
        Self {
            model,
            ids,
            features,
        }
    }

    /// The layouts of its pictures; none of a text.
    fn layouts(&self) -> &[ImageLayout] {
        self.features
            .as_ref()
            .map_or(&[], |features| &features.layouts)
    }

    /// The logits of the whole prompt, computed in pieces.
    fn logits(&self, sequence: &mut Sequence, pieces: &[usize]) -> Tensor {
        let kept = sequence.begin(self.model, &self.ids, self.layouts());
        assert_eq!(kept, 0);
        let (mut rest, mut rows) = (self.ids.as_slice(), Vec::new());
        for piece in pieces.iter().copied().chain([self.ids.len()]) {
            let (now, later) = rest.split_at(piece.min(rest.len()));
            let found = sequence.append(self.model, now, self.features.as_ref(), Logits::All);
            rows.extend(found.unwrap());
            rest = later;
        }
        Tensor::cat(&rows, 0).unwrap()
    }

    /// The largest difference to the last logits of the reference.
    fn deviation(&self, case: &Case, reference: &Reference) -> f32 {
        let expected = reference.tensor(&format!("{}.logits", case.name));
        [&[][..], &[3, 20, 1]]
            .into_iter()
            .map(|pieces| {
                let logits = self.logits(&mut Sequence::new(self.model), pieces);
                let last = expected.dims()[0];
                let found = logits.narrow(0, self.ids.len() - last, last).unwrap();
                difference(&found, expected)
            })
            .fold(0.0, f32::max)
    }

    fn assert_same(&self, case: &Case, reference: &Reference) {
        let found = self.deviation(case, reference);
        assert!(found < LOGIT_TOLERANCE, "{}: {found}", case.name);
        let expected = reference.ids(&format!("{}.generated", case.name), 0);
        let mut sequence = Sequence::new(self.model);
        sequence.begin(self.model, &self.ids, self.layouts());
        let count = expected.len();
        let features = self.features.as_ref();
        let found = greedy(self.model, &mut sequence, &self.ids, features, count);
        assert_eq!(found, expected, "{}", case.name);
    }
}

#[test]
fn folders_give_the_logits_and_tokens_of_transformers() {
    let reference = reference();
    for case in cases() {
        let folder = case.folder();
        let model = open(&ModelPlace::Folder(folder.path().to_path_buf()));
        Run::open(&*model, &case, &reference).assert_same(&case, &reference);
    }
}

#[test]
fn a_scaling_that_is_left_out_is_found() {
    let reference = reference();
    for mut case in cases() {
        if case.is("dynamic_within") || case.is("yarn_old") {
            continue;
        }
        case.edits
            .retain(|(pointer, _)| pointer.ends_with("max_position_embeddings"));
        case.edits[0].1 = json!(4096);
        let folder = case.folder();
        let model = open(&ModelPlace::Folder(folder.path().to_path_buf()));
        let found = Run::open(&*model, &case, &reference).deviation(&case, &reference);
        assert!(found > 20.0 * LOGIT_TOLERANCE, "{}: {found}", case.name);
    }
}

/// Adds the keys that llama.cpp's converter writes for a scaling.
fn add_keys(model: &Path, case: &Case) {
    let (rope, positions) = case.scaling();
    edit(model, |header, _| {
        let architecture = header.architecture().unwrap().to_owned();
        let mut set = |key: &str, value: &Value| {
            let key = format!("{architecture}.{key}");
            header.metadata.insert(key, value.clone());
        };
        set("context_length", positions);
        for (key, own) in [
            ("rope_type", "type"),
            ("factor", "factor"),
            (
                "original_max_position_embeddings",
                "original_context_length",
            ),
            ("beta_fast", "yarn_beta_fast"),
            ("beta_slow", "yarn_beta_slow"),
            ("attention_factor", "yarn_attn_factor"),
        ] {
            if let Some(value) = rope.get(key) {
                let value = match value.as_f64() {
                    Some(number) if own.starts_with("yarn_") => json!(number),
                    _ => value.clone(),
                };
                set(&format!("rope.scaling.{own}"), &value);
            }
        }
    });
}

#[test]
fn llama_cpps_files_give_the_logits_and_tokens_of_transformers() {
    let reference = reference();
    let mut seen = 0;
    for case in cases() {
        let files = fixture(&case.folder).join("gguf");
        let known = ["yarn", "yarn_options", "linear", "yarn_image"];
        if !files.is_dir() || !known.iter().any(|kind| case.is(kind)) {
            continue;
        }
        let folder = case.folder();
        for name in ["model.gguf", "mmproj-model.gguf"] {
            fs::copy(files.join(name), folder.path().join(name)).unwrap();
        }
        let model = folder.path().join("model.gguf");
        add_keys(&model, &case);
        let model = open(&gguf(&model));
        Run::open(&*model, &case, &reference).assert_same(&case, &reference);
        seen += 1;
    }
    assert!(seen >= 14, "{seen}");
}

#[test]
fn an_export_keeps_the_scaling() {
    let reference = reference();
    for case in cases() {
        if case.folder != "tiny_llava" {
            continue;
        }
        let folder = case.folder();
        let to = tempfile::tempdir().unwrap();
        let model = export(folder.path(), to.path(), WeightFormat::F32);
        let opened = open(&gguf(&model));
        Run::open(&*opened, &case, &reference).assert_same(&case, &reference);
        // What llama.cpp knows stands in keys and tensors of its own.
        if case.is("yarn_exact") || case.is("dynamic") {
            continue;
        }
        edit(&model, |header, _| {
            header.metadata.retain(|key, _| !key.starts_with(FILE));
        });
        let opened = open(&gguf(&model));
        Run::open(&*opened, &case, &reference).assert_same(&case, &reference);
    }
}

/// Keys of a prompt that was computed for another length are not used.
#[test]
fn rounds_of_a_dynamic_base_give_what_each_gives_alone() {
    let reference = reference();
    for case in cases().iter().filter(|case| case.is("dynamic")) {
        let folder = case.folder();
        let model = open(&ModelPlace::Folder(folder.path().to_path_buf()));
        let ids = reference.ids(&format!("{}.input_ids", case.name), 0);
        let mut kept = Sequence::new(&*model);
        // Within the context, at its border, behind it, and back.
        for (length, expected) in [(20, 0), (30, 20), (32, 30), (44, 0), (60, 0), (31, 0)] {
            let prompt = &ids[..length];
            let answer = |sequence: &mut Sequence| {
                let kept = sequence.begin(&*model, prompt, &[]);
                let logits = sequence
                    .append_in_passes(&*model, &prompt[kept..], None, Logits::Last, Deadline::NONE)
                    .unwrap()
                    .unwrap();
                (kept, logits)
            };
            let (found, logits) = answer(&mut kept);
            let (_, alone) = answer(&mut Sequence::new(&*model));
            assert_eq!(found, expected, "{}: {length}", case.name);
            let apart = difference(&logits, &alone);
            assert!(apart < 1e-5, "{}: {length}: {apart}", case.name);
        }
    }
}

/// What opening a model says that is edited so.
fn problem(name: &str, edits: &[(&str, Value)]) -> String {
    let edits = edits.iter();
    let case = Case {
        name: name.into(),
        folder: name.into(),
        edits: edits
            .map(|(pointer, value)| ((*pointer).to_owned(), value.clone()))
            .collect(),
    };
    let folder = case.folder();
    let place = ModelPlace::Folder(folder.path().to_path_buf());
    let opened = Checkpoint::open(&place, None, &Families::default())
        .and_then(|mut checkpoint| checkpoint.open_model());
    match opened {
        Err(error @ MllmError::Config { .. }) => error.to_string(),
        Err(error) => panic!("{:?}: {error}", case.edits),
        Ok(_) => panic!("{:?} opens", case.edits),
    }
}

#[test]
fn a_scaling_that_cannot_be_computed_is_named() {
    let yarn = |key: &str, value: Value| {
        let mut rope =
            json!({"rope_type": "yarn", "factor": 4.0, "original_max_position_embeddings": 64});
        rope[key] = value;
        problem("tiny_llava", &[("/text_config/rope_parameters", rope)])
    };
    for (key, value) in [
        ("factor", json!(0)),
        ("factor", json!(-2.0)),
        ("factor", json!("four")),
        ("factor", json!(1e9)),
        ("beta_fast", json!(0)),
        ("beta_fast", json!(1e300)),
        ("beta_slow", json!(64)),
        ("attention_factor", json!(-1)),
        ("attention_factor", json!(1e30)),
        ("mscale", json!([])),
        ("original_max_position_embeddings", json!(0)),
        ("truncate", json!("no")),
        ("rope_theta", json!(1)),
    ] {
        let said = yarn(key, value.clone());
        let named = "config.json: text_config.";
        assert!(
            said.contains(named) && said.contains(&format!("{key}: ")),
            "{value}: {said}"
        );
    }
    let without = json!({"rope_type": "yarn"});
    let said = problem("tiny_llava", &[("/text_config/rope_parameters", without)]);
    assert!(
        said.contains("rope_parameters.factor: is missing"),
        "{said}"
    );
    let dynamic = json!({"rope_type": "dynamic"});
    let said = problem("tiny_llava", &[("/text_config/rope_parameters", dynamic)]);
    assert!(
        said.contains("rope_parameters.factor: is missing"),
        "{said}"
    );
}

#[test]
fn a_scaling_of_a_gguf_that_cannot_be_computed_is_named_by_its_own_key() {
    for (key, value) in [
        ("type", json!("longrope")),
        ("factor", json!(-1.0)),
        ("factor", json!(1e9)),
        ("yarn_ext_factor", json!(0.5)),
        ("yarn_beta_fast", json!(-3.0)),
        ("yarn_beta_slow", json!(90.0)),
        ("yarn_attn_factor", json!(1e30)),
        ("yarn_log_multiplier", json!(0.1)),
    ] {
        let files = fixture("tiny_smolvlm").join("gguf");
        let folder = tempfile::tempdir().unwrap();
        for name in ["model.gguf", "mmproj-model.gguf"] {
            fs::copy(files.join(name), folder.path().join(name)).unwrap();
        }
        let model = folder.path().join("model.gguf");
        edit(&model, |header, _| {
            let mut set = |key: &str, value: Value| {
                let key = format!("llama.rope.scaling.{key}");
                header.metadata.insert(key, value);
            };
            set("type", json!("yarn"));
            set("factor", json!(4.0));
            set(key, value.clone());
        });
        let place = gguf(&model);
        let check = crate::LocalModel::check(&place, &crate::Loading::default());
        let said = check.problems.join("\n");
        let named = format!("llama.rope.scaling.{key}: ");
        assert!(said.contains(&named), "{key} = {value}: {said}");
    }
}
