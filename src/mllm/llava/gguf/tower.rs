//! The vision tower's configuration and preprocessor in the metadata of a `clip` GGUF file, in both
//! directions.

use crate::MllmError;
use crate::checkpoint::TowerType;
use crate::gguf::{Entries, Header, tower_metadata};
use crate::llava::LlavaConfig;
use crate::vision::PixelScale;
use planagent_kernels::Activation;
use serde_json::{Value, json};

/// The tensor that LLaVA-NeXT adds to LLaVA's.
const IMAGE_NEWLINE: &str = "model.image_newline";
/// Tensors of LLaVA's projector and tower, by which a file is known that does not name it.
const OWN_TENSORS: [&str; 2] = ["mm.0.weight", "v.class_embd"];
/// Keys of the tower's activation, and llama.cpp's where a file has neither.
const GELU: &str = "clip.use_gelu";
const SILU: &str = "clip.use_silu";
const DEFAULT_ACTIVATION: &str = "quick_gelu";
/// Key of the hidden states that are the image features.
const FEATURE_LAYER: &str = "clip.vision.feature_layer";
/// Key of the resolutions of LLaVA-NeXT's grids, flattened.
const PINPOINTS: &str = "clip.vision.image_grid_pinpoints";

/// Whether the tower's projector is LLaVA's, or one that no file names.
pub(super) fn is_llava(header: &Header) -> bool {
    match header.projector() {
        Ok(None) => OWN_TENSORS
            .iter()
            .all(|name| header.tensors.contains_key(*name)),
        found => matches!(found, Ok(Some("mlp"))),
    }
}

/// Whether the tower belongs to a LLaVA-NeXT.
pub(super) fn is_next(header: &Header) -> bool {
    header.tensors.contains_key(IMAGE_NEWLINE)
}

/// Width of the hidden states; none in a decoder's file.
pub(super) fn hidden(header: &Header) -> Result<Option<usize>, MllmError> {
    header.count("clip.vision.embedding_length")
}

/// The keys of `config.json` that describe tower and projector, and a note if the file leaves one
/// open.
pub(super) fn config(
    header: &Header,
    model_type: &str,
) -> Result<(Value, Option<String>), MllmError> {
    let layers = header.required_count("clip.vision.block_count")?;
    // llama.cpp's order; its default without both keys is the activation of CLIP.
    let act = match (header.flag(GELU)?, header.flag(SILU)?) {
        (Some(true), _) => "gelu",
        (_, Some(true)) => "silu",
        _ => DEFAULT_ACTIVATION,
    };
    let (features, note) =
        if let Some(features) = header.list::<i64>(FEATURE_LAYER, "a list of integers")? {
            (json!(features), None)
        } else {
            let (layer, note) = default_feature_layer(layers);
            (json!(layer), Some(note))
        };
    let mut config = json!({
        "model_type": model_type,
        "projector_hidden_act": "gelu",
        "multimodal_projector_bias": header.tensors.contains_key("mm.0.bias"),
        "vision_feature_layer": features,
        "vision_config": {
            "model_type": "clip_vision_model",
            "hidden_size": header.required_count("clip.vision.embedding_length")?,
            "intermediate_size": header.required_count("clip.vision.feed_forward_length")?,
            "num_hidden_layers": layers,
            "num_attention_heads": header.required_count("clip.vision.attention.head_count")?,
            "image_size": header.required_count("clip.vision.image_size")?,
            "patch_size": header.required_count("clip.vision.patch_size")?,
            "layer_norm_eps": header.required_number("clip.vision.attention.layer_norm_epsilon")?,
            "hidden_act": act,
        },
    });
    if let Some(pinpoints) = pinpoints(header)? {
        config["image_grid_pinpoints"] = pinpoints;
    }
    Ok((config, note))
}

