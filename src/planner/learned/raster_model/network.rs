//! A residual network of bottleneck blocks.

use crate::planner::learned::blocks::{Linear, Probe, Weights};
use candle_core::{D, Result, Tensor};

/// Poses of the plan, 0.5 s apart.
const POSES: usize = 16;
/// Channels of the raster: ego, agents, road map, baseline paths.
const CHANNELS: usize = 4;
/// Channels behind the first layer.
const STEM: usize = 64;
/// Blocks of the four stages, and how much wider a block's output is than its middle.
const BLOCKS: [usize; 4] = [3, 4, 6, 3];
const EXPANSION: usize = 4;
/// ε of the batch normalization.
const EPSILON: f64 = 1e-5;

/// Widths of a RasterModel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RasterModelConfig {
    /// Middle width of the blocks of each stage.
    pub widths: [usize; 4],
}

impl RasterModelConfig {
    /// The published model.
    pub const PUBLISHED: Self = Self { widths: [64, 128, 256, 512] };
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
        let shape = Shape { inputs: CHANNELS, outputs: STEM, kernel: 7, stride: 2 };
        let stem = Convolution::take(weights, ["_model.conv1", "_model.bn1"], shape)?;
        let mut inputs = STEM;
        let mut stages = Vec::with_capacity(BLOCKS.len());
        for (stage, (blocks, width)) in BLOCKS.into_iter().zip(config.widths).enumerate() {
            let mut made = Vec::with_capacity(blocks);
            for i in 0..blocks {
                let stride = if i == 0 && stage > 0 { 2 } else { 1 };
                let name = format!("_model.layer{}.{i}", stage + 1);
                made.push(Bottleneck::take(weights, &name, [inputs, width, stride], i == 0)?);
                inputs = EXPANSION * width;
            }
            stages.push(made);
        }
        Ok(Self { stem, stages, output: Linear::take(weights, "_model.fc", inputs, 3 * POSES)? })
    }

    /// The plans (B, 16, 3) of rasters (B, 4, rows, columns).
    ///
    /// # Errors
    /// When an input has another shape.
    pub fn forward(&self, raster: &Tensor, probe: &mut Probe) -> Result<Tensor> {
        let x = self.stem.forward(raster)?;
        probe.note("_model.bn1", &x);
        let x = x.relu()?;
        // Values are not negative here, so that a border of zeros does not change a maximum.
        let padded = x.pad_with_zeros(2, 1, 1)?.pad_with_zeros(3, 1, 1)?;
        let mut x = padded.max_pool2d_with_stride(3, 2)?;
        probe.note("_model.maxpool", &x);
        for (i, stage) in self.stages.iter().enumerate() {
            for block in stage {
                x = block.forward(&x)?;
            }
            probe.note(&format!("_model.layer{}", i + 1), &x);
        }
        let pooled = x.flatten_from(2)?.mean(D::Minus1)?;
        probe.note("_model.global_pool", &pooled);
        self.output.forward(&pooled)?.reshape(((), POSES, 3))
    }
}

/// Channels, kernel and stride of a convolution.
#[derive(Debug, Clone, Copy)]
struct Shape {
    inputs: usize,
    outputs: usize,
    kernel: usize,
    stride: usize,
}

/// A convolution with the batch normalization behind it, as one convolution with a bias.
#[derive(Debug, Clone)]
struct Convolution {
    weight: Tensor,
    bias: Tensor,
    stride: usize,
    padding: usize,
}

impl Convolution {
    fn take(weights: &mut Weights, [name, norm]: [&str; 2], shape: Shape) -> Result<Self> {
        let Shape { inputs, outputs, kernel, stride } = shape;
        let weight = weights.take(&format!("{name}.weight"), &[outputs, inputs, kernel, kernel])?;
        let mut vector = |part: &str| weights.take(&format!("{norm}.{part}"), &[outputs]);
        let (scale, shift) = (vector("weight")?, vector("bias")?);
        let (mean, variance) = (vector("running_mean")?, vector("running_var")?);
        weights.skip(&format!("{norm}.num_batches_tracked"), &[])?;
        let factor = (scale / (variance + EPSILON)?.sqrt()?)?;
        let bias = (shift - (mean * &factor)?)?.reshape((1, outputs, 1, 1))?;
        let weight = weight.broadcast_mul(&factor.reshape((outputs, 1, 1, 1))?)?;
        Ok(Self { weight, bias, stride, padding: kernel / 2 })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        x.conv2d(&self.weight, self.padding, self.stride, 1, 1)?.broadcast_add(&self.bias)
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
        with_shortcut: bool,
    ) -> Result<Self> {
        let outputs = EXPANSION * width;
        let mut layer = |part: usize, shape: Shape| {
            Convolution::take(weights, [&format!("{name}.conv{part}"), &format!("{name}.bn{part}")], shape)
        };
        let layers = [
            layer(1, Shape { inputs, outputs: width, kernel: 1, stride: 1 })?,
            layer(2, Shape { inputs: width, outputs: width, kernel: 3, stride })?,
            layer(3, Shape { inputs: width, outputs, kernel: 1, stride: 1 })?,
        ];
        let names = [format!("{name}.downsample.0"), format!("{name}.downsample.1")];
        let shape = Shape { inputs, outputs, kernel: 1, stride };
        let shortcut =
            if with_shortcut { Some(Convolution::take(weights, [&names[0], &names[1]], shape)?) } else { None };
        Ok(Self { layers, shortcut })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let [first, second, third] = &self.layers;
        let y = third.forward(&second.forward(&first.forward(x)?.relu()?)?.relu()?)?;
        let x = match &self.shortcut {
            Some(shortcut) => shortcut.forward(x)?,
            None => x.clone(),
        };
        (x + y)?.relu()
    }
}
