//! PlanTF's encoder of an agent's history: neighborhood attention at three time scales, joined from
//! coarse to fine.

use super::network::{PlanTfInputs, names};
use crate::blocks::{Conv1d, LayerNorm, Linear, PackedKeyValues, Probe, Weights, gelu};
use candle_core::{D, DType, Device, Result, Tensor};

/// Columns of a step: Δposition, Δvelocity, cosine and sine of the turn, width, length, seen.
const CHANNELS: usize = 9;
/// Heads and windows of the three levels, and the blocks of each.
const HEADS: [usize; 3] = [2, 4, 8];
const WINDOWS: [usize; 3] = [3, 3, 5];
const BLOCKS: usize = 2;
/// Samples at the end of each scale that the last sample of the finest one is made of.
const READ: usize = 2;
/// Width of a block's MLP relative to its input.
const MLP_RATIO: usize = 3;

#[derive(Debug, Clone)]
pub(super) struct HistoryEncoder {
    dim: usize,
    embed: Conv1d,
    levels: Vec<Level>,
    lateral: Vec<Conv1d>,
    joined: Conv1d,
}

#[derive(Debug, Clone)]
struct Level {
    blocks: Vec<Block>,
    norm: LayerNorm,
    downsample: Option<(Conv1d, LayerNorm)>,
}

impl HistoryEncoder {
    pub(super) fn take(weights: &mut Weights, name: &str, dim: usize) -> Result<Self> {
        let width = |level: usize| (dim / 4) << level;
        let embed = Conv1d::take(weights, &format!("{name}.embed.proj"), CHANNELS, width(0))?;
        let mut levels = Vec::new();
        for level in 0..HEADS.len() {
            let within = format!("{name}.levels.{level}");
            let block = |i| {
                Block::take(
                    weights,
                    &format!("{within}.blocks.{i}"),
                    width(level),
                    level,
                )
            };
            let blocks = (0..BLOCKS).map(block).collect::<Result<_>>()?;
            // Nothing stands behind the coarsest level, so it alone is not halved.
            let downsample = if level + 1 < HEADS.len() {
                Some((
                    Conv1d::halving(
                        weights,
                        &format!("{within}.downsample.reduction"),
                        width(level),
                        width(level + 1),
                    )?,
                    weights.layer_norm(&format!("{within}.downsample.norm"), width(level + 1))?,
                ))
            } else {
                None
            };
            let norm = weights.layer_norm(&format!("{name}.norm{level}"), width(level))?;
            levels.push(Level {
                blocks,
                norm,
                downsample,
            });
        }
        let lateral = names(&format!("{name}.lateral_convs"), [0, 1, 2]);
        let lateral = lateral
            .iter()
            .enumerate()
            .map(|(i, name)| Conv1d::take(weights, name, width(i), width(2)));
        let lateral = lateral.collect::<Result<_>>()?;
        Ok(Self {
            dim,
            embed,
            levels,
            lateral,
            joined: Conv1d::take(weights, &format!("{name}.fpn_conv"), dim, dim)?,
        })
    }

    /// Features of all agents (B·A, dim); zeros for those that were never seen.
    pub(super) fn forward(
        &self,
        inputs: &PlanTfInputs,
        name: &str,
        probe: &Probe,
    ) -> Result<Tensor> {
        let steps = steps(inputs)?;
        let (rows, _, _) = steps.dims3()?;
        let seen = inputs
            .valid
            .max(D::Minus1)?
            .flatten_all()?
            .to_vec1::<u8>()?;
        // Rows of agents that were never seen stay zero, so they need not be computed.
        let places: Vec<u32> = (0u32..)
            .zip(&seen)
            .filter(|&(_, &seen)| seen != 0)
            .map(|(i, _)| i)
            .collect();
        let zeros = Tensor::zeros((rows, self.dim), DType::F32, &Device::Cpu)?;
        if places.is_empty() {
            return Ok(zeros);
        }
        let places = Tensor::from_vec(
            places,
            seen.iter().filter(|&&seen| seen != 0).count(),
            &Device::Cpu,
        )?;
        let encoded = self.encode(&steps.index_select(&places, 0)?, name, probe)?;
        probe.note(name, &encoded);
        zeros.index_add(&places, &encoded, 0)
    }

    /// Steps (N, 20, 9) to features (N, dim).
    fn encode(&self, steps: &Tensor, name: &str, probe: &Probe) -> Result<Tensor> {
        let mut x = self
            .embed
            .forward(&steps.transpose(1, 2)?)?
            .transpose(1, 2)?
            .contiguous()?;
        probe.note(&format!("{name}.embed"), &x);
        let mut scales = Vec::with_capacity(self.levels.len());
        for (level, (stage, lateral)) in self.levels.iter().zip(&self.lateral).enumerate() {
            for (i, block) in stage.blocks.iter().enumerate() {
                x = block.forward(&x, &format!("{name}.levels.{level}.blocks.{i}"), probe)?;
            }
            let normed = stage.norm.forward(&x)?;
            probe.note(&format!("{name}.norm{level}"), &normed);
            // Only the last steps reach the output; the convolution needs one more at their edge.
            let end = normed.narrow(1, normed.dim(1)? - READ - 1, READ + 1)?;
            scales.push(lateral.forward(&end.transpose(1, 2)?)?.narrow(2, 1, READ)?);
            if let Some((halving, norm)) = &stage.downsample {
                x = norm.forward(
                    &halving
                        .forward(&x.transpose(1, 2)?)?
                        .transpose(1, 2)?
                        .contiguous()?,
                )?;
            }
        }
        let coarse_to_fine = scales.into_iter().rev();
        let mut joined: Option<Tensor> = None;
        for scale in coarse_to_fine {
            joined = Some(match joined {
                None => scale,
                Some(coarse) => (scale + end_of_doubled(&coarse)?)?,
            });
        }
        let Some(joined) = joined else {
            candle_core::bail!("the history encoder has no levels")
        };
        let joined = self.joined.forward(&joined)?;
        joined.narrow(2, READ - 1, 1)?.squeeze(2)?.contiguous()
    }
}

