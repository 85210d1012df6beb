//! GPTQ: 2, 3, 4 or 8 bits in groups of columns (E. Frantar et al., arXiv:2210.17323), as auto-gptq
//! and gptqmodel write them.

use super::bits::{BitStream, words_of};
use super::layer::{Packed, PackedLayer};
use super::scales::{Meaning, Places, Scales};
use super::table::{FLOATS, Part, TensorTable};
use super::{Description, Method};
use crate::MllmError;
use rayon::prelude::*;
use safetensors::Dtype;

pub(super) const METHOD: Method = Method {
    names: &["gptq"],
    layers,
};

/// Widths of codes.
const WIDTHS: [u32; 4] = [2, 3, 4, 8];
/// Outputs that are unpacked at once: a cache line of words.
const TOGETHER: usize = 16;

/// What is stored for a zero point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Zeros {
    /// Version 1: one less.
    LessOne,
    /// Version 2: itself.
    Plain,
    /// The files do not say. Symmetric ones show it.
    Unknown,
}

fn layers(
    description: &Description,
    table: &mut TensorTable,
) -> Result<Vec<PackedLayer>, MllmError> {
    let settings = description.settings()?;
    let version: Option<String> = settings
        .value("checkpoint_format")?
        .or(settings.value("format")?);
    let zeros = match version.as_deref() {
        Some("gptq_v2") => Zeros::Plain,
        // Symmetric files of both versions lack the key; the stored zeros tell which it is.
        None if settings.value("sym")?.unwrap_or(true) => Zeros::Unknown,
        Some("gptq") | None => Zeros::LessOne,
        Some(other) => {
            let problem = format!(
                "the layout '{other}' of GPTQ is not read; gptq and gptq_v2 are: take another file of the model"
            );
            return Err(settings.error("checkpoint_format", problem));
        }
    };
    if let Some(word) = settings.value::<String>("pack_dtype")?
        && word != "int32"
    {
        let problem =
            format!("words of {word} are not read; int32 is: take another file of the model");
        return Err(settings.error("pack_dtype", problem));
    }
    let bits: Option<u32> = settings.value("bits")?.or(settings.value("w_bit")?);
    let names = table.layers("qweight", |_| true);
    names
        .into_iter()
        .map(|name| take(table, name, zeros, bits.unwrap_or(4)))
        .collect()
}

fn take(
    table: &mut TensorTable,
    name: String,
    version: Zeros,
    bits: u32,
) -> Result<PackedLayer, MllmError> {
    let codes = table.need(&name, "qweight")?.of_type(&[Dtype::I32])?;
    let zeros = table.need_side(&name, "qzeros")?.of_type(&[Dtype::I32])?;
    let scales = table.need_side(&name, "scales")?.of_type(&FLOATS)?;
    let columns = match table.take(&name, "g_idx") {
        Some(part) => Some(part.of_type(&[Dtype::I32])?),
        None => None,
    };
    let ([words, outputs], [groups, wide]) = (codes.matrix()?, zeros.matrix()?);
    scales.check_shape(&[groups, outputs])?;
    // Layers may have widths of their own, which the width of the zero points tells.
    let fits = |bits: &u32| words_of(outputs, *bits) == Some(wide);
    let bits = [bits]
        .into_iter()
        .chain(WIDTHS)
        .filter(|bits| WIDTHS.contains(bits))
        .find(fits);
    let Some(bits) = bits else {
        let problem = format!(
            "{wide} words of zero points for {outputs} outputs are no 2, 3, 4 or 8 bits for each, which are read"
        );
        return Err(zeros.error(problem));
    };
    let inputs = words * 32 / bits as usize;
    if !(words * 32).is_multiple_of(bits as usize) || groups == 0 {
        let problem = format!("{words} rows of words are no whole number of {bits} bits");
        return Err(codes.error(problem));
    }
    if groups > inputs {
        return Err(scales.error(format!("{groups} groups of {inputs} inputs")));
    }
    if let Some(columns) = &columns {
        columns.check_shape(&[inputs])?;
    }
    Ok(PackedLayer {
        name,
        outputs,
        inputs,
        bits,
        label: format!("gptq {bits} bits"),
        packed: Box::new(Gptq {
            version,
            bits,
            outputs,
            inputs,
            groups,
            codes,
            zeros,
            scales,
            columns,
        }),
    })
}

