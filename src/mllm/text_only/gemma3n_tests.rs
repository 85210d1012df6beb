//! Parity of Gemma 3n's decoder with Hugging Face transformers (`tests/fixtures/make_gemma3n.py`),
//! and the errors that are easily made with it.

use super::GEMMA3N;
use crate::MllmError;
use crate::checkpoint::read_json;
use crate::export::round_trip_tests::edit_metadata;
use crate::family::ImageSettings;
use crate::local::test_faults::Fault;
use crate::local::test_prompts::Prompts;
use crate::local::test_reference::{assert_greedy, assert_logits, fixture};
use crate::local::{Loading, LocalModel};
use crate::source::ModelPlace;
use candle_core::Tensor;
use serde_json::{Value, json};
use std::path::Path;

const FIXTURE: &str = "tiny_gemma3n";

#[test]
fn logits_and_greedy_tokens_are_those_of_transformers() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let local = prompts.open(".", ImageSettings::default());
    assert_eq!(local.model().info().architecture, "gemma3n_text");
    prompts.check(&local, |_| true);
}

/// llama.cpp's converter adds rows of zeros to the table of layers.
#[test]
fn files_of_llama_cpps_converter_give_the_numbers_of_their_table() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let local = Prompts::open_at(&prompts.folder.join("gguf"));
    let model = local.model();
    assert_eq!(model.info().architecture, "gemma3n_text");
    for run in ["text_", "chat_"] {
        let ids = prompts.reference.ids(&format!("{run}input_ids"), 0);
        let logits = prompts.reference.tensor(&format!("padded_{run}logits"));
        assert_logits(model, &ids, None, logits);
        let tokens = prompts.reference.ids(&format!("padded_{run}generated"), 0);
        assert_greedy(model, &ids, None, &tokens);
    }
}

/// A copy of the folder whose configuration is changed.
fn changed(prompts: &Prompts, change: impl FnOnce(&mut Value)) -> tempfile::TempDir {
    let copy = prompts.in_layout(".");
    let path = copy.path().join("config.json");
    let mut config = read_json(&path).unwrap();
    change(&mut config);
    std::fs::write(&path, config.to_string()).unwrap();
    copy
}

/// A configuration as the published models have it, around that of the decoder.
fn nested(config: &mut Value, tower: &Value) {
    let text = config.take();
    *config = json!({"model_type": "gemma3n", "architectures": ["Gemma3nForConditionalGeneration"],
        "text_config": text, "vision_config": tower, "audio_config": {"model_type": "gemma3n_audio"}});
}

/// Why a folder does not open.
fn problem(folder: &Path) -> String {
    load(folder).map(|_| ()).unwrap_err().to_string()
}

fn load(folder: &Path) -> Result<LocalModel, MllmError> {
    let place = ModelPlace::Folder(folder.to_path_buf());
    LocalModel::load("tiny", &place, &Loading::default())
}

#[test]
fn a_folder_with_another_vision_tower_is_refused_and_opens_without() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let tower = json!({"model_type": "gemma3n_vision", "architecture": "resnet50"});
    let whole = changed(&prompts, |config| nested(config, &tower));
    let said = problem(whole.path());
    for part in ["vision_config.architecture", "mobilenetv5_300m_enc"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let blind = changed(&prompts, |config| nested(config, &Value::Null));
    prompts.check(&load(blind.path()).unwrap(), |_| true);
}

#[test]
fn a_decoder_beside_its_tower_is_opened_without_it_as_a_description_says() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let folder = tempfile::tempdir().unwrap();
    let [model, tower] = ["model.gguf", "mmproj-model.gguf"].map(|name| folder.path().join(name));
    std::fs::copy(prompts.folder.join("gguf/model.gguf"), &model).unwrap();
    // Of another tower, which calls itself that of a later Gemma 3n.
    std::fs::copy(
        fixture("tiny_gemma3").join("gguf/mmproj-model.gguf"),
        &tower,
    )
    .unwrap();
    edit_metadata(&tower, |metadata| {
        drop(metadata.insert("clip.projector_type".into(), json!("gemma3nw")));
    });
    let said = problem(folder.path());
    assert!(
        said.contains("gemma3nw") && said.contains("vision = false"),
        "{said}"
    );
    let alone = Prompts::load(&ModelPlace::Decoder(model), ImageSettings::default());
    assert_eq!(alone.model().info().image_size, None);
}

