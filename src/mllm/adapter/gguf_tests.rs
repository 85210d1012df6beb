//! Adapters of models in GGUF, and adapters in GGUF.

use super::AdapterSpec;
use super::test_adapter::{Made, embedding_pair, made, pair, peft};
use crate::checkpoint::MergedAdapter;
use crate::export::{GgufPart, export_model};
use crate::families::Families;
use crate::local::Loading;
use crate::local::test_reference::fixture;
use crate::source::{Checkpoint, ModelPlace};
use crate::{MllmError, WeightFormat};
use candle_core::quantized::gguf_file::{self, Value};
use candle_core::quantized::{GgmlDType, QTensor};
use candle_core::{Device, Tensor};
use serde_json::json;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

const LAYER: &str = "model.language_model.layers.1.";

fn place(path: &Path) -> ModelPlace {
    if path.is_dir() {
        return ModelPlace::Folder(path.to_path_buf());
    }
    ModelPlace::Gguf {
        model: path.to_path_buf(),
        mmproj: None,
    }
}

fn adapted(
    path: &Path,
    adapter: &Path,
    quantize: Option<WeightFormat>,
) -> Result<Checkpoint, MllmError> {
    Checkpoint::open(&place(path), quantize, &Families::default())?
        .adapted(Some(&AdapterSpec::new(adapter)))
}

/// All tensors of a model in f32.
fn tensors(mut checkpoint: Checkpoint) -> BTreeMap<String, Vec<f32>> {
    let shapes: Vec<(String, Vec<usize>)> = checkpoint
        .weights
        .shapes()
        .map(|(name, shape)| (name.to_owned(), shape.to_vec()))
        .collect();
    let numbers = shapes.into_iter().map(|(name, shape)| {
        let tensor = checkpoint.weights.take(&name, &shape).unwrap();
        (name, tensor.flatten_all().unwrap().to_vec1().unwrap())
    });
    numbers.collect()
}

/// Exports the tiny LLaVA as llama.cpp's files.
fn export(to: &Path, weight_format: WeightFormat, adapter: Option<AdapterSpec>) -> PathBuf {
    let model = to.join("m.gguf");
    let mut create = |part: GgufPart| -> std::io::Result<Box<dyn Write>> {
        Ok(Box::new(File::create(part.path(&model))?))
    };
    let loading = Loading {
        quantize: Some(weight_format),
        adapter,
        ..Loading::default()
    };
    let place = place(&fixture("tiny_llava"));
    export_model("tiny", &place, &loading, &[], &mut create, &mut |_, _| {}).unwrap();
    model
}

/// Shape of a tensor of the tiny LLaVA.
fn shape(canonical: &str) -> [usize; 2] {
    let place = place(&fixture("tiny_llava"));
    let checkpoint = Checkpoint::open(&place, None, &Families::default()).unwrap();
    let found = checkpoint.weights.base_tensor(canonical).unwrap();
    found.shape().try_into().unwrap()
}

/// Matrices for the rotary projections, the embedding, the tower and the projector.
fn parts() -> Vec<Made> {
    let stored = |module: &str| module.replace("language_model.", "model.language_model.");
    let modules = [
        "language_model.layers.1.self_attn.q_proj",
        "language_model.layers.1.self_attn.k_proj",
        "language_model.layers.0.mlp.down_proj",
        "vision_tower.encoder.layers.0.self_attn.q_proj",
        "vision_tower.encoder.layers.0.mlp.fc1",
        "multi_modal_projector.linear_1",
    ];
    let linear = modules.iter().flat_map(|module| {
        let shape = shape(&format!("{module}.weight"));
        pair(&stored(module), shape, 4)
    });
    let tokens = shape("language_model.embed_tokens.weight");
    linear
        .chain(embedding_pair(
            "model.language_model.embed_tokens",
            tokens,
            4,
        ))
        .collect()
}