#[derive(Debug)]
struct Gptq {
    version: Zeros,
    bits: u32,
    outputs: usize,
    inputs: usize,
    groups: usize,
    codes: Part,
    zeros: Part,
    scales: Part,
    /// The group of each column.
    columns: Option<Part>,
}

impl Gptq {
    fn places(&self) -> Result<Places, MllmError> {
        let listed = match &self.columns {
            Some(columns) => columns.words()?,
            None => Vec::new(),
        };
        let size = self.inputs.div_ceil(self.groups);
        let in_order = listed
            .iter()
            .enumerate()
            .all(|(column, group)| *group as usize == column / size);
        // A file without an order has none, or zeros.
        if in_order || listed.iter().all(|group| *group == 0) {
            if !self.inputs.is_multiple_of(self.groups) {
                let problem = format!(
                    "{} groups do not divide {} inputs",
                    self.groups, self.inputs
                );
                return Err(self.scales.error(problem));
            }
            return Ok(Places::groups(size, self.groups));
        }
        if let Some(columns) = &self.columns
            && let Some(group) = listed.iter().find(|group| **group as usize >= self.groups)
        {
            let group = group.cast_signed();
            return Err(columns.error(format!(
                "group {group} of a column, but there are {}",
                self.groups
            )));
        }
        Ok(Places::Listed {
            groups: listed,
            across: self.groups,
        })
    }

    /// The zero points, an entry for each output and group.
    fn zero_points(&self) -> Result<Vec<i16>, MllmError> {
        let words = self.zeros.words()?;
        let width = words.len() / self.groups;
        let stored = |output: usize, group: usize| {
            let stream = BitStream {
                words: &words,
                first: group * width,
                stride: 1,
                bits: self.bits,
            };
            i16::from(stream.code(output))
        };
        let pairs =
            (0..self.outputs).flat_map(|output| (0..self.groups).map(move |group| (output, group)));
        let mut zeros: Vec<i16> = pairs.map(|(output, group)| stored(output, group)).collect();
        let middle = 1 << (self.bits - 1);
        let plain = match self.version {
            Zeros::Plain => true,
            Zeros::LessOne => false,
            Zeros::Unknown => zeros.iter().all(|zero| *zero == middle),
        };
        if !plain {
            // Wraps as the fields of the file do.
            for zero in &mut zeros {
                *zero = (*zero + 1) & ((1 << self.bits) - 1);
            }
        }
        Ok(zeros)
    }
}

impl Packed for Gptq {
    fn scales(&self) -> Result<Scales, MllmError> {
        let scales = self.scales.floats()?;
        let (outputs, groups) = (self.outputs, self.groups);
        let scale = |index: usize| scales.get(index % groups * outputs + index / groups);
        Ok(Scales {
            scales: (0..outputs * groups)
                .map(|index| scale(index).copied().unwrap_or(0.0))
                .collect(),
            places: self.places()?,
            meaning: Meaning::Zeros(self.zero_points()?),
        })
    }

    fn codes(&self) -> Result<Vec<u8>, MllmError> {
        let words = self.codes.words()?;
        let (outputs, inputs, bits) = (self.outputs, self.inputs, self.bits);
        let mut codes = vec![0; outputs * inputs];
        let parts = codes.par_chunks_mut((TOGETHER * inputs).max(1));
        parts.enumerate().for_each(|(part, codes)| {
            for input in 0..inputs {
                for (output, codes) in codes.chunks_exact_mut(inputs).enumerate() {
                    let stream = BitStream {
                        words: &words,
                        first: part * TOGETHER + output,
                        stride: outputs,
                        bits,
                    };
                    codes[input] = stream.code(input);
                }
            }
        });
        Ok(codes)
    }
}
