//! Parity with the packages that write packed folders: their numbers, and the logits of a model
//! with them (`tests/fixtures/quantized_reference`).
//!
//! `cargo test -p planagent-mllm --lib quantized::reference -- --nocapture` prints a table.

use super::open;
use crate::checkpoint::{ConfigObject, DecoderType, LlamaConfig, ModelFiles, Weights, read_json};
use crate::decoder::{Decoder, DecoderInput, LanguageModel, LlamaLayer, Logits};
use crate::family::Positions;
use crate::local::test_reference::{LOGIT_TOLERANCE, Reference, difference, fixture};
use candle_core::Tensor;
use planagent_kernels::matrix::WeightFormat;
use safetensors::SafeTensors;
use std::path::{Path, PathBuf};

/// The 29 folders, and the largest difference of a number from the package's. It is 0 where the
/// package multiplies as this program does, else a rounding of f32.
const CASES: [(&str, f32); 29] = [
    ("awq_gemm_column", 0.0),
    ("awq_gemm_g32", 0.0),
    ("awq_gemv_fast_g64", 0.0),
    ("awq_gemv_g32", 0.0),
    ("bnb_int8", 1e-7),
    ("bnb_nf4", 0.0),
    ("bnb_nf4_double", 0.0),
    ("ct_fp8_block", 0.0),
    ("ct_fp8_channel_dynamic", 0.0),
    ("ct_fp8_tensor_static", 0.0),
    ("ct_int8_w8a8", 0.0),
    ("ct_naive_int8", 0.0),
    ("ct_w3a16_g32", 6e-8),
    ("ct_w4a16_asym_g32_bf16", 0.0),
    ("ct_w4a16_sym_g32", 6e-8),
    ("ct_w8a16_channel", 6e-8),
    ("fp8_block", 0.0),
    ("fp8_block_ragged", 0.0),
    ("fp8_block_ue8m0", 0.0),
    ("fp8_tensor_static", 0.0),
    ("gptq_2bit_g32_v2", 0.0),
    ("gptq_3bit_g32", 0.0),
    ("gptq_4bit_column_v2", 0.0),
    ("gptq_4bit_g32_desc_act", 0.0),
    ("gptq_4bit_g32_sym", 0.0),
    ("gptq_8bit_g64", 0.0),
    ("mlx_4bit_g64", 0.0),
    ("mlx_8bit_g32_tied", 0.0),
    ("mlx_mixed_3_6_bf16", 0.0),
];
/// Largest difference of logits with rounded activations, relative to the largest logit. That of the
/// packages' own rounding of activations is up to 0.3 on these random models.
const ROUNDED_LOGITS: f32 = 0.1;

fn folder(case: &str) -> PathBuf {
    fixture("quantized_reference").join(case)
}

fn weights(folder: &Path, quantize: Option<WeightFormat>) -> Weights {
    let files = ModelFiles::folder(folder).unwrap();
    open(&files, folder, quantize, |name| Some(name.to_owned())).unwrap()
}

/// The folder of bf16 whose reference has the logits of a model in f16, and a folder with the
/// unrounded embedding and norms of that model.
const UNROUNDED: [&str; 2] = ["mlx_mixed_3_6_bf16", "gptq_8bit_g64"];

/// A copy of the first folder of [`UNROUNDED`] with the plain tensors of the second.
fn unrounded() -> tempfile::TempDir {
    let place = tempfile::tempdir().unwrap();
    let files =
        UNROUNDED.map(|case| std::fs::read(folder(case).join("model.safetensors")).unwrap());
    let [own, plain] = [&files[0], &files[1]].map(|bytes| SafeTensors::deserialize(bytes).unwrap());
    let views = own.tensors().into_iter().map(|(name, view)| {
        let is_plain = name.ends_with("norm.weight") || name.ends_with("embed_tokens.weight");
        let view = if is_plain {
            plain.tensor(&name).unwrap()
        } else {
            view
        };
        (name, view)
    });
    let bytes = safetensors::serialize(views, None).unwrap();
    std::fs::write(place.path().join("model.safetensors"), bytes).unwrap();
    let config = folder(UNROUNDED[0]).join("config.json");
    std::fs::copy(config, place.path().join("config.json")).unwrap();
    place
}

