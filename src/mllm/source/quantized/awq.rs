//! AWQ: four bits with zero points (J. Lin et al., arXiv:2306.00978), as autoawq writes them.

use super::layer::{Packed, PackedLayer};
use super::scales::{Meaning, Places, Scales};
use super::table::{FLOATS, Part, TensorTable};
use super::{Description, Method};
use crate::MllmError;
use rayon::prelude::*;
use safetensors::Dtype;

pub(super) const METHOD: Method = Method {
    names: &["awq"],
    layers,
};

/// Bits of a code.
const BITS: u32 = 4;
/// Codes of a word.
const IN_WORD: usize = 8;
/// Where the codes of a word of `gemm` go, from the lowest bits on.
const ORDER: [usize; IN_WORD] = [0, 2, 4, 6, 1, 3, 5, 7];
/// Outputs that are unpacked at once: a cache line of words.
const TOGETHER: usize = 16 * IN_WORD;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Version {
    Gemm,
    Gemv,
    GemvFast,
}

fn layers(
    description: &Description,
    table: &mut TensorTable,
) -> Result<Vec<PackedLayer>, MllmError> {
    let settings = description.settings()?;
    // Each setting has two names, of which a file uses one.
    let bits: Option<u32> = settings.value("bits")?.or(settings.value("w_bit")?);
    if bits.is_some_and(|bits| bits != BITS) {
        return Err(settings.error("bits", "AWQ is read with 4 bits; take a file with 4"));
    }
    let group: Option<i64> = settings
        .value("group_size")?
        .or(settings.value("q_group_size")?);
    let version: Option<String> = settings.value("version")?.or(settings.value("format")?);
    let version = match version.as_deref().unwrap_or("gemm").to_lowercase().as_str() {
        "gemm" => Version::Gemm,
        "gemv" => Version::Gemv,
        "gemv_fast" => Version::GemvFast,
        other => {
            let problem = format!(
                "the layout '{other}' of AWQ is not read; gemm, gemv and gemv_fast are: take another file of the model"
            );
            return Err(settings.error("version", problem));
        }
    };
    if let Some(part) = table
        .parts()
        .find(|part| part.tensor.name.ends_with("act.scales"))
    {
        return Err(part.error(
            "scales of an activation are not read: AWQ could not fold them into this model; take another quantization",
        ));
    }
    let names = table.layers("qweight", |_| true);
    let layer = |name: String| take(table, name, version, group.unwrap_or(128));
    names.into_iter().map(layer).collect()
}

fn take(
    table: &mut TensorTable,
    name: String,
    version: Version,
    group: i64,
) -> Result<PackedLayer, MllmError> {
    let word = if version == Version::GemvFast {
        Dtype::I16
    } else {
        Dtype::I32
    };
    let codes = table.need(&name, "qweight")?.of_type(&[word])?;
    let scales = table.need_side(&name, "scales")?.of_type(&FLOATS)?;
    let zeros = table.need_side(&name, "qzeros")?;
    let zeros = if version == Version::GemvFast {
        zeros.of_type(&FLOATS)?
    } else {
        zeros.of_type(&[Dtype::I32])?
    };
    let [rows, columns] = codes.matrix()?;
    let (outputs, inputs) = match version {
        Version::Gemm => (columns * IN_WORD, rows),
        Version::Gemv => (rows, columns * IN_WORD),
        Version::GemvFast => (rows * 4, columns),
    };
    let group = match version {
        // The shapes decide.
        Version::Gemm => inputs / scales.matrix()?[0].max(1),
        Version::Gemv | Version::GemvFast => usize::try_from(group).unwrap_or(inputs),
    };
    if group == 0
        || !inputs.is_multiple_of(group)
        || version == Version::GemvFast && !inputs.is_multiple_of(64)
    {
        let problem = format!("groups of {group} do not divide the {inputs} inputs");
        return Err(table.error(&name, problem));
    }
    let groups = inputs / group;
    let padded = match version {
        Version::Gemm => outputs / IN_WORD,
        Version::Gemv => zeros.matrix()?[1],
        Version::GemvFast => zeros.matrix()?[0],
    };
    match version {
        Version::Gemm => {
            scales.check_shape(&[groups, outputs])?;
            zeros.check_shape(&[groups, padded])?;
        }
        Version::Gemv => {
            zeros.check_shape(&[outputs, padded])?;
            scales.check_shape(&[outputs, padded * IN_WORD])?;
        }
        Version::GemvFast => {
            zeros.check_shape(&[padded, outputs])?;
            scales.check_shape(&[padded, outputs])?;
        }
    }
    let places = if version == Version::Gemv {
        padded * IN_WORD
    } else {
        padded
    };
    if version != Version::Gemm && places < groups {
        return Err(scales.error(format!("{groups} groups need more scales")));
    }
    let layout = Layout {
        version,
        outputs,
        inputs,
        group,
    };
    Ok(PackedLayer {
        name,
        outputs,
        inputs,
        bits: BITS,
        label: "awq 4 bits".into(),
        packed: Box::new(Awq {
            layout,
            codes,
            zeros,
            scales,
        }),
    })
}

