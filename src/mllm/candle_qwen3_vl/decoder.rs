//! candle's model as a decoder. It takes token ids and pixels, and keeps keys and values inside
//! itself. So the input row of a token holds its id, and that of an image token also the image's
//! grid and the token's patches.

use super::weights;
use crate::MllmError;
use crate::checkpoint::{ModelFiles, Weights};
use crate::decoder::{DecoderInput, KvCache, LanguageModel, Logits};
use crate::family::ImageLayout;
use crate::qwen3_vl::Qwen3VlConfig;
use candle_core::{DType, Device, Result, Tensor, TensorId};
use candle_nn::VarBuilder;
use candle_transformers::models::qwen3_vl::{Config, Qwen3VLModel};
use std::collections::{BTreeMap, HashMap};
use std::fmt::{self, Debug, Formatter};
use std::sync::{Mutex, PoisonError};

/// Numbers of a row before its patches: the id, and the rows and columns of the image.
const HEAD: usize = 3;

pub(super) struct CandleDecoder {
    config: Config,
    tensors: HashMap<String, Tensor>,
    image_token: u32,
    live: Mutex<Option<Live>>,
}

/// A model with keys and values. They cannot be shortened: another chat needs another model, of the
/// same tensors.
struct Live {
    model: Qwen3VLModel,
    /// The rows that it has taken.
    taken: Vec<TensorId>,
}

impl Debug for CandleDecoder {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        out.debug_struct("CandleDecoder")
            .field("config", &self.config)
            .finish_non_exhaustive()
    }
}

impl CandleDecoder {
    pub(super) fn take(
        weights: &mut Weights,
        config: &Qwen3VlConfig,
        files: &ModelFiles,
    ) -> std::result::Result<Self, MllmError> {
        let image_token = config.image_token;
        let tied = config.text.is_tied(weights);
        let config = weights::config(files, config, tied)?;
        let tensors = weights::take(weights, &config)?;
        Ok(Self {
            config,
            tensors,
            image_token,
            live: Mutex::new(None),
        })
    }

    /// Numbers of a row.
    fn width(&self) -> usize {
        let vision = &self.config.vision_config;
        let patch =
            vision.in_chans * vision.temporal_patch_size * vision.patch_size * vision.patch_size;
        HEAD + self.merged() * patch
    }

    /// Patches of a token.
    fn merged(&self) -> usize {
        self.config.vision_config.spatial_merge_size.pow(2)
    }

    /// The rows of an image with these patches, (tokens, numbers of a token).
    pub(super) fn image_rows(&self, patches: &Tensor, layout: ImageLayout) -> Result<Tensor> {
        let head = [self.image_token, layout.rows as u32, layout.columns as u32]
            .map(|number| number as f32);
        let head = Tensor::new(&[head], &Device::Cpu)?.repeat((layout.tokens, 1))?;
        Tensor::cat(&[&head, patches], 1)
    }

    fn fresh(&self) -> Result<Live> {
        let tensors = VarBuilder::from_tensors(self.tensors.clone(), DType::F32, &Device::Cpu);
        Ok(Live {
            model: Qwen3VLModel::new(&self.config, tensors)?,
            taken: Vec::new(),
        })
    }

    /// Lets the live model take the rows that it has not taken yet. Text goes token by token,
    /// because passes of several have no causal mask. An image goes in one pass, as soon as all of
    /// it is there. Gives the logits after each pass by the index of its last row.
    fn catch_up(
        &self,
        live: &mut Option<Live>,
        rows: &[Tensor],
    ) -> Result<BTreeMap<usize, Tensor>> {
        let agrees = |live: &Live| {
            live.taken.len() <= rows.len()
                && live
                    .taken
                    .iter()
                    .zip(rows)
                    .all(|(taken, row)| *taken == row.id())
        };
        let mut now = match live.take().filter(agrees) {
            Some(live) => live,
            None => self.fresh()?,
        };
        let mut logits = BTreeMap::new();
        while let Some(row) = rows.get(now.taken.len()) {
            let start = now.taken.len();
            let head = row.narrow(1, 0, HEAD)?.flatten_all()?.to_vec1::<f32>()?;
            let [id, image_rows, columns] = [0, 1, 2].map(|index| head[index] as u32);
            let is_image = id == self.image_token;
            let count = if is_image {
                (image_rows * columns).max(1) as usize
            } else {
                1
            };
            let Some(pass) = rows.get(start..start + count) else {
                break;
            };
            let grid = is_image.then_some([image_rows, columns]);
            logits.insert(
                start + count - 1,
                self.pass(&now.model, pass, id, grid, start)?,
            );
            now.taken.extend(pass.iter().map(Tensor::id));
        }
        *live = Some(now);
        Ok(logits)
    }

    /// A pass of a text token, or of the tokens of an image with this grid of tokens.
    fn pass(
        &self,
        model: &Qwen3VLModel,
        rows: &[Tensor],
        id: u32,
        grid: Option<[u32; 2]>,
        start: usize,
    ) -> Result<Tensor> {
        let count = rows.len();
        let ids = Tensor::from_vec(vec![id; count], (1, count), &Device::Cpu)?;
        let Some(grid) = grid else {
            return model.forward(
                &ids,
                None,
                None,
                None,
                None,
                vec![1],
                vec![vec![]],
                vec![vec![]],
                &[start],
            );
        };
        let rows = Tensor::cat(rows, 0)?;
        let patches = rows
            .narrow(1, HEAD, rows.dim(1)? - HEAD)?
            .contiguous()?
            .reshape((count * self.merged(), ()))?;
        let merge = self.config.vision_config.spatial_merge_size as u32;
        let grid = Tensor::new(&[[1, grid[0] * merge, grid[1] * merge]], &Device::Cpu)?;
        let span = vec![vec![(0, count)]];
        model.forward(
            &ids,
            Some(patches),
            None,
            Some(grid),
            None,
            vec![count],
            span,
            vec![vec![]],
            &[start],
        )
    }
}

impl LanguageModel for CandleDecoder {
    fn embed(&self, ids: &[u32]) -> Result<Tensor> {
        let ids = Tensor::new(ids, &Device::Cpu)?
            .to_dtype(DType::F32)?
            .unsqueeze(1)?;
        ids.pad_with_zeros(1, 0, self.width() - 1)
    }

    fn new_cache(&self, limit: usize) -> KvCache {
        KvCache::of_inputs(limit)
    }

    /// candle gives the logits of a pass's last position alone; those of an image's other tokens
    /// are NaN.
    fn forward(
        &self,
        input: &DecoderInput,
        cache: &mut KvCache,
        wanted: Logits,
    ) -> Result<Option<Tensor>> {
        let before = cache.len();
        cache.append_inputs(&input.rows)?;
        let mut live = self.live.lock().unwrap_or_else(PoisonError::into_inner);
        let mut logits = match self.catch_up(&mut live, cache.inputs()) {
            Ok(logits) => logits,
            Err(error) => {
                cache.truncate(before);
                return Err(error);
            }
        };
        let end = cache.len();
        let from = match wanted {
            Logits::None => return Ok(None),
            Logits::Last => end - 1,
            Logits::Tail(count) => end - count.clamp(1, end - before),
            Logits::All => before,
        };
        let unknown = Tensor::full(
            f32::NAN,
            (1, self.config.text_config.vocab_size),
            &Device::Cpu,
        )?;
        let rows: Vec<Tensor> = (from..end)
            .map(|at| logits.remove(&at).unwrap_or_else(|| unknown.clone()))
            .collect();
        Ok(Some(Tensor::cat(&rows, 0)?))
    }
}
