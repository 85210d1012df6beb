//! GGUF files in number formats and with tensors that this program does not write by itself.

use super::round_trip_tests::{edit, export, logits, widened};
use super::writer::{Layout, PlannedTensor};
use crate::MllmError;
use crate::families::Families;
use crate::gguf::{FILE, open_header};
use crate::local::test_reference::fixture;
use crate::source::{Checkpoint, ModelPlace};
use candle_core::quantized::{GgmlDType, QTensor};
use candle_core::{Device, Tensor};
use planagent_kernels::matrix::{StoredFormat, WeightFormat, widen};
use serde_json::json;
use std::fs;
use std::path::{Path, PathBuf};

/// Rewrites the layers' matrices of a decoder in f32 with what `convert` makes of their values: a
/// format and its blocks.
fn convert(model: &Path, convert: impl Fn(Vec<f32>) -> (GgmlDType, Vec<u8>)) {
    let bytes = fs::read(model).unwrap();
    let (header, _) = open_header(model).unwrap();
    let mut data = Vec::new();
    let mut tensors = Vec::new();
    for (name, place) in &header.tensors {
        let old = bytes[place.begin as usize..][..place.bytes as usize].to_vec();
        let (format, blocks) = if name.starts_with("blk.") && place.shape.len() == 2 {
            convert(widen(GgmlDType::F32, old).unwrap())
        } else {
            (GgmlDType::F32, old)
        };
        tensors.push(PlannedTensor {
            name: name.clone(),
            format: format.into(),
            shape: place.shape.clone(),
        });
        data.push(blocks);
    }
    let layout = Layout {
        metadata: header.metadata.into_iter().collect(),
        tensors,
    };
    let mut out = Vec::new();
    layout.write_header(&mut out).unwrap();
    for data in &data {
        Layout::write_data(&mut out, data).unwrap();
    }
    fs::write(model, out).unwrap();
}

fn quantized(values: Vec<f32>, format: GgmlDType) -> Vec<u8> {
    let count = values.len();
    let tensor = Tensor::from_vec(values, count, &Device::Cpu).unwrap();
    QTensor::quantize(&tensor, format)
        .unwrap()
        .data()
        .unwrap()
        .to_vec()
}

fn apart(one: &[f32], other: &[f32]) -> f32 {
    one.iter()
        .zip(other)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max)
}

/// A wide tiny model whose layers are stored in a format, and the same numbers in f32.
fn stored_as(format: GgmlDType) -> [(tempfile::TempDir, PathBuf); 2] {
    // One checkpoint for both: its numbers are random.
    let from = widened("tiny_llava");
    [false, true].map(|wide| {
        let folder = tempfile::tempdir().unwrap();
        let model = export(from.path(), folder.path(), WeightFormat::F32);
        convert(&model, |values| {
            let blocks = quantized(values, format);
            if !wide {
                return (format, blocks);
            }
            (
                GgmlDType::F32,
                widen(format, blocks)
                    .unwrap()
                    .into_iter()
                    .flat_map(f32::to_le_bytes)
                    .collect(),
            )
        });
        (folder, model)
    })
}

/// A copy of a fixture.
fn copy(name: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for entry in fs::read_dir(fixture(name)).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
    }
    folder
}

fn place(model: &Path) -> ModelPlace {
    ModelPlace::Gguf {
        model: model.to_path_buf(),
        mmproj: None,
    }
}

/// A product in 8 bits rounds its activations, so the logits of `q8_0` differ from those of the
/// same numbers in f32. Another format may hardly add to that.
#[test]
fn formats_without_a_product_lose_hardly_more_than_eight_bits_do() {
    let difference = |format| {
        let [(_stored, stored), (_wide, wide)] = stored_as(format);
        apart(&logits(&place(&stored), None), &logits(&place(&wide), None))
    };
    let usual = difference(GgmlDType::Q8_0);
    println!("q8_0: {usual:.1e}");
    for (format, times) in [
        (GgmlDType::Q4_0, 1.5),
        (GgmlDType::Q4_1, 1.5),
        (GgmlDType::Q5_0, 1.5),
        (GgmlDType::Q5_1, 1.5),
        (GgmlDType::Q2K, 2.0),
    ] {
        let found = difference(format);
        println!("{format:?}: {found:.1e}");
        assert!(found < times * usual, "{format:?}: {found}, q8_0 {usual}");
    }
    // Formats with a product of their own round activations alike.
    let [three, four, five] = [GgmlDType::Q3K, GgmlDType::Q4K, GgmlDType::Q5K].map(difference);
    println!("q3_k: {three:.1e}, q4_k: {four:.1e}, q5_k: {five:.1e}");
    assert!(three.max(five) < 2.0 * four, "{three}, {five}, q4_k {four}");
    // What another rounding to four bits costs.
    let [(_stored, stored), (_wide, wide)] = stored_as(GgmlDType::Q4_0);
    let again = apart(
        &logits(&place(&wide), Some(WeightFormat::Q4K)),
        &logits(&place(&wide), None),
    );
    println!("q4_0 rounded to q4_k: {again:.1e}");
    assert!(again > 5.0 * usual, "{again}");
    // Also where four bits are asked for, four bits are not rounded again.
    let checkpoint = Checkpoint::open(&place(&stored), None, &Families::default()).unwrap();
    let lines = checkpoint.weights.forecast(Some(WeightFormat::Q4K)).lines();
    assert!(
        lines
            .iter()
            .any(|line| line.starts_with("q4_0 loaded as q4_0: the file has no more bits")),
        "{lines:?}"
    );
}

