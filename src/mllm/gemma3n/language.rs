//! The decoder of a Gemma 3n that sees: tokens of pictures and sounds have tables of their own.

use super::embedder::Embedder;
use crate::decoder::{Decoder, DecoderCache, DecoderInput, LanguageModel, Logits, StreamLayer};
use candle_core::{Result, Tensor};

/// A decoder and the tables of tokens that are not its own.
#[derive(Debug)]
pub(super) struct SeeingDecoder {
    pub(super) decoder: Decoder<StreamLayer>,
    pub(super) embedder: Embedder,
}

impl LanguageModel for SeeingDecoder {
    /// Each token of a table is embedded by itself, so that its row is the same in any pass.
    fn embed(&self, ids: &[u32]) -> Result<Tensor> {
        let is_own = |id: &u32| self.embedder.table(*id).is_none();
        let runs = ids.chunk_by(|one, next| is_own(one) && is_own(next));
        let rows = runs.map(|run| match run {
            [id] if !is_own(id) => self.embedder.row(*id),
            own => self.decoder.embed(own),
        });
        let rows = rows.collect::<Result<Vec<_>>>()?;
        if rows.is_empty() {
            return self.decoder.embed(ids);
        }
        Tensor::cat(&rows, 0)
    }

    fn new_cache(&self, limit: usize) -> DecoderCache {
        self.decoder.new_cache(limit)
    }

    fn forward(
        &self,
        input: &DecoderInput,
        cache: &mut DecoderCache,
        wanted: Logits,
    ) -> Result<Option<Tensor>> {
        self.decoder.forward(input, cache, wanted)
    }

    fn exact_pass(&self) -> usize {
        self.decoder.exact_pass()
    }

    fn rotary_length(&self, end: usize) -> usize {
        self.decoder.rotary_length(end)
    }
}
