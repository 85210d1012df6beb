//! `InternVL` in llama.cpp's GGUF files, which its converter makes from the authors' layout.

use super::config::{IMAGE, InternVlConfig};
use super::tiles::TileProcessor;
use crate::MllmError;
use crate::checkpoint::ModelFiles;
use crate::gguf::names::{
    DECODER_LAYERS, EMBEDDING, FINAL_NORM, Names, OUTPUT, ROTARY, VISION_LAYERS,
};
use crate::gguf::{
    Changed, Described, Description, Header, PairLayout, TowerDescription, VisionFiles, Written,
    as_stored, decoder, tower_with_activation,
};
use planagent_kernels::Activation;
use serde_json::json;

const NAMES: Names = Names {
    single: &[
        EMBEDDING,
        FINAL_NORM,
        OUTPUT,
        ROTARY,
        ("v.class_embd", "vision_tower.embeddings.class_embedding"),
        (
            "v.patch_embd.weight",
            "vision_tower.embeddings.patch_embedding.weight",
        ),
        (
            "v.patch_embd.bias",
            "vision_tower.embeddings.patch_embedding.bias",
        ),
        (
            "v.position_embd.weight",
            "vision_tower.embeddings.position_embedding.weight",
        ),
        (
            "mm.model.mlp.0.weight",
            "multi_modal_projector.layer_norm.weight",
        ),
        (
            "mm.model.mlp.0.bias",
            "multi_modal_projector.layer_norm.bias",
        ),
        (
            "mm.model.mlp.1.weight",
            "multi_modal_projector.linear_1.weight",
        ),
        ("mm.model.mlp.1.bias", "multi_modal_projector.linear_1.bias"),
        (
            "mm.model.mlp.3.weight",
            "multi_modal_projector.linear_2.weight",
        ),
        ("mm.model.mlp.3.bias", "multi_modal_projector.linear_2.bias"),
    ],
    layers: &[DECODER_LAYERS, VISION_LAYERS],
};

/// Architectures of the decoders.
const DECODERS: [&str; 3] = ["qwen2", "qwen3", "llama"];
/// Kind of the projector.
const PROJECTOR: &str = "internvl";
/// Key of the side of the blocks of patches that become a token.
const SCALE: &str = "clip.vision.projector.scale_factor";
/// Keys of the least and most tiles, with the published models' numbers.
const TILES: [(&str, &str, usize); 2] = [
    ("clip.vision.preproc_min_tiles", "min_patches", 1),
    ("clip.vision.preproc_max_tiles", "max_patches", 12),
];

/// The files of an `InternVL`.
pub(super) static LAYOUT: PairLayout = PairLayout {
    decoders: &DECODERS,
    projector: PROJECTOR,
    model_type: "internvl",
    placeholder: IMAGE,
    names: NAMES,
    renamed: as_stored,
    vision,
    changed: Changed::Nothing,
    written: Written::With(metadata),
};

fn vision(tower: &Header, notes: &mut Vec<String>) -> Result<VisionFiles, MllmError> {
    tower.check_activation("gelu", notes)?;
    let mut vision = tower.vision_config()?;
    vision["hidden_act"] = json!("gelu");
    vision["attention_bias"] = json!(true);
    let mut processor = tower.pixel_scale()?;
    processor["image_processor_type"] = json!("GotOcr2ImageProcessor");
    processor["size"] = vision["image_size"].clone();
    for (key, name, published) in TILES {
        let count = tower.count(key)?;
        if count.is_none() {
            notes.push(format!(
                "the vision tower's file has no {key}; it is taken for {published}"
            ));
        }
        processor[name] = json!(count.unwrap_or(published));
    }
    let scale = tower.required_count(SCALE)?;
    Ok(VisionFiles {
        config: json!({"downsample_ratio": 1.0 / scale as f64, "vision_config": vision}),
        processor,
    })
}

/// The metadata of a model with these files.
fn metadata(files: &ModelFiles) -> Result<Described, MllmError> {
    let config = InternVlConfig::open(files)?;
    let tiler = TileProcessor::open(files, config.vision.image_size as u32)?;
    Ok(described(&config, &tiler))
}

fn described(config: &InternVlConfig, tiler: &TileProcessor) -> Described {
    let (architecture, decoder) = decoder::describe(&config.text)?;
    if !DECODERS.contains(&architecture) {
        return Err("another decoder than that of Qwen or Llama");
    }
    let tiles = [tiler.min, tiler.max];
    if tiles != [1, 1] && !tiler.whole {
        return Err("tiles without the whole image behind them");
    }
    let mut tower = tower_with_activation(
        Activation::Gelu,
        PROJECTOR,
        &config.vision,
        config.text.hidden,
        tiler.scale.mean_and_deviation(),
    )?;
    tower.push((SCALE.to_owned(), json!(config.scale)));
    for ((key, _, _), count) in TILES.into_iter().zip(tiles) {
        tower.push((key.to_owned(), json!(count)));
    }
    Ok(Description {
        architecture,
        decoder,
        tower: Some(TowerDescription::apart(tower)),
    })
}