#[test]
fn a_base_in_gguf_gets_the_weights_of_its_folder() {
    let (work, adapter) = (tempfile::tempdir().unwrap(), peft(&json!({}), &parts()));
    let model = export(work.path(), WeightFormat::F32, None);
    let folder = tensors(adapted(&fixture("tiny_llava"), adapter.path(), None).unwrap());
    let file = tensors(adapted(&model, adapter.path(), None).unwrap());
    let mut compared = 0;
    for (name, numbers) in &file {
        let Some(expected) = folder.get(name) else {
            continue;
        };
        compared += 1;
        let near = numbers
            .iter()
            .zip(expected)
            .all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(near && numbers.len() == expected.len(), "{name}");
    }
    assert!(compared > 40, "{compared}");
    // The merged model written out is the same.
    let spec = AdapterSpec::new(adapter.path());
    let written = export(work.path(), WeightFormat::F32, Some(spec));
    let opened = Checkpoint::open(&place(&written), None, &Families::default()).unwrap();
    let written = tensors(opened);
    assert_eq!(
        written.get("language_model.layers.1.self_attn.q_proj.weight"),
        file.get("language_model.layers.1.self_attn.q_proj.weight")
    );
    assert_eq!(
        written.get("language_model.embed_tokens.weight"),
        file.get("language_model.embed_tokens.weight")
    );
}

#[test]
fn merged_matrices_are_finer_than_a_base_of_few_bits_and_follow_a_wish() {
    let (work, adapter) = (tempfile::tempdir().unwrap(), peft(&json!({}), &parts()));
    let merged = "language_model.layers.1.self_attn.q_proj.weight";
    let other = "language_model.layers.1.self_attn.v_proj.weight";
    for (base, asked, expected) in [
        (
            WeightFormat::Q4_0,
            None,
            [WeightFormat::Q8_0, WeightFormat::Q4_0],
        ),
        (
            WeightFormat::Q8_0,
            None,
            [WeightFormat::Q8_0, WeightFormat::Q8_0],
        ),
        (
            WeightFormat::F16,
            None,
            [WeightFormat::F32, WeightFormat::F16],
        ),
        (
            WeightFormat::F32,
            Some(WeightFormat::F16),
            [WeightFormat::F16; 2],
        ),
        (
            WeightFormat::F32,
            Some(WeightFormat::Q4_0),
            [WeightFormat::Q4_0; 2],
        ),
    ] {
        let model = export(work.path(), base, None);
        let mut checkpoint = adapted(&model, adapter.path(), asked).unwrap();
        let found = [merged, other].map(|name| checkpoint.weights.weight_format_of(name).unwrap());
        assert_eq!(found, expected, "{base} as {asked:?}");
        checkpoint
            .weights
            .take_matrix(merged, shape(merged))
            .unwrap();
    }
}

/// Writes an adapter as llama.cpp's converter does.
fn write(path: &Path, metadata: &[(&str, Value)], tensors: &[Made]) {
    let tensors: Vec<(&str, QTensor)> = tensors
        .iter()
        .map(|(name, shape, numbers)| {
            let tensor = Tensor::from_vec(numbers.clone(), shape.as_slice(), &Device::Cpu).unwrap();
            (
                name.as_str(),
                QTensor::quantize(&tensor, GgmlDType::F32).unwrap(),
            )
        })
        .collect();
    let tensors: Vec<(&str, &QTensor)> = tensors
        .iter()
        .map(|(name, tensor)| (*name, tensor))
        .collect();
    let metadata: Vec<(&str, &Value)> = metadata.iter().map(|(key, value)| (*key, value)).collect();
    gguf_file::write(&mut File::create(path).unwrap(), &metadata, &tensors).unwrap();
}

fn usual() -> Vec<(&'static str, Value)> {
    let text = |text: &str| Value::String(text.to_owned());
    vec![
        ("general.type", text("adapter")),
        ("general.architecture", text("llama")),
        ("adapter.type", text("lora")),
        ("adapter.lora.alpha", Value::F32(6.0)),
    ]
}

/// Rows of a matrix in llama.cpp's order of queries and keys.
fn paired((name, shape, numbers): &Made, heads: usize) -> Made {
    let (rows, width) = (shape[0], shape[1]);
    let head = rows / heads;
    let row = |row: usize| {
        let (first, within) = (row / head * head, row % head);
        let from = first + within / 2 + within % 2 * head / 2;
        numbers[from * width..][..width].to_vec()
    };
    (
        name.clone(),
        shape.clone(),
        (0..rows).flat_map(row).collect(),
    )
}

