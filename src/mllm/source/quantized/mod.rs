//! Folders whose layers a quantizer packed. To add a format, add its file and a line to
//! [`METHODS`].
//!
//! A format takes the tensors of its layers out of the folder's. What is common to all stands in
//! [`scales`]: codes, what they mean, and the blocks of ggml that hold them.

mod awq;
mod bits;
mod bitsandbytes;
mod channels_last;
mod compressed_tensors;
mod description;
mod fp8;
mod gptq;
mod layer;
mod mlx;
#[cfg(test)]
mod reference_tests;
mod refused;
mod scales;
mod table;
#[cfg(test)]
mod test_folders;
#[cfg(test)]
mod tests;

use crate::MllmError;
use crate::checkpoint::safetensors_folder::{self, RawTensor};
use crate::checkpoint::{
    FileKind, ModelFiles, RowOrder, TensorSource, WeightFile, WeightFormatPlan, Weights,
};
use channels_last::ChannelsLast;
use description::{Description, MLX};
use layer::{PackedLayer, PackedLayers};
use planagent_kernels::matrix::WeightFormat;
use std::path::Path;
use std::sync::Arc;
use table::TensorTable;

const METHODS: [Method; 6] = [
    awq::METHOD,
    gptq::METHOD,
    fp8::METHOD,
    compressed_tensors::METHOD,
    mlx::METHOD,
    bitsandbytes::METHOD,
];

/// A format of packed layers.
struct Method {
    /// Its names in `quant_method`.
    names: &'static [&'static str],
    /// Takes its layers.
    layers: fn(&Description, &mut TensorTable) -> Result<Vec<PackedLayer>, MllmError>,
}

/// Scales of activations and of keys and values, which stay floats here.
const OF_ACTIVATIONS: [&str; 12] = [
    "activation_scale",
    "input_scale",
    "input_scale_ub",
    "input_zero_point",
    "input_global_scale",
    "output_scale",
    "output_zero_point",
    "k_scale",
    "v_scale",
    "q_scale",
    "kv_scale",
    "prob_output_scale",
];
/// Tensors that stand for nothing without the others of their layer.
const PARTS: [&str; 9] = [
    "qweight",
    "qzeros",
    "scales",
    "g_idx",
    "weight_packed",
    "weight_scale",
    "weight_scale_inv",
    "weight_zero_point",
    "SCB",
];

/// Opens the weights of a folder, plain or packed. `canonical` gives the canonical name of a
/// tensor, or none to leave it out.
pub(super) fn open(
    files: &ModelFiles,
    folder: &Path,
    quantize: Option<WeightFormat>,
    canonical: impl Fn(&str) -> Option<String>,
) -> Result<Weights, MllmError> {
    let description = Description::find(files)?;
    let raw = safetensors_folder::read(folder)?;
    let Some(description) = description else {
        return safetensors_folder::of_files(folder, raw, quantize, canonical);
    };
    let all_plain = raw
        .iter()
        .flat_map(|(_, tensors)| tensors)
        .all(RawTensor::is_plain);
    // Some converters keep the description of a quantizer whose tensors they have widened.
    if all_plain {
        let mut weights = safetensors_folder::of_files(folder, raw, quantize, canonical)?;
        weights.note(description.ignored());
        return Ok(weights);
    }
    let method = METHODS
        .iter()
        .find(|method| method.names.contains(&description.method.as_str()))
        .ok_or_else(|| refused::error(&description))?;
    let files: Vec<Arc<WeightFile>> = raw.iter().map(|(file, _)| Arc::clone(file)).collect();
    let mut table = TensorTable::new(folder, raw)?;
    let last = |name: &str| name.rsplit('.').next().unwrap_or(name).to_owned();
    table.leave_out(|name| OF_ACTIVATIONS.contains(&last(name).as_str()));
    let layers = (method.layers)(&description, &mut table)?;
    check_rest(&table, &description)?;
    let packed = PackedLayers::new(&table, layers)?;
    let plan = WeightFormatPlan {
        quantize,
        kind: FileKind::Quantized,
        ..WeightFormatPlan::default()
    };
    let mut weights = Weights::empty(folder, plan);
    for (label, format, layers) in packed.exact() {
        weights.note(format!(
            "{label}: {layers} layers in {format}, which holds their numbers exactly"
        ));
    }
    let is_mlx = description.method == MLX;
    add_plain(&mut weights, &files, &table, is_mlx, &canonical)?;
    let places: Vec<_> = packed.places().collect();
    let source = weights.add_file(packed);
    for (name, place) in places {
        if let Some(canonical) = canonical(&name) {
            weights.add(canonical, source, name, place, RowOrder::Plain)?;
        }
    }
    Ok(weights)
}

/// Adds the tensors that no layer took, which are plain.
fn add_plain(
    weights: &mut Weights,
    files: &[Arc<WeightFile>],
    table: &TensorTable,
    is_mlx: bool,
    canonical: &impl Fn(&str) -> Option<String>,
) -> Result<(), MllmError> {
    let indices: Vec<usize> = files
        .iter()
        .map(|file| weights.add_file(Arc::clone(file)))
        .collect();
    for part in table.parts() {
        let position = files.iter().position(|file| Arc::ptr_eq(file, &part.file));
        let Some(index) = position.and_then(|position| indices.get(position)) else {
            continue;
        };
        let Some(canonical) = canonical(&part.tensor.name) else {
            continue;
        };
        // MLX keeps the channels of a convolution last; all other tensors have PyTorch's order.
        let kernel = ChannelsLast::find(part).filter(|_| is_mlx);
        let (index, place) = match kernel {
            Some(kernel) => {
                let place = kernel.place()?;
                (weights.add_file(kernel), place)
            }
            None => (*index, part.tensor.plain(part.file.path())?),
        };
        let name = part.tensor.name.clone();
        weights.add(canonical, index, name, place, RowOrder::Plain)?;
    }
    Ok(())
}

/// Checks that the tensors that no layer took are plain, and parts of no packed layer.
fn check_rest(table: &TensorTable, description: &Description) -> Result<(), MllmError> {
    for part in table.parts() {
        let name = &part.tensor.name;
        if !part.tensor.is_plain() {
            return Err(part.error(format!(
                "{:?} of {:?} is part of no layer as '{}' packs them; the folder is incomplete, or its \
                 quantization_config is of another",
                part.tensor.dtype,
                part.shape(),
                description.method
            )));
        }
        // Scales beside plain weights are left from calibration.
        let layer = PARTS
            .into_iter()
            .find_map(|part| name.strip_suffix(part)?.strip_suffix('.'));
        if let Some(layer) = layer
            && table.get(layer, "weight").is_none()
        {
            return Err(part.error("its layer has no packed weights, so the folder is incomplete"));
        }
    }
    Ok(())
}
