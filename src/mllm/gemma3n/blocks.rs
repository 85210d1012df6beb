//! The blocks of a `MobileNet` V5, as timm's `block_args` have them.

use crate::MllmError;
use crate::checkpoint::{ConfigObject, Neutral};
use serde_json::Value;

/// A block of the tower (Qin et al., "`MobileNetV4`", arXiv:2404.10518).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Block {
    pub kind: Kind,
    pub inputs: usize,
    pub outputs: usize,
    /// Pixels from a window to the next: 1, or 2 in a block that halves the image.
    pub stride: usize,
    /// Whether the block's input is added to what it computes.
    pub added: bool,
}

/// What a block computes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Kind {
    /// A convolution to `wide` channels, and a projection.
    Fused { kernel: usize, wide: usize },
    /// An expansion to `wide` channels and a projection, with a convolution of each channel before
    /// and between them; a kernel of 0 for none.
    Inverted {
        start: usize,
        middle: usize,
        wide: usize,
    },
    /// Attention whose heads share keys and values, which are those of every `key_stride`-th pixel.
    Attention {
        heads: usize,
        width: usize,
        kernel: usize,
        key_stride: usize,
    },
}

/// Most stages. With the first convolution, each halves the image, and timm spreads windows beyond
/// a 32nd.
const MAX_STAGES: usize = 4;
/// Most blocks of a stage. Published towers have up to 39.
const MAX_BLOCKS: usize = 1 << 8;
/// Most channels, and widest attention.
const MAX_CHANNELS: usize = 1 << 16;
/// Largest kernel.
const MAX_KERNEL: usize = 15;
/// Largest factor of an expansion.
const MAX_EXPANSION: f64 = 64.0;
/// timm makes numbers of channels multiples of this.
const DIVISOR: usize = 8;

/// Keys of a block, of any kind.
const KEYS: &[&str] = &[
    "block_type",
    "out_chs",
    "stride",
    "act_layer",
    "noskip",
    "exp_ratio",
    "se_ratio",
    "exp_kernel_size",
    "pw_kernel_size",
    "force_in_chs",
    "dw_kernel_size_start",
    "dw_kernel_size_mid",
    "dw_kernel_size_end",
    "dw_kernel_size",
    "num_heads",
    "key_dim",
    "value_dim",
    "kv_stride",
];

/// The blocks of `mobilenetv5_300m_enc` behind a first convolution of `inputs` channels, by stage.
pub(super) fn published(inputs: usize) -> Vec<Vec<Block>> {
    let fused = |outputs| (outputs, Kind::Fused { kernel: 3, wide: 4 });
    let inverted = |outputs, [start, middle, wide]: [usize; 3]| {
        let kind = Kind::Inverted {
            start,
            middle,
            wide,
        };
        (outputs, kind)
    };
    // Attention and an expansion follow one another.
    let attention = |outputs, [heads, width, key_stride]: [usize; 3], pairs: usize| {
        let kind = Kind::Attention {
            heads,
            width,
            kernel: 3,
            key_stride,
        };
        [(outputs, kind), inverted(outputs, [0, 0, 2])].repeat(pairs)
    };
    let stages = [
        vec![fused(128); 3],
        [[3, 5, 6], [5, 0, 4], [3, 0, 4], [5, 0, 4], [3, 0, 4]]
            .map(|shape| inverted(256, shape))
            .to_vec(),
        [
            vec![inverted(640, [5, 5, 6])],
            vec![inverted(640, [5, 0, 4]); 7],
            vec![inverted(640, [0, 0, 1])],
            attention(640, [12, 64, 2], 14),
        ]
        .concat(),
        [
            vec![inverted(1280, [5, 5, 6])],
            attention(1280, [16, 96, 1], 19),
        ]
        .concat(),
    ];
    let mut channels = inputs;
    let mut block = |index: usize, (outputs, mut kind): (usize, Kind)| {
        let inputs = std::mem::replace(&mut channels, outputs);
        // In the list above it is the factor of the expansion.
        if let Kind::Fused { wide, .. } | Kind::Inverted { wide, .. } = &mut kind {
            *wide *= inputs;
        }
        Block {
            kind,
            inputs,
            outputs,
            stride: if index == 0 { 2 } else { 1 },
            added: index > 0 && inputs == outputs,
        }
    };
    let mut stage = |stage: Vec<(usize, Kind)>| {
        let blocks = stage.into_iter().enumerate();
        blocks
            .map(|(index, listed)| block(index, listed))
            .collect::<Vec<Block>>()
    };
    stages.into_iter().map(&mut stage).collect()
}

