//! Typical errors of porting a model. Each must deviate from a reference far more than the parity
//! tests accept; otherwise those tests would prove nothing.
//!
//! `cargo test --lib easily_made -- --nocapture` prints the deviations.

use super::Sequence;
use super::sequence::new_cache;
use super::test_reference::{FEATURE_TOLERANCE, LOGIT_TOLERANCE, Run, feature_difference, whole};
use crate::checkpoint::{Weights, read_json, safetensors_folder};
use crate::decoder::{Decoder, DecoderInput, DecoderLayer, LanguageModel, Logits};
use crate::family::{Family, ImageFeatures, Positions, VisionLanguageModel};
use candle_core::{Device, Tensor};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Smallest deviation of an error, in multiples of the parity tests' tolerance.
const FAR: f32 = 100.0;

/// Configuration and weights of a model, to change before it is opened.
pub(crate) struct Parts {
    pub path: PathBuf,
    pub config: Value,
    tensors: HashMap<String, Tensor>,
}

/// A change that makes a model wrong.
pub(crate) type Fault = (&'static str, fn(&mut Parts));

impl Parts {
    /// The parts of a folder.
    pub(crate) fn from_folder(folder: &Path) -> Self {
        let path = folder.join("config.json");
        let tensors =
            candle_core::safetensors::load(folder.join("model.safetensors"), &Device::Cpu).unwrap();
        Self {
            config: read_json(&path).unwrap(),
            path,
            tensors,
        }
    }

    /// The parts of a folder with a fault.
    pub(crate) fn wrong(folder: &Path, fault: fn(&mut Self)) -> Self {
        let mut parts = Self::from_folder(folder);
        fault(&mut parts);
        parts
    }

    /// The weights of a family, read from a file.
    pub(crate) fn weights(&self, family: &Family) -> Weights {
        let folder = tempfile::tempdir().unwrap();
        candle_core::safetensors::save(&self.tensors, folder.path().join("model.safetensors"))
            .unwrap();
        safetensors_folder::open(folder.path(), None, family.canonical_name).unwrap()
    }

    /// A tensor, as it is stored.
    pub(crate) fn tensor(&self, name: &str) -> &Tensor {
        &self.tensors[name]
    }

    /// Swaps two tensors.
    pub(crate) fn swap(&mut self, one: &str, other: &str) {
        let [first, second] = [one, other].map(|name| self.tensors.remove(name).unwrap());
        self.tensors
            .extend([(one.to_string(), second), (other.to_string(), first)]);
    }

    /// Changes every tensor whose name has this end; there must be one.
    pub(crate) fn change(&mut self, end: &str, change: impl Fn(&Tensor) -> Tensor) {
        let mut changed = 0;
        for (_, tensor) in self
            .tensors
            .iter_mut()
            .filter(|(name, _)| name.ends_with(end))
        {
            *tensor = change(tensor).contiguous().unwrap();
            changed += 1;
        }
        assert!(changed > 0, "no tensor {end}");
    }
}

/// Errors on the way from a LLaVA's pixels to its features.
pub(crate) const LLAVA_IMAGE_FAULTS: [Fault; 6] = [
    ("the tower's last layer", |parts| {
        parts.config["vision_feature_layer"] = json!(-1);
    }),
    ("the layer before the right one", |parts| {
        parts.config["vision_feature_layer"] = json!(-3);
    }),
    ("gelu in the place of quick_gelu", |parts| {
        parts.config["vision_config"]["hidden_act"] = json!("gelu");
    }),
    ("the projector's layers swapped", |parts| {
        for kind in ["weight", "bias"] {
            let name = |layer| format!("multi_modal_projector.linear_{layer}.{kind}");
            parts.swap(&name(1), &name(2));
        }
    }),
    ("the projector's first layer transposed", |parts| {
        parts.change("linear_1.weight", |tensor| tensor.t().unwrap());
    }),
    ("the projector's second layer transposed", |parts| {
        parts.change("linear_2.weight", |tensor| tensor.t().unwrap());
    }),
];

/// Errors in a LLaVA's decoder.
pub(crate) const LLAVA_DECODER_FAULTS: [Fault; 2] = [
    ("another base of the rotary embedding", |parts| {
        parts.config["text_config"]["rope_parameters"]["rope_theta"] = json!(1_000_000);
    }),
    ("queries and keys in the order of GGUF's rows", |parts| {
        let text = &parts.config["text_config"];
        let heads = text["num_attention_heads"].as_u64().unwrap();
        let key_heads = text["num_key_value_heads"].as_u64().unwrap_or(heads);
        for (name, heads) in [("q_proj", heads), ("k_proj", key_heads)] {
            let name = format!("language_model.model.layers.0.self_attn.{name}.weight");
            parts.change(&name, |rows| paired(rows, heads as usize));
        }
    }),
];

/// The rows of each head in llama.cpp's order: one of the first half, then its partner of the
/// second.
fn paired(rows: &Tensor, heads: usize) -> Tensor {
    let (outputs, inputs) = rows.dims2().unwrap();
    let halves = rows
        .reshape((heads, 2, outputs / heads / 2, inputs))
        .unwrap();
    halves
        .transpose(1, 2)
        .unwrap()
        .reshape((outputs, inputs))
        .unwrap()
}

/// Positions with those of `part` increased by one.
pub(crate) fn one_further(positions: &[u32], part: &Range<usize>) -> Vec<u32> {
    positions
        .iter()
        .enumerate()
        .map(|(index, position)| position + u32::from(part.contains(&index)))
        .collect()
}

/// The deviation of a model from a reference.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Deviation {
    pub features: f32,
    pub logits: f32,
}

