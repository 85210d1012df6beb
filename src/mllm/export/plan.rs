//! Which tensors a file of an exported model has, and from which tensors of the model they are.

use super::GgufPart;
use super::writer::{Layout, PlannedTensor};
use crate::MllmError;
use crate::checkpoint::{Weights, is_kernel, is_matrix, may_add_one, paired};
use crate::gguf::{Entries, GgufLayout, TowerDescription, llama};
use planagent_kernels::matrix::WeightFormat;

/// One file.
pub(super) struct Part {
    pub kind: GgufPart,
    pub layout: Layout,
    /// Where each tensor of the layout is from.
    sources: Vec<Source>,
    /// Whether rows of queries and keys are written in pairs.
    pub heads: Option<Heads>,
    /// What is added to the weights of norms.
    pub norm_offset: f32,
}

/// A tensor of the model, by its canonical name and its shape, and what of it is written.
struct Source {
    canonical: String,
    shape: Vec<usize>,
    share: Share,
}

/// The part of a model's tensor that becomes one in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Share {
    Whole,
    /// One of three equal runs of rows.
    Third(usize),
    /// The rows of this projection to queries, then those of the projections to keys and values.
    Fused,
    /// The kernel of one of two frames, which are the third axis; each has these sides.
    Frame(usize, [usize; 4]),
}

/// Heads of queries and of keys.
#[derive(Clone, Copy)]
pub(super) struct Heads {
    pub queries: usize,
    pub keys: usize,
}

impl Heads {
    /// The heads of a tensor, by llama.cpp's name, if it makes queries or keys.
    fn for_tensor(self, name: &str) -> Option<usize> {
        match llama::projection(name)? {
            "attn_q" => Some(self.queries),
            "attn_k" => Some(self.keys),
            _ => None,
        }
    }
}

impl Part {
    /// A file without tensors.
    pub(super) fn new(kind: GgufPart, metadata: Entries) -> Self {
        Self {
            kind,
            layout: Layout {
                metadata,
                tensors: Vec::new(),
            },
            sources: Vec::new(),
            heads: None,
            norm_offset: 0.0,
        }
    }

    /// Adds the tensors that `named` gives names, by their canonical name and shape.
    pub(super) fn plan(
        &mut self,
        weights: &Weights,
        named: impl Fn(&str, &[usize]) -> Vec<(String, Share)>,
    ) {
        for (canonical, stored) in weights.shapes() {
            let format = weights
                .weight_format_of(canonical)
                .unwrap_or(WeightFormat::F32)
                .stored();
            for (name, share) in named(canonical, stored) {
                let mut shape = share.shape(stored);
                if is_kernel(canonical) && canonical != name {
                    shape.retain(|side| *side != 1);
                }
                if shape.is_empty() {
                    // The format has no numbers without a side.
                    shape.push(1);
                }
                self.sources.push(Source {
                    canonical: canonical.to_owned(),
                    shape: match share {
                        Share::Whole => shape.clone(),
                        _ => stored.to_vec(),
                    },
                    share,
                });
                self.layout.tensors.push(PlannedTensor {
                    name,
                    format,
                    shape,
                });
            }
        }
    }

    /// Gives `write` the bytes of one tensor after the other.
    pub(super) fn write_data(
        &self,
        weights: &mut Weights,
        write: &mut WriteTensor<'_>,
    ) -> Result<(), MllmError> {
        // A tensor is taken once, and its shares follow one another.
        let mut taken: Option<(&str, Vec<u8>)> = None;
        for (tensor, source) in self.layout.tensors.iter().zip(&self.sources) {
            let mut whole = match taken.take() {
                Some((name, whole)) if name == source.canonical => whole,
                _ => source.data(weights, self.norm_offset)?,
            };
            if source.share == Share::Fused {
                for part in [KEYS, VALUES] {
                    let other = source.with_name(source.canonical.replace(QUERIES, part));
                    whole.extend(other.data(weights, self.norm_offset)?);
                }
            }
            let paired_rows = self.heads.and_then(|heads| heads.for_tensor(&tensor.name));
            match (source.share.cut(&whole), paired_rows) {
                (Some(share), _) => write(tensor, &share)?,
                (None, Some(heads)) => {
                    let rows = tensor.shape.first().copied().unwrap_or(1);
                    write(tensor, &paired(&whole, rows, heads))?;
                }
                (None, None) => write(tensor, &whole)?,
            }
            if matches!(source.share, Share::Third(_) | Share::Frame(..)) {
                taken = Some((source.canonical.as_str(), whole));
            }
        }
        Ok(())
    }
}

impl Source {
    /// A tensor of the same shape.
    fn with_name(&self, canonical: String) -> Self {
        Self {
            canonical,
            shape: self.shape.clone(),
            share: Share::Whole,
        }
    }

