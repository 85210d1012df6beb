//! The names that a GGUF file has for the keys of the small files that are made from it, so that an
//! error names what stands in the file.

use crate::MllmError;
use std::path::{Path, PathBuf};

/// Keys of `text_config`, and those of a decoder behind its architecture.
const DECODER: [(&str, &str); 41] = [
    ("hidden_size", "embedding_length"),
    ("intermediate_size", "feed_forward_length"),
    ("num_hidden_layers", "block_count"),
    ("num_attention_heads", "attention.head_count"),
    ("num_key_value_heads", "attention.head_count_kv"),
    ("head_dim", "attention.key_length"),
    ("max_position_embeddings", "context_length"),
    ("rms_norm_eps", "attention.layer_norm_rms_epsilon"),
    ("rope_theta", "rope.freq_base"),
    ("rope_scaling.factor", "rope.scaling.factor"),
    ("rope_scaling.type", "rope.scaling.type"),
    ("rope_scaling.mrope_section", "rope.dimension_sections"),
    ("mrope_section", "rope.dimension_sections"),
    (
        "rope_scaling.original_max_position_embeddings",
        "rope.scaling.original_context_length",
    ),
    ("rope_scaling.beta_fast", "rope.scaling.yarn_beta_fast"),
    ("rope_scaling.beta_slow", "rope.scaling.yarn_beta_slow"),
    (
        "rope_scaling.attention_factor",
        "rope.scaling.yarn_attn_factor",
    ),
    ("sliding_window_pattern", "attention.sliding_window_pattern"),
    ("sliding_window", "attention.sliding_window"),
    ("rope_local_base_freq", "rope.freq_base_swa"),
    ("norm_eps", "attention.layer_norm_rms_epsilon"),
    ("layer_types", "attention.head_count_kv"),
    ("conv_L_cache", "shortconv.l_cache"),
    ("partial_rotary_factor", "rope.dimension_count"),
    ("full_attention_interval", "full_attention_interval"),
    ("linear_num_key_heads", "ssm.group_count"),
    ("linear_num_value_heads", "ssm.time_step_rank"),
    ("linear_key_head_dim", "ssm.state_size"),
    ("linear_value_head_dim", "ssm.inner_size"),
    ("linear_conv_kernel_dim", "ssm.conv_kernel"),
    ("num_kv_shared_layers", "attention.shared_kv_layers"),
    (
        "hidden_size_per_layer_input",
        "embedding_length_per_layer_input",
    ),
    ("final_logit_softcapping", "final_logit_softcapping"),
    ("altup_num_inputs", "altup.num_inputs"),
    ("altup_active_idx", "altup.active_idx"),
    ("activation_sparsity_pattern", "activation_sparsity_scale"),
    (
        "vocab_size_per_layer_input",
        "embedding_length_per_layer_input",
    ),
    ("global_head_dim", "attention.key_length"),
    ("num_global_key_value_heads", "attention.head_count_kv"),
    ("per_layer_config", "attention.head_count_kv"),
    ("rope_parameters", "rope.freq_base"),
];
/// Keys of `vision_config`, and those of a tower behind `clip.vision.`.
const TOWER: [(&str, &str); 16] = [
    ("hidden_size", "embedding_length"),
    ("intermediate_size", "feed_forward_length"),
    ("num_hidden_layers", "block_count"),
    ("embed_dim", "embedding_length"),
    ("mlp_ratio", "feed_forward_length"),
    ("depth", "block_count"),
    ("num_attention_heads", "attention.head_count"),
    ("num_heads", "attention.head_count"),
    ("image_size", "image_size"),
    ("num_position_embeddings", "image_size"),
    ("patch_size", "patch_size"),
    ("layer_norm_eps", "attention.layer_norm_epsilon"),
    ("spatial_merge_size", "spatial_merge_size"),
    ("window_size", "window_size"),
    ("fullatt_block_indexes", "n_wa_pattern"),
    ("deepstack_visual_indexes", "is_deepstack_layers"),
];
/// Other keys of `config.json`, and those of a tower behind `clip.vision.`.
const PROJECTOR: [(&str, &str); 5] = [
    ("mm_tokens_per_image", "projector.scale_factor"),
    ("scale_factor", "projector.scale_factor"),
    ("downsample_ratio", "projector.scale_factor"),
    ("downsample_factor", "projector.scale_factor"),
    ("vision_feature_layer", "feature_layer"),
];
/// Keys of `preprocessor_config.json`, and those of a tower behind `clip.vision.`.
const PROCESSOR: [(&str, &str); 10] = [
    ("image_mean", "image_mean"),
    ("image_std", "image_std"),
    ("patch_size", "patch_size"),
    ("merge_size", "spatial_merge_size"),
    ("min_patches", "preproc_min_tiles"),
    ("max_patches", "preproc_max_tiles"),
    ("image_grid_pinpoints", "image_grid_pinpoints"),
    ("max_pixels", "image_max_pixels"),
    ("max_image_size", "image_size"),
    ("size", "image_size"),
];

