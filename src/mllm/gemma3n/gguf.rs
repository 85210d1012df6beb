//! Gemma 3n with its vision tower in llama.cpp's GGUF files. Their tower has timm's names, and says
//! the shape of no block: the tensors do.

use super::embedder::SOUND;
use crate::MllmError;
use crate::checkpoint::{KNOWN_TOKENS, ModelFiles};
use crate::gguf::names::GEMMA3N_NAMES;
use crate::gguf::{Described, GgufLayout, Header, TextFiles, gemma3n, is_pair, no_tower};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Beginnings of names in the tower's file, and canonical ones.
const TOWER: [(&str, &str); 3] = [
    ("v.blk.", "vision_tower.blocks."),
    ("v.conv_stem.", "vision_tower.conv_stem."),
    ("v.msfa.", "vision_tower.msfa."),
];
/// Tensors between tower and decoder: names in the tower's file behind `mm.`, or behind `mm.a.` for
/// sounds, and canonical ones.
const BETWEEN: [(&str, &str); 4] = [
    ("embedding.weight", "embedding.weight"),
    ("hard_emb_norm.weight", "hard_embedding_norm.weight"),
    ("soft_emb_norm.weight", "soft_embedding_norm.weight"),
    ("input_projection.weight", "embedding_projection.weight"),
];

/// The kind of the projector.
const PROJECTOR: &str = "gemma3nv";
/// The token of an image, and the first token of the table of pictures.
const SOFT: &str = "<image_soft_token>";
const FIRST: &str = "<end_of_image>";
const SIDE: &str = "clip.vision.image_size";
const PATCH: &str = "clip.vision.patch_size";
/// Most stages of a tower, and most blocks of a stage, that are looked for.
const MAX_BLOCKS: usize = 1 << 9;

/// The files of a Gemma 3n with its tower.
pub(super) struct Gemma3nGguf;

impl GgufLayout for Gemma3nGguf {
    fn opens(&self, decoder: &Header, tower: Option<&Header>) -> bool {
        is_pair(decoder, tower, &[gemma3n::ARCHITECTURE], PROJECTOR)
    }

    fn small_files(
        &self,
        decoder: &Header,
        tower: Option<&Header>,
        notes: &mut Vec<String>,
    ) -> Result<BTreeMap<String, String>, MllmError> {
        let tower = tower.ok_or_else(|| no_tower(decoder, "its configuration"))?;
        let mut files = TextFiles::read(decoder, notes)?;
        tower.check_epsilon(1e-6)?;
        let side = tower.required_count(SIDE)?;
        let first = files.added_id(decoder, FIRST)?;
        let table = shape(tower, "mm.embedding.weight");
        let grid = grid(tower, side)?;
        let mut text = files.text_config.clone();
        text[KNOWN_TOKENS] = json!(first);
        let config = json!({
            "model_type": "gemma3n",
            "image_token_id": files.added_id(decoder, SOFT)?,
            "vision_soft_tokens_per_image": grid * grid,
            "text_config": text,
            "vision_config": {
                "hidden_size": tower.required_count("clip.vision.embedding_length")?,
                "vocab_offset": first,
                "vocab_size": table.first(),
                "model_args": {
                    "stem_size": shape(tower, "v.conv_stem.conv.weight").first(),
                    "msfa_output_resolution": grid,
                    "block_args": blocks(tower),
                },
            },
            "audio_config": sounds(tower, first + table.first().map_or(0, |rows| *rows as u64)),
        });
        let mut processor = tower.pixel_scale()?;
        processor["image_processor_type"] = json!("SiglipImageProcessor");
        processor["size"] = json!({"height": side, "width": side});
        // Bilinear, as llama.cpp does for this kind of projector.
        processor["resample"] = json!(2);
        files.put("config.json", &config);
        files.put("preprocessor_config.json", &processor);
        Ok(files.into_files())
    }

    fn canonical_name(&self, _file: &Header, name: &str) -> Result<Option<String>, MllmError> {
        Ok(canonical_name(name))
    }

    fn gguf_name(&self, canonical: &str) -> Option<String> {
        let tower = TOWER.iter().find_map(|(layout, own)| {
            let rest = canonical.strip_prefix(own)?;
            Some(format!("{layout}{rest}"))
        });
        tower.or_else(|| GEMMA3N_NAMES.in_gguf(canonical))
    }

    fn norms_have_one(&self) -> bool {
        false
    }

    /// The number in these files is a stand-in.
    fn tower_says_its_layers(&self) -> bool {
        false
    }

    fn metadata(&self, _files: &ModelFiles) -> Result<Described, MllmError> {
        Ok(Err("how the maps of a convolutional tower are made"))
    }
}

fn canonical_name(name: &str) -> Option<String> {
    for (layout, canonical) in TOWER {
        if let Some(rest) = name.strip_prefix(layout) {
            return Some(format!("{canonical}{rest}"));
        }
    }
    let (part, prefix) = match name.strip_prefix("mm.a.") {
        Some(part) => (part, SOUND),
        None => match name.strip_prefix("mm.") {
            Some(part) => (part, "multi_modal_projector"),
            None => return GEMMA3N_NAMES.to_canonical(name),
        },
    };
    let (_, canonical) = BETWEEN.iter().find(|(layout, _)| *layout == part)?;
    // Nothing hears.
    let is_unread = prefix == SOUND && canonical.starts_with("soft");
    (!is_unread).then(|| format!("{prefix}.{canonical}"))
}

