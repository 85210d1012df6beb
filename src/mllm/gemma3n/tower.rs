//! The vision tower of Gemma 3n: a `MobileNet` V5, a convolutional network with attention in its
//! last stages, and what fuses the maps of two stages to tokens.

use super::blocks::{Block, Kind};
use super::config::TowerConfig;
use crate::MllmError;
use crate::checkpoint::Weights;
use candle_core::{Result, Tensor};
use planagent_kernels::attention::{
    AttentionMask, HeadShape, KeyValues, Precision, Projected, attend,
};
use planagent_kernels::{Activation, Convolution, Depthwise, Grid, Linear, RmsNorm};

/// From pixel values to tokens. A map of features is a table of pixels, (rows · columns, channels).
#[derive(Debug)]
pub(super) struct Tower {
    stem: Convolution,
    stem_norm: RmsNorm,
    stages: Vec<Vec<TowerBlock>>,
    fusion: Fusion,
}

const TOWER: &str = "vision_tower";
/// Added to the mean squares of all norms (`RmsNorm2d`).
const EPS: f64 = 1e-6;
const ACTIVATION: Activation = Activation::GeluTanh;

impl Tower {
    pub(super) fn take(
        weights: &mut Weights,
        config: &TowerConfig,
    ) -> std::result::Result<Self, MllmError> {
        let name = format!("{TOWER}.conv_stem");
        let kernel = weights.take(&format!("{name}.conv.weight"), &[config.stem, 3, 3, 3])?;
        let bias = weights.take_of_any_rank(&format!("{name}.conv.bias"), &[config.stem])?;
        let stages = config.stages.iter().enumerate();
        Ok(Self {
            stem: Convolution::new(&kernel, Some(bias), 2)?,
            stem_norm: norm(weights, &format!("{name}.bn"), config.stem)?,
            stages: stages
                .map(|(stage, blocks)| {
                    let blocks = blocks.iter().enumerate();
                    blocks
                        .map(|(index, block)| {
                            let name = format!("{TOWER}.blocks.{stage}.{index}");
                            TowerBlock::take(weights, *block, &name)
                        })
                        .collect()
                })
                .collect::<std::result::Result<_, MllmError>>()?,
            fusion: Fusion::take(weights, config)?,
        })
    }

    /// Maps pixel values (3, side, side) to (tokens, width).
    pub(super) fn forward(&self, pixels: &Tensor) -> Result<Tensor> {
        let [before, last] = self.maps(pixels)?;
        self.tokens(&self.fused(&before, &last)?)
    }

    /// The maps of the last two stages.
    pub(super) fn maps(&self, pixels: &Tensor) -> Result<[Map; 2]> {
        let (channels, rows, columns) = pixels.dims3()?;
        let grid = Grid { rows, columns };
        let rows = pixels
            .permute((1, 2, 0))?
            .contiguous()?
            .reshape((grid.pixels(), channels))?;
        let rows = self.stem_norm.forward(&self.stem.forward(&rows, grid)?)?;
        let mut map = Map {
            rows: ACTIVATION.forward(&rows)?,
            grid: grid.strided(2),
        };
        let mut before = map.clone();
        for stage in &self.stages {
            before = map;
            map = before.clone();
            for block in stage {
                map = block.forward(&map)?;
            }
        }
        Ok([before, map])
    }

    /// One map of the map of the last stage and of the one before it.
    pub(super) fn fused(&self, before: &Map, last: &Map) -> Result<Map> {
        let last = enlarged(last, before.grid)?;
        let both = Map {
            rows: Tensor::cat(&[&before.rows, &last], 1)?,
            grid: before.grid,
        };
        self.fusion.part.forward(&both, None)
    }

    /// Averages of a fused map, (tokens, width).
    pub(super) fn tokens(&self, fused: &Map) -> Result<Tensor> {
        let Map { rows, grid } = fused;
        let (side, width) = (self.fusion.side, rows.dim(1)?);
        let [tall, wide] = [grid.rows, grid.columns].map(|length| length / side);
        if grid.rows != side * tall || grid.columns != side * wide || tall * wide == 0 {
            candle_core::bail!("{grid:?} is not averaged to {side} by {side} tokens");
        }
        let averages = rows
            .reshape(vec![side, tall, side, wide, width])?
            .mean(3)?
            .mean(1)?
            .reshape((side * side, width))?;
        self.fusion.norm.forward(&averages)
    }
}

/// A map of features.
#[derive(Debug, Clone)]
pub(super) struct Map {
    /// (rows · columns, channels)
    pub rows: Tensor,
    pub grid: Grid,
}