#[test]
fn what_contradicts_in_a_file_of_llama_cpp_is_named() {
    let prompts = Prompts::from_fixture(FIXTURE);
    for (key, value) in [
        ("feed_forward_length", json!([24, 40])),
        ("feed_forward_length", json!([24, 40, 24, 32, 24, 24, 0])),
        ("feed_forward_length", json!("wide")),
        ("attention.sliding_window_pattern", json!([true])),
        ("attention.sliding_window", json!(0)),
        ("attention.shared_kv_layers", json!(7)),
        ("embedding_length_per_layer_input", json!(0)),
        ("altup.num_inputs", json!(0)),
        ("altup.active_idx", json!(4)),
        ("activation_sparsity_scale", json!([0.5])),
        ("activation_sparsity_scale", json!(vec![40.0; 7])),
        ("final_logit_softcapping", json!(-1)),
        ("rope.freq_base_swa", json!(0)),
    ] {
        let key = format!("gemma3n.{key}");
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("model.gguf");
        std::fs::copy(prompts.folder.join("gguf/model.gguf"), &model).unwrap();
        edit_metadata(&model, |metadata| {
            // Infinite ones, which the writer of tests has no number for.
            let scale = "gemma3n.activation_sparsity_scale".to_owned();
            metadata.insert(scale, json!(vec![0.5; 7]));
            drop(metadata.insert(key.clone(), value.clone()));
        });
        let said = problem(folder.path());
        assert!(said.contains(&key), "{key} = {value}: {said}");
    }
}

/// Changes the numbers of tensors that are vectors about 1.
fn ones(weight: &Tensor) -> Tensor {
    weight.ones_like().unwrap()
}

fn transposed(matrix: &Tensor) -> Tensor {
    matrix.t().unwrap()
}

const FAULTS: [Fault; 22] = [
    ("the first stream is the active one", |parts| {
        parts.config["altup_active_idx"] = json!(0);
    }),
    ("all gates count", |parts| {
        parts.config["activation_sparsity_pattern"] = json!(vec![0.0; 7]);
    }),
    ("another part of gates", |parts| {
        parts.config["activation_sparsity_pattern"][0] = json!(0.95);
    }),
    ("gates of all layers are few", |parts| {
        parts.config["activation_sparsity_pattern"] = json!(vec![0.7; 7]);
    }),
    ("the factors of the active stream left out", |parts| {
        parts.config["altup_correct_scale"] = json!(false);
    }),
    ("no route to predictions", |parts| {
        parts.change("prediction_coefs.weight", |weight| {
            weight.zeros_like().unwrap()
        });
    }),
    ("predictions mixed by the transposed factors", |parts| {
        parts.change("prediction_coefs.weight", |weight| {
            let factors = weight.reshape((4, 4, 4)).unwrap();
            factors.transpose(0, 1).unwrap().reshape((16, 4)).unwrap()
        });
    }),
    ("corrections without their factors", |parts| {
        parts.change("correction_coefs.weight", |weight| {
            weight.zeros_like().unwrap()
        });
    }),
    ("the factors of corrections transposed", |parts| {
        parts.change("correction_coefs.weight", transposed);
    }),
    ("routes that are not normalized by the width", |parts| {
        parts.change("modality_router.weight", |weight| (weight * 32.0).unwrap());
    }),
    ("the norm before routes without its weight", |parts| {
        parts.change("router_norm.weight", ones);
    }),
    ("streams made by transposed projections", |parts| {
        parts.change("altup_projections.0.weight", transposed);
    }),
    ("streams exchanged at the end", |parts| {
        let name = |index| format!("model.altup_unembed_projections.{index}.weight");
        parts.swap(&name(0), &name(1));
    }),
    ("the low-rank part without its norm's weight", |parts| {
        parts.change("post_laurel_norm.weight", ones);
    }),
    ("no low-rank part", |parts| {
        parts.change("post_laurel_norm.weight", |weight| {
            weight.zeros_like().unwrap()
        });
    }),
    ("norms by 1 + w", |parts| {
        parts.change("norm.weight", |weight| (weight + 1.0).unwrap());
    }),
    ("no bound of logits", |parts| {
        parts.config["final_logit_softcapping"] = json!(1e6);
    }),
    ("a window that is one wider", |parts| {
        parts.config["sliding_window"] = json!(8);
    }),
    ("the base of local layers in global ones", |parts| {
        parts.config["rope_parameters"]["full_attention"]["rope_theta"] = json!(1e4);
    }),
    ("the base of global layers in local ones", |parts| {
        parts.config["rope_parameters"]["sliding_attention"]["rope_theta"] = json!(1e6);
    }),
    ("another first row of the table of layers", |parts| {
        parts.change("embed_tokens_per_layer.weight", |table| {
            let first = table.narrow(0, 1, 1).unwrap();
            let others = table.narrow(0, 1, table.dims()[0] - 1).unwrap();
            Tensor::cat(&[first, others], 0).unwrap()
        });
    }),
    ("scores divided by the root of the width", |parts| {
        parts.change("q_norm.weight", |weight| (weight / 4.0).unwrap());
    }),
];

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    Prompts::from_fixture(FIXTURE).assert_noticed(&GEMMA3N, &FAULTS);
}