/// The shape of a tensor; no side where there is none.
fn shape<'a>(tower: &'a Header, name: &str) -> &'a [usize] {
    let place = tower.tensors.get(name);
    place.map_or(&[], |place| place.shape.as_slice())
}

/// A side of a tensor; 0 where there is none.
fn length(tower: &Header, name: &str, axis: usize) -> usize {
    shape(tower, name).get(axis).copied().unwrap_or(0)
}

/// Tokens along a side of an image: llama.cpp's converter writes the side of the image divided by
/// the number of tokens, rounded down, as that of a patch.
fn grid(tower: &Header, side: usize) -> Result<usize, MllmError> {
    /// As in configurations.
    const MAX_GRID: usize = 1 << 7;
    let patch = tower.required_count(PATCH)?;
    // Pixels of the map that is averaged: a 16th of the side.
    let map = side / 16;
    let fits = |grid: &usize| map.is_multiple_of(*grid) && side / (grid * grid) == patch;
    let grid = (1..=MAX_GRID.min(map)).rev().find(fits);
    grid.ok_or_else(|| {
        let problem = format!("{patch} is that of no square number of tokens of {side} pixels");
        tower.error(PATCH, problem)
    })
}

/// The table of tokens of sounds, from its first token on.
fn sounds(tower: &Header, first: u64) -> Value {
    let table = shape(tower, "mm.a.embedding.weight");
    json!({
        "vocab_offset": first,
        "vocab_size": table.first(),
        "hidden_size": table.get(1),
    })
}

/// The blocks as timm lists them, by the shapes of their tensors; the first of a stage halves an
/// image.
fn blocks(tower: &Header) -> Vec<Vec<Value>> {
    let mut channels = length(tower, "v.conv_stem.conv.weight", 0);
    let mut stages = Vec::new();
    for stage in 0..MAX_BLOCKS {
        let mut blocks = Vec::new();
        for index in 0..MAX_BLOCKS {
            let name = format!("v.blk.{stage}.{index}");
            let Some((mut block, outputs)) = block(tower, &name, channels) else {
                break;
            };
            block["out_chs"] = json!(outputs);
            block["stride"] = json!(if index == 0 { 2 } else { 1 });
            channels = outputs;
            blocks.push(block);
        }
        if blocks.is_empty() {
            break;
        }
        stages.push(blocks);
    }
    stages
}

/// A block behind `inputs` channels, and its own channels; none where the file has none.
fn block(tower: &Header, name: &str, inputs: usize) -> Option<(Value, usize)> {
    // Each kind has a tensor that no other has.
    let side = |part: &str, axis: usize| length(tower, &format!("{name}.{part}.weight"), axis);
    let factor = |wide: usize| wide as f64 / inputs.max(1) as f64;
    if side("conv_exp", 0) > 0 {
        let block = json!({
            "block_type": "er",
            "exp_kernel_size": side("conv_exp", 2),
            "exp_ratio": factor(side("conv_exp", 0)),
        });
        return Some((block, side("conv_pwl", 0)));
    }
    let width = side("attn.key.proj", 0);
    if let Some(heads) = side("attn.query.proj", 0).checked_div(width) {
        let kernel = side("attn.key.down_conv", 2);
        let mut block = json!({
            "block_type": "mqa",
            "num_heads": heads,
            "key_dim": width,
            "value_dim": side("attn.value.proj", 0),
            "kv_stride": if kernel > 0 { 2 } else { 1 },
        });
        if kernel > 0 {
            block["dw_kernel_size"] = json!(kernel);
        }
        return Some((block, side("attn.output.proj", 0)));
    }
    let wide = side("pw_exp.conv", 0);
    let block = json!({
        "block_type": "uir",
        "dw_kernel_size_start": side("dw_start.conv", 2),
        "dw_kernel_size_mid": side("dw_mid.conv", 2),
        "exp_ratio": factor(wide),
    });
    (wide > 0).then(|| (block, side("pw_proj.conv", 0)))
}

#[cfg(test)]
mod tests {
    use super::canonical_name;

    #[test]
    fn names_of_both_files_have_one_canonical_name() {
        for (name, canonical) in [
            (
                "v.blk.2.9.attn.query.proj.weight",
                Some("vision_tower.blocks.2.9.attn.query.proj.weight"),
            ),
            (
                "v.blk.1.0.layer_scale.gamma",
                Some("vision_tower.blocks.1.0.layer_scale.gamma"),
            ),
            (
                "mm.input_projection.weight",
                Some("multi_modal_projector.embedding_projection.weight"),
            ),
            (
                "mm.a.hard_emb_norm.weight",
                Some("multi_modal_projector.sound.hard_embedding_norm.weight"),
            ),
            ("mm.a.soft_emb_norm.weight", None),
            ("a.blk.0.ffn_up.weight", None),
            (
                "blk.3.altup_correct_scale.weight",
                Some("language_model.layers.3.altup.correct_output_scale.weight"),
            ),
        ] {
            assert_eq!(canonical_name(name).as_deref(), canonical, "{name}");
        }
    }
}