fn norm(
    weights: &mut Weights,
    name: &str,
    width: usize,
) -> std::result::Result<RmsNorm, MllmError> {
    weights.take_rms_norm(name, width, EPS)
}

/// A convolution of each channel, and the norm behind it.
fn depthwise(
    weights: &mut Weights,
    [name, norm_name]: [String; 2],
    [channels, kernel, stride]: [usize; 3],
) -> std::result::Result<(Depthwise, RmsNorm), MllmError> {
    let shape = [channels, 1, kernel, kernel];
    let weight = weights.take(&format!("{name}.weight"), &shape)?;
    Ok((
        Depthwise::new(&weight, stride)?,
        norm(weights, &norm_name, channels)?,
    ))
}

/// A block: its input is added to what it computes, times a factor of each channel.
#[derive(Debug)]
struct TowerBlock {
    computed: Computed,
    added: bool,
}

#[derive(Debug)]
enum Computed {
    Fused(FusedPart),
    Inverted(InvertedPart),
    Attention(AttentionPart),
}

impl TowerBlock {
    fn take(
        weights: &mut Weights,
        block: Block,
        name: &str,
    ) -> std::result::Result<Self, MllmError> {
        let computed = match block.kind {
            Kind::Fused { kernel, wide } => {
                Computed::Fused(FusedPart::take(weights, block, name, [kernel, wide])?)
            }
            Kind::Inverted {
                start,
                middle,
                wide,
            } => Computed::Inverted(InvertedPart::take(
                weights,
                block,
                name,
                [start, middle, wide],
            )?),
            Kind::Attention { .. } => {
                Computed::Attention(AttentionPart::take(weights, block, name)?)
            }
        };
        // timm has factors of channels in all but fused blocks.
        let scale = format!("{name}.layer_scale.gamma");
        let mut scale = || weights.take_of_any_rank(&scale, &[block.outputs]);
        let computed = match computed {
            Computed::Fused(part) => Computed::Fused(part),
            Computed::Inverted(part) => Computed::Inverted(part.scaled(&scale()?)?),
            Computed::Attention(part) => Computed::Attention(part.scaled(scale()?)),
        };
        Ok(Self {
            computed,
            added: block.added,
        })
    }

    fn forward(&self, map: &Map) -> Result<Map> {
        let residual = self.added.then_some(&map.rows);
        match &self.computed {
            Computed::Fused(part) => part.forward(map, residual),
            Computed::Inverted(part) => part.forward(map, residual),
            Computed::Attention(part) => part.forward(map, residual),
        }
    }
}

/// A convolution that expands, and a projection (`EdgeResidual`).
#[derive(Debug)]
struct FusedPart {
    expand: Convolution,
    expand_norm: RmsNorm,
    project: Linear,
    project_norm: RmsNorm,
    stride: usize,
}

impl FusedPart {
    fn take(
        weights: &mut Weights,
        block: Block,
        name: &str,
        [kernel, wide]: [usize; 2],
    ) -> std::result::Result<Self, MllmError> {
        let shape = [wide, block.inputs, kernel, kernel];
        let expand = weights.take(&format!("{name}.conv_exp.weight"), &shape)?;
        Ok(Self {
            expand: Convolution::new(&expand, None, block.stride)?,
            expand_norm: norm(weights, &format!("{name}.bn1"), wide)?,
            project: weights.take_linear(
                &format!("{name}.conv_pwl"),
                wide,
                block.outputs,
                false,
            )?,
            project_norm: norm(weights, &format!("{name}.bn2"), block.outputs)?,
            stride: block.stride,
        })
    }

    fn forward(&self, map: &Map, residual: Option<&Tensor>) -> Result<Map> {
        let wide = self.expand.forward(&map.rows, map.grid)?;
        let wide = ACTIVATION.forward(&self.expand_norm.forward(&wide)?)?;
        Ok(Map {
            rows: normed_onto(&self.project_norm, &self.project.forward(&wide)?, residual)?,
            grid: map.grid.strided(self.stride),
        })
    }
}

/// An expansion and a projection, with convolutions of each channel before and between them
/// (`UniversalInvertedResidual`).
#[derive(Debug)]
struct InvertedPart {
    start: Option<(Depthwise, RmsNorm)>,
    expand: Linear,
    expand_norm: RmsNorm,
    middle: Option<(Depthwise, RmsNorm)>,
    project: Linear,
    project_norm: RmsNorm,
    /// Distance of windows of the first convolution, and of the one between.
    strides: [usize; 2],
}

