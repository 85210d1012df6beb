//! What a model computes and reads in a planning call, by the shapes of its tensors.

use super::PictureNeed;
use crate::checkpoint::{LlamaConfig, Weights};
use planagent_kernels::matrix::WeightFormat;

/// The canonical name of the output layer.
const OUTPUT: &str = "lm_head.weight";
/// The end of the embedding's canonical name.
const EMBEDDING: &str = "embed_tokens.weight";

/// What a model computes, in operations: multiplications and additions of matrix products and
/// attention, as [`Work`](planagent_kernels::Work) counts them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ModelWork {
    /// The vision tower and projector, for the drawn image.
    pub image: u64,
    /// The decoder's layers, for one token, without attention.
    pub token: u64,
    /// The decoder's attention, for one token to one position.
    pub attention: u64,
}

impl ModelWork {
    pub(super) fn from_weights(
        weights: &Weights,
        decoder: &LlamaConfig,
        picture: PictureNeed,
    ) -> Self {
        let layers = weights.matrices(None).filter(|(name, ..)| is_layer(name));
        let token = layers.map(|(_, [outputs, inputs], _)| 2 * outputs as u64 * inputs as u64);
        // Opening the model refuses more layers than its weights have.
        let layers = 0..decoder.layers.min(weights.shapes().count());
        let queries = layers.map(|layer| decoder.queries(layer) as u64);
        Self {
            image: picture.operations,
            token: token.fold(0, u64::saturating_add),
            // Queries with keys, then weights with values: two operations each.
            attention: queries.fold(0, u64::saturating_add).saturating_mul(4),
        }
    }
}

/// Whether a matrix is multiplied with every text token: not those of the tower, and not those
/// that CogVLM keeps for image tokens.
fn is_layer(name: &str) -> bool {
    let names = ["vision", "multi_modal_projector"];
    name.contains("layers.") && !names.iter().any(|part| name.contains(part))
}

/// Bytes of weights that a decoded token reads: those of the layers and of the output layer, which
/// may be the embedding.
pub(super) fn token_bytes(weights: &Weights, format: WeightFormat) -> u64 {
    let output = |name: &str| weights.matrices(None).any(|(other, ..)| other == name);
    let own_output = output(OUTPUT);
    let read = weights.matrices(Some(format)).filter(|(name, ..)| {
        is_layer(name) || *name == OUTPUT || (!own_output && name.ends_with(EMBEDDING))
    });
    let bytes = read.map(|(_, [outputs, inputs], format)| format.matrix_bytes(outputs, inputs));
    bytes
        .map(|bytes| bytes.map_or(u64::MAX, |bytes| bytes as u64))
        .fold(0, u64::saturating_add)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::local::test_reference::{fixture, open_checkpoint};

    #[test]
    fn the_work_of_a_token_is_that_of_its_layers() {
        let checkpoint = open_checkpoint(&fixture("tiny_llava"));
        let decoder = checkpoint.decoder_config().unwrap();
        let work = ModelWork::from_weights(&checkpoint.weights, &decoder, PictureNeed::default());
        let (width, inner) = (decoder.hidden, decoder.intermediate);
        let heads = decoder.heads * decoder.head_dim;
        let keys = 2 * decoder.kv_heads * decoder.head_dim;
        let layer = width * (2 * heads + keys) + 3 * width * inner;
        assert_eq!(work.token, (2 * decoder.layers * layer) as u64);
        assert_eq!(work.attention, (4 * decoder.layers * heads) as u64);
        let read = token_bytes(&checkpoint.weights, WeightFormat::F32);
        let outputs = decoder.vocabulary * width;
        assert_eq!(read, 4 * (decoder.layers * layer + outputs) as u64);
    }

    #[test]
    fn matrices_of_the_tower_and_of_image_experts_are_no_layers() {
        assert!(is_layer("language_model.layers.3.self_attn.q_proj.weight"));
        assert!(!is_layer("vision_tower.encoder.layers.3.mlp.fc1.weight"));
        assert!(!is_layer("layers.3.mlp.vision_mlp.up_proj.weight"));
        assert!(!is_layer("lm_head.weight"));
    }
}