/// Reads `block_args`, a list of stages, each a list of blocks, behind a first convolution of
/// `inputs` channels.
pub(super) fn read(
    object: &ConfigObject<'_>,
    key: &str,
    inputs: usize,
) -> Result<Option<Vec<Vec<Block>>>, MllmError> {
    let Some(stages) = object.value::<Vec<Vec<Value>>>(key)? else {
        return Ok(None);
    };
    if !(2..=MAX_STAGES).contains(&stages.len()) {
        let problem = format!("expected 2 to {MAX_STAGES} stages, found {}", stages.len());
        return Err(object.error(key, problem));
    }
    // A block's inputs are the outputs of the one before, also of another stage.
    let mut channels = inputs;
    let mut read = Vec::with_capacity(stages.len());
    for (stage, blocks) in stages.iter().enumerate() {
        if !(1..=MAX_BLOCKS).contains(&blocks.len()) {
            let problem = format!(
                "stage {stage} has {} blocks; from 1 to {MAX_BLOCKS} are supported",
                blocks.len()
            );
            return Err(object.error(key, problem));
        }
        let mut own = Vec::with_capacity(blocks.len());
        for (index, value) in blocks.iter().enumerate() {
            let value = object.nested(&format!("{key}.{stage}.{index}"), value)?;
            let block = Block::read(&value, channels, index == 0)?;
            channels = block.outputs;
            own.push(block);
        }
        read.push(own);
    }
    Ok(Some(read))
}

impl Block {
    /// Reads a block of an image of `inputs` channels; the first of a stage halves it.
    fn read(object: &ConfigObject<'_>, inputs: usize, first: bool) -> Result<Self, MllmError> {
        let count = |key: &str, most: usize| -> Result<usize, MllmError> {
            let count: Option<usize> = object.value(key)?;
            count
                .filter(|count| (1..=most).contains(count))
                .ok_or_else(|| {
                    let found = count.map_or_else(|| "nothing".to_owned(), |n| n.to_string());
                    let problem =
                        format!("expected a whole number from 1 to {most}, found {found}");
                    object.error(key, problem)
                })
        };
        let outputs = divisible(count("out_chs", MAX_CHANNELS)? as f64);
        let (stride, expected) = (count("stride", 2)?, if first { 2 } else { 1 });
        if stride != expected {
            let problem = format!("{stride} is not supported here; {expected} is");
            return Err(object.error("stride", problem));
        }
        // Keys of any kind first, then those of its own.
        object.only_keys(KEYS)?;
        object.only_neutral(&[
            ("act_layer", Neutral::Text(&[])),
            ("se_ratio", Neutral::Number(0.0)),
            ("force_in_chs", Neutral::Number(0.0)),
            ("pw_kernel_size", Neutral::Number(1.0)),
            ("dw_kernel_size_end", Neutral::Number(0.0)),
        ])?;
        let kind: Option<String> = object.value("block_type")?;
        let kind = match kind.as_deref().unwrap_or("nothing") {
            "er" => Kind::Fused {
                kernel: kernel(object, "exp_kernel_size", 3, false)?,
                wide: wide(object, inputs)?,
            },
            "uir" => {
                let start = kernel(object, "dw_kernel_size_start", 0, true)?;
                let middle = kernel(object, "dw_kernel_size_mid", 3, true)?;
                if first && start + middle == 0 {
                    let problem = "0 beside no first kernel: nothing halves the image";
                    return Err(object.error("dw_kernel_size_mid", problem));
                }
                Kind::Inverted {
                    start,
                    middle,
                    wide: wide(object, inputs)?,
                }
            }
            "mqa" if !first => attention(object, count)?,
            other => {
                let problem = format!(
                    "'{}' is not supported here; er, uir and, behind the first block of a stage, mqa are",
                    other.escape_debug()
                );
                return Err(object.error("block_type", problem));
            }
        };
        let alone: bool = object.value("noskip")?.unwrap_or(false);
        Ok(Self {
            kind,
            inputs,
            outputs,
            stride,
            added: !alone && stride == 1 && inputs == outputs,
        })
    }
}

