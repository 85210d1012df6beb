//! compressed-tensors, the format of llm-compressor and vLLM: whole numbers of 1 to 8 bits, packed
//! or as bytes, and floats of 8 bits.

use super::bits::{BitStream, words_of};
use super::fp8;
use super::layer::{Packed, PackedLayer};
use super::scales::{Meaning, Places, Scales};
use super::table::{FLOATS, Part, TensorTable};
use super::{Description, Method};
use crate::MllmError;
use crate::checkpoint::ConfigObject;
use rayon::prelude::*;
use safetensors::Dtype;
use serde_json::{Map, Value};

pub(super) const METHOD: Method = Method {
    names: &["compressed-tensors"],
    layers,
};

/// Formats that are read, or that leave weights plain.
const FORMATS: [&str; 8] = [
    "pack-quantized",
    "int-quantized",
    "float-quantized",
    "naive-quantized",
    "mixed-precision",
    "dense",
    "fakequant",
    "unquantized",
];
/// Sides of a block where the configuration is silent.
const BLOCK: [usize; 2] = [128, 128];

/// What the groups of the configuration say that shapes do not.
#[derive(Debug, Default)]
struct Schemes {
    bits: Vec<u32>,
    blocks: Vec<[usize; 2]>,
}

impl Schemes {
    fn read(settings: &ConfigObject<'_>) -> Result<Self, MllmError> {
        check_format(settings)?;
        for key in ["transform_config", "moe_sparsity_config"] {
            let found: Option<Value> = settings.value(key)?;
            let empty = |value: &Value| value.as_object().is_some_and(Map::is_empty);
            if found.is_some_and(|found| !empty(&found)) {
                return Err(settings.error(
                    key,
                    "changes of the model while it runs are not read; take another quantization",
                ));
            }
        }
        if let Some(sparsity) = settings.child("sparsity_config")? {
            check_format(&sparsity)?;
        }
        let mut schemes = Self::default();
        let groups: Option<Map<String, Value>> = settings.value("config_groups")?;
        let groups_object = settings.child_or_empty("config_groups")?;
        for name in groups.iter().flat_map(Map::keys) {
            // A list of targets under the name of a preset, such as W4A16.
            if let Ok(Some(group)) = groups_object.child(name) {
                schemes.add(&group)?;
            } else {
                let digits: String = name
                    .chars()
                    .skip(1)
                    .take_while(char::is_ascii_digit)
                    .collect();
                schemes.bits.extend(digits.parse::<u32>().ok());
            }
        }
        Ok(schemes)
    }

    fn add(&mut self, group: &ConfigObject<'_>) -> Result<(), MllmError> {
        check_format(group)?;
        let weights = group.child_or_empty("weights")?;
        self.bits.push(weights.value("num_bits")?.unwrap_or(8));
        let block = match weights.value::<Value>("block_structure")? {
            None => return Ok(()),
            // Sides in a text, as older versions write them.
            Some(Value::String(text)) => text
                .split_once('x')
                .and_then(|(rows, columns)| Some([rows.parse().ok()?, columns.parse().ok()?])),
            Some(_) => weights.value("block_structure")?,
        };
        let Some(block) = block else {
            return Err(weights.error("block_structure", "expected two sides, such as [128, 128]"));
        };
        self.blocks.push(block);
        Ok(())
    }
}

fn check_format(object: &ConfigObject<'_>) -> Result<(), MllmError> {
    let format: Option<String> = object.value("format")?;
    match format {
        Some(format) if !FORMATS.contains(&format.as_str()) => {
            let problem = format!(
                "'{format}' is not read; {} are: take another quantization, or the model's original repository",
                FORMATS[..4].join(", ")
            );
            Err(object.error("format", problem))
        }
        _ => Ok(()),
    }
}

fn layers(
    description: &Description,
    table: &mut TensorTable,
) -> Result<Vec<PackedLayer>, MllmError> {
    let schemes = Schemes::read(&description.settings()?)?;
    let mut layers = Vec::new();
    for name in table.layers("weight_packed", |_| true) {
        layers.push(packed(table, name, &schemes)?);
    }
    for name in table.layers("weight", |part| part.tensor.dtype == Dtype::I8) {
        layers.push(bytes(table, name, &schemes)?);
    }
    for name in table.layers("weight", |part| part.tensor.dtype == Dtype::F8_E4M3) {
        let weight = table.need(&name, "weight")?;
        let scale = table.need_side(&name, "weight_scale")?;
        let block = block_of(&schemes, &scale, weight.matrix()?);
        layers.push(fp8::floats(
            name,
            weight,
            scale,
            block,
            "compressed-tensors fp8",
        )?);
    }
    Ok(layers)
}

