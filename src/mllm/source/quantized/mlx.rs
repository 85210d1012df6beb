//! MLX: whole numbers of 2 to 8 bits with a scale and a bias for each group of a row.

use super::bits::BitStream;
use super::layer::{Packed, PackedLayer};
use super::scales::{Meaning, Places, Scales};
use super::table::{FLOATS, Part, TensorTable};
use super::{Description, MLX, Method};
use crate::MllmError;
use crate::checkpoint::ConfigObject;
use rayon::prelude::*;
use safetensors::Dtype;

pub(super) const METHOD: Method = Method {
    names: &[MLX, "metal"],
    layers,
};

/// Bits of a number that MLX packs.
const WIDTHS: [u32; 6] = [2, 3, 4, 5, 6, 8];

/// The settings of a layer.
#[derive(Debug, Clone, Copy)]
struct Groups {
    size: usize,
    bits: u32,
}

impl Groups {
    /// Those of an object; what it lacks is as in `others`.
    fn read(object: &ConfigObject<'_>, others: Self) -> Result<Self, MllmError> {
        let mode: Option<String> = object.value("mode")?;
        if let Some(mode) = mode.filter(|mode| mode != "affine") {
            let problem = format!(
                "'{mode}' is not read; affine is: take a folder in affine groups, or the model's original repository"
            );
            return Err(object.error("mode", problem));
        }
        let groups = Self {
            size: object.value("group_size")?.unwrap_or(others.size),
            bits: object.value("bits")?.unwrap_or(others.bits),
        };
        if !WIDTHS.contains(&groups.bits) {
            return Err(object.error(
                "bits",
                format!("expected one of {WIDTHS:?}, found {}", groups.bits),
            ));
        }
        if !(1..=1 << 20).contains(&groups.size) {
            return Err(object.error(
                "group_size",
                format!("{} is no number of columns", groups.size),
            ));
        }
        Ok(groups)
    }
}

fn layers(
    description: &Description,
    table: &mut TensorTable,
) -> Result<Vec<PackedLayer>, MllmError> {
    let settings = description.settings()?;
    let all = Groups::read(&settings, Groups { size: 64, bits: 4 })?;
    let names = table.layers("weight", |part| part.tensor.dtype == Dtype::U32);
    let layer = |name: String| {
        // `false` marks a plain layer, which has no packed tensor.
        let groups = match settings.child(&name) {
            Ok(Some(own)) => Groups::read(&own, all)?,
            _ => all,
        };
        take(table, name, groups)
    };
    names.into_iter().map(layer).collect()
}

fn take(table: &mut TensorTable, name: String, groups: Groups) -> Result<PackedLayer, MllmError> {
    let codes = table.need(&name, "weight")?;
    let scales = table.need_side(&name, "scales")?.of_type(&FLOATS)?;
    let minima = match table.take(&name, "qbiases") {
        Some(minima) => minima.checked_side()?,
        None => table.need_side(&name, "biases")?,
    };
    let minima = minima.of_type(&FLOATS)?;
    let Groups { size, bits } = groups;
    let ([outputs, words], [rows, across]) = (codes.matrix()?, scales.matrix()?);
    minima.check_shape(scales.shape())?;
    let inputs = across.checked_mul(size);
    let needed = inputs.and_then(|inputs| inputs.checked_mul(bits as usize));
    // MLX stores no width: it follows from the scales, and the words must agree.
    let Some(inputs) = inputs.filter(|_| rows == outputs && needed == words.checked_mul(32)) else {
        let problem = format!(
            "{words} words and {across} scales of {rows} rows do not fit groups of {size} numbers of {bits} bits"
        );
        return Err(codes.error(problem));
    };
    Ok(PackedLayer {
        name,
        outputs,
        inputs,
        bits,
        label: format!("mlx {bits} bits"),
        packed: Box::new(Affine {
            groups,
            inputs,
            codes,
            scales,
            minima,
        }),
    })
}

#[derive(Debug)]
struct Affine {
    groups: Groups,
    inputs: usize,
    codes: Part,
    scales: Part,
    minima: Part,
}

impl Packed for Affine {
    fn scales(&self) -> Result<Scales, MllmError> {
        Ok(Scales {
            scales: self.scales.floats()?,
            places: Places::groups(self.groups.size, self.inputs / self.groups.size),
            meaning: Meaning::Minima(self.minima.floats()?),
        })
    }

    fn codes(&self) -> Result<Vec<u8>, MllmError> {
        let words = self.codes.words()?;
        let width = self.inputs * self.groups.bits as usize / 32;
        let mut codes = vec![0; words.len() / width.max(1) * self.inputs];
        let rows = codes
            .par_chunks_mut(self.inputs.max(1))
            .zip(words.par_chunks(width.max(1)));
        rows.for_each(|(codes, words)| {
            let stream = BitStream {
                words,
                first: 0,
                stride: 1,
                bits: self.groups.bits,
            };
            for (index, code) in codes.iter_mut().enumerate() {
                *code = stream.code(index);
            }
        });
        Ok(codes)
    }
}