fn attention(
    object: &ConfigObject<'_>,
    count: impl Fn(&str, usize) -> Result<usize, MllmError>,
) -> Result<Kind, MllmError> {
    const VALUES: &str = "value_dim";
    let width = count("key_dim", MAX_CHANNELS)?;
    if count(VALUES, MAX_CHANNELS)? != width {
        let problem = format!("expected the width of keys, {width}");
        return Err(object.error(VALUES, problem));
    }
    let heads = count("num_heads", MAX_CHANNELS)?;
    if heads.saturating_mul(width) > MAX_CHANNELS {
        let problem = format!("{heads} heads of {width} numbers are more than {MAX_CHANNELS}");
        return Err(object.error("num_heads", problem));
    }
    Ok(Kind::Attention {
        heads,
        width,
        kernel: kernel(object, "dw_kernel_size", 3, false)?,
        key_stride: count("kv_stride", 2)?,
    })
}

/// The side of a kernel, an odd number; 0 for none where `optional` says so.
fn kernel(
    object: &ConfigObject<'_>,
    key: &str,
    default: usize,
    optional: bool,
) -> Result<usize, MllmError> {
    let kernel = object.value(key)?.unwrap_or(default);
    if kernel % 2 == 1 && kernel <= MAX_KERNEL || kernel == 0 && optional {
        return Ok(kernel);
    }
    let problem = format!("expected an odd number up to {MAX_KERNEL}, found {kernel}");
    Err(object.error(key, problem))
}

/// The channels of an expansion.
fn wide(object: &ConfigObject<'_>, inputs: usize) -> Result<usize, MllmError> {
    const KEY: &str = "exp_ratio";
    let factor = object.positive(KEY)?.unwrap_or(1.0);
    let wide = divisible(inputs as f64 * factor.min(MAX_EXPANSION));
    if factor <= MAX_EXPANSION && wide <= MAX_CHANNELS {
        return Ok(wide);
    }
    let problem = format!(
        "{factor} times {inputs} channels; at most {MAX_EXPANSION} times and {MAX_CHANNELS} channels are supported"
    );
    Err(object.error(KEY, problem))
}

