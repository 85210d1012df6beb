//! Formats of packed layers that are not read, each with its reason.

use super::description::Description;
use crate::MllmError;

/// Methods whose layout is known and not read.
const KNOWN: [(&[&str], &str); 8] = [
    (
        &["hqq", "quanto", "torchao", "eetq", "higgs"],
        "its layers are made while the model loads, in a layout of the package",
    ),
    (
        &["aqlm", "vptq", "quip", "quip_sharp", "spqr", "fp_quant"],
        "its codes choose vectors, for which there is no product here",
    ),
    (
        &["exl2", "exl3", "marlin", "bitblas"],
        "its layers lie in the order of a GPU's kernels",
    ),
    (
        &["mxfp4", "nvfp4"],
        "floats of four bits are read from GGUF files alone",
    ),
    (
        &["auto-round", "intel/auto-round"],
        "it packs in several layouts; the same model is often published as GPTQ",
    ),
    (
        &["bitnet"],
        "its activations are rounded while the model runs",
    ),
    (
        &["quark"],
        "its layout depends on the version that wrote it",
    ),
    (
        &["gguf"],
        "the folder's tensors are packed, but not as a GGUF file's; name the GGUF file itself",
    ),
];

/// The error for a folder whose layers are packed by a method that is not read.
pub(super) fn error(description: &Description) -> MllmError {
    let known = KNOWN
        .iter()
        .find(|(names, _)| names.contains(&description.method.as_str()))
        .map_or(String::new(), |(_, reason)| format!(" ({reason})"));
    let problem = format!(
        "weights quantized by '{}' are not read{known}; take the model's original repository, which --quantize makes small, a \
         GGUF file, or a folder in {}",
        description.method,
        super::METHODS
            .iter()
            .filter_map(|method| method.names.first().copied())
            .collect::<Vec<_>>()
            .join(", ")
    );
    match description.settings() {
        Ok(settings) => settings.error("quant_method", problem),
        Err(error) => error,
    }
}
