//! Parity of Gemma 3 with Hugging Face transformers (`tests/fixtures/make_gemma3_text.py`), and the
//! errors that are easily made with it.

use super::GEMMA3;
use crate::export::export_model;
use crate::family::ImageSettings;
use crate::local::Loading;
use crate::local::test_faults::Fault;
use crate::local::test_prompts::Prompts;
use crate::local::test_reference::{difference, logits_in_pieces};
use crate::source::ModelPlace;
use planagent_kernels::matrix::WeightFormat;
use serde_json::json;
use std::fs::File;
use std::io::Write;
use std::path::Path;

const FIXTURE: &str = "tiny_gemma3_text";

#[test]
fn logits_and_greedy_tokens_are_those_of_transformers() {
    let prompts = Prompts::from_fixture(FIXTURE);
    prompts.check(&prompts.open(".", ImageSettings::default()), |_| true);
}

/// Writes a model of the fixture as GGUF.
fn export(from: &Path, to: &Path) -> ModelPlace {
    let model = to.join("m.gguf");
    let loading = Loading {
        quantize: Some(WeightFormat::F32),
        ..Loading::default()
    };
    export_model(
        "tiny",
        &ModelPlace::Folder(from.to_path_buf()),
        &loading,
        &[],
        &mut |_| Ok(Box::new(File::create(&model)?) as Box<dyn Write>),
        &mut |_, _| {},
    )
    .unwrap();
    ModelPlace::Gguf {
        model,
        mmproj: None,
    }
}

/// The scale of the fixture's queries has no key in llama.cpp's format, so that the file is for
/// this program alone; with the usual scale, it is llama.cpp's, whose norms have 1 added.
#[test]
fn exported_files_give_the_same_logits() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let ids = prompts.reference.ids("chat_input_ids", 0);
    for (scalar, architecture) in [(24, "planagent"), (16, "gemma3")] {
        let copy = prompts.in_layout(".");
        let path = copy.path().join("config.json");
        let mut config = crate::checkpoint::read_json(&path).unwrap();
        config["query_pre_attn_scalar"] = json!(scalar);
        std::fs::write(&path, config.to_string()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let place = export(copy.path(), folder.path());
        let (header, _) = crate::gguf::open_header(place.path()).unwrap();
        assert_eq!(header.architecture().unwrap(), architecture);
        let models = [ModelPlace::Folder(copy.path().to_path_buf()), place]
            .map(|place| Prompts::load(&place, ImageSettings::default()));
        let [folder, gguf] = models
            .each_ref()
            .map(|local| logits_in_pieces(local.model(), &ids, None, &[]));
        assert_eq!(difference(&folder, &gguf).to_bits(), 0, "{architecture}");
    }
}

const FAULTS: [Fault; 9] = [
    ("no windows", |parts| {
        parts.config["layer_types"] = json!(vec!["full_attention"; 7]);
        parts.config["rope_parameters"]["full_attention"] =
            json!({"rope_type": "default", "rope_theta": 1e4});
    }),
    ("a window that is one narrower", |parts| {
        parts.config["sliding_window"] = json!(11);
    }),
    ("a window that is one wider", |parts| {
        parts.config["sliding_window"] = json!(13);
    }),
    ("the first layer is global", |parts| {
        let kinds = parts.config["layer_types"].as_array_mut().unwrap();
        kinds.rotate_left(5);
    }),
    ("the global base in local layers", |parts| {
        parts.config["rope_parameters"]["sliding_attention"]["rope_theta"] = json!(1e6);
    }),
    ("the local base in global layers", |parts| {
        parts.config["rope_parameters"]["full_attention"]["rope_theta"] = json!(1e4);
    }),
    ("positions that are not scaled", |parts| {
        parts.config["rope_parameters"]["full_attention"] =
            json!({"rope_type": "default", "rope_theta": 1e6});
    }),
    ("queries scaled by the width of a head", |parts| {
        parts.config["query_pre_attn_scalar"] = json!(16);
    }),
    ("norms without the 1", |parts| {
        parts.change("norm.weight", |weight| (weight - 1.0).unwrap());
    }),
];

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    Prompts::from_fixture(FIXTURE).assert_noticed(&GEMMA3, &FAULTS);
}