/// The adapter for two projections and the embedding: as a folder of PEFT, and in GGUF.
fn both(work: &Path) -> (tempfile::TempDir, PathBuf) {
    let decoder = Checkpoint::open(&place(&fixture("tiny_llava")), None, &Families::default())
        .and_then(|checkpoint| checkpoint.decoder_config())
        .unwrap();
    let mut of_peft = Vec::new();
    let mut of_llama = Vec::new();
    for (part, name, heads) in [
        ("q_proj", "attn_q", decoder.heads),
        ("k_proj", "attn_k", decoder.kv_heads),
    ] {
        let canonical = format!("language_model.layers.1.self_attn.{part}.weight");
        let [a, b] = pair(&format!("{LAYER}self_attn.{part}"), shape(&canonical), 4);
        let renamed = |made: &Made, half: &str| {
            (
                format!("blk.1.{name}.weight.{half}"),
                made.1.clone(),
                made.2.clone(),
            )
        };
        of_llama.extend([renamed(&a, "lora_a"), renamed(&paired(&b, heads), "lora_b")]);
        of_peft.extend([a, b]);
    }
    let tokens = shape("language_model.embed_tokens.weight");
    let [a, b] = embedding_pair("model.language_model.embed_tokens", tokens, 4);
    let turned = (0..a.2.len())
        .map(|at| a.2[at % 4 * tokens[0] + at / 4])
        .collect();
    of_llama.extend([
        (
            "token_embd.weight.lora_a".to_owned(),
            vec![tokens[0], 4],
            turned,
        ),
        (
            "token_embd.weight.lora_b".to_owned(),
            b.1.clone(),
            b.2.clone(),
        ),
    ]);
    of_peft.extend([a, b]);
    let file = work.join("adapter.gguf");
    write(&file, &usual(), &of_llama);
    (peft(&json!({}), &of_peft), file)
}

#[test]
fn an_adapter_in_gguf_gives_the_weights_of_its_folder_over_any_base() {
    let work = tempfile::tempdir().unwrap();
    let (folder, file) = both(work.path());
    let model = export(work.path(), WeightFormat::F32, None);
    for base in [fixture("tiny_llava"), model] {
        let expected = tensors(adapted(&base, folder.path(), None).unwrap());
        let found = tensors(adapted(&base, &file, None).unwrap());
        assert_eq!(expected, found, "{}", base.display());
    }
    let checkpoint = adapted(&fixture("tiny_llava"), &file, None).unwrap();
    let report = checkpoint.weights.report();
    let MergedAdapter { tensors, kind, .. } = report.adapter.clone().unwrap();
    assert_eq!(
        (tensors, kind.as_str()),
        (3, "LoRA in GGUF of architecture llama")
    );
    assert!(report.notes.iter().any(|note| note.contains("rsLoRA")));
}

/// Metadata, tensors, and what the error says.
type Case<'a> = (Vec<(&'a str, Value)>, Vec<Made>, &'a str);