#[derive(Debug, Clone, Copy)]
struct Layout {
    version: Version,
    outputs: usize,
    inputs: usize,
    group: usize,
}

#[derive(Debug)]
struct Awq {
    layout: Layout,
    codes: Part,
    zeros: Part,
    scales: Part,
}

impl Packed for Awq {
    fn scales(&self) -> Result<Scales, MllmError> {
        let Layout {
            version,
            outputs,
            inputs,
            group,
        } = self.layout;
        let groups = inputs / group;
        let scales = self.scales.floats()?;
        // The files have a row for each group, or padding behind each row.
        let across = |numbers: &[f32]| match version {
            Version::Gemm | Version::GemvFast => transposed(numbers, groups, outputs),
            Version::Gemv => without_padding(numbers, outputs, groups),
        };
        let meaning = match version {
            Version::GemvFast => Meaning::Minima(across(&self.zeros.floats()?)),
            Version::Gemm => {
                let zeros = gemm(&self.zeros.words()?, groups, outputs);
                Meaning::Zeros(zeros.into_iter().map(i16::from).collect())
            }
            Version::Gemv => {
                let words = self.zeros.words()?;
                let zeros = words.iter().flat_map(|word| natural(*word)).map(i16::from);
                Meaning::Zeros(without_padding(&zeros.collect::<Vec<_>>(), outputs, groups))
            }
        };
        Ok(Scales {
            scales: across(&scales),
            places: Places::groups(group, groups),
            meaning,
        })
    }

    fn codes(&self) -> Result<Vec<u8>, MllmError> {
        let Layout {
            version,
            outputs,
            inputs,
            ..
        } = self.layout;
        Ok(match version {
            Version::Gemm => gemm(&self.codes.words()?, inputs, outputs),
            Version::Gemv => self
                .codes
                .words()?
                .iter()
                .flat_map(|word| natural(*word))
                .collect(),
            Version::GemvFast => fast(&self.codes.bytes()?, outputs, inputs),
        })
    }
}

/// The first `columns` rows of numbers [_, outputs], transposed.
fn transposed(numbers: &[f32], columns: usize, outputs: usize) -> Vec<f32> {
    let place = |index: usize| index % columns.max(1) * outputs + index / columns.max(1);
    (0..outputs * columns)
        .map(|index| numbers.get(place(index)).copied().unwrap_or(0.0))
        .collect()
}

/// The first `columns` numbers of each row.
fn without_padding<T: Copy>(numbers: &[T], rows: usize, columns: usize) -> Vec<T> {
    let width = numbers.len() / rows.max(1);
    let rows = numbers.chunks(width.max(1));
    rows.flat_map(|row| row.iter().take(columns).copied())
        .collect()
}

