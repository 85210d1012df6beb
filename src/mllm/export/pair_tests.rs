//! Decoder and vision tower of today's families, written as llama.cpp's converter writes them.

use super::round_trip_tests::{edit, export, logits};
use crate::checkpoint::read_json;
use crate::family::ImageSettings;
use crate::gguf::{FILE, Header, open_header, tower_path};
use crate::local::test_prompts::{Prompts, is_unsplit};
use crate::source::ModelPlace;
use planagent_kernels::matrix::WeightFormat;
use safetensors::{SafeTensors, serialize_to_file, tensor::TensorView};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Fixtures with a pair that llama.cpp's converter made, and the layout of their folder.
const PAIRS: [(&str, &str); 7] = [
    ("tiny_smolvlm", "."),
    ("tiny_internvl3", "."),
    ("tiny_internvl3", "original"),
    ("tiny_qwen3_vl", "."),
    ("tiny_qwen2_5_vl", "."),
    ("tiny_qwen2_vl", "."),
    ("tiny_gemma3", "."),
];

/// The pair of a folder, in a folder of its own.
fn written(folder: &Path, weight_format: WeightFormat) -> (tempfile::TempDir, PathBuf) {
    let own = tempfile::tempdir().unwrap();
    let model = export(folder, own.path(), weight_format);
    assert!(tower_path(&model).is_file(), "{}", folder.display());
    (own, model)
}

fn place(model: &Path) -> ModelPlace {
    ModelPlace::Gguf {
        model: model.to_path_buf(),
        mmproj: None,
    }
}

/// Removes the small files, so that the model is read by the keys that llama.cpp reads.
fn without_packed_files(model: &Path) {
    edit(model, |header, _| {
        header.metadata.retain(|key, _| !key.starts_with(FILE));
    });
}

#[test]
fn a_pair_computes_what_transformers_computes_by_packed_files_and_by_keys() {
    for (name, layout) in PAIRS {
        let prompts = Prompts::from_fixture(name);
        let (_own, model) = written(prompts.in_layout(layout).path(), WeightFormat::F32);
        let check = || {
            let local = Prompts::load(&place(&model), ImageSettings::default());
            prompts.check(&local, |run| !is_unsplit(run));
        };
        check();
        without_packed_files(&model);
        check();
    }
}

#[test]
fn a_quantized_pair_computes_what_its_folder_computes_bit_by_bit() {
    for (name, layout) in PAIRS {
        let prompts = Prompts::from_fixture(name);
        let folder = prompts.in_layout(layout);
        let (_own, model) = written(folder.path(), WeightFormat::Q8_0);
        let bits = |place: &ModelPlace| -> Vec<u32> {
            let logits = logits(place, Some(WeightFormat::Q8_0));
            logits.into_iter().map(f32::to_bits).collect()
        };
        let from = ModelPlace::Folder(folder.path().to_path_buf());
        assert_eq!(bits(&place(&model)), bits(&from), "{name}, {layout}");
    }
}

/// A file with the numbers of its tensors.
struct File {
    header: Header,
    /// By name: sides without those of 1, and numbers.
    tensors: BTreeMap<String, (Vec<usize>, Vec<f32>)>,
}

impl File {
    fn read(path: &Path) -> Self {
        let (header, _) = open_header(path).unwrap();
        let bytes = fs::read(path).unwrap();
        let tensors = header.tensors.iter().map(|(name, place)| {
            let data = bytes[place.begin as usize..][..place.bytes as usize].to_vec();
            let sides = place.shape.iter().copied().filter(|side| *side != 1);
            let numbers = place.format.widen(data).unwrap();
            (name.clone(), (sides.collect(), numbers))
        });
        Self {
            tensors: tensors.collect(),
            header,
        }
    }
}

/// Keys of llama.cpp's converter whose values are others here.
const OTHER: [(&str, &str); 2] = [
    // The converter writes the decoder's width there (`conversion/qwenvl.py`).
    ("tiny_qwen2_vl", "clip.vision.feed_forward_length"),
    // The base of the rotary embedding grows behind the context of the training.
    ("tiny_internvl3", "qwen2.context_length"),
];

/// The keys of `their` that `own` says otherwise.
fn other_keys(name: &str, own: &Header, their: &Header) -> Vec<String> {
    let architecture = their.architecture().unwrap();
    assert_eq!(own.architecture().unwrap(), architecture);
    let prefix = format!("{architecture}.");
    let keys = their.metadata.iter().filter(|(key, value)| {
        let is_known = OTHER.contains(&(name, key));
        key.starts_with(&prefix) && !is_known && own.metadata.get(*key) != Some(*value)
    });
    let said = |key: &str| own.metadata.get(key).map(Value::to_string);
    keys.map(|(key, value)| format!("{key} = {:?}, not {value}", said(key)))
        .collect()
}

/// The tensors of a file and of one of llama.cpp's converter that differ.
fn other_tensors(own: &File, their: &File) -> Vec<String> {
    const OUTPUT: &str = "output.weight";
    const EMBEDDING: &str = "token_embd.weight";
    let names: BTreeSet<&String> = own.tensors.keys().chain(their.tensors.keys()).collect();
    let is_other = |name: &&String| {
        // The converter writes the output layer of a tied embedding once more.
        let is_tied = name.as_str() == OUTPUT && !own.tensors.contains_key(OUTPUT);
        let here = if is_tied { EMBEDDING } else { name.as_str() };
        own.tensors.get(here) != their.tensors.get(*name)
    };
    names.into_iter().filter(is_other).cloned().collect()
}

