//! candle-transformers' LLaVA on the fixture that checks ours: how far its logits are from
//! transformers', and why.

use super::Llava;
use crate::family::VisionLanguageModel;
use crate::local::test_reference::{
    LOGIT_TOLERANCE, Reference, difference, fixture, logits_deviation, open_checkpoint,
};
use candle_core::{DType, Device, IndexOp, Tensor};
use candle_nn::VarBuilder;
use candle_transformers::models::clip::text_model::Activation;
use candle_transformers::models::clip::vision_model::ClipVisionConfig;
use candle_transformers::models::llama::Cache;
use candle_transformers::models::llava::{LLaVA, config::LLaVAConfig};
use serde_json::json;
use std::collections::HashMap;

/// Hidden width of the fixture.
const HIDDEN: usize = 32;
/// The fixture's image token.
const IMAGE_TOKEN: i64 = 3;

/// Candle's model with the fixture's weights under candle's names. `layers` is the depth of the
/// vision tower.
fn candle_llava(layers: usize) -> (LLaVA, LLaVAConfig) {
    let stored = candle_core::safetensors::load(
        fixture("tiny_llava").join("model.safetensors"),
        &Device::Cpu,
    )
    .unwrap();
    let mut weights: HashMap<String, Tensor> = stored
        .into_iter()
        .map(|(name, tensor)| match name.strip_prefix("vision_tower.") {
            Some(rest) => (format!("vision_tower.vision_model.{rest}"), tensor),
            None => (name, tensor),
        })
        .collect();
    // Candle asks for the newline of LLaVA-NeXT also where the patches stay flat.
    weights.insert(
        "image_newline".into(),
        Tensor::zeros(HIDDEN, DType::F32, &Device::Cpu).unwrap(),
    );
    let config: LLaVAConfig = serde_json::from_value(json!({
        "hf": true, "architectures": ["LlavaForConditionalGeneration"], "model_type": "llava", "torch_dtype": "float32",
        "bos_token_id": 1, "eos_token_id": 2, "pad_token_id": 0, "image_token_index": IMAGE_TOKEN, "vocab_size": 352,
        "hidden_size": HIDDEN, "intermediate_size": 64, "num_hidden_layers": 2, "num_attention_heads": 4,
        "num_key_value_heads": 2, "max_position_embeddings": 256, "rms_norm_eps": 1e-5, "rope_theta": 10000.0,
        "mm_hidden_size": HIDDEN, "mm_projector_type": "mlp2x_gelu", "mm_patch_merge_type": "flat",
        "mm_vision_select_layer": -2, "mm_vision_select_feature": "patch", "mm_use_im_start_end": false,
        "image_crop_resolution": 32, "image_split_resolution": 32, "image_grid_pinpoints": [], "use_cache": false,
    }))
    .unwrap();
    let tower = ClipVisionConfig {
        embed_dim: HIDDEN,
        activation: Activation::QuickGelu,
        intermediate_size: 48,
        num_hidden_layers: layers,
        num_attention_heads: 4,
        projection_dim: 512,
        num_channels: 3,
        image_size: 32,
        patch_size: 8,
    };
    let weights = VarBuilder::from_tensors(weights, DType::F32, &Device::Cpu);
    (LLaVA::load(weights, &config, Some(tower)).unwrap(), config)
}

/// Differences of candle's image features and of its logits of the prompt's last position to the
/// reference.
fn candle_deviation(layers: usize, reference: &Reference) -> [f32; 2] {
    let (model, config) = candle_llava(layers);
    let pixels = reference.tensor("pixel_values");
    let features = model.encode_images(pixels).unwrap();
    // Candle's prompt has one image token, the reference one for each feature.
    let mut ids: Vec<i64> = reference.tensor("input_ids").to_vec1().unwrap();
    ids.dedup_by(|second, first| *first == IMAGE_TOKEN && *second == IMAGE_TOKEN);
    let count = ids.len();
    let ids = Tensor::from_vec(ids, (1, count), &Device::Cpu).unwrap();
    let inputs = model
        .prepare_inputs_labels_for_multimodal(&ids, std::slice::from_ref(pixels), &[(32, 32)])
        .unwrap();
    let mut cache = Cache::new(false, DType::F32, &config.to_llama_config(), &Device::Cpu).unwrap();
    let logits = model.forward(&inputs, 0, &mut cache).unwrap();
    let expected = reference.tensor("logits");
    let last = expected.i(expected.dims()[0] - 1).unwrap();
    [
        difference(&features, reference.tensor("features")),
        difference(&logits, &last),
    ]
}

#[test]
fn candles_llava_takes_the_vision_tower_one_layer_too_far() {
    let folder = fixture("tiny_llava");
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let mut checkpoint = open_checkpoint(&folder);
    let model = Llava::open(&checkpoint.files, &mut checkpoint.weights).unwrap();
    let image = image::open(folder.join("image.png")).unwrap().into_rgb8();
    let features = model.encode_image(&image).unwrap();
    let ids = reference.ids("input_ids", model.info().image_token);
    let ours = logits_deviation(&model, &ids, &features, reference.tensor("logits"));
    let [features, logits] = candle_deviation(3, &reference);
    println!("ours: logits {ours:.1e}; candle: features {features:.2}, logits {logits:.2}");
    assert!(ours < LOGIT_TOLERANCE, "{ours}");
    assert!(
        features > 0.1 && logits > 0.1,
        "candle: features {features}, logits {logits}"
    );
    // Its list of hidden states lacks the embeddings and ends with the pooled output, so index -2
    // is the last layer, not the one before. A tower without its last layer gives the reference:
    // nothing else is wrong.
    let [features, logits] = candle_deviation(2, &reference);
    println!("candle with a tower of one layer less: features {features:.1e}, logits {logits:.1e}");
    assert!(
        features < LOGIT_TOLERANCE && logits < LOGIT_TOLERANCE,
        "candle: features {features}, logits {logits}"
    );
}
