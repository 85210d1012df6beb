//! What weights will be in memory, before any is taken.

use super::load_report::LoadReport;
use super::weight_format_plan::{WeightFormatPlan, is_matrix};
use super::weights::{Weights, f32_bytes};
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
