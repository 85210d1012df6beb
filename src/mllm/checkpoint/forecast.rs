//! What weights will be in memory, before any is taken.

use super::load_report::LoadReport;
use super::weight_format_plan::{WeightFormatPlan, held_as, is_matrix};
use super::weights::{StoredTensor, Weights, f32_bytes};
use planagent_kernels::matrix::WeightFormat;

impl Weights {
    /// The format in memory of a tensor that is not taken yet.
    pub(crate) fn weight_format_of(&self, name: &str) -> Option<WeightFormat> {
        let stored = self.tensors.get(name)?;
        let shape = &stored.place.shape;
        match shape.as_slice() {
            [_, inputs] if is_matrix(name, shape) => {
                Some(self.planned(self.plan, name, stored, *inputs).weight_format)
            }
            _ => Some(WeightFormat::F32),
        }
    }

    /// Names, shapes and formats in memory of the matrices that are left, with another wanted
    /// format.
    pub(crate) fn matrices(
        &self,
        quantize: Option<WeightFormat>,
    ) -> impl Iterator<Item = (&str, [usize; 2], WeightFormat)> {
        let plan = WeightFormatPlan {
            quantize,
            ..self.plan
        };
        self.tensors
            .iter()
            .filter_map(move |(name, stored)| match stored.place.shape.as_slice() {
                shape @ &[outputs, inputs] if is_matrix(name, shape) => {
                    let planned = self.planned(plan, name, stored, inputs);
                    Some((name.as_str(), [outputs, inputs], planned.weight_format))
                }
                _ => None,
            })
    }

    /// The most memory that taking one of the tensors needs beside what it becomes, bytes, with
    /// another wanted format.
    pub(crate) fn largest_reading(&self, quantize: Option<WeightFormat>) -> u64 {
        let plan = WeightFormatPlan {
            quantize,
            ..self.plan
        };
        let needs = self.tensors.iter();
        let needs = needs.map(|(name, stored)| self.reading(plan, name, stored));
        needs.max().unwrap_or(0)
    }

    /// What taking a tensor needs beside what it becomes: the tensor as in its file and, where it
    /// gets another format, its numbers in f32 and the blocks that they are rounded to. Of a large
    /// matrix that is a strip.
    fn reading(&self, plan: WeightFormatPlan, name: &str, stored: &StoredTensor) -> u64 {
        let shape = &stored.place.shape;
        let numbers = f32_bytes(shape);
        let (bytes, &[outputs, inputs]) = (stored.place.bytes, shape.as_slice()) else {
            return stored.place.bytes.saturating_add(numbers);
        };
        if stored.merged.is_some() || self.packed(stored).is_some() || !is_matrix(name, shape) {
            return numbers.saturating_mul(2);
        }
        let wanted = self.planned(plan, name, stored, inputs).weight_format;
        let rows = self.rows_at_once(stored, [outputs, inputs]);
        let bytes = bytes / outputs.max(1) as u64 * rows as u64;
        if held_as(stored.place.format) == Some(wanted) {
            return bytes;
        }
        let blocks = wanted.matrix_bytes(rows, inputs);
        let blocks = blocks.map_or(u64::MAX, |blocks| blocks as u64);
        bytes
            .saturating_add(f32_bytes(&[rows, inputs]))
            .saturating_add(blocks)
    }

    /// The report of taking all tensors that are left, with another wanted format.
    pub(crate) fn forecast(&self, quantize: Option<WeightFormat>) -> LoadReport {
        let plan = WeightFormatPlan {
            quantize,
            ..self.plan
        };
        let mut report = LoadReport {
            quantize,
            adapter: self.report.adapter.clone(),
            ..LoadReport::default()
        };
        for (name, stored) in &self.tensors {
            let shape = &stored.place.shape;
            match shape.as_slice() {
                [outputs, inputs] if is_matrix(name, shape) => {
                    let planned = self.planned(plan, name, stored, *inputs);
                    let bytes = planned
                        .weight_format
                        .matrix_bytes(*outputs, *inputs)
                        .unwrap_or(usize::MAX);
                    let file = self.format_name(stored);
                    report.add_matrix(name, file, planned, bytes as u64, None);
                }
                _ => report.add(WeightFormat::F32, f32_bytes(shape)),
            }
        }
        report
    }
}
