//! Large matrices, which are read strip by strip.

use super::safetensors_folder;
use super::strips::STRIP;
use crate::MllmError;
use candle_core::safetensors::save;
use candle_core::{DType, Device, Tensor};
use planagent_kernels::matrix::{Matrix, WeightFormat};
use std::collections::HashMap;

const NAME: &str = "language_model.embed_tokens_per_layer.weight";
const COLUMNS: usize = 1 << 12;
/// One strip, and a part of another.
const ROWS: usize = STRIP / COLUMNS + 20;

/// A folder with a matrix in bf16 whose rows differ; one number is `odd`.
fn folder(odd: f32, at: [usize; 2]) -> tempfile::TempDir {
    let row = |row: usize| {
        (0..COLUMNS).map(move |column| {
            if [row, column] == at {
                odd
            } else {
                (row % 97) as f32 - (column % 89) as f32
            }
        })
    };
    let numbers: Vec<f32> = (0..ROWS).flat_map(row).collect();
    let matrix = Tensor::from_vec(numbers, (ROWS, COLUMNS), &Device::Cpu).unwrap();
    let matrix = matrix.to_dtype(DType::BF16).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let tensors = HashMap::from([(NAME.to_owned(), matrix)]);
    save(&tensors, folder.path().join("model.safetensors")).unwrap();
    folder
}

fn taken(folder: &tempfile::TempDir, quantize: WeightFormat) -> Result<Matrix, MllmError> {
    let name = |stored: &str| Some(stored.to_owned());
    let mut weights = safetensors_folder::open(folder.path(), Some(quantize), name).unwrap();
    // The strip as in the file, in f32 and rounded.
    let rounded = quantize.matrix_bytes(STRIP / COLUMNS, COLUMNS).unwrap() as u64;
    let reading = weights.largest_reading(Some(quantize));
    assert_eq!(reading, 6 * STRIP as u64 + rounded);
    weights.take_matrix(NAME, [ROWS, COLUMNS])
}

#[test]
fn a_matrix_in_strips_has_the_rows_of_its_file() {
    let folder = folder(0.5, [3, 4]);
    for (quantize, error) in [(WeightFormat::F16, 0.0), (WeightFormat::Q8_0, 0.5)] {
        let matrix = taken(&folder, quantize).unwrap();
        assert_eq!(matrix.weight_format(), quantize);
        for row in [0, 3, ROWS - 21, ROWS - 20, ROWS - 1] {
            let found = matrix.rows(&[row as u32]).unwrap().flatten_all().unwrap();
            for (column, value) in found.to_vec1::<f32>().unwrap().into_iter().enumerate() {
                let expected = if [row, column] == [3, 4] {
                    0.5
                } else {
                    (row % 97) as f32 - (column % 89) as f32
                };
                assert!((value - expected).abs() <= error, "{row} {column}: {value}");
            }
        }
    }
}

#[test]
fn a_number_that_is_not_finite_is_named_by_its_place_in_the_whole() {
    let at = [ROWS - 2, 7];
    let folder = folder(f32::NAN, at);
    let error = taken(&folder, WeightFormat::Q8_0).unwrap_err();
    let expected = at[0] * COLUMNS + at[1];
    assert!(
        matches!(&error, MllmError::NonFiniteWeight { element, .. } if *element == expected),
        "{error}"
    );
}