/// The sides of the blocks that fit the scales.
fn block_of(schemes: &Schemes, scale: &Part, [outputs, inputs]: [usize; 2]) -> [usize; 2] {
    let fits = |block: &&[usize; 2]| {
        let [rows, columns] = **block;
        let grid = [
            outputs.div_ceil(rows.max(1)),
            inputs.div_ceil(columns.max(1)),
        ];
        rows > 0 && columns > 0 && *scale.shape() == grid
    };
    schemes.blocks.iter().find(fits).copied().unwrap_or(BLOCK)
}

/// The scales of whole numbers: as those of floats, or in groups of columns.
fn places(schemes: &Schemes, scale: &Part, shape: [usize; 2]) -> Result<Places, MllmError> {
    let [outputs, inputs] = shape;
    if let &[rows, groups] = scale.shape()
        && rows == outputs
        && groups > 1
    {
        if !inputs.is_multiple_of(groups) {
            return Err(scale.error(format!("{groups} groups do not divide {inputs} inputs")));
        }
        return Ok(Places::groups(inputs / groups, groups));
    }
    fp8::places(scale, shape, block_of(schemes, scale, shape))
}

fn packed(
    table: &mut TensorTable,
    name: String,
    schemes: &Schemes,
) -> Result<PackedLayer, MllmError> {
    let codes = table.need(&name, "weight_packed")?;
    if codes.tensor.dtype == Dtype::U8 {
        return Err(codes.error(
            "floats of 4 bits are not read from folders; take the model's original repository or a GGUF file",
        ));
    }
    let codes = codes.of_type(&[Dtype::I32])?;
    let scale = table.need_side(&name, "weight_scale")?.of_type(&FLOATS)?;
    let shape = table
        .need(&name, "weight_shape")?
        .of_type(&[Dtype::I64, Dtype::I32])?;
    let [outputs, inputs] = stored_shape(&shape)?;
    let [rows, words] = codes.matrix()?;
    if rows != outputs {
        return Err(shape.error(format!("{outputs} rows, but the packed tensor has {rows}")));
    }
    let fits = |bits: &&u32| {
        let in_word = 32 / (**bits).clamp(1, 32);
        (1..=8).contains(*bits)
            && (words_of(inputs, **bits) == Some(words)
                || inputs.div_ceil(in_word as usize) == words)
    };
    let Some(bits) = schemes.bits.iter().find(fits).copied() else {
        let problem = format!(
            "{words} words a row of {inputs} numbers fit none of the widths of the configuration, {:?} bits",
            schemes.bits
        );
        return Err(codes.error(problem));
    };
    let mut places = places(schemes, &scale, [outputs, inputs])?;
    if let Some(part) = table.take(&name, "weight_g_idx") {
        places = listed(&part.of_type(&[Dtype::I32])?, places, inputs)?;
    }
    let zeros = match table.take(&name, "weight_zero_point") {
        Some(part) => Some(part.of_type(&[Dtype::I32, Dtype::I8])?),
        None => None,
    };
    Ok(PackedLayer {
        name,
        outputs,
        inputs,
        bits,
        label: format!("compressed-tensors {bits} bits"),
        packed: Box::new(Integers {
            outputs,
            inputs,
            // Older versions left the rest of a word empty.
            gaps: words_of(inputs, bits) != Some(words),
            bits,
            codes,
            zeros,
            scale,
            places,
        }),
    })
}

fn bytes(
    table: &mut TensorTable,
    name: String,
    schemes: &Schemes,
) -> Result<PackedLayer, MllmError> {
    let codes = table.need(&name, "weight")?;
    let scale = table.need_side(&name, "weight_scale")?.of_type(&FLOATS)?;
    let [outputs, inputs] = codes.matrix()?;
    let zeros = match table.take(&name, "weight_zero_point") {
        Some(part) => Some(part.of_type(&[Dtype::I8])?),
        None => None,
    };
    Ok(PackedLayer {
        name,
        outputs,
        inputs,
        bits: 8,
        label: "compressed-tensors 8 bits".into(),
        packed: Box::new(Integers {
            places: places(schemes, &scale, [outputs, inputs])?,
            outputs,
            inputs,
            gaps: false,
            bits: 8,
            codes,
            zeros,
            scale,
        }),
    })
}