/// The feature layer of a file without [`FEATURE_LAYER`]: the last but one of the tower in
/// training. llama.cpp's converter drops the last layer, and CLIP's towers have even numbers of
/// layers. So a tower with an odd number is used whole.
fn default_feature_layer(layers: usize) -> (usize, String) {
    let layer = if layers.is_multiple_of(2) {
        layers - 1
    } else {
        layers
    };
    let note = format!(
        "the vision tower's file does not say which layer's output is used ({FEATURE_LAYER}); of its {layers} layers, the \
         output of layer {layer} is taken for the last but one of the whole tower, as LLaVA was trained"
    );
    (layer, note)
}

/// Notes about keys that a file leaves out, and what is taken.
pub(super) fn left_out(header: &Header) -> Vec<String> {
    let has = |key: &str| header.metadata.contains_key(key);
    let mut notes = Vec::new();
    if !has(GELU) && !has(SILU) {
        notes.push(header.taken(GELU, DEFAULT_ACTIVATION));
    }
    if is_next(header) && !has(PINPOINTS) {
        notes.push(format!(
            "{}: the key {PINPOINTS} is missing; the resolutions of transformers' class are taken",
            header.path.display()
        ));
    }
    notes
}

fn pinpoints(header: &Header) -> Result<Option<Value>, MllmError> {
    let Some(flat) = header.list::<i64>(PINPOINTS, "a list of integers")? else {
        return Ok(None);
    };
    let (pairs, rest) = flat.as_chunks::<2>();
    if !rest.is_empty() || pairs.is_empty() {
        return Err(header.error(
            PINPOINTS,
            format!("{} numbers are no pairs of height and width", flat.len()),
        ));
    }
    Ok(Some(json!(pairs)))
}

/// `preprocessor_config.json` of the tower.
pub(super) fn preprocessor(header: &Header, image_processor: &str) -> Result<Value, MllmError> {
    let side = header.required_count("clip.vision.image_size")?;
    let mut preprocessor = json!({
        "image_processor_type": image_processor,
        "size": {"shortest_edge": side},
        "crop_size": {"height": side, "width": side},
        "resample": 3,
    });
    let scale = header.pixel_scale()?;
    for key in ["image_mean", "image_std"] {
        if let Some(values) = scale.get(key) {
            preprocessor[key] = values.clone();
        }
    }
    if let Some(pinpoints) = pinpoints(header)? {
        preprocessor["image_grid_pinpoints"] = pinpoints;
    }
    Ok(preprocessor)
}

/// The metadata that [`config`] and [`preprocessor`] read.
///
/// # Errors
/// The part that llama.cpp has no key for.
pub(super) fn metadata(
    config: &LlavaConfig,
    pinpoints: Option<Vec<[u32; 2]>>,
    scale: &PixelScale,
) -> Result<Entries, &'static str> {
    // The keys below describe a CLIP tower; llama.cpp would read other weights as one.
    if config.tower == TowerType::Siglip {
        return Err("a SigLIP tower in a LLaVA");
    }
    let vision = &config.vision;
    let mut metadata = tower_metadata(
        "mlp",
        vision,
        config.text.hidden,
        scale.mean_and_deviation(),
    )?;
    let mut put = |key: &str, value: Value| metadata.push((key.to_owned(), value));
    put("clip.has_text_encoder", json!(false));
    put("clip.has_llava_projector", json!(true));
    put(FEATURE_LAYER, json!(config.feature_layers));
    match vision.act {
        Activation::QuickGelu => put(GELU, json!(false)),
        Activation::Gelu => put(GELU, json!(true)),
        Activation::Silu => put(SILU, json!(true)),
        Activation::GeluTanh | Activation::Relu => {
            return Err("the activation of the vision tower");
        }
    }
    if let Some(pinpoints) = pinpoints {
        put(PINPOINTS, json!(pinpoints.concat()));
        put("clip.vision.mm_patch_merge_type", json!("spatial_unpad"));
    }
    Ok(metadata)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_but_one_layer_of_the_whole_tower_is_used() {
        // CLIP ViT-L/14 has 24 layers, of which llama.cpp's converter writes 23.
        assert_eq!(default_feature_layer(23).0, 23);
        assert_eq!(default_feature_layer(24).0, 23);
    }
}
