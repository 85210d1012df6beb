//! Many errors of one cause as one line.

use crate::MllmError;
use crate::checkpoint::any_layer;

/// Names or examples in a line.
const MAX_NAMED: usize = 4;

/// Errors of one cause.
struct Group<'a> {
    cause: String,
    errors: Vec<&'a MllmError>,
}

/// The errors as lines, in the order of their first ones: those of one cause are one.
pub(super) fn grouped(errors: &[MllmError]) -> Vec<String> {
    let mut groups: Vec<Group<'_>> = Vec::new();
    for error in errors {
        let cause = cause(error);
        match groups.iter_mut().find(|group| group.cause == cause) {
            Some(group) => group.errors.push(error),
            None => groups.push(Group {
                cause,
                errors: vec![error],
            }),
        }
    }
    groups.iter().map(Group::line).collect()
}

/// What errors of one cause have in common.
fn cause(error: &MllmError) -> String {
    match error {
        MllmError::MissingTensor { folder, .. } => format!("missing {}", folder.display()),
        MllmError::TensorShape { path, .. } => format!("shape {}", path.display()),
        MllmError::TensorType { path, found, .. } => format!("type {found} {}", path.display()),
        MllmError::GgufFormat { path, format, .. } => {
            format!("format {format} {}", path.display())
        }
        other => other.to_string(),
    }
}

impl Group<'_> {
    fn line(&self) -> String {
        let count = self.errors.len();
        let Some(first) = self.errors.first() else {
            return String::new();
        };
        if count == 1 {
            return first.to_string();
        }
        match first {
            MllmError::MissingTensor { folder, .. } => format!(
                "{}: {count} tensors are missing from the checkpoint: {}",
                folder.display(),
                listed(self.errors.iter().filter_map(|error| name(error)))
            ),
            MllmError::TensorShape { path, .. } => format!(
                "{}: {count} tensors have other shapes than the configuration requires: {}",
                path.display(),
                listed(self.errors.iter().filter_map(|error| shape(error)))
            ),
            _ => format!(
                "{first}; the same holds for {} other tensors: {}",
                count - 1,
                listed(self.errors.iter().skip(1).filter_map(|error| name(error)))
            ),
        }
    }
}

fn name(error: &MllmError) -> Option<String> {
    match error {
        MllmError::MissingTensor { name, .. }
        | MllmError::TensorType { name, .. }
        | MllmError::GgufFormat { name, .. } => Some(any_layer(name)),
        _ => None,
    }
}

fn shape(error: &MllmError) -> Option<String> {
    match error {
        MllmError::TensorShape {
            name,
            expected,
            found,
            ..
        } => Some(format!(
            "{} has {found:?} instead of {expected:?}",
            any_layer(name)
        )),
        _ => None,
    }
}

/// The first words, each once.
fn listed(words: impl Iterator<Item = String>) -> String {
    let mut distinct: Vec<String> = Vec::new();
    for word in words {
        if !distinct.contains(&word) {
            distinct.push(word);
        }
    }
    let more = distinct.len().saturating_sub(MAX_NAMED);
    distinct.truncate(MAX_NAMED);
    if more > 0 {
        distinct.push(format!("and {more} more"));
    }
    distinct.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_one_cause_are_one_line() {
        let missing = |name: String| MllmError::MissingTensor {
            folder: "m".into(),
            name,
        };
        let shape = |name: &str| MllmError::TensorShape {
            path: "m/a.safetensors".into(),
            name: name.into(),
            expected: vec![8, 4],
            found: vec![4, 4],
        };
        let mut errors: Vec<MllmError> = (0..1000)
            .map(|layer| missing(format!("layers.{layer}.up.weight")))
            .collect();
        errors.push(missing("norm.weight".into()));
        errors.push(shape("layers.0.down.weight"));
        errors.push(shape("layers.1.down.weight"));
        errors.push(MllmError::Image {
            problem: "it has no pixels".into(),
        });
        assert_eq!(
            grouped(&errors),
            [
                "m: 1001 tensors are missing from the checkpoint: layers.*.up.weight, norm.weight",
                "m/a.safetensors: 2 tensors have other shapes than the configuration requires: layers.*.down.weight has \
                 [4, 4] instead of [8, 4]",
                "cannot use the image: it has no pixels",
            ]
        );
        assert_eq!(
            grouped(&errors[1000..1001]),
            ["m: tensor norm.weight is missing from the checkpoint"]
        );
        assert_eq!(grouped(&[]), [] as [&str; 0]);
    }
}
