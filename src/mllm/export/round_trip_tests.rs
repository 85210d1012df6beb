//! Models exported as GGUF and opened again.

use super::writer::{Layout, PlannedTensor};
use super::{GgufPart, export_model};
use crate::checkpoint::paired;
use crate::decoder::Logits;
use crate::families::Families;
use crate::family::{ImageSettings, VisionLanguageModel};
use crate::gguf::{FILE, Header, open_header, tokenizer_tests, tower_path};
use crate::local::test_prompts::{Prompts, is_unsplit};
use crate::local::test_reference::{assert_chat, fixture, synthetic};
use crate::local::{Loading, LocalModel, Sequence};
use crate::source::{Checkpoint, ModelPlace};
use crate::{Constraint, Deadline, ImageFeatures, Mllm, PromptPrefix, Request, Sampling};
use candle_core::Tensor;
use planagent_kernels::matrix::WeightFormat;
use safetensors::{Dtype, SafeTensors, serialize_to_file, tensor::TensorView};
use serde_json::{Value as Json, json};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Exports a model folder to `m.gguf` in another folder.
pub(super) fn export(from: &Path, to: &Path, weight_format: WeightFormat) -> PathBuf {
    let model = to.join("m.gguf");
    let mut create = |part: GgufPart| -> std::io::Result<Box<dyn Write>> {
        Ok(Box::new(File::create(part.path(&model))?))
    };
    let loading = Loading {
        quantize: Some(weight_format),
        ..Loading::default()
    };
    let mut written = (0, 1);
    export_model(
        "tiny",
        &ModelPlace::Folder(from.to_path_buf()),
        &loading,
        &[],
        &mut create,
        &mut |bytes, total| {
            assert!(written.0 < bytes);
            written = (bytes, total);
        },
    )
    .unwrap();
    assert_eq!(written.0, written.1);
    model
}

/// Copies the reference files of [`assert_chat`].
fn copy_reference(from: &Path, to: &Path) {
    for file in ["reference.safetensors", "prompts.json", "image.png"] {
        fs::copy(from.join(file), to.join(file)).unwrap();
    }
}

/// Rewrites a file with other metadata.
pub(crate) fn edit_metadata(
    path: &Path,
    change: impl FnOnce(&mut BTreeMap<String, serde_json::Value>),
) {
    edit(path, |header, _| change(&mut header.metadata));
}

/// Rewrites a file with other metadata.
pub(super) fn edit(path: &Path, change: impl FnOnce(&mut Header, &mut Vec<PlannedTensor>)) {
    let bytes = fs::read(path).unwrap();
    let (mut header, _) = open_header(path).unwrap();
    let data: BTreeMap<String, Vec<u8>> = header
        .tensors
        .iter()
        .map(|(name, place)| {
            (
                name.clone(),
                bytes[place.begin as usize..][..place.bytes as usize].to_vec(),
            )
        })
        .collect();
    let planned = header.tensors.iter();
    let mut tensors = planned
        .map(|(name, place)| PlannedTensor {
            name: name.clone(),
            format: place.format,
            shape: place.shape.clone(),
        })
        .collect();
    change(&mut header, &mut tensors);
    let layout = Layout {
        metadata: header.metadata.into_iter().collect(),
        tensors,
    };
    let mut out = Vec::new();
    layout.write_header(&mut out).unwrap();
    // Renamed tensors keep their place.
    for (tensor, data) in layout.tensors.iter().zip(data.values()) {
        Layout::write_data(&mut out, data).unwrap();
        assert_eq!(tensor.bytes(), data.len() as u64);
    }
    fs::write(path, out).unwrap();
}

