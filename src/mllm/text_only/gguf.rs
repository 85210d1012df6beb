//! Language models in llama.cpp's GGUF files.

use crate::MllmError;
use crate::checkpoint::{LlamaConfig, ModelFiles};
use crate::gguf::names::{
    DECODER_LAYERS, EMBEDDING, FINAL_NORM, GEMMA_LAYERS, GEMMA3N_NAMES, GEMMA4_LAYERS,
    GEMMA4_SINGLE, LFM2_LAYERS, LFM2_NORM, Names, OUTPUT, QWEN35_LAYERS, ROTARY,
};
use crate::gguf::{
    Changed, Described, Description, GgufLayout, Header, TextFiles, as_stored, decoder, gemma,
    gemma3n, gemma4, lfm2, qwen35,
};
use std::collections::BTreeMap;

const NAMES: Names = Names {
    single: &[EMBEDDING, FINAL_NORM, OUTPUT, ROTARY],
    layers: &[DECODER_LAYERS],
};

const GEMMA_NAMES: Names = Names {
    single: &[EMBEDDING, FINAL_NORM, OUTPUT, ROTARY],
    layers: &[GEMMA_LAYERS],
};

const GEMMA4_NAMES: Names = Names {
    single: &[
        EMBEDDING,
        FINAL_NORM,
        OUTPUT,
        ROTARY,
        GEMMA4_SINGLE[0],
        GEMMA4_SINGLE[1],
        GEMMA4_SINGLE[2],
    ],
    layers: &[GEMMA4_LAYERS],
};

const LFM2_NAMES: Names = Names {
    single: &[EMBEDDING, LFM2_NORM, OUTPUT],
    layers: &[LFM2_LAYERS],
};

const QWEN35_NAMES: Names = Names {
    single: &[EMBEDDING, FINAL_NORM, OUTPUT],
    layers: &[QWEN35_LAYERS],
};

/// The files of a family of language models.
pub(super) struct TextGguf {
    /// Architectures of its decoders.
    architectures: &'static [&'static str],
    names: Names,
    /// As in a [`PairLayout`](crate::gguf::PairLayout).
    renamed: fn(file: &Header, name: &str) -> Result<Option<String>, MllmError>,
    changed: Changed,
}

impl TextGguf {
    /// The files of decoders with the tensors of Llama.
    pub(super) const fn of_llama(architectures: &'static [&'static str]) -> Self {
        Self {
            architectures,
            names: NAMES,
            renamed: as_stored,
            changed: Changed::Nothing,
        }
    }

    /// The files of Gemma 3.
    pub(super) const OF_GEMMA: Self = Self {
        architectures: &[gemma::ARCHITECTURE],
        names: GEMMA_NAMES,
        renamed: as_stored,
        changed: Changed::Norms,
    };

    /// The files of Gemma 4.
    pub(super) const OF_GEMMA4: Self = Self {
        architectures: &[gemma4::ARCHITECTURE],
        names: GEMMA4_NAMES,
        renamed: as_stored,
        changed: Changed::Nothing,
    };

    /// The files of Gemma 3n.
    pub(super) const OF_GEMMA3N: Self = Self {
        architectures: &[gemma3n::ARCHITECTURE],
        names: GEMMA3N_NAMES,
        renamed: as_stored,
        changed: Changed::Nothing,
    };

    /// The files of LFM2.
    pub(super) const OF_LFM2: Self = Self {
        architectures: &[lfm2::ARCHITECTURE],
        names: LFM2_NAMES,
        renamed: as_stored,
        changed: Changed::Nothing,
    };

    /// The files of Qwen 3.5.
    pub(super) const OF_QWEN35: Self = Self {
        architectures: &[qwen35::ARCHITECTURE],
        names: QWEN35_NAMES,
        renamed: qwen35::renamed,
        changed: Changed::NormsAndHeads,
    };
}

impl GgufLayout for TextGguf {
    fn opens(&self, decoder: &Header, tower: Option<&Header>) -> bool {
        let known = |architecture| self.architectures.contains(&architecture);
        tower.is_none() && decoder.architecture().is_ok_and(known)
    }

    fn small_files(
        &self,
        decoder: &Header,
        _tower: Option<&Header>,
        notes: &mut Vec<String>,
    ) -> Result<BTreeMap<String, String>, MllmError> {
        let mut files = TextFiles::read(decoder, notes)?;
        let config = files.text_config.clone();
        files.put("config.json", &config);
        Ok(files.into_files())
    }

    fn canonical_name(&self, file: &Header, name: &str) -> Result<Option<String>, MllmError> {
        let name = (self.renamed)(file, name)?;
        Ok(name.and_then(|name| self.names.to_canonical(&name)))
    }

    fn gguf_name(&self, canonical: &str) -> Option<String> {
        self.names.in_gguf(canonical)
    }

    fn norms_have_one(&self) -> bool {
        self.changed.norms()
    }

    fn heads_are_tiled(&self) -> bool {
        self.changed.heads()
    }

    fn metadata(&self, files: &ModelFiles) -> Result<Described, MllmError> {
        let config = super::config(files, super::DecoderType::Llama)?;
        Ok(described(&config))
    }
}

fn described(config: &LlamaConfig) -> Described {
    if config.rope.sections.is_some() {
        return Err("positions on three axes without a vision tower");
    }
    let (architecture, decoder) = decoder::describe(config)?;
    Ok(Description {
        architecture,
        decoder,
        tower: None,
    })
}