/// The codes of a word from the lowest bits on.
fn natural(word: u32) -> [u8; IN_WORD] {
    std::array::from_fn(|place| (word >> (BITS as usize * place) & 15) as u8)
}

/// Codes [outputs, rows] of words [rows, outputs / 8] in the order of `gemm`.
fn gemm(words: &[u32], rows: usize, outputs: usize) -> Vec<u8> {
    let width = outputs / IN_WORD;
    let mut codes = vec![0; outputs * rows];
    let parts = codes.par_chunks_mut((TOGETHER * rows).max(1));
    parts.enumerate().for_each(|(part, codes)| {
        let first = part * TOGETHER / IN_WORD;
        for row in 0..rows {
            let words = words
                .iter()
                .skip(row * width + first)
                .take(codes.len() / rows / IN_WORD);
            for (word, outputs) in words.zip(codes.chunks_exact_mut(IN_WORD * rows)) {
                for (code, output) in natural(*word).into_iter().zip(ORDER) {
                    outputs[output * rows + row] = code;
                }
            }
        }
    });
    codes
}

/// The codes of `gemv_fast`: 256 of a word each, in blocks of 4 rows and 64 columns.
fn fast(bytes: &[u8], outputs: usize, inputs: usize) -> Vec<u8> {
    let mut codes = vec![0; outputs * inputs];
    let fours = codes
        .par_chunks_exact_mut((4 * inputs).max(1))
        .zip(bytes.par_chunks_exact((2 * inputs).max(1)));
    fours.for_each(|(codes, bytes)| {
        for (row, codes) in codes.chunks_exact_mut(inputs).enumerate() {
            for (column, code) in codes.iter_mut().enumerate() {
                // Within 32 columns, column b * 8 + a * 2 + c lies at a * 8 + c * 4 + b.
                let (b, a, c) = (column % 32 / 8, column % 8 / 2, column % 2);
                let place =
                    column / 64 * 256 + row * 64 + column % 64 / 32 * 32 + a * 8 + c * 4 + b;
                // Two codes in a byte, as the words are little-endian.
                let byte = bytes.get(place / 2).copied().unwrap_or(0);
                *code = byte >> (4 * (place % 2)) & 15;
            }
        }
    });
    codes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nibbles_of_gemm_are_evens_then_odds() {
        let word = 0x7654_3210;
        // Places 0 to 7 of the word hold outputs 0, 2, 4, 6, 1, 3, 5, 7.
        assert_eq!(gemm(&[word], 1, 8), [0, 4, 1, 5, 2, 6, 3, 7]);
        let many: Vec<u32> = (0..3 * 40).collect();
        let codes = gemm(&many, 3, 320);
        // Output 8 of row 2 has the lowest bits of the word in column 1.
        assert_eq!(codes[8 * 3 + 2], (2 * 40 + 1) & 15);
        assert_eq!(codes[312 * 3 + 1], (40 + 39) & 15);
    }

    #[test]
    fn padding_is_left_out() {
        assert_eq!(without_padding(&[1, 2, 9, 3, 4, 9], 2, 2), [1, 2, 3, 4]);
        assert_eq!(
            transposed(&[1.0, 2.0, 3.0, 4.0, 9.0, 9.0], 2, 2),
            [1.0, 3.0, 2.0, 4.0]
        );
    }

    #[test]
    fn each_code_of_gemv_fast_has_one_place() {
        let bytes: Vec<u8> = (0..128_u8).map(|byte| byte.wrapping_mul(17)).collect();
        let codes = fast(&bytes, 4, 64);
        // Row 0 has the first 64 codes: column 1 lies at place 4, in byte 2.
        assert_eq!(
            (codes[0], codes[1], codes[2]),
            (0, bytes[2] & 15, bytes[4] & 15)
        );
        assert_eq!(codes[64], bytes[32] & 15, "row 1 begins at code 64");
    }
}
