//! Packed layers as a source of tensors.

use super::scales::Scales;
use super::table::TensorTable;
use crate::MllmError;
use crate::checkpoint::{Held, PackedBlocks, PackedForm, TensorPlace, TensorSource};
use candle_core::quantized::GgmlDType;
use planagent_kernels::matrix::WeightFormat;
use rayon::prelude::*;
use std::fmt::Debug;
use std::path::{Path, PathBuf};

/// The tensors of a layer in the layout of a quantizer. Their shapes fit the layer's.
pub(super) trait Packed: Debug + Send + Sync {
    /// Reads what its codes mean.
    fn scales(&self) -> Result<Scales, MllmError>;

    /// Reads its codes, row by row.
    fn codes(&self) -> Result<Vec<u8>, MllmError>;
}

/// A linear layer or an embedding that a quantizer packed.
#[derive(Debug)]
pub(super) struct PackedLayer {
    /// Its name, without `.weight`.
    pub name: String,
    pub outputs: usize,
    pub inputs: usize,
    /// Bits of a code.
    pub bits: u32,
    /// What reports call its format.
    pub label: String,
    pub packed: Box<dyn Packed>,
}

/// The packed layers of a folder.
#[derive(Debug)]
pub(super) struct PackedLayers {
    folder: PathBuf,
    layers: Vec<(PackedLayer, PackedForm)>,
}

impl PackedLayers {
    /// Reads the scales of all layers, one after another, and chooses the formats by them.
    pub(super) fn new(table: &TensorTable, layers: Vec<PackedLayer>) -> Result<Self, MllmError> {
        let with_form = |layer: PackedLayer| {
            let form = form(table, &layer)?;
            Ok((layer, form))
        };
        Ok(Self {
            folder: table.folder.clone(),
            layers: layers
                .into_iter()
                .map(with_form)
                .collect::<Result<_, MllmError>>()?,
        })
    }

    /// The names of the layers' weights, and where they are.
    pub(super) fn places(&self) -> impl Iterator<Item = (String, TensorPlace)> {
        self.layers.iter().enumerate().map(|(index, (layer, _))| {
            let place = TensorPlace {
                format: GgmlDType::F32.into(),
                shape: vec![layer.outputs, layer.inputs],
                // The index of the layer: its tensors lie in several places.
                begin: index as u64,
                bytes: (layer.outputs * layer.inputs * size_of::<f32>()) as u64,
            };
            (format!("{}.weight", layer.name), place)
        })
    }

    /// What is said of layers whose numbers are held exactly: their label, format and number.
    pub(super) fn exact(&self) -> Vec<(&str, WeightFormat, usize)> {
        let mut kinds: Vec<(&str, WeightFormat, usize)> = Vec::new();
        let exact = self
            .layers
            .iter()
            .filter(|(_, form)| form.held == Held::Exactly);
        for (_, form) in exact {
            let same = |kind: &&mut (&str, WeightFormat, usize)| {
                kind.0 == form.label && kind.1 == form.weight_format
            };
            match kinds.iter_mut().find(same) {
                Some(kind) => kind.2 += 1,
                None => kinds.push((&form.label, form.weight_format, 1)),
            }
        }
        kinds
    }

    fn layer(&self, place: &TensorPlace) -> Result<&(PackedLayer, PackedForm), MllmError> {
        let layer = self.layers.get(place.begin as usize);
        layer.ok_or_else(|| MllmError::MissingTensor {
            folder: self.folder.clone(),
            name: format!("(packed layer {})", place.begin),
        })
    }
}

/// How a layer goes into memory.
fn form(table: &TensorTable, layer: &PackedLayer) -> Result<PackedForm, MllmError> {
    let scales = layer.packed.scales()?;
    if !scales.fit(layer.outputs, layer.inputs) {
        let problem = format!(
            "its scales do not fit a matrix of {} x {}",
            layer.outputs, layer.inputs
        );
        return Err(table.error(&layer.name, problem));
    }
    let (weight_format, held) = scales.format(layer.bits, layer.inputs);
    Ok(PackedForm {
        label: layer.label.clone(),
        weight_format,
        held,
    })
}

impl TensorSource for PackedLayers {
    fn path(&self) -> &Path {
        &self.folder
    }

    fn bytes(&self, place: &TensorPlace) -> Result<Vec<u8>, MllmError> {
        let (layer, _) = self.layer(place)?;
        let values = layer
            .packed
            .scales()?
            .values(&layer.packed.codes()?, layer.inputs);
        Ok(values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect())
    }

    fn packed(&self, place: &TensorPlace) -> Option<&PackedForm> {
        self.layer(place).ok().map(|(_, form)| form)
    }

    fn blocks(&self, place: &TensorPlace) -> Result<PackedBlocks, MllmError> {
        let (layer, form) = self.layer(place)?;
        let (scales, codes) = (layer.packed.scales()?, layer.packed.codes()?);
        let format = form.weight_format;
        let width = layer.inputs / format.block() * format.block_bytes();
        let mut bytes = vec![0; layer.outputs * width];
        let rows = bytes
            .par_chunks_exact_mut(width.max(1))
            .zip(codes.par_chunks_exact(layer.inputs.max(1)));
        let largest_error = rows
            .enumerate()
            .map(|(row, (out, codes))| scales.row_blocks(row, codes, format, out))
            .reduce(|| 0.0, f32::max);
        Ok(PackedBlocks {
            bytes,
            largest_error,
        })
    }

    /// The files that the layers lie in are sources of their own.
    fn hash(&self, _: &mut blake3::Hasher) -> Result<(), MllmError> {
        Ok(())
    }
}
