//! Cells of a column, whatever integer, float or text type it has. Each function gives nothing for
//! a column of another type; an empty cell, or a value that does not fit, is `None`.

use arrow_array::cast::AsArray;
use arrow_array::types::{
    Float16Type, Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type,
    UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrowPrimitiveType};

/// Cells of a column of one primitive type.
fn cells_of<T: ArrowPrimitiveType, V>(
    column: &dyn Array,
    value: impl Fn(T::Native) -> Option<V>,
) -> Option<Vec<Option<V>>> {
    Some(
        column
            .as_primitive_opt::<T>()?
            .iter()
            .map(|cell| cell.and_then(&value))
            .collect(),
    )
}

pub(super) fn integers(column: &dyn Array) -> Option<Vec<Option<i64>>> {
    cells_of::<Int64Type, _>(column, Some)
        .or_else(|| cells_of::<Int32Type, _>(column, |value| Some(value.into())))
        .or_else(|| cells_of::<Int16Type, _>(column, |value| Some(value.into())))
        .or_else(|| cells_of::<Int8Type, _>(column, |value| Some(value.into())))
        .or_else(|| cells_of::<UInt64Type, _>(column, |value| value.try_into().ok()))
        .or_else(|| cells_of::<UInt32Type, _>(column, |value| Some(value.into())))
        .or_else(|| cells_of::<UInt16Type, _>(column, |value| Some(value.into())))
        .or_else(|| cells_of::<UInt8Type, _>(column, |value| Some(value.into())))
}

pub(super) fn numbers(column: &dyn Array) -> Option<Vec<Option<f64>>> {
    let whole = || {
        Some(
            integers(column)?
                .into_iter()
                .map(|cell| cell.map(|value| value as f64))
                .collect(),
        )
    };
    cells_of::<Float64Type, _>(column, Some)
        .or_else(|| cells_of::<Float32Type, _>(column, |value| Some(value.into())))
        .or_else(|| cells_of::<Float16Type, _>(column, |value| Some(value.into())))
        .or_else(whole)
}

pub(super) fn words(column: &dyn Array) -> Option<Vec<Option<String>>> {
    if let Some(dictionary) = column.as_any_dictionary_opt() {
        let values = words(dictionary.values())?;
        if values.is_empty() {
            return Some(vec![None; dictionary.len()]);
        }
        let keys = dictionary.normalized_keys().into_iter().enumerate();
        return Some(
            keys.map(|(row, key)| {
                values
                    .get(key)
                    .filter(|_| dictionary.is_valid(row))?
                    .clone()
            })
            .collect(),
        );
    }
    let owned = |word: Option<&str>| word.map(str::to_owned);
    let short = || Some(column.as_string_opt::<i32>()?.iter().map(owned).collect());
    let long = || Some(column.as_string_opt::<i64>()?.iter().map(owned).collect());
    let view = || Some(column.as_string_view_opt()?.iter().map(owned).collect());
    short().or_else(long).or_else(view)
}