fn logits(folder: &Path, quantize: Option<WeightFormat>, ids: &[u32]) -> (Tensor, Weights) {
    let path = folder.join("config.json");
    let json = read_json(&path).unwrap();
    let root = ConfigObject::root(&path, &json).unwrap();
    let config = LlamaConfig::read_as(root, DecoderType::Llama).unwrap();
    let mut weights = weights(folder, quantize);
    let decoder: Decoder<LlamaLayer> = Decoder::take(&mut weights, &config, "model.").unwrap();
    let input = DecoderInput {
        rows: decoder.embed(ids).unwrap(),
        tokens: ids.iter().copied().map(Some).collect(),
        positions: Positions::plain(0..ids.len() as u32).rotary,
        prompt_end: 0,
        vision: Vec::new(),
        deep: Vec::new(),
    };
    let logits = decoder.forward(&input, &mut decoder.new_cache(ids.len()), Logits::All);
    (logits.unwrap().unwrap(), weights)
}

/// The largest magnitude of a tensor.
fn largest(tensor: &Tensor) -> f32 {
    difference(tensor, &tensor.zeros_like().unwrap())
}

/// Checks one folder and gives its row of the table.
fn check(case: &str, exact: f32) -> String {
    let reference = Reference::open(&folder(case).join("expected.safetensors"));
    let place = folder(case);
    let mut floats = weights(&place, Some(WeightFormat::F32));
    let mut held = weights(&place, None);
    let (mut worst, mut worst_held) = (0.0_f32, 0.0_f32);
    let names: Vec<String> = reference
        .names()
        .filter_map(|name| name.strip_prefix("weight."))
        .map(str::to_owned)
        .collect();
    assert!(!names.is_empty(), "{case} has no weights");
    for name in &names {
        let expected = reference.tensor(&format!("weight.{name}"));
        let &[outputs, inputs] = expected.dims() else {
            panic!("{name} is no matrix");
        };
        let found = floats.take(name, &[outputs, inputs]).unwrap();
        worst = worst.max(difference(&found, expected));
        let matrix = held.take_matrix(name, [outputs, inputs]).unwrap();
        let ids: Vec<u32> = (0..outputs as u32).collect();
        worst_held = worst_held.max(difference(&matrix.rows(&ids).unwrap(), expected));
    }
    assert!(worst <= exact, "{case}: the numbers differ by {worst}");
    let reported = held
        .report()
        .exceptions
        .iter()
        .filter_map(|exception| exception.largest_error);
    let reported = reported.fold(0.0, f32::max);
    assert!(
        worst_held <= reported * 1.01 + exact,
        "{case}: the numbers in memory differ by {worst_held}, the report says {reported}"
    );

    let ids = reference.ids("input_ids", 0);
    let expected = reference.tensor("logits");
    let copy = (case == UNROUNDED[0]).then(unrounded);
    let place = copy
        .as_ref()
        .map_or_else(|| folder(case), |copy| copy.path().to_path_buf());
    let (found, _) = logits(&place, Some(WeightFormat::F32), &ids);
    let unrounded = difference(&found, expected);
    assert!(
        unrounded < LOGIT_TOLERANCE,
        "{case}: the logits differ by {unrounded}"
    );
    let (found, weights) = logits(&place, None, &ids);
    let rounded = difference(&found, expected) / largest(expected);
    assert!(
        rounded < ROUNDED_LOGITS,
        "{case}: the logits of the default formats differ by {rounded}"
    );
    let formats: Vec<String> = weights
        .report()
        .weight_formats
        .iter()
        .map(|share| share.weight_format.to_string())
        .collect();
    format!(
        "{case:24} {worst:8.1e} {unrounded:8.1e} {worst_held:8.1e} {rounded:6.3} {}",
        formats.join(" ")
    )
}

#[test]
fn numbers_and_logits_of_all_packages_are_found() {
    println!(
        "folder, numbers, logits in f32, numbers in memory, logits with rounded activations (relative), formats"
    );
    for (case, exact) in CASES {
        println!("{}", check(case, exact));
    }
}