/// The shape that a tensor of two numbers holds.
fn stored_shape(shape: &Part) -> Result<[usize; 2], MllmError> {
    shape.check_shape(&[2])?;
    let bytes = shape.bytes()?;
    let numbers: Vec<i64> = match shape.tensor.dtype {
        Dtype::I64 => {
            let numbers = bytes.as_chunks::<8>().0.iter();
            numbers.map(|number| i64::from_le_bytes(*number)).collect()
        }
        _ => shape
            .words()?
            .into_iter()
            .map(|word| i64::from(word.cast_signed()))
            .collect(),
    };
    match numbers.as_slice() {
        &[outputs, inputs] if (1..1 << 32).contains(&outputs) && (1..1 << 32).contains(&inputs) => {
            Ok([outputs as usize, inputs as usize])
        }
        other => Err(shape.error(format!("expected the sides of a matrix, found {other:?}"))),
    }
}

/// The groups of columns that a tensor lists.
fn listed(columns: &Part, places: Places, inputs: usize) -> Result<Places, MllmError> {
    columns.check_shape(&[inputs])?;
    let groups = columns.words()?;
    let Places::Blocks {
        columns: size,
        across,
        rows: 1,
    } = places
    else {
        return Err(columns.error("an order of columns needs scales in groups"));
    };
    if groups
        .iter()
        .enumerate()
        .all(|(column, group)| *group as usize == column / size)
    {
        return Ok(places);
    }
    match groups.iter().find(|group| **group as usize >= across) {
        Some(group) => Err(columns.error(format!(
            "group {} of a column, but there are {across}",
            group.cast_signed()
        ))),
        None => Ok(Places::Listed { groups, across }),
    }
}

#[derive(Debug)]
struct Integers {
    outputs: usize,
    inputs: usize,
    bits: u32,
    /// Whether a word has only whole codes.
    gaps: bool,
    /// Words, or bytes of 8 bits.
    codes: Part,
    zeros: Option<Part>,
    scale: Part,
    places: Places,
}

impl Integers {
    /// What a code is more than its number.
    fn offset(&self) -> i16 {
        1 << (self.bits - 1)
    }

    /// The zero points of codes.
    fn zero_points(&self, zeros: &Part) -> Result<Vec<i16>, MllmError> {
        if zeros.tensor.dtype == Dtype::I8 {
            zeros.check_shape(self.scale.shape())?;
            let bytes = zeros.bytes()?;
            let signed = bytes.into_iter().map(|byte| i16::from(byte.cast_signed()));
            return Ok(signed.map(|zero| zero + self.offset()).collect());
        }
        let groups = self.scale.shape().get(1).copied().unwrap_or(1);
        let words = words_of(self.outputs, self.bits).unwrap_or(usize::MAX);
        zeros.check_shape(&[words, groups])?;
        let words = zeros.words()?;
        let zero = |index: usize| {
            let stream = BitStream {
                words: &words,
                first: index % groups,
                stride: groups,
                bits: self.bits,
            };
            i16::from(stream.code(index / groups))
        };
        Ok((0..self.outputs * groups).map(zero).collect())
    }
}

impl Packed for Integers {
    fn scales(&self) -> Result<Scales, MllmError> {
        let meaning = match &self.zeros {
            None => Meaning::Zero(self.offset()),
            Some(zeros) => Meaning::Zeros(self.zero_points(zeros)?),
        };
        Ok(Scales {
            scales: self.scale.floats()?,
            places: self.places.clone(),
            meaning,
        })
    }

    fn codes(&self) -> Result<Vec<u8>, MllmError> {
        if self.codes.tensor.dtype == Dtype::I8 {
            let mut bytes = self.codes.bytes()?;
            for byte in &mut bytes {
                // Signed bytes become codes from 0 up, as packed ones are, so that the rest knows
                // one form.
                *byte ^= 0x80;
            }
            return Ok(bytes);
        }
        let words = self.codes.words()?;
        let width = words.len() / self.outputs.max(1);
        let in_word = (32 / self.bits) as usize;
        let mut codes = vec![0; self.outputs * self.inputs];
        let rows = codes
            .par_chunks_mut(self.inputs.max(1))
            .zip(words.par_chunks(width.max(1)));
        rows.for_each(|(codes, words)| {
            let stream = BitStream {
                words,
                first: 0,
                stride: 1,
                bits: self.bits,
            };
            for (index, code) in codes.iter_mut().enumerate() {
                *code = if self.gaps {
                    let first = index / in_word;
                    BitStream { first, ..stream }.code(index % in_word)
                } else {
                    stream.code(index)
                };
            }
        });
        Ok(codes)
    }
}
