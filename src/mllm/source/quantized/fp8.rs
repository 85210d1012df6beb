//! Floats of eight bits (E4M3 of P. Micikevicius et al., arXiv:2209.05433, without infinities), with
//! a scale for the tensor, each row, or each block.

use super::layer::{Packed, PackedLayer};
use super::scales::{Meaning, Places, Scales};
use super::table::{FLOATS, Part, TensorTable};
use super::{Description, Method};
use crate::MllmError;
use safetensors::Dtype;

pub(super) const METHOD: Method = Method {
    names: &["fp8", "fbgemm_fp8", "modelopt"],
    layers,
};

/// Names of the scales. All are multiplied; "inv" is of an older convention.
const SCALES: [&str; 4] = ["weight_scale_inv", "weight_scale", "scale", "qscale_weight"];
/// Sides of a block where the configuration is silent.
const BLOCK: [usize; 2] = [128, 128];

fn layers(
    description: &Description,
    table: &mut TensorTable,
) -> Result<Vec<PackedLayer>, MllmError> {
    let settings = description.settings()?;
    // Tensors of other formats look the same; only these keys tell them apart.
    let known: [(&str, &[&str]); 4] = [
        ("fmt", &["e4m3", "float8_e4m3fn"]),
        ("scale_fmt", &["float", "ue8m0"]),
        ("expert_dtype", &["fp8"]),
        ("quant_algo", &["FP8", "FP8_PB_WO"]),
    ];
    for (key, known) in known {
        let found: Option<String> = settings.value(key)?;
        if let Some(found) = found.filter(|found| !known.contains(&found.as_str())) {
            let problem = format!(
                "'{found}' is not read; {} is: take the model's original repository or another quantization",
                known.join(" or ")
            );
            return Err(settings.error(key, problem));
        }
    }
    let block: [usize; 2] = settings.value("weight_block_size")?.unwrap_or(BLOCK);
    let names = table.layers("weight", |part| part.tensor.dtype == Dtype::F8_E4M3);
    let layer = |name: String| {
        let weight = table.need(&name, "weight")?;
        let scale = SCALES
            .into_iter()
            .find_map(|scale| table.take(&name, scale));
        let scale = scale.ok_or_else(|| {
            table.error(
                &name,
                "it has no weight_scale or weight_scale_inv, so it is incomplete",
            )
        })?;
        floats(name, weight, scale, block, "fp8")
    };
    names.into_iter().map(layer).collect()
}

/// A layer of `F8_E4M3`, whose blocks have the sides `block`.
pub(super) fn floats(
    name: String,
    weight: Part,
    scale: Part,
    block: [usize; 2],
    method: &str,
) -> Result<PackedLayer, MllmError> {
    let [outputs, inputs] = weight.matrix()?;
    let scale = scale.of_type(&[&FLOATS[..], &[Dtype::F8_E8M0, Dtype::U8]].concat())?;
    let scale = scale.checked_side()?;
    let places = places(&scale, [outputs, inputs], block)?;
    Ok(PackedLayer {
        name,
        outputs,
        inputs,
        bits: 8,
        label: method.to_owned(),
        packed: Box::new(Fp8 {
            weight,
            scale,
            places,
        }),
    })
}

/// Which number has which scale, by the shape of the scales.
pub(super) fn places(
    scale: &Part,
    [outputs, inputs]: [usize; 2],
    [rows, columns]: [usize; 2],
) -> Result<Places, MllmError> {
    if rows == 0 || columns == 0 {
        return Err(scale.error("a block without rows or columns"));
    }
    let grid = [outputs.div_ceil(rows), inputs.div_ceil(columns)];
    match scale.shape() {
        [] | [1] | [1, 1] => Ok(Places::Blocks {
            rows: outputs.max(1),
            columns: inputs.max(1),
            across: 1,
        }),
        &[each] | &[each, 1] if each == outputs => Ok(Places::rows(inputs.max(1))),
        shape if *shape == grid => Ok(Places::Blocks {
            rows,
            columns,
            across: grid[1],
        }),
        shape => Err(scale.error(format!(
            "shape {shape:?} is neither one scale, nor one for each of {outputs} rows, nor one for each block of \
             {rows} x {columns} ({grid:?})"
        ))),
    }
}

#[derive(Debug)]
struct Fp8 {
    weight: Part,
    scale: Part,
    places: Places,
}

impl Packed for Fp8 {
    fn scales(&self) -> Result<Scales, MllmError> {
        Ok(Scales {
            scales: self.scale.floats()?,
            places: self.places.clone(),
            meaning: Meaning::Table((0..=u8::MAX).map(e4m3).collect()),
        })
    }

    fn codes(&self) -> Result<Vec<u8>, MllmError> {
        self.weight.bytes()
    }
}

/// The number of a byte: a sign, four bits of exponent with bias 7, three of fraction.
fn e4m3(byte: u8) -> f32 {
    let (exponent, fraction) = (i32::from(byte >> 3 & 15), f32::from(byte & 7));
    let magnitude = match (exponent, byte & 7) {
        (15, 7) => f32::NAN,
        (0, _) => fraction / 512.0,
        _ => (1.0 + fraction / 8.0) * f64::from(exponent - 7).exp2() as f32,
    };
    if byte >> 7 == 1 {
        -magnitude
    } else {
        magnitude
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_floats_without_infinity() {
        let found = [0x00, 0x01, 0x08, 0x38, 0x3c, 0x7e, 0xbc].map(e4m3);
        let expected = [0.0, 0.001_953_125, 0.015_625, 1.0, 1.5, 448.0, -1.5];
        assert_eq!(found.map(f32::to_bits), expected.map(f32::to_bits));
        assert!(e4m3(0x7f).is_nan() && e4m3(0xff).is_nan());
        assert_eq!(e4m3(0x80).to_bits(), (-0.0_f32).to_bits());
    }
}
