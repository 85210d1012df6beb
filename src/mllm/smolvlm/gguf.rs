//! `SmolVLM` in llama.cpp's GGUF files.

use super::config::SmolVlmConfig;
use super::tiles::TileProcessor;
use crate::MllmError;
use crate::checkpoint::ModelFiles;
use crate::gguf::names::{
    DECODER_LAYERS, EMBEDDING, FINAL_NORM, Names, OUTPUT, ROTARY, VISION_LAYERS,
};
use crate::gguf::{
    Changed, Described, Description, Header, PairLayout, TowerDescription, VisionFiles, Written,
    as_stored, decoder, llama, tower_with_activation,
};
use planagent_kernels::Activation;
use serde_json::json;

const NAMES: Names = Names {
    single: &[
        EMBEDDING,
        FINAL_NORM,
        OUTPUT,
        ROTARY,
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
        ("v.post_ln.weight", "vision_tower.post_layernorm.weight"),
        ("v.post_ln.bias", "vision_tower.post_layernorm.bias"),
        ("mm.model.fc.weight", "multi_modal_projector.proj.weight"),
    ],
    layers: &[DECODER_LAYERS, VISION_LAYERS],
};

/// Kind of the projector.
const PROJECTOR: &str = "idefics3";
/// Key of the side of the blocks of patches that become a token.
const SCALE: &str = "clip.vision.projector.scale_factor";
/// Key of the longest side before an image is cut, pixels; 0 for images that are not cut.
const LONGEST: &str = "clip.vision.preproc_image_size";
/// Tiles along the longest side in all published models.
const TILES: usize = 4;

/// The files of a `SmolVLM`.
pub(super) static LAYOUT: PairLayout = PairLayout {
    decoders: &[llama::ARCHITECTURE],
    projector: PROJECTOR,
    model_type: "smolvlm",
    placeholder: "<image>",
    names: NAMES,
    renamed: as_stored,
    vision,
    changed: Changed::Nothing,
    written: Written::With(metadata),
};

fn vision(tower: &Header, notes: &mut Vec<String>) -> Result<VisionFiles, MllmError> {
    tower.check_activation("gelu", notes)?;
    let mut vision = tower.vision_config()?;
    vision["hidden_act"] = json!("gelu_pytorch_tanh");
    let tile = tower.required_count("clip.vision.image_size")?;
    // llama.cpp cuts by its own rule; only a file of this program says that images stay whole.
    let is_whole = tower
        .metadata
        .get(LONGEST)
        .and_then(serde_json::Value::as_u64)
        == Some(0);
    let longest = if let Some(longest) = tower.count_or_none(LONGEST)? {
        longest
    } else if is_whole {
        TILES * tile
    } else {
        notes.push(format!(
            "the vision tower's file has no {LONGEST}; images are cut into {TILES} tiles a side"
        ));
        TILES * tile
    };
    let mut processor = tower.pixel_scale()?;
    processor["image_processor_type"] = json!("SmolVLMImageProcessor");
    processor["do_image_splitting"] = json!(!is_whole);
    processor["size"] = json!({"longest_edge": longest});
    processor["max_image_size"] = json!({"longest_edge": tile});
    let scale = tower.required_count(SCALE)?;
    Ok(VisionFiles {
        config: json!({"scale_factor": scale, "vision_config": vision}),
        processor,
    })
}

/// The metadata of a model with these files.
fn metadata(files: &ModelFiles) -> Result<Described, MllmError> {
    let config = SmolVlmConfig::open(files)?;
    let tiler = TileProcessor::open(files, config.vision.image_size as u32)?;
    Ok(described(&config, &tiler))
}

fn described(config: &SmolVlmConfig, tiler: &TileProcessor) -> Described {
    let (architecture, decoder) = decoder::describe(&config.text)?;
    if architecture != llama::ARCHITECTURE {
        return Err("another decoder than Llama's");
    }
    let mut tower = tower_with_activation(
        Activation::GeluTanh,
        PROJECTOR,
        &config.vision,
        config.text.hidden,
        tiler.scale.mean_and_deviation(),
    )?;
    let longest = if tiler.splitting { tiler.longest } else { 0 };
    tower.push((SCALE.to_owned(), json!(config.scale)));
    tower.push((LONGEST.to_owned(), json!(longest)));
    Ok(Description {
        architecture,
        decoder,
        tower: Some(TowerDescription::plain(tower)),
    })
}