/// Differences of neighboring samples (B·A, 20, 9); zero where one of both is missing, and the
/// cosine one.
fn steps(inputs: &PlanTfInputs) -> Result<Tensor> {
    let (batch, agents, samples) = inputs.heading.dims3()?;
    let count = samples - 1;
    let before_and_after =
        |x: &Tensor| Ok::<_, candle_core::Error>((x.narrow(2, 0, count)?, x.narrow(2, 1, count)?));
    let (before, after) = before_and_after(&inputs.valid.to_dtype(DType::F32)?)?;
    let both = (before * after)?.unsqueeze(3)?;
    let difference = |x: &Tensor| -> Result<Tensor> {
        let (before, after) = before_and_after(x)?;
        (after - before)?.broadcast_mul(&both)
    };
    let turn = difference(&inputs.heading.unsqueeze(3)?)?;
    let (_, shape) = before_and_after(&inputs.shape)?;
    let columns = [
        difference(&inputs.position)?,
        difference(&inputs.velocity)?,
        turn.cos()?,
        turn.sin()?,
        shape,
        both.clone(),
    ];
    Tensor::cat(&columns, 3)?.reshape((batch * agents, count, CHANNELS))
}

/// The last two samples of a scale of doubled length, from its last two (N, C, 2): linear
/// interpolation with samples at the middle of their intervals (PyTorch's `align_corners=False`).
fn end_of_doubled(x: &Tensor) -> Result<Tensor> {
    let (before, last) = (x.narrow(2, 0, 1)?, x.narrow(2, 1, 1)?);
    let between = ((before * 0.25)? + (&last * 0.75)?)?;
    Tensor::cat(&[between, last], 2)
}

/// A transformer block whose attention sees a window of neighbors.
#[derive(Debug, Clone)]
struct Block {
    norms: [LayerNorm; 2],
    heads: usize,
    projections: Linear,
    output: Linear,
    /// Logit offsets (heads, L, L) of the level's length, −∞ outside the window.
    offsets: Vec<f32>,
    window: usize,
    mlp: [Linear; 2],
}

impl Block {
    fn take(weights: &mut Weights, name: &str, width: usize, level: usize) -> Result<Self> {
        let (heads, window) = (HEADS[level], WINDOWS[level]);
        let norm =
            |weights: &mut Weights, i: usize| weights.layer_norm(&format!("{name}.norm{i}"), width);
        Ok(Self {
            norms: [norm(weights, 1)?, norm(weights, 2)?],
            heads,
            window,
            offsets: weights
                .take(&format!("{name}.attn.rpb"), &[heads, 2 * window - 1])?
                .flatten_all()?
                .to_vec1()?,
            projections: weights.linear(&format!("{name}.attn.qkv"), width, 3 * width)?,
            output: weights.linear(&format!("{name}.attn.proj"), width, width)?,
            mlp: [
                weights.linear(&format!("{name}.mlp.fc1"), width, MLP_RATIO * width)?,
                weights.linear(&format!("{name}.mlp.fc2"), MLP_RATIO * width, width)?,
            ],
        })
    }

    fn forward(&self, x: &Tensor, name: &str, probe: &Probe) -> Result<Tensor> {
        let [first, second] = &self.norms;
        let mixed = self.attention(&first.forward(x)?)?;
        probe.note(&format!("{name}.attn"), &mixed);
        let x = (x + mixed)?;
        let [inner, outer] = &self.mlp;
        outer.forward_onto(&gelu(&inner.forward(&second.forward(&x)?)?)?, &x)
    }

    fn attention(&self, x: &Tensor) -> Result<Tensor> {
        let (_, length, width) = x.dims3()?;
        let parts = self.projections.forward(x)?;
        let [query, key, value] = [0, 1, 2].map(|i| parts.narrow(2, i * width, width));
        let mixed = PackedKeyValues::pack(&key?, &value?, self.heads)?
            .attend(&query?, Some(&self.bias(length)?))?;
        self.output.forward(&mixed)
    }

    /// Each query sees the window around it; at the ends, the window is moved inside.
    fn bias(&self, length: usize) -> Result<Tensor> {
        let offsets = 2 * self.window - 1;
        let mut bias = vec![f32::NEG_INFINITY; self.heads * length * length];
        for (head, bias) in bias.chunks_exact_mut(length * length).enumerate() {
            for (query, row) in bias.chunks_exact_mut(length).enumerate() {
                let start = query
                    .saturating_sub(self.window / 2)
                    .min(length - self.window);
                for (key, value) in row.iter_mut().enumerate().skip(start).take(self.window) {
                    *value = self.offsets[head * offsets + key + self.window - 1 - query];
                }
            }
        }
        Tensor::from_vec(bias, (1, self.heads, length, length), &Device::Cpu)
    }
}