/// The nearest multiple of [`DIVISOR`] that is no more than a tenth smaller (`make_divisible` in
/// timm).
pub(super) fn divisible(channels: f64) -> usize {
    /// The part of the channels that must be left.
    const LEAST: f64 = 0.9;
    let halved = (channels + (DIVISOR / 2) as f64) as usize;
    let nearest = (halved / DIVISOR * DIVISOR).max(DIVISOR);
    if (nearest as f64) < LEAST * channels {
        nearest + DIVISOR
    } else {
        nearest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::path::Path;

    fn parse(stages: &Value) -> Result<Option<Vec<Vec<Block>>>, MllmError> {
        let root = json!({"block_args": stages});
        read(
            &ConfigObject::root(Path::new("config.json"), &root)?,
            "block_args",
            64,
        )
    }

    /// Numbers of timm's `make_divisible`.
    #[test]
    fn channels_are_multiples_of_eight() {
        for (channels, expected) in [
            (1.0, 8),
            (8.0, 8),
            (12.0, 16),
            (17.0, 16),
            (19.0, 24),
            (128.0, 128),
            (139.9, 136),
        ] {
            assert_eq!(divisible(channels), expected, "{channels}");
        }
    }

    #[test]
    fn the_published_tower_has_84_blocks_of_294_million_weights() {
        let stages = published(64);
        let counts: Vec<usize> = stages.iter().map(Vec::len).collect();
        assert_eq!(counts, [3, 5, 37, 39]);
        assert_eq!(stages[2][9].inputs, 640);
        let halving = stages.iter().flatten().filter(|block| block.stride == 2);
        assert_eq!(halving.count(), 4);
        let kind = Kind::Attention {
            heads: 12,
            width: 64,
            kernel: 3,
            key_stride: 2,
        };
        assert_eq!(stages[2][9].kind, kind);
        assert_eq!(
            stages[0][0].kind,
            Kind::Fused {
                kernel: 3,
                wide: 256
            }
        );
    }

    /// A stage of one block that is supported, with one key of another value.
    fn with(key: &str, value: Value) -> Value {
        let block =
            json!({"block_type": "uir", "out_chs": 16, "stride": 2, "dw_kernel_size_mid": 5});
        let mut first = block.clone();
        first[key] = value;
        json!([[first], [block]])
    }

    #[test]
    fn what_is_not_computed_is_refused_by_its_key() {
        assert!(parse(&with("noskip", json!(true))).unwrap().is_some());
        assert_eq!(parse(&Value::Null).unwrap(), None);
        for (key, value) in [
            ("block_type", json!("cn")),
            ("block_type", json!("mqa")),
            ("block_type", Value::Null),
            ("stride", json!(1)),
            ("stride", json!(3)),
            ("out_chs", json!(0)),
            ("out_chs", json!(1_u64 << 40)),
            ("dw_kernel_size_mid", json!(4)),
            ("dw_kernel_size_mid", json!(0)),
            ("dw_kernel_size_start", json!(17)),
            ("dw_kernel_size_end", json!(3)),
            ("exp_ratio", json!(1e9)),
            ("exp_ratio", json!(-1)),
            ("se_ratio", json!(0.25)),
            ("act_layer", json!("relu")),
            ("group_size", json!(2)),
        ] {
            let said = parse(&with(key, value.clone())).unwrap_err().to_string();
            let named = format!("block_args.0.0.{key}");
            assert!(said.contains(&named), "{key} = {value}: {said}");
        }
        for stages in [
            json!([]),
            json!([[]]),
            json!([[], []]),
            json!(3),
            json!([[3], [3]]),
        ] {
            let said = parse(&stages).unwrap_err().to_string();
            assert!(said.contains("block_args"), "{stages}: {said}");
        }
    }

    #[test]
    fn heads_of_attention_are_bounded() {
        let read = |key: &str, value: Value| {
            let mut stages = with("noskip", json!(false));
            let mut block = json!({"block_type": "mqa", "out_chs": 16, "stride": 1, "num_heads": 2, "key_dim": 8,
                "value_dim": 8, "kv_stride": 1});
            block[key] = value;
            stages[1].as_array_mut().unwrap().push(block);
            parse(&stages)
        };
        assert!(read("dw_kernel_size", json!(3)).is_ok());
        for (key, value) in [
            ("num_heads", json!(1_u64 << 14)),
            ("value_dim", json!(4)),
            ("kv_stride", json!(3)),
            ("key_dim", Value::Null),
            ("stride", json!(2)),
        ] {
            let said = read(key, value).unwrap_err().to_string();
            assert!(said.contains(&format!("block_args.1.1.{key}")), "{said}");
        }
    }
}