    /// The bytes of the whole tensor in its format.
    fn data(&self, weights: &mut Weights, norm_offset: f32) -> Result<Vec<u8>, MllmError> {
        let mut bytes = Vec::new();
        match self.shape.as_slice() {
            &[outputs, inputs] if is_matrix(&self.canonical, &self.shape) => {
                let matrix = weights.take_matrix(&self.canonical, [outputs, inputs])?;
                bytes.reserve_exact(matrix.bytes());
                // Writing to memory cannot fail.
                let _ = matrix.write_blocks(&mut bytes);
            }
            shape => {
                let mut values: Vec<f32> = weights
                    .take_of_any_rank(&self.canonical, shape)?
                    .flatten_all()?
                    .to_vec1()?;
                if norm_offset != 0.0 && may_add_one(&self.canonical) {
                    for value in &mut values {
                        *value += norm_offset;
                    }
                }
                bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
            }
        }
        Ok(bytes)
    }
}

impl Share {
    /// The shape of this part of a tensor.
    fn shape(self, whole: &[usize]) -> Vec<usize> {
        match self {
            Self::Whole => whole.to_vec(),
            Self::Third(_) => {
                let mut shape = whole.to_vec();
                if let Some(rows) = shape.first_mut() {
                    *rows /= 3;
                }
                shape
            }
            Self::Fused => {
                let mut shape = whole.to_vec();
                if let Some(rows) = shape.first_mut() {
                    *rows *= 3;
                }
                shape
            }
            Self::Frame(_, sides) => sides.to_vec(),
        }
    }

    /// This part of a tensor's bytes; none for the whole of it.
    fn cut(self, whole: &[u8]) -> Option<Vec<u8>> {
        let nth = |run: &[u8], at: usize, of: usize| -> Vec<u8> {
            let length = run.len() / of;
            run.chunks_exact(length.max(1))
                .nth(at)
                .expect("opening checked that the rows divide into these parts")
                .to_vec()
        };
        match self {
            Self::Whole | Self::Fused => None,
            Self::Third(at) => Some(nth(whole, at, 3)),
            Self::Frame(at, [outputs, channels, ..]) => {
                let both = whole.len() / (outputs * channels).max(1);
                let kernels = whole.chunks_exact(both.max(1));
                Some(kernels.flat_map(|both| nth(both, at, 2)).collect())
            }
        }
    }
}

/// Writes the bytes of a tensor.
type WriteTensor<'a> = dyn FnMut(&PlannedTensor, &[u8]) -> Result<(), MllmError> + 'a;

/// The projections of a tower's layer, in their names.
const QUERIES: &str = ".q_proj.";
const KEYS: &str = ".k_proj.";
const VALUES: &str = ".v_proj.";
const ALL: &str = ".qkv.";

/// The kernel of patches, which a checkpoint has for two frames at once.
const PATCHES: &str = "vision_tower.embeddings.patch_embedding.weight";
const SECOND: &str = "vision_tower.embeddings.patch_embedding.second.weight";

/// The names of a tensor of the model in a tower's file, and what each has of it.
pub(super) fn tower_names(
    layout: &dyn GgufLayout,
    tower: &TowerDescription,
    canonical: &str,
    shape: &[usize],
) -> Vec<(String, Share)> {
    let named = |name: &str, share: Share| {
        let name = layout.gguf_name(name)?;
        Some((numbered(name, &tower.deep_layers), share))
    };
    // A file has the projections of attention as one tensor or as three, whatever the model has.
    if tower.fused == Some(false) && canonical.contains(ALL) {
        let parts = [QUERIES, KEYS, VALUES].into_iter().enumerate();
        return parts
            .filter_map(|(at, part)| named(&canonical.replace(ALL, part), Share::Third(at)))
            .collect();
    }
    if tower.fused == Some(true) && is_of_tower(canonical) {
        if canonical.contains(QUERIES) {
            let fused = named(&canonical.replace(QUERIES, ALL), Share::Fused);
            return fused.into_iter().collect();
        }
        if [KEYS, VALUES].iter().any(|part| canonical.contains(part)) {
            return Vec::new();
        }
    }
    if let Some(sides) = frame_sides(shape).filter(|_| canonical == PATCHES)
        && layout.gguf_name(SECOND).is_some()
    {
        let frames = [PATCHES, SECOND].into_iter().enumerate();
        return frames
            .filter_map(|(at, name)| named(name, Share::Frame(at, sides)))
            .collect();
    }
    named(canonical, Share::Whole).into_iter().collect()
}

fn is_of_tower(canonical: &str) -> bool {
    canonical.starts_with("vision_tower.")
}

/// The sides of the kernel of one frame in a kernel of two, whose axes of channels and frames a file
/// of four axes has as one.
fn frame_sides(shape: &[usize]) -> Option<[usize; 4]> {
    /// Red, green and blue.
    const CHANNELS: usize = 3;
    match *shape {
        [outputs, CHANNELS, 2, height, width] => Some([outputs, CHANNELS, height, width]),
        [outputs, both, height, width] if both == 2 * CHANNELS => {
            Some([outputs, CHANNELS, height, width])
        }
        _ => None,
    }
}

/// A name in the table as a file has it, which counts mergers of early layers by the layers.
fn numbered(name: String, deep_layers: &[usize]) -> String {
    const DEEP: &str = "v.deepstack.";
    let counted = name.strip_prefix(DEEP).and_then(|rest| {
        let (index, part) = rest.split_once('.')?;
        let layer = deep_layers.get(index.parse::<usize>().ok()?)?;
        Some(format!("{DEEP}{layer}.{part}"))
    });
    counted.unwrap_or(name)
}
