//! Adapters: tensors of few numbers that change a model. They are merged into its weights when it is
//! loaded, a tensor at a time, so that a family computes as without them.
//!
//! A folder of PEFT (`peft`) and a GGUF file of llama.cpp (`gguf`) become changes by the names of the
//! base's tensors (`change`). `target` finds these tensors among the weights and checks the shapes;
//! `missing` finds what an adapter announces and lacks.
//! `merge` computes a tensor when it is read.
//!
//! LoRA: Hu et al., arXiv:2106.09685. rsLoRA: Kalajdzievski, arXiv:2312.03732. DoRA: Liu et al.,
//! arXiv:2402.09353. PiSSA: Meng et al., arXiv:2404.02948. OLoRA: Büyükakyüz, arXiv:2406.01775.

mod about;
mod change;
mod fit;
mod gguf;
mod initial;
mod leading;
mod merge;
mod missing;
mod names;
mod patterns;
mod peft;
mod settings;
mod source;
mod spec;
mod target;
mod targeted;

#[cfg(test)]
mod gguf_tests;
#[cfg(test)]
mod hostile_tests;
#[cfg(test)]
mod identity_tests;
#[cfg(test)]
mod merge_tests;
#[cfg(test)]
mod reference_tests;
#[cfg(test)]
mod test_adapter;
#[cfg(test)]
mod written_tests;

pub(crate) use about::PEFT_CONFIG;
pub use spec::AdapterSpec;
pub(crate) use target::BaseModel;

use super::MllmError;
use super::checkpoint::{MergedAdapter, TensorSource, Weights};
use about::{PEFT_WEIGHTS, refused};
use gguf::GgufAdapter;
use peft::PeftAdapter;
use source::AdapterFiles;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// An adapter whose settings and headers are read, and no weights.
#[derive(Debug)]
pub(crate) struct Adapter {
    path: PathBuf,
    form: Form,
    files: Arc<AdapterFiles>,
}

#[derive(Debug)]
enum Form {
    Peft(Box<PeftAdapter>),
    Gguf(GgufAdapter),
}

impl Adapter {
    /// Opens a folder of PEFT, a file in one, or a GGUF file.
    pub(crate) fn open(spec: &AdapterSpec) -> Result<Self, MllmError> {
        let path = spec.path.as_path();
        let is_gguf = |path: &Path| {
            path.extension()
                .is_some_and(|ending| ending.eq_ignore_ascii_case("gguf"))
        };
        if !path.exists() {
            return Err(refused(path, "there is no such adapter"));
        }
        if path.is_file() && is_gguf(path) {
            let (adapter, files) = GgufAdapter::open(path)?;
            return Ok(Self {
                path: path.to_path_buf(),
                form: Form::Gguf(adapter),
                files,
            });
        }
        // Users name the folder or one of its two files; both mean the same adapter.
        let folder = match path.file_name() {
            _ if path.is_dir() => path,
            Some(name) if name == PEFT_CONFIG || name == PEFT_WEIGHTS => {
                path.parent().unwrap_or(Path::new(""))
            }
            _ => {
                let problem = "an adapter is a folder of PEFT, or a GGUF file of llama.cpp";
                return Err(refused(path, problem));
            }
        };
        let (adapter, files) = PeftAdapter::open(folder, spec.changed_base)?;
        Ok(Self {
            path: folder.to_path_buf(),
            form: Form::Peft(Box::new(adapter)),
            files,
        })
    }

    /// Adds the content of its files to a digest.
    pub(crate) fn hash(&self, hasher: &mut blake3::Hasher) -> Result<(), MllmError> {
        self.files.hash(hasher)
    }

    /// Puts what the adapter makes of the weights in their place.
    ///
    /// # Errors
    /// When a tensor of the adapter matches nothing of the base, or has another shape.
    pub(crate) fn merge_into(
        self,
        weights: &mut Weights,
        base: &BaseModel<'_>,
    ) -> Result<MergedAdapter, MllmError> {
        let Self { path, form, files } = self;
        let (entries, about) = match form {
            Form::Peft(adapter) => adapter.entries()?,
            Form::Gguf(adapter) => adapter.entries(base)?,
        };
        target::merge(&path, files, entries, about, weights, base)
    }
}