#[test]
fn files_of_other_kinds_and_models_are_refused_by_name() {
    let work = tempfile::tempdir().unwrap();
    let file = work.path().join("adapter.gguf");
    let text = |text: &str| Value::String(text.to_owned());
    let q = "blk.1.attn_q.weight";
    let [outputs, inputs] = shape("language_model.layers.1.self_attn.q_proj.weight");
    let whole = [
        made(&format!("{q}.lora_a"), &[4, inputs]),
        made(&format!("{q}.lora_b"), &[outputs, 4]),
    ];
    let with = |key: &'static str, value: Value| {
        let mut metadata = usual();
        metadata.retain(|(known, _)| *known != key);
        metadata.push((key, value));
        metadata
    };
    let renamed = |name: &str| (name.to_owned(), whole[0].1.clone(), whole[0].2.clone());
    let cases: Vec<Case<'_>> = vec![
        (
            with("general.type", text("model")),
            whole.to_vec(),
            "not an adapter",
        ),
        (
            with("adapter.type", text("control")),
            whole.to_vec(),
            "'control'",
        ),
        (
            with("general.architecture", text("qwen2")),
            whole.to_vec(),
            "'qwen2', the model has 'llama'",
        ),
        (
            with(
                "adapter.alora.invocation_tokens",
                Value::Array(vec![Value::U32(1)]),
            ),
            whole.to_vec(),
            "activated",
        ),
        (usual(), whole[..1].to_vec(), "one of lora_a and lora_b"),
        (
            usual(),
            [vec![renamed("blk.1.attn_q.weight")], whole.to_vec()].concat(),
            "neither",
        ),
        (
            usual(),
            vec![
                renamed("blk.99.attn_v.weight.lora_a"),
                made("blk.99.attn_v.weight.lora_b", &[outputs, 4]),
            ],
            "blk.99.attn_v.weight.lora_a",
        ),
        (
            usual(),
            vec![
                whole[0].clone(),
                made(&format!("{q}.lora_b"), &[2 * outputs, 4]),
            ],
            "does not fit",
        ),
        (
            usual(),
            vec![whole[0].clone(), made(&format!("{q}.lora_b"), &[3, 4])],
            "whole pairs",
        ),
        (usual(), Vec::new(), "no tensors"),
    ];
    for (metadata, tensors, said) in cases {
        write(&file, &metadata, &tensors);
        let error = adapted(&fixture("tiny_llava"), &file, None)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("adapter.gguf") && error.contains(said),
            "{said}: {error}"
        );
    }
    // Norms are left out, as llama.cpp does; an alpha of 0 is a scale of 1.
    let norm = made("blk.0.attn_norm.weight", &[inputs]);
    write(
        &file,
        &with("adapter.lora.alpha", Value::F32(0.0)),
        &[vec![norm], whole.to_vec()].concat(),
    );
    let checkpoint = adapted(&fixture("tiny_llava"), &file, None).unwrap();
    assert_eq!(
        checkpoint
            .weights
            .report()
            .adapter
            .as_ref()
            .unwrap()
            .tensors,
        1
    );
}

/// llama.cpp has the value heads of a delta rule in another order than a folder.
#[test]
fn an_adapter_of_a_delta_rule_fits_a_folder_from_a_folder_alone() {
    let base = fixture("tiny_qwen3_5");
    let module = "language_model.layers.0.linear_attn.in_proj_qkv";
    let checkpoint = Checkpoint::open(&place(&base), None, &Families::default()).unwrap();
    let found = checkpoint.weights.base_tensor(&format!("{module}.weight"));
    let shape: [usize; 2] = found.unwrap().shape().try_into().unwrap();
    let [a, b] = pair(&format!("model.{module}"), shape, 4);
    let folder = peft(&json!({}), &[a.clone(), b.clone()]);
    let merged = adapted(&base, folder.path(), None).unwrap();
    assert_eq!(merged.weights.report().adapter.as_ref().unwrap().tensors, 1);
    let said = |base: &Path, adapter: &Path| {
        let adapted = adapted(base, adapter, None).map(|_| ());
        adapted.unwrap_err().to_string()
    };
    let gguf = base.join("gguf/model.gguf");
    let problem = said(&gguf, folder.path());
    assert!(
        problem.contains("in another order") && problem.contains(module),
        "{problem}"
    );
    let work = tempfile::tempdir().unwrap();
    let file = work.path().join("adapter.gguf");
    let mut metadata = usual();
    metadata.retain(|(key, _)| *key != "general.architecture");
    metadata.push(("general.architecture", Value::String("qwen35".to_owned())));
    let renamed = |made: &Made, half: &str| {
        let name = format!("blk.0.attn_qkv.weight.{half}");
        (name, made.1.clone(), made.2.clone())
    };
    write(
        &file,
        &metadata,
        &[renamed(&a, "lora_a"), renamed(&b, "lora_b")],
    );
    for base in [&base, &gguf] {
        let problem = said(base, &file);
        assert!(problem.contains("in another order"), "{problem}");
    }
}