impl InvertedPart {
    /// Takes a block with kernels before and between, and the channels between.
    fn take(
        weights: &mut Weights,
        block: Block,
        name: &str,
        [start, middle, wide]: [usize; 3],
    ) -> std::result::Result<Self, MllmError> {
        // The last convolution of a block halves the image.
        let strides = if middle > 0 {
            [1, block.stride]
        } else {
            [block.stride, 1]
        };
        let mut convolution = |part: &str, shape: [usize; 3]| {
            let names = ["conv", "bn"].map(|kind| format!("{name}.{part}.{kind}"));
            (shape[1] > 0)
                .then(|| depthwise(weights, names, shape))
                .transpose()
        };
        let start = convolution("dw_start", [block.inputs, start, strides[0]])?;
        let middle = convolution("dw_mid", [wide, middle, strides[1]])?;
        let ([expand, expand_norm], [project, project_norm]) = (
            ["conv", "bn"].map(|kind| format!("{name}.pw_exp.{kind}")),
            ["conv", "bn"].map(|kind| format!("{name}.pw_proj.{kind}")),
        );
        Ok(Self {
            start,
            expand: weights.take_linear(&expand, block.inputs, wide, false)?,
            expand_norm: norm(weights, &expand_norm, wide)?,
            middle,
            project: weights.take_linear(&project, wide, block.outputs, false)?,
            project_norm: norm(weights, &project_norm, block.outputs)?,
            strides,
        })
    }

    /// The part with a factor for each channel of its result.
    fn scaled(self, scale: &Tensor) -> Result<Self> {
        Ok(Self {
            project_norm: self.project_norm.scaled(scale)?,
            ..self
        })
    }

    fn forward(&self, map: &Map, residual: Option<&Tensor>) -> Result<Map> {
        let Map { mut rows, mut grid } = map.clone();
        if let Some((convolution, norm)) = &self.start {
            rows = norm.forward(&convolution.forward(&rows, grid)?)?;
            grid = grid.strided(self.strides[0]);
        }
        rows = self.expand_norm.forward(&self.expand.forward(&rows)?)?;
        rows = ACTIVATION.forward(&rows)?;
        if let Some((convolution, norm)) = &self.middle {
            rows = norm.forward(&convolution.forward(&rows, grid)?)?;
            rows = ACTIVATION.forward(&rows)?;
            grid = grid.strided(self.strides[1]);
        }
        Ok(Map {
            rows: normed_onto(&self.project_norm, &self.project.forward(&rows)?, residual)?,
            grid,
        })
    }
}

/// norm(x), plus a residual.
fn normed_onto(norm: &RmsNorm, x: &Tensor, residual: Option<&Tensor>) -> Result<Tensor> {
    match residual {
        Some(residual) => norm.forward_onto(x, residual),
        None => norm.forward(x),
    }
}

/// Attention among all pixels, whose heads share keys and values (`MultiQueryAttention2d`).
#[derive(Debug)]
struct AttentionPart {
    norm: RmsNorm,
    query: Linear,
    key: KeyPart,
    value: KeyPart,
    out: Linear,
    shape: HeadShape,
}

/// Keys, or values: those of every few pixels, where a convolution makes an image smaller first.
#[derive(Debug)]
struct KeyPart {
    smaller: Option<(Depthwise, RmsNorm)>,
    project: Linear,
}

impl KeyPart {
    fn forward(&self, rows: &Tensor, grid: Grid) -> Result<Tensor> {
        match &self.smaller {
            None => self.project.forward(rows),
            Some((convolution, norm)) => self
                .project
                .forward(&norm.forward(&convolution.forward(rows, grid)?)?),
        }
    }
}

impl AttentionPart {
    fn take(
        weights: &mut Weights,
        block: Block,
        name: &str,
    ) -> std::result::Result<Self, MllmError> {
        let Kind::Attention {
            heads,
            width,
            kernel,
            key_stride,
        } = block.kind
        else {
            return Err(candle_core::Error::Msg(format!("{name} is no attention")).into());
        };
        // Keys and values lie in parts alike, queries and outputs in plain projections.
        let inputs = block.inputs;
        let mut keys = |part: &str| -> std::result::Result<KeyPart, MllmError> {
            let name = format!("{name}.attn.{part}");
            let names = ["down_conv", "norm"].map(|kind| format!("{name}.{kind}"));
            let smaller = (key_stride > 1)
                .then(|| depthwise(weights, names, [inputs, kernel, key_stride]))
                .transpose()?;
            let project = weights.take_linear(&format!("{name}.proj"), inputs, width, false)?;
            Ok(KeyPart { smaller, project })
        };
        let (key, value) = (keys("key")?, keys("value")?);
        let mut linear = |part: &str, [inputs, outputs]: [usize; 2]| {
            weights.take_linear(&format!("{name}.attn.{part}.proj"), inputs, outputs, false)
        };
        Ok(Self {
            query: linear("query", [inputs, heads * width])?,
            out: linear("output", [heads * width, block.outputs])?,
            norm: norm(weights, &format!("{name}.norm"), inputs)?,
            key,
            value,
            shape: HeadShape {
                query_heads: heads,
                key_heads: 1,
                width,
            },
        })
    }