#[test]
fn a_model_from_gguf_computes_what_transformers_computes() {
    for (name, rounds) in [
        ("tiny_llava", &["", "chat_"][..]),
        ("tiny_llava_next", &["", "chat_"]),
        ("tiny_llava_next_mistral", &[""]),
        ("tiny_cogvlm", &["", "chat_"]),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let model = export(&fixture(name), folder.path(), WeightFormat::F32);
        assert_eq!(tower_path(&model).is_file(), name != "tiny_cogvlm");
        copy_reference(&fixture(name), folder.path());
        assert_chat(folder.path(), rounds);
    }
}

#[test]
fn families_without_a_pair_compute_from_one_file_what_transformers_computes() {
    for name in ["tiny_llava_onevision", "tiny_gemma4", "tiny_qwen3_5"] {
        let prompts = Prompts::from_fixture(name);
        let folder = tempfile::tempdir().unwrap();
        let model = export(
            prompts.in_layout(".").path(),
            folder.path(),
            WeightFormat::F32,
        );
        assert!(!tower_path(&model).is_file());
        let place = ModelPlace::Gguf {
            model,
            mmproj: None,
        };
        prompts.check(&Prompts::load(&place, ImageSettings::default()), |run| {
            !is_unsplit(run)
        });
    }
}

/// A decoder and a tower as from llama.cpp: without packed files, with the older names of the
/// tower's feed-forward layers. The tokenizer lies beside them, because its kind is not supported
/// in GGUF.
#[test]
fn a_model_of_llama_cpp_computes_what_transformers_computes() {
    for name in ["tiny_llava", "tiny_llava_next"] {
        let from = fixture(name);
        let folder = tempfile::tempdir().unwrap();
        let model = export(&from, folder.path(), WeightFormat::F32);
        edit(&model, |header, _| {
            header.metadata.retain(|key, _| !key.starts_with(FILE));
        });
        edit(&tower_path(&model), |_, tensors| {
            for tensor in tensors {
                tensor.name = if tensor.name.contains("ffn_up") {
                    tensor.name.replace("ffn_up", "ffn_down")
                } else {
                    tensor.name.replace("ffn_down", "ffn_up")
                };
            }
        });
        for file in [
            "tokenizer.json",
            "tokenizer_config.json",
            "chat_template.jinja",
        ] {
            fs::copy(from.join(file), folder.path().join(file)).unwrap();
        }
        copy_reference(&from, folder.path());
        assert_chat(folder.path(), &["", "chat_"]);
    }
}

/// As most files of llama.cpp: a SentencePiece tokenizer in the metadata, no image token, no chat
/// template.
#[test]
fn a_model_of_llama_cpp_with_its_own_tokenizer_answers() {
    let folder = tempfile::tempdir().unwrap();
    let path = export(&fixture("tiny_llava"), folder.path(), WeightFormat::Q8_0);
    edit(&path, |header, _| {
        header
            .metadata
            .retain(|key, _| !key.starts_with(FILE) && !key.starts_with("tokenizer."));
        header
            .metadata
            .extend(tokenizer_tests::metadata(&tokenizer_tests::small(), 352));
    });
    let place = ModelPlace::Folder(folder.path().to_path_buf());
    let model = LocalModel::load("tiny", &place, &Loading::default()).unwrap();
    let image = synthetic(32, 32);
    let mut conversation = model
        .converse(
            &PromptPrefix {
                system: "keep lane".into(),
                image: Some(image.into()),
            },
            0,
        )
        .unwrap();
    let request = |constraint| Request {
        constraint,
        max_new_tokens: 8,
        sampling: Sampling::Greedy,
        deadline: Deadline::NONE,
        draft: None,
    };
    let first = conversation
        .ask("left?", &request(Constraint::Free))
        .unwrap()
        .tokens;
    assert_eq!(first.image, 16);
    let second = conversation
        .ask(
            "lane?",
            &request(Constraint::Choice(vec!["keep left".into()])),
        )
        .unwrap();
    assert_eq!(second.text, "keep left");
    assert!(
        second.tokens.cached > 20 && second.tokens.image == 0,
        "{:?} after {first:?}",
        second.tokens
    );
    let notes = model.describe().load.notes;
    assert!(
        notes
            .iter()
            .any(|note| note.contains("it gets that of Vicuna")),
        "{notes:?}"
    );
}

