//! In which formats the tensors of a checkpoint were loaded.

use super::weight_format_plan::PlannedFormat;
use planagent_kernels::matrix::WeightFormat;
use serde::{Deserialize, Serialize};
use std::fmt;

/// The formats of a model's weights in memory.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct LoadReport {
    /// The format of `mllm.quantize`; none for the format of the files.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quantize: Option<WeightFormat>,
    /// The adapter that is merged into the weights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adapter: Option<MergedAdapter>,
    /// Tensors and bytes of each format.
    pub weight_formats: Vec<WeightFormatShare>,
    /// Tensors in another format than the wanted one.
    pub exceptions: Vec<WeightFormatException>,
    /// Further facts about the files for the user.
    pub notes: Vec<String>,
}

/// A merged adapter, for reports.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MergedAdapter {
    /// Its folder or file.
    pub path: String,
    /// `LoRA` or `DoRA`.
    pub kind: String,
    /// The model that it was trained for, as it says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base: Option<String>,
    /// Number of the model's tensors that it changes.
    pub tensors: usize,
}

impl fmt::Display for MergedAdapter {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            out,
            "{} ({}, {} tensors",
            self.path, self.kind, self.tensors
        )?;
        if let Some(base) = &self.base {
            write!(out, ", for {}", base.escape_debug())?;
        }
        out.write_str(")")
    }
}

/// The tensors of one format.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WeightFormatShare {
    pub weight_format: WeightFormat,
    pub tensors: usize,
    /// Their bytes in memory.
    pub bytes: u64,
}

/// A tensor of all layers in another format than the wanted one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WeightFormatException {
    /// Its name, the number of the layer as `*`.
    pub name: String,
    /// Number of layers.
    pub tensors: usize,
    /// Its number format in the file.
    pub file: String,
    /// Its format in memory.
    pub weight_format: WeightFormat,
    pub reason: String,
    /// Largest distance of a number in memory from that of a quantizer's file; none before it is
    /// loaded, and for other files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub largest_error: Option<f32>,
}

impl LoadReport {
    pub(super) fn add_matrix(
        &mut self,
        name: &str,
        file: String,
        planned: PlannedFormat,
        bytes: u64,
        largest_error: Option<f32>,
    ) {
        self.add(planned.weight_format, bytes);
        let Some(reason) = planned.reason else { return };
        let name = any_layer(name);
        // Layers repeat, so equal exceptions of all layers are one line with a count.
        let same = |known: &&mut WeightFormatException| {
            known.name == name
                && known.weight_format == planned.weight_format
                && known.file == file
                && known.reason == reason
        };
        if let Some(known) = self.exceptions.iter_mut().find(same) {
            known.tensors += 1;
            known.largest_error = larger(known.largest_error, largest_error);
        } else {
            let (weight_format, reason) = (planned.weight_format, reason.to_string());
            self.exceptions.push(WeightFormatException {
                name,
                tensors: 1,
                file,
                weight_format,
                reason,
                largest_error,
            });
        }
    }

    pub(super) fn add(&mut self, weight_format: WeightFormat, bytes: u64) {
        match self
            .weight_formats
            .iter_mut()
            .find(|share| share.weight_format == weight_format)
        {
            Some(share) => {
                share.tensors += 1;
                share.bytes += bytes;
            }
            None => self.weight_formats.push(WeightFormatShare {
                weight_format,
                tensors: 1,
                bytes,
            }),
        }
        self.weight_formats
            .sort_by_key(|share| std::cmp::Reverse(share.bytes));
    }

    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Bytes of all weights in memory.
    pub fn bytes(&self) -> u64 {
        self.weight_formats.iter().map(|share| share.bytes).sum()
    }

    /// The report as lines for people: formats, then the exceptions with their names, then notes.
    pub fn lines(&self) -> Vec<String> {
        let share = |share: &WeightFormatShare| {
            format!(
                "{}: {} tensors, {}",
                share.weight_format,
                share.tensors,
                in_bytes(share.bytes)
            )
        };
        let mut lines: Vec<String> = self.weight_formats.iter().map(share).collect();
        // Exceptions of one kind share a line, but need not follow each other in the list.
        let mut told: Vec<(WeightFormat, &str, &str)> = Vec::new();
        for WeightFormatException {
            file,
            weight_format,
            reason,
            ..
        } in &self.exceptions
        {
            let kind = (*weight_format, file.as_str(), reason.as_str());
            if told.contains(&kind) {
                continue;
            }
            told.push(kind);
            let alike = self
                .exceptions
                .iter()
                .filter(|other| (other.weight_format, &*other.file, &*other.reason) == kind);
            let largest = alike
                .clone()
                .map(|exception| exception.largest_error)
                .fold(None, larger);
            let error =
                largest.map_or_else(String::new, |error| format!("; largest error {error:.1e}"));
            lines.push(format!("{file} loaded as {weight_format}: {reason}{error}"));
            lines.extend(
                alike.map(|exception| format!("  {} ({})", exception.name, exception.tensors)),
            );
        }
        lines.extend(self.notes.iter().cloned());
        lines
    }
}

fn larger(first: Option<f32>, second: Option<f32>) -> Option<f32> {
    match (first, second) {
        (Some(first), Some(second)) => Some(first.max(second)),
        (first, second) => first.or(second),
    }
}

/// The name of a tensor with the number of its layer as `*`.
pub(crate) fn any_layer(name: &str) -> String {
    let is_number = |part: &str| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit());
    name.split('.')
        .map(|part| if is_number(part) { "*" } else { part })
        .collect::<Vec<_>>()
        .join(".")
}

/// A number of weights for people: thousands, millions or billions.
pub fn parameter_count(parameters: u64) -> String {
    let count = parameters as f64;
    match parameters {
        0..1_000 => parameters.to_string(),
        1_000..1_000_000 => format!("{:.0} K", count / 1e3),
        1_000_000..10_000_000 => format!("{:.1} M", count / 1e6),
        10_000_000..1_000_000_000 => format!("{:.0} M", count / 1e6),
        _ => format!("{:.2} B", count / 1e9),
    }
}

/// A number of bytes for people: GiB from 1 GiB on, else MiB.
pub fn in_bytes(bytes: u64) -> String {
    /// Bytes of a MiB.
    const MIB: f64 = 1_048_576.0;
    let mebibytes = bytes as f64 / MIB;
    if mebibytes >= 1024.0 {
        format!("{:.1} GiB", mebibytes / 1024.0)
    } else {
        format!("{mebibytes:.1} MiB")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tensors_of_all_layers_are_one_line() {
        let mut report = LoadReport::default();
        let planned = PlannedFormat {
            weight_format: WeightFormat::Q8_0,
            reason: Some("because"),
        };
        for layer in 0..3 {
            report.add_matrix(
                &format!("layers.{layer}.up.weight"),
                "f16".into(),
                planned,
                34,
                None,
            );
        }
        report.add(WeightFormat::F32, 400);
        assert_eq!(
            report.lines(),
            [
                "f32: 1 tensors, 0.0 MiB",
                "q8_0: 3 tensors, 0.0 MiB",
                "f16 loaded as q8_0: because",
                "  layers.*.up.weight (3)"
            ]
        );
        assert_eq!(report.bytes(), 502);
        assert_eq!(in_bytes(3 << 29), "1.5 GiB");
        let counts = [7, 74_900, 4_020_000, 256_500_000, 7_060_000_000];
        assert_eq!(
            counts.map(parameter_count),
            ["7", "75 K", "4.0 M", "256 M", "7.06 B"]
        );
    }
}