    /// The part with a factor for each channel of its result.
    fn scaled(self, scale: Tensor) -> Self {
        Self {
            out: self.out.scaled(scale),
            ..self
        }
    }

    fn forward(&self, map: &Map, residual: Option<&Tensor>) -> Result<Map> {
        let rows = self.norm.forward(&map.rows)?;
        let keys = self.key.forward(&rows, map.grid)?;
        let values = self.value.forward(&rows, map.grid)?;
        let positions = keys.dim(0)?;
        // The cache reads keys behind queries, of which it takes none.
        let queries = self.shape.query_heads * self.shape.width;
        let none = Tensor::zeros((positions, queries), keys.dtype(), keys.device())?;
        let held = Tensor::cat(&[none, keys, values], 1)?.contiguous()?;
        let held = Projected::read(&held, self.shape, None, |rows| {
            let mut held = KeyValues::new(self.shape, Precision::Single);
            held.write(rows, 0)?;
            Ok(held)
        })?;
        let queries = self.query.forward(&rows)?;
        let mixed = Projected::read_queries(&queries, self.shape, None, |rows| {
            attend(rows, &held, AttentionMask::All { positions })
        })?;
        Ok(Map {
            rows: match residual {
                Some(residual) => self.out.forward_onto(&mixed, residual)?,
                None => self.out.forward(&mixed)?,
            },
            grid: map.grid,
        })
    }
}

/// Makes tokens of the maps of two stages (`MobileNetV5MultiScaleFusionAdapter`).
#[derive(Debug)]
struct Fusion {
    part: InvertedPart,
    norm: RmsNorm,
    /// Tokens along a side.
    side: usize,
}

impl Fusion {
    fn take(weights: &mut Weights, config: &TowerConfig) -> std::result::Result<Self, MllmError> {
        let ends = config.stages.iter().rev().filter_map(|stage| stage.last());
        let inputs: usize = ends.take(2).map(|block| block.outputs).sum();
        let block = Block {
            kind: Kind::Inverted {
                start: 0,
                middle: 0,
                wide: 2 * inputs,
            },
            inputs,
            outputs: config.width,
            stride: 1,
            added: false,
        };
        let name = format!("{TOWER}.msfa");
        Ok(Self {
            part: InvertedPart::take(weights, block, &format!("{name}.ffn"), [0, 0, 2 * inputs])?,
            norm: norm(weights, &format!("{name}.norm"), config.width)?,
            side: config.grid,
        })
    }
}

/// A map with the pixels of a larger image, each the nearest of its own (`nearest` in torch).
fn enlarged(map: &Map, grid: Grid) -> Result<Tensor> {
    let row = |row: usize| row * map.grid.rows / grid.rows;
    let column = |column: usize| column * map.grid.columns / grid.columns;
    let nearest: Vec<u32> = (0..grid.rows)
        .flat_map(|y| (0..grid.columns).map(move |x| (y, x)))
        .map(|(y, x)| (row(y) * map.grid.columns + column(x)) as u32)
        .collect();
    let nearest = Tensor::new(nearest, map.rows.device())?;
    map.rows.index_select(&nearest, 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    #[test]
    fn a_smaller_map_is_repeated_pixel_by_pixel() {
        let rows = Tensor::new(&[[0_f32], [1.0], [2.0], [3.0]], &Device::Cpu).unwrap();
        let map = Map {
            rows,
            grid: Grid::square(2),
        };
        let grid = Grid {
            rows: 4,
            columns: 2,
        };
        let found = enlarged(&map, grid).unwrap().flatten_all().unwrap();
        let expected = [0.0, 1.0, 0.0, 1.0, 2.0, 3.0, 2.0, 3.0];
        assert_eq!(found.to_vec1::<f32>().unwrap(), expected);
    }
}