impl Deviation {
    /// Prints the head of a reference's table.
    pub(crate) fn print_heading(reference: &Path) {
        println!("{}", reference.display());
        println!(
            "  {:48} {FEATURE_TOLERANCE:>10.1e} {LOGIT_TOLERANCE:>10.1e}",
            "accepted (features, logits)"
        );
    }

    /// The deviation of a model with these features.
    pub(crate) fn from_run(
        run: &Run,
        model: &dyn VisionLanguageModel,
        features: &ImageFeatures,
    ) -> Self {
        let mut sequence = Sequence::new(model);
        let logits = sequence
            .append(model, &run.ids, Some(features), Logits::All)
            .unwrap()
            .unwrap();
        Self {
            features: feature_difference(&features.rows, &run.features),
            logits: run.logits_difference(&logits),
        }
    }

    /// The deviation of a model with the right features, these positions, and image rows `vision`.
    pub(crate) fn of_placed<L: DecoderLayer>(
        run: &Run,
        model: &dyn VisionLanguageModel,
        decoder: &Decoder<L>,
        positions: Vec<u32>,
        vision: Range<usize>,
    ) -> Self {
        let features = whole(run.features.clone());
        let input = Sequence::new(model)
            .decoder_input(model, &run.ids, Some(&features))
            .unwrap();
        let positions = Positions::plain(positions).rotary;
        let input = DecoderInput {
            positions,
            vision: vec![vision],
            ..input
        };
        let logits = decoder
            .forward(&input, &mut new_cache(model), Logits::All)
            .unwrap()
            .unwrap();
        Self {
            features: 0.0,
            logits: run.logits_difference(&logits),
        }
    }

    /// Checks that there is none.
    pub(crate) fn assert_none(self, what: &str) {
        let (features, logits) = self.print(what);
        assert!(features < 1.0 && logits < 1.0, "{what}: {self:?}");
    }

    /// Checks that features and logits are far off.
    pub(crate) fn assert_far(self, what: &str) {
        let (features, logits) = self.print(what);
        assert!(
            features > FAR && logits > FAR,
            "{what} is hardly noticed: {self:?}"
        );
    }

    /// Checks that the logits are far off although the features are right.
    pub(crate) fn assert_logits_far(self, what: &str) {
        let (features, logits) = self.print(what);
        assert!(
            features < 1.0 && logits > FAR,
            "{what} is hardly noticed: {self:?}"
        );
    }

    /// Prints a line of the table; returns both deviations in multiples of the tolerance.
    fn print(self, what: &str) -> (f32, f32) {
        println!(
            "  {what:48} {:>10.1e} {:>10.1e}",
            self.features, self.logits
        );
        (
            self.features / FEATURE_TOLERANCE,
            self.logits / LOGIT_TOLERANCE,
        )
    }
}
