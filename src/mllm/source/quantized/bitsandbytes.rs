//! bitsandbytes: four bits that choose from a table (T. Dettmers et al., arXiv:2305.14314), and
//! eight bits with a scale for each row.

use super::layer::{Packed, PackedLayer};
use super::scales::{Meaning, Places, Scales};
use super::table::{Part, TensorTable};
use super::{Description, Method};
use crate::MllmError;
use safetensors::Dtype;
use serde::Deserialize;

pub(super) const METHOD: Method = Method {
    names: &["bitsandbytes"],
    layers,
};

/// The tables of four bits.
const KINDS: [&str; 2] = ["nf4", "fp4"];
/// Longest description of a tensor, bytes.
const MAX_STATE: usize = 1 << 16;
/// What the scale of eight bits is divided by.
const LARGEST: f32 = 127.0;

fn layers(_: &Description, table: &mut TensorTable) -> Result<Vec<PackedLayer>, MllmError> {
    let mut layers = Vec::new();
    for kind in KINDS {
        let part = format!("weight.quant_state.bitsandbytes__{kind}");
        for name in table.layers(&part, |_| true) {
            layers.push(four(table, name, kind, &part)?);
        }
    }
    for name in table.layers("SCB", |_| true) {
        layers.push(eight(table, name)?);
    }
    Ok(layers)
}

/// How a tensor of four bits was packed.
#[derive(Debug, Clone, Deserialize)]
struct State {
    quant_type: String,
    blocksize: usize,
    shape: Vec<usize>,
    #[serde(default)]
    nested_blocksize: Option<usize>,
    #[serde(default)]
    nested_offset: Option<f32>,
}

impl State {
    fn read(part: &Part) -> Result<Self, MllmError> {
        if part.tensor.bytes as usize > MAX_STATE {
            return Err(part.error(format!("a description of more than {MAX_STATE} bytes")));
        }
        serde_json::from_slice(&part.bytes()?).map_err(|error| {
            part.error(format!("the description of the tensor is no JSON: {error}"))
        })
    }
}

fn four(
    table: &mut TensorTable,
    name: String,
    kind: &str,
    state_part: &str,
) -> Result<PackedLayer, MllmError> {
    let state_part = table.need(&name, state_part)?.of_type(&[Dtype::U8])?;
    let state = State::read(&state_part)?;
    let codes = table.need(&name, "weight")?;
    let numbers = table
        .need(&name, "weight.quant_map")?
        .of_type(&[Dtype::F32])?;
    numbers.check_shape(&[16])?;
    let &[outputs, inputs] = state.shape.as_slice() else {
        return Err(state_part.error(format!("shape {:?} is no matrix", state.shape)));
    };
    if state.quant_type != kind || state.blocksize == 0 {
        return Err(state_part.error("quant_type and blocksize do not describe the tensor"));
    }
    // The shape comes from the file's own text, so it is compared with the bytes that are there.
    let count = outputs.checked_mul(inputs).filter(|count| *count > 0);
    let Some(count) = count.filter(|count| count.div_ceil(2) as u64 == codes.tensor.bytes) else {
        let problem = format!(
            "{} bytes do not hold a matrix of {outputs} x {inputs}",
            codes.tensor.bytes
        );
        return Err(codes.error(problem));
    };
    let runs = count.div_ceil(state.blocksize);
    let absmax = table.need_side(&name, "weight.absmax")?;
    absmax.check_shape(&[runs])?;
    let nested = match absmax.tensor.dtype {
        Dtype::F32 => None,
        _ => Some(nested(table, &name, &state, &state_part, runs)?),
    };
    Ok(PackedLayer {
        name,
        outputs,
        inputs,
        bits: 4,
        label: format!("bitsandbytes {kind}"),
        packed: Box::new(Table {
            count,
            run: state.blocksize,
            codes,
            numbers,
            absmax: absmax.of_type(&[Dtype::F32, Dtype::U8])?,
            nested,
        }),
    })
}