#[test]
fn rows_in_the_wrong_order_are_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let model = export(&fixture("tiny_llava"), folder.path(), WeightFormat::F32);
    let place = ModelPlace::Folder(folder.path().to_path_buf());
    let right = logits(&place, None);
    // The rows of queries in Hugging Face's order, where llama.cpp's is expected.
    let mut bytes = fs::read(&model).unwrap();
    let (header, _) = open_header(&model).unwrap();
    let query = &header.tensors["blk.0.attn_q.weight"];
    let range = query.begin as usize..(query.begin + query.bytes) as usize;
    let plain = paired(&bytes[range.clone()], 32, 4);
    bytes[range].copy_from_slice(&plain);
    fs::write(&model, bytes).unwrap();
    let wrong = logits(&place, None);
    let difference = right
        .iter()
        .zip(&wrong)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max);
    assert!(difference > 1e-3, "{difference}");
}

/// Logits of an image and some tokens.
pub(super) fn logits(place: &ModelPlace, quantize: Option<WeightFormat>) -> Vec<f32> {
    logits_behind(place, quantize, true)
}

/// Logits behind a few words, with a picture among them or without.
fn logits_behind(place: &ModelPlace, quantize: Option<WeightFormat>, picture: bool) -> Vec<f32> {
    let mut checkpoint = Checkpoint::open(place, quantize, &Families::default()).unwrap();
    let model = checkpoint.open_model().unwrap();
    let model: &dyn VisionLanguageModel = &*model;
    let features = picture.then(|| model.encode_image(&synthetic(40, 50)).unwrap());
    let image = model.info().image_token;
    let words = |ids: &[u32]| -> Vec<u32> {
        let words = ids.iter().copied();
        words.filter(|id| *id != image).collect()
    };
    let tokens = features.as_ref().map_or(0, ImageFeatures::tokens);
    let placeholders = vec![image; tokens];
    let ids = [words(&[1, 5]), placeholders, words(&[7, 8, 9])].concat();
    let logits: Tensor = Sequence::new(model)
        .append(model, &ids, features.as_ref(), Logits::All)
        .unwrap()
        .unwrap();
    logits.flatten_all().unwrap().to_vec1().unwrap()
}

/// A checkpoint like a fixture, but wide enough for the k-quants and with random weights.
pub(super) fn widened(name: &str) -> tempfile::TempDir {
    let from = fixture(name);
    let folder = tempfile::tempdir().unwrap();
    for entry in fs::read_dir(&from).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
    }
    let wide = |side: usize| match side {
        16 => 128,
        32 => 256,
        48 | 64 => 512,
        24 | 96 => 768,
        72 => 3 * 768,
        other => other,
    };
    let mut config: Json =
        serde_json::from_str(&fs::read_to_string(from.join("config.json")).unwrap()).unwrap();
    widen(&mut config, &|side| wide(side as usize) as u64);
    fs::write(folder.path().join("config.json"), config.to_string()).unwrap();
    let bytes = fs::read(from.join("model.safetensors")).unwrap();
    let mut state = 1_u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 - 0.5
    };
    // A file gives its tensors in another order each time.
    let mut stored = SafeTensors::deserialize(&bytes).unwrap().tensors();
    stored.sort_by(|(one, _), (other, _)| one.cmp(other));
    let tensors: BTreeMap<String, (Vec<usize>, Vec<u8>)> = stored
        .iter()
        .map(|(name, view)| {
            let shape: Vec<usize> = match view.shape() {
                // The patch kernel keeps its sides.
                [outputs, rest @ ..] if rest.len() == 3 => [&[wide(*outputs)], rest].concat(),
                shape => shape.iter().map(|side| wide(*side)).collect(),
            };
            let values = (0..shape.iter().product::<usize>())
                .flat_map(|_| (random() * 0.2).to_le_bytes())
                .collect();
            (name.clone(), (shape, values))
        })
        .collect();
    let views = tensors.iter().map(|(name, (shape, values))| {
        (
            name.clone(),
            TensorView::new(Dtype::F32, shape.clone(), values).unwrap(),
        )
    });
    serialize_to_file(views, None, &folder.path().join("model.safetensors")).unwrap();
    folder
}