/// The files that small files were made from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct OwnKeys {
    /// `general.architecture` of the decoder.
    pub(crate) architecture: String,
    pub(crate) decoder: PathBuf,
    /// The vision tower; none for a decoder alone.
    pub(crate) tower: Option<PathBuf>,
}

impl OwnKeys {
    /// An error about a key of a small file as one about the key that it was made from. Other
    /// errors stay.
    pub(crate) fn rename(&self, error: MllmError) -> MllmError {
        match error {
            MllmError::Config { path, key, problem } => {
                let (path, key) = match self.find(&path, &key) {
                    Some((own, name)) => (own.to_path_buf(), name),
                    None => (path, key),
                };
                MllmError::Config { path, key, problem }
            }
            other => other,
        }
    }

    /// The file that has a tensor by llama.cpp's name.
    pub(crate) fn file_of(&self, tensor: &str) -> &Path {
        const OF_DECODER: [&str; 6] = [
            "token_embd",
            "blk.",
            "output",
            "rope_freqs",
            "per_layer_",
            "altup_",
        ];
        let is_of_decoder = OF_DECODER.iter().any(|begin| tensor.starts_with(begin));
        match &self.tower {
            Some(tower) if !is_of_decoder => tower,
            _ => &self.decoder,
        }
    }

    /// The file and its key that a key of a small file was made from.
    fn find(&self, path: &Path, key: &str) -> Option<(&Path, String)> {
        let name = path.strip_prefix(&self.decoder).ok()?.to_str()?;
        let in_decoder = |key: &str| {
            let name = format!("{}.{}", self.architecture, own(&DECODER, key)?);
            Some((self.decoder.as_path(), name))
        };
        let Some(tower) = &self.tower else {
            return in_decoder(key).filter(|_| name == "config.json");
        };
        let in_tower = |table: &[(&str, &str)], key: &str| {
            let name = format!("clip.vision.{}", own(table, key)?);
            Some((tower.as_path(), name))
        };
        match (name, key.split_once('.')) {
            ("config.json", Some(("text_config", key))) => in_decoder(key),
            ("config.json", Some(("vision_config", key))) => in_tower(&TOWER, key),
            ("config.json", _) => in_tower(&PROJECTOR, key),
            ("preprocessor_config.json", _) => in_tower(&PROCESSOR, key),
            _ => None,
        }
    }
}

/// The file's name of a key, or of the object that it stands in.
fn own<'a>(table: &[(&str, &'a str)], key: &str) -> Option<&'a str> {
    let is_of = |known: &str| {
        key.strip_prefix(known)
            .is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
    };
    table
        .iter()
        .find(|(known, _)| is_of(known))
        .map(|(_, name)| *name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tensor_is_in_the_file_that_its_name_says() {
        let mut files = OwnKeys {
            architecture: "llama".into(),
            decoder: "m/d.gguf".into(),
            tower: Some("m/t.gguf".into()),
        };
        for (tensor, file) in [
            ("token_embd.weight", "m/d.gguf"),
            ("blk.1.attn_q.weight", "m/d.gguf"),
            ("output_norm.weight", "m/d.gguf"),
            ("v.blk.1.attn_q.weight", "m/t.gguf"),
            ("mm.0.weight", "m/t.gguf"),
            ("model.image_newline", "m/t.gguf"),
        ] {
            assert_eq!(files.file_of(tensor), Path::new(file), "{tensor}");
        }
        files.tower = None;
        assert_eq!(files.file_of("v.blk.0.ln1.bias"), Path::new("m/d.gguf"));
    }

    #[test]
    fn an_error_names_the_key_of_its_file() {
        let own = OwnKeys {
            architecture: "qwen2".into(),
            decoder: "m/d.gguf".into(),
            tower: Some("m/t.gguf".into()),
        };
        let renamed = |path: &str, key: &str| {
            own.rename(MllmError::Config {
                path: path.into(),
                key: key.into(),
                problem: "is wrong".into(),
            })
            .to_string()
        };
        for (path, key, said) in [
            (
                "m/d.gguf/config.json",
                "text_config.num_attention_heads",
                "m/d.gguf: qwen2.attention.head_count: is wrong",
            ),
            (
                "m/d.gguf/config.json",
                "vision_config.depth",
                "m/t.gguf: clip.vision.block_count: is wrong",
            ),
            (
                "m/d.gguf/config.json",
                "downsample_ratio",
                "m/t.gguf: clip.vision.projector.scale_factor: is wrong",
            ),
            (
                "m/d.gguf/preprocessor_config.json",
                "size.longest_edge",
                "m/t.gguf: clip.vision.image_size: is wrong",
            ),
            // What lies beside the file, and keys that no file has.
            (
                "m/preprocessor_config.json",
                "size",
                "m/preprocessor_config.json: size: is wrong",
            ),
            (
                "m/d.gguf/config.json",
                "text_config.hidden_act",
                "m/d.gguf/config.json: text_config.hidden_act: is wrong",
            ),
        ] {
            assert_eq!(renamed(path, key), said);
        }
    }
}
