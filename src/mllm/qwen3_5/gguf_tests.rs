//! Metadata of llama.cpp's files that contradicts itself, and what is exported of them.

use crate::export::export_model;
use crate::export::round_trip_tests::edit_metadata;
use crate::family::ImageSettings;
use crate::gguf::open_header;
use crate::local::test_prompts::Prompts;
use crate::local::{Loading, LocalModel};
use crate::source::ModelPlace;
use crate::{Mllm, checkpoint::read_json};
use planagent_kernels::matrix::WeightFormat;
use serde_json::{Value, json};
use std::fs::File;
use std::io::Write;
use std::path::Path;

const FIXTURE: &str = "tiny_qwen3_5";
const RECURRENT: &str = "qwen35.attention.recurrent_layers";

/// A folder with the files of llama.cpp and the processor.
fn files() -> tempfile::TempDir {
    Prompts::from_fixture(FIXTURE).gguf_with("preprocessor_config.json")
}

/// Why a folder does not open.
fn problem(folder: &Path) -> String {
    let place = ModelPlace::Folder(folder.to_path_buf());
    let opened = LocalModel::load("tiny", &place, &Loading::default());
    opened.map(|_| ()).unwrap_err().to_string()
}

#[test]
fn a_file_says_how_many_blocks_predict_and_which_are_recurrent() {
    let folder = files();
    let (header, _) = open_header(&folder.path().join("model.gguf")).unwrap();
    let value = |key: &str| header.metadata.get(&format!("qwen35.{key}")).cloned();
    // llama.cpp's converter counts the block behind the six of the model.
    assert_eq!(value("block_count"), Some(json!(7)));
    assert_eq!(value("nextn_predict_layers"), Some(json!(1)));
    let local = Prompts::open_at(folder.path());
    let notes = local.describe().load.notes;
    let unused = notes.iter().filter(|note| note.contains("blk.6.")).count();
    assert!(unused > 5, "{notes:?}");
}

#[test]
fn what_contradicts_is_named() {
    let (model, tower) = ("model.gguf", "mmproj-model.gguf");
    for (file, key, value) in [
        (model, "qwen35.nextn_predict_layers", json!(7)),
        (model, "qwen35.nextn_predict_layers", json!("one")),
        (model, RECURRENT, json!([true, false])),
        (model, RECURRENT, json!([1, 2])),
        (model, "qwen35.ssm.inner_size", json!(71)),
        (model, "qwen35.ssm.time_step_rank", json!(0)),
        (model, "qwen35.ssm.time_step_rank", json!(9)),
        (model, "qwen35.ssm.group_count", json!(0)),
        (model, "qwen35.ssm.conv_kernel", json!(1000)),
        (model, "qwen35.ssm.state_size", json!(1 << 20)),
        (model, "qwen35.rope.dimension_count", json!(48)),
        (model, "qwen35.rope.dimension_sections", json!([9, 9, 9, 0])),
        (model, "qwen35.expert_count", json!(8)),
        (
            tower,
            "clip.vision.is_deepstack_layers",
            json!([true, false]),
        ),
    ] {
        let folder = files();
        edit_metadata(&folder.path().join(file), |metadata| {
            metadata.insert(key.to_owned(), value.clone());
        });
        let said = problem(folder.path());
        assert!(said.contains(key), "{key} = {value}: {said}");
    }
    for key in [
        "inner_size",
        "time_step_rank",
        "group_count",
        "state_size",
        "conv_kernel",
    ] {
        let folder = files();
        let key = format!("qwen35.ssm.{key}");
        edit_metadata(&folder.path().join(model), |metadata| {
            metadata.remove(&key);
        });
        let said = problem(folder.path());
        assert!(said.contains(&key), "{key}: {said}");
    }
}

/// The fixture says an interval, as older files; a list of layers comes before it.
#[test]
fn files_may_list_the_layers_with_a_rule() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let folder = files();
    edit_metadata(&folder.path().join("model.gguf"), |metadata| {
        let listed = json!([true, true, false, true, true, false, false]);
        metadata.insert(RECURRENT.into(), listed);
        metadata.insert("qwen35.full_attention_interval".into(), json!(2));
    });
    prompts.check(&Prompts::open_at(folder.path()), |run| run == "second_");
}

fn export(place: &ModelPlace, to: &Path) -> ModelPlace {
    let loading = Loading {
        quantize: Some(WeightFormat::F32),
        ..Loading::default()
    };
    export_model(
        "tiny",
        place,
        &loading,
        &[],
        &mut |_| Ok(Box::new(File::create(to)?) as Box<dyn Write>),
        &mut |_, _| {},
    )
    .unwrap();
    ModelPlace::Gguf {
        model: to.to_path_buf(),
        mmproj: None,
    }
}

/// An export of llama.cpp's file keeps the order of its heads, and says so.
#[test]
fn what_is_exported_of_llama_cpps_files_gives_the_same() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let folder = files();
    let to = folder.path().join("own/own.gguf");
    std::fs::create_dir(folder.path().join("own")).unwrap();
    let gguf = ModelPlace::Folder(folder.path().to_path_buf());
    let own = export(&gguf, &to);
    let (header, _) = open_header(&to).unwrap();
    assert_eq!(header.architecture().unwrap(), "planagent");
    prompts.check(&Prompts::load(&own, ImageSettings::default()), |_| true);
}

#[test]
fn mixtures_of_experts_are_refused() {
    let copy = Prompts::from_fixture(FIXTURE).in_layout(".");
    let path = copy.path().join("config.json");
    let mut config: Value = read_json(&path).unwrap();
    config["model_type"] = json!("qwen3_5_moe");
    std::fs::write(&path, config.to_string()).unwrap();
    let said = problem(copy.path());
    assert!(said.contains("'qwen3_5_moe' is not supported"), "{said}");
}
