//! A residual network of bottleneck blocks.

use super::convolution::{Convolution, Shape, largest};
use crate::blocks::{Linear, Probe, Weights, relu};
use candle_core::{Result, Tensor};

/// Poses of the plan, 0.5 s apart.
const POSES: usize = 16;
/// Channels of the raster: ego, agents, road map, baseline paths.
const CHANNELS: usize = 4;
/// Channels behind the first layer.
const STEM: usize = 64;
/// Blocks of the four stages, and how much wider a block's output is than its middle.
const BLOCKS: [usize; 4] = [3, 4, 6, 3];
const EXPANSION: usize = 4;

/// Widths of a RasterModel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RasterModelConfig {
    /// Middle width of the blocks of each stage.
    pub widths: [usize; 4],
}

impl RasterModelConfig {
    /// The published model.
    pub const PUBLISHED: Self = Self {
        widths: [64, 128, 256, 512],
    };
    /// `raster-model-small`.
    pub const SMALL: Self = Self {
        widths: [16, 32, 64, 128],
    };
}

/// RasterModel.
#[derive(Debug, Clone)]
pub struct RasterModel {
    stem: Convolution,
    stages: Vec<Vec<Bottleneck>>,
    output: Linear,
}

impl RasterModel {
    /// Takes the parameters.
    ///
    /// # Errors
    /// When a tensor cannot be converted.
    pub fn take(weights: &mut Weights, config: RasterModelConfig) -> Result<Self> {
        let shape = Shape {
            inputs: CHANNELS,
            outputs: STEM,
            kernel: 7,
            stride: 2,
        };
        let stem = Convolution::take(weights, ["_model.conv1", "_model.bn1"], shape)?;
        let mut inputs = STEM;
        let mut stages = Vec::with_capacity(BLOCKS.len());
        for (stage, (blocks, width)) in BLOCKS.into_iter().zip(config.widths).enumerate() {
            let mut made = Vec::with_capacity(blocks);
            for i in 0..blocks {
                let stride = if i == 0 && stage > 0 { 2 } else { 1 };
                let name = format!("_model.layer{}.{i}", stage + 1);
                made.push(Bottleneck::take(weights, &name, [inputs, width, stride])?);
                inputs = EXPANSION * width;
            }
            stages.push(made);
        }
        Ok(Self {
            stem,
            stages,
            output: weights.linear("_model.fc", inputs, 3 * POSES)?,
        })
    }

    /// The plans (B, 16, 3) of rasters (B, 4, rows, columns).
    ///
    /// # Errors
    /// When an input has another shape.
    pub fn forward(&self, raster: &Tensor, probe: &Probe) -> Result<Tensor> {
        // PyTorch's order of dimensions, for the probe.
        let channels_first = |x: &Tensor| x.permute((0, 3, 1, 2));
        let x = self.stem.forward(&raster.permute((0, 2, 3, 1))?)?;
        probe.note("_model.bn1", &channels_first(&x)?);
        let mut x = largest(&relu(&x)?)?;
        probe.note("_model.maxpool", &channels_first(&x)?);
        for (i, stage) in self.stages.iter().enumerate() {
            for block in stage {
                x = block.forward(&x)?;
            }
            probe.note(&format!("_model.layer{}", i + 1), &channels_first(&x)?);
        }
        let pooled = x.flatten(1, 2)?.mean(1)?;
        probe.note("_model.global_pool", &pooled);
        self.output.forward(&pooled)?.reshape(((), POSES, 3))
    }
}

/// Three convolutions with a residual around them.
#[derive(Debug, Clone)]
struct Bottleneck {
    layers: [Convolution; 3],
    shortcut: Option<Convolution>,
}

impl Bottleneck {
    fn take(
        weights: &mut Weights,
        name: &str,
        [inputs, width, stride]: [usize; 3],
    ) -> Result<Self> {
        let outputs = EXPANSION * width;
        let mut layer = |part: usize, shape: Shape| {
            Convolution::take(
                weights,
                [&format!("{name}.conv{part}"), &format!("{name}.bn{part}")],
                shape,
            )
        };
        let layers = [
            layer(
                1,
                Shape {
                    inputs,
                    outputs: width,
                    kernel: 1,
                    stride: 1,
                },
            )?,
            layer(
                2,
                Shape {
                    inputs: width,
                    outputs: width,
                    kernel: 3,
                    stride,
                },
            )?,
            layer(
                3,
                Shape {
                    inputs: width,
                    outputs,
                    kernel: 1,
                    stride: 1,
                },
            )?,
        ];
        let names = [
            format!("{name}.downsample.0"),
            format!("{name}.downsample.1"),
        ];
        let shape = Shape {
            inputs,
            outputs,
            kernel: 1,
            stride,
        };
        // Where a block keeps its input's shape, the residual is the input itself.
        let keeps_shape = stride == 1 && inputs == outputs;
        let shortcut = if keeps_shape {
            None
        } else {
            Some(Convolution::take(weights, [&names[0], &names[1]], shape)?)
        };
        Ok(Self { layers, shortcut })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let [first, second, third] = &self.layers;
        let y = relu(&second.forward(&relu(&first.forward(x)?)?)?)?;
        let x = match &self.shortcut {
            Some(shortcut) => shortcut.forward(x)?,
            None => x.clone(),
        };
        relu(&third.forward_onto(&y, &x)?)
    }
}