fn nested(
    table: &mut TensorTable,
    name: &str,
    state: &State,
    state_part: &Part,
    runs: usize,
) -> Result<Nested, MllmError> {
    let numbers = table
        .need(name, "weight.nested_quant_map")?
        .of_type(&[Dtype::F32])?;
    numbers.check_shape(&[256])?;
    let absmax = table
        .need(name, "weight.nested_absmax")?
        .of_type(&[Dtype::F32])?;
    let Some(run) = state.nested_blocksize.filter(|run| *run > 0) else {
        return Err(state_part.error("scales of 8 bits need nested_blocksize"));
    };
    absmax.check_shape(&[runs.div_ceil(run)])?;
    let offset = state.nested_offset.unwrap_or(0.0);
    Ok(Nested {
        run,
        offset,
        numbers,
        absmax,
    })
}

/// Scales that are packed themselves.
#[derive(Debug)]
struct Nested {
    run: usize,
    offset: f32,
    numbers: Part,
    absmax: Part,
}

impl Nested {
    fn scales(&self, codes: &[u8]) -> Result<Vec<f32>, MllmError> {
        let (numbers, absmax) = (self.numbers.floats()?, self.absmax.floats()?);
        let runs = codes.chunks(self.run).zip(absmax);
        let scale = |code: &u8| numbers.get(usize::from(*code)).copied().unwrap_or(0.0);
        Ok(runs
            .flat_map(|(codes, absmax)| codes.iter().map(move |code| (code, absmax)))
            .map(|(code, absmax)| scale(code) * absmax + self.offset)
            .collect())
    }
}

/// Numbers of a table, with a scale for each run of the row-major matrix.
#[derive(Debug)]
struct Table {
    count: usize,
    run: usize,
    codes: Part,
    numbers: Part,
    absmax: Part,
    nested: Option<Nested>,
}

impl Packed for Table {
    fn scales(&self) -> Result<Scales, MllmError> {
        let scales = match &self.nested {
            None => self.absmax.floats()?,
            Some(nested) => nested.scales(&self.absmax.bytes()?)?,
        };
        Ok(Scales {
            scales,
            places: Places::Runs(self.run),
            meaning: Meaning::Table(self.numbers.floats()?),
        })
    }

    fn codes(&self) -> Result<Vec<u8>, MllmError> {
        let bytes = self.codes.bytes()?;
        let pairs = bytes.iter().flat_map(|byte| [byte >> 4, byte & 15]);
        Ok(pairs.take(self.count).collect())
    }
}

fn eight(table: &mut TensorTable, name: String) -> Result<PackedLayer, MllmError> {
    let codes = table.need(&name, "weight")?.of_type(&[Dtype::I8])?;
    let largest = table.need_side(&name, "SCB")?.of_type(&[Dtype::F32])?;
    let [outputs, inputs] = codes.matrix()?;
    largest.check_shape(&[outputs])?;
    if let Some(order) = table.take(&name, "weight_format")
        && (order.tensor.bytes > 8 || order.bytes()?.iter().any(|byte| *byte != 0))
    {
        return Err(order.error(
            "an order of tiles for a GPU; only rows (0) are read: save the model again with a newer bitsandbytes",
        ));
    }
    Ok(PackedLayer {
        name,
        outputs,
        inputs,
        bits: 8,
        label: "bitsandbytes int8".into(),
        packed: Box::new(Rows {
            codes,
            largest,
            inputs,
        }),
    })
}

/// Bytes with the largest magnitude of each row.
#[derive(Debug)]
struct Rows {
    codes: Part,
    largest: Part,
    inputs: usize,
}

impl Packed for Rows {
    fn scales(&self) -> Result<Scales, MllmError> {
        let largest = self.largest.floats()?;
        Ok(Scales {
            scales: largest.iter().map(|largest| largest / LARGEST).collect(),
            places: Places::rows(self.inputs.max(1)),
            meaning: Meaning::Zero(128),
        })
    }

    fn codes(&self) -> Result<Vec<u8>, MllmError> {
        let mut bytes = self.codes.bytes()?;
        for byte in &mut bytes {
            *byte ^= 0x80;
        }
        Ok(bytes)
    }
}