#[test]
fn a_pair_says_what_the_pair_of_llama_cpps_converter_says() {
    let mut other = Vec::new();
    for (name, layout) in PAIRS {
        let prompts = Prompts::from_fixture(name);
        let (_own, model) = written(prompts.in_layout(layout).path(), WeightFormat::F32);
        let theirs = prompts.folder.join("gguf/model.gguf");
        for (own, their) in [
            (model.clone(), theirs.clone()),
            (tower_path(&model), tower_path(&theirs)),
        ] {
            let (own, their) = (File::read(&own), File::read(&their));
            let mut found = other_keys(name, &own.header, &their.header);
            found.extend(other_tensors(&own, &their));
            other.extend(found.iter().map(|what| format!("{name}, {layout}: {what}")));
        }
    }
    assert_eq!(other, [] as [&str; 0]);
}

/// A copy of a fixture with another value in a small file.
fn changed(name: &str, file: &str, key: &str, value: Value) -> tempfile::TempDir {
    let folder = Prompts::from_fixture(name).in_layout(".");
    let path = folder.path().join(file);
    let mut keys = read_json(&path).unwrap();
    keys[key] = value;
    fs::write(path, keys.to_string()).unwrap();
    folder
}

#[test]
fn images_that_are_not_cut_stay_whole_by_the_keys_alone() {
    // Four tiles a side, which no key says of an image that is not cut.
    let size = json!({"longest_edge": 64});
    let folder = changed("tiny_smolvlm", "preprocessor_config.json", "size", size);
    let path = folder.path().join("preprocessor_config.json");
    let mut processor = read_json(&path).unwrap();
    processor["do_image_splitting"] = json!(false);
    fs::write(path, processor.to_string()).unwrap();
    let (_own, model) = written(folder.path(), WeightFormat::F32);
    without_packed_files(&model);
    let from = ModelPlace::Folder(folder.path().to_path_buf());
    assert_eq!(logits(&place(&model), None), logits(&from, None));
}

#[test]
fn a_setting_without_a_key_becomes_a_file_for_this_program_and_is_named() {
    let vision = |name: &str, key: &str, value: Value| {
        let config = read_json(&Prompts::from_fixture(name).folder.join("config.json")).unwrap();
        let mut vision = config["vision_config"].clone();
        vision[key] = value;
        changed(name, "config.json", "vision_config", vision)
    };
    let processor = "preprocessor_config.json";
    for (folder, lacking) in [
        (
            vision("tiny_smolvlm", "hidden_act", json!("gelu")),
            "another activation of the vision tower",
        ),
        (
            changed("tiny_internvl3", processor, "use_thumbnail", json!(false)),
            "tiles without the whole image behind them",
        ),
        (
            changed("tiny_qwen3_vl", processor, "do_normalize", json!(false)),
            "pixels that are not normalized",
        ),
        (
            vision("tiny_qwen2_5_vl", "fullatt_block_indexes", json!([0, 3])),
            "layers that attend to the whole image at uneven distances",
        ),
        (
            vision("tiny_qwen2_5_vl", "window_size", json!(64)),
            "windows of another size than 112 pixels",
        ),
    ] {
        let own = tempfile::tempdir().unwrap();
        let model = export(folder.path(), own.path(), WeightFormat::F32);
        assert!(!tower_path(&model).is_file(), "{lacking}");
        let from = ModelPlace::Folder(folder.path().to_path_buf());
        assert_eq!(
            logits(&place(&model), None),
            logits(&from, None),
            "{lacking}"
        );
    }
}

/// Rewrites a folder's weights, with the tower's projections to queries, keys and values as three
/// tensors each, as random weights have them.
fn take_projections_apart(folder: &Path) {
    let path = folder.join("model.safetensors");
    let bytes = fs::read(&path).unwrap();
    let mut tensors = Vec::new();
    for (name, view) in SafeTensors::deserialize(&bytes).unwrap().tensors() {
        let (mut shape, data) = (view.shape().to_vec(), view.data());
        if !name.contains(".attn.qkv.") {
            tensors.push((name, view.dtype(), shape, data.to_vec()));
            continue;
        }
        shape[0] /= 3;
        let parts = ["q_proj", "k_proj", "v_proj"];
        for (part, rows) in parts.iter().zip(data.chunks_exact(data.len() / 3)) {
            let name = name.replace("qkv", part);
            tensors.push((name, view.dtype(), shape.clone(), rows.to_vec()));
        }
    }
    let views = tensors.iter().map(|(name, dtype, shape, data)| {
        let view = TensorView::new(*dtype, shape.clone(), data).unwrap();
        (name.clone(), view)
    });
    serialize_to_file(views, None, &path).unwrap();
}

#[test]
fn projections_that_llama_cpp_has_in_one_tensor_are_joined() {
    let folder = Prompts::from_fixture("tiny_qwen3_vl").in_layout(".");
    let (_own, expected) = written(folder.path(), WeightFormat::Q8_0);
    take_projections_apart(folder.path());
    let (_other, model) = written(folder.path(), WeightFormat::Q8_0);
    let [own, other] = [&expected, &model].map(|model| File::read(&tower_path(model)));
    assert!(own.tensors.contains_key("v.blk.0.attn_qkv.weight"));
    assert_eq!(other_tensors(&other, &own), [] as [&str; 0]);
}