fn widen(config: &mut Json, wide: &impl Fn(u64) -> u64) {
    let Json::Object(object) = config else { return };
    for (key, value) in object {
        match value {
            Json::Object(_) => widen(value, wide),
            Json::Number(number)
                if ["hidden_size", "intermediate_size"].contains(&key.as_str()) =>
            {
                *value = json!(wide(number.as_u64().unwrap()));
            }
            Json::Number(number) if key == "head_dim" => {
                *value = json!(number.as_u64().unwrap() * 8);
            }
            _ => {}
        }
    }
}

#[test]
fn a_quantized_model_from_gguf_is_bit_identical() {
    for (name, weight_formats) in [
        ("tiny_llava", &WeightFormat::ALL[..]),
        ("tiny_llava_next", &[WeightFormat::Q8_0]),
        ("tiny_cogvlm", &[WeightFormat::Q4K]),
    ] {
        let checkpoint = widened(name);
        let from = ModelPlace::Folder(checkpoint.path().to_path_buf());
        for weight_format in weight_formats.iter().copied() {
            let folder = tempfile::tempdir().unwrap();
            let model = export(checkpoint.path(), folder.path(), weight_format);
            let place = ModelPlace::Gguf {
                model,
                mmproj: None,
            };
            // Of fewer than 8 bits, a file has the tower in `q8_0`, and memory in `q8_256`.
            let picture = weight_format.bits() >= WeightFormat::Q8_0.bits();
            let logits = |place, quantize| logits_behind(place, quantize, picture);
            let expected = logits(&from, Some(weight_format));
            assert!(expected.iter().all(|logit| logit.is_finite()));
            let bits = |logits: Vec<f32>| logits.into_iter().map(f32::to_bits).collect::<Vec<_>>();
            let expected = bits(expected);
            assert_eq!(
                bits(logits(&place, None)),
                expected,
                "{name}, {weight_format}"
            );
            assert_eq!(
                bits(logits(&place, Some(weight_format))),
                expected,
                "{name}, {weight_format}, asked for once more"
            );
        }
    }
}

#[test]
fn the_report_says_what_is_held_how() {
    let checkpoint = widened("tiny_llava");
    let place = ModelPlace::Folder(checkpoint.path().to_path_buf());
    let mut opened =
        Checkpoint::open(&place, Some(WeightFormat::Q4K), &Families::default()).unwrap();
    let forecast = opened.weights.forecast(Some(WeightFormat::Q4K));
    opened.open_model().unwrap();
    let report = opened.weights.report();
    let tensors = |weight_format| {
        report
            .weight_formats
            .iter()
            .find(|share| share.weight_format == weight_format)
            .map_or(0, |share| share.tensors)
    };
    assert_eq!(
        (
            tensors(WeightFormat::Q4K),
            tensors(WeightFormat::Q6K),
            tensors(WeightFormat::Q8Of256)
        ),
        (15, 1, 20)
    );
    assert!(
        report
            .exceptions
            .iter()
            .any(|known| known.name == "lm_head.weight" && known.weight_format == WeightFormat::Q6K)
    );
    // The forecast ignores the packing for products, and counts a norm that no LLaVA uses.
    let (foreseen, held) = (forecast.bytes() as f64, report.bytes() as f64);
    assert!((foreseen / held - 1.0).abs() < 0.01, "{foreseen} {held}");
}