/// Replaces the `ggml_type` of all tensors of one type.
fn retype(model: &Path, from: u32, to: u32) {
    let mut bytes = fs::read(model).unwrap();
    let (header, _) = open_header(model).unwrap();
    for name in header
        .tensors
        .keys()
        .filter(|name| name.starts_with("blk."))
    {
        let at = bytes
            .windows(name.len())
            .position(|window| window == name.as_bytes())
            .unwrap()
            + name.len();
        let dimensions = u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        let at = at + 4 + 8 * dimensions;
        if bytes[at..at + 4] == from.to_le_bytes() {
            bytes[at..at + 4].copy_from_slice(&to.to_le_bytes());
        }
    }
    fs::write(model, bytes).unwrap();
}

#[test]
fn tables_of_four_bits_are_read_and_others_named() {
    let [(_stored, stored), (_wide, wide)] = stored_as(GgmlDType::Q4_0);
    // Both have a half and sixteen bytes in a block.
    retype(&stored, 2, 20);
    convert(&wide, |values| {
        let blocks = quantized(values, GgmlDType::Q4_0);
        let numbers = StoredFormat::Iq4Nl.widen(blocks).unwrap();
        (
            GgmlDType::F32,
            numbers.into_iter().flat_map(f32::to_le_bytes).collect(),
        )
    });
    let checkpoint = Checkpoint::open(&place(&stored), None, &Families::default()).unwrap();
    let report = checkpoint.weights.forecast(None);
    assert!(
        report
            .lines()
            .iter()
            .any(|line| line.starts_with("iq4_nl: ")),
        "{report:?}"
    );
    let (found, expected) = (logits(&place(&stored), None), logits(&place(&wide), None));
    let largest = expected
        .iter()
        .fold(0f32, |largest, logit| largest.max(logit.abs()));
    assert!(
        apart(&found, &expected) < 0.05 * largest,
        "{} of {largest}",
        apart(&found, &expected)
    );

    retype(&stored, 20, 17);
    match Checkpoint::open(&place(&stored), None, &Families::default()).map(|_| ()) {
        Err(
            error @ MllmError::GgufFormat {
                format: "IQ2_XS", ..
            },
        ) => {
            assert!(
                error
                    .to_string()
                    .contains("take a file of the same model in Q4_K_M"),
                "{error}"
            );
        }
        other => panic!("{other:?}"),
    }
}

/// Llama 3.1 scales the frequencies of its rotary embedding one by one. llama.cpp's files have the
/// factors as a tensor.
#[test]
fn factors_of_rotary_frequencies_are_written_and_read() {
    let from = copy("tiny_llava");
    let path = from.path().join("config.json");
    let mut config: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
    config["text_config"]["rope_parameters"] = json!({"rope_type": "llama3", "rope_theta": 10_000.0, "factor": 8.0,
        "low_freq_factor": 1.0, "high_freq_factor": 4.0, "original_max_position_embeddings": 64});
    fs::write(&path, config.to_string()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let model = export(from.path(), folder.path(), WeightFormat::F32);
    let (header, _) = open_header(&model).unwrap();
    assert_eq!(header.tensors["rope_freqs.weight"].shape.len(), 1);
    let expected = logits(&ModelPlace::Folder(from.path().to_path_buf()), None);
    assert_eq!(
        logits(&place(&model), None),
        expected,
        "the configuration in the file comes first"
    );

    // As llama.cpp writes it: no configuration beside the metadata.
    edit(&model, |header, _| {
        header.metadata.retain(|key, _| !key.starts_with(FILE));
    });
    for file in [
        "tokenizer.json",
        "tokenizer_config.json",
        "chat_template.jinja",
    ] {
        fs::copy(from.path().join(file), folder.path().join(file)).unwrap();
    }
    let found = apart(&logits(&place(&model), None), &expected);
    assert!(found < 1e-4, "{found}");
    edit(&model, |_, tensors| {
        for tensor in tensors
            .iter_mut()
            .filter(|tensor| tensor.name == "rope_freqs.weight")
        {
            tensor.name = "rope_unused.weight".into();
        }
    });
    let without = apart(&logits(&place(&model), None), &expected);
    assert!(
        without > 1e-5 && without > 100.0 * found,
        "the factors change little: {without}, {found}"
    );
}
