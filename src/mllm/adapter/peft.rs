//! A folder of PEFT.

use super::about::{About, PEFT_CONFIG, PEFT_WEIGHTS as WEIGHTS, refused};
use super::change::{Change, Entry, Experts, Factor, LowRank, Rows, Target, flat};
use super::initial::Initial;
use super::missing::Announced;
use super::names::{Name, Role};
use super::settings::Settings;
use super::source::AdapterFiles;
use crate::MllmError;
use crate::checkpoint::{
    BaseTensor, TensorPlace, WeightFile, parse_json, read_text,
    safetensors_folder::{RawTensor, read_header},
};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Weights as Python objects, which may run code.
const PICKLE: &str = "adapter_model.bin";
/// The weights of mlx-lm.
const MLX: &str = "adapters.safetensors";
/// Tensors of an adapter at most. One of all layers of a large mixture of experts has 100 thousand.
const MAX_TENSORS: usize = 1 << 18;
/// Matches of all modules with all patterns at most.
const MAX_MATCHES: usize = 1 << 22;

/// An adapter whose headers are read.
#[derive(Debug)]
pub(super) struct PeftAdapter {
    folder: PathBuf,
    settings: Settings,
    files: Arc<AdapterFiles>,
    tensors: Vec<(String, TensorPlace)>,
    has_tokenizer: bool,
}

/// The tensors of a module by their roles, each with its name in the file.
type Module<'a> = BTreeMap<Role<'a>, (String, BaseTensor)>;

impl PeftAdapter {
    pub(super) fn open(
        folder: &Path,
        changed_base: bool,
    ) -> Result<(Self, Arc<AdapterFiles>), MllmError> {
        let config = folder.join(PEFT_CONFIG);
        if !config.is_file() {
            let problem = if folder.join(MLX).is_file() {
                "this is an adapter of mlx-lm, whose format is not read; PEFT's and llama.cpp's are"
                    .to_owned()
            } else {
                format!(
                    "it has no {PEFT_CONFIG}; an adapter is a folder of PEFT, or a GGUF file of llama.cpp"
                )
            };
            return Err(refused(folder, problem));
        }
        let text = read_text(&config)?;
        let settings = Settings::read(folder, &parse_json(&config, &text)?, changed_base)?;
        let path = folder.join(WEIGHTS);
        if !path.is_file() {
            let problem = if folder.join(PICKLE).is_file() {
                format!(
                    "{PICKLE} is not read, since it may run code; save the adapter with safetensors"
                )
            } else {
                format!("it has no {WEIGHTS}")
            };
            return Err(refused(folder, problem));
        }
        let weights = WeightFile::open(&path)?;
        let raw = read_header(&path, &mut weights.reader()?, weights.len())?;
        let plain = |tensor: RawTensor| Ok((tensor.name.clone(), tensor.plain(&path)?));
        let tensors: Vec<(String, TensorPlace)> = raw
            .into_iter()
            .map(plain)
            .collect::<Result<_, MllmError>>()?;
        if tensors.len() > MAX_TENSORS {
            let problem = format!(
                "{} tensors; at most {MAX_TENSORS} are supported",
                tensors.len()
            );
            return Err(refused(&path, problem));
        }
        if tensors.len().saturating_mul(settings.patterns()) > MAX_MATCHES {
            let problem = "too many patterns (rank_pattern, alpha_pattern) for so many tensors";
            return Err(refused(&config, problem));
        }
        // `changed_base` belongs to the settings: it changes the merged weights and so the digest.
        let settings_text = format!("{changed_base}\n{text}").into_bytes();
        let files = Arc::new(AdapterFiles {
            weights,
            settings: settings_text,
        });
        let adapter = Self {
            folder: folder.to_path_buf(),
            settings,
            files: Arc::clone(&files),
            tensors,
            has_tokenizer: folder.join("tokenizer.json").is_file(),
        };
        Ok((adapter, files))
    }

    /// The changes that the tensors make.
    pub(super) fn entries(self) -> Result<(Vec<Entry>, About), MllmError> {
        let mut modules: BTreeMap<&str, Module<'_>> = BTreeMap::new();
        let mut entries = Vec::new();
        for (name, place) in &self.tensors {
            let Some(parsed) = Name::parse(name) else {
                let problem = format!(
                    "tensor {} is none of a LoRA of PEFT, whose names begin with base_model.model.",
                    name.escape_debug()
                );
                return Err(refused(&self.folder.join(WEIGHTS), problem));
            };
            let tensor = BaseTensor::new(
                Arc::clone(&self.files) as Arc<_>,
                name.clone(),
                place.clone(),
            );
            match parsed.role {
                Role::Saved(parameter, _) => {
                    entries.push(self.saved(parsed.module, parameter, name, tensor));
                }
                Role::Tokens => entries.push(self.tokens(parsed.module, name, tensor)?),
                role => {
                    let module = modules.entry(parsed.module).or_default();
                    module.insert(role, (name.clone(), tensor));
                }
            }
        }
        let adapted = modules.keys().map(|module| (*module).to_owned()).collect();
        let mut unnamed = 0;
        // After the loop: the tensors of a module stand in any order in the file.
        for (module, tensors) in modules {
            if let Some(parameter) = self.parameter(module) {
                entries.push(self.experts(&parameter, tensors)?);
            } else {
                unnamed += usize::from(!self.settings.targeted.names(module));
                entries.extend(self.low_rank(module, tensors)?);
            }
        }
        let about = self.about(adapted, unnamed);
        Ok((entries, about))
    }

    fn about(self, adapted: BTreeSet<String>, unnamed: usize) -> About {
        let Self {
            settings,
            has_tokenizer,
            ..
        } = self;
        let mut notes = settings.notes;
        if unnamed > 0 {
            notes.push(format!(
                "{unnamed} modules of the adapter are not among its target_modules: PEFT leaves them out, here they are merged"
            ));
        }
        if has_tokenizer {
            notes.push(
                "the adapter has a tokenizer of its own, which is not used (tokenizer = { folder = \"…\" } in a description \
                 names it)"
                    .to_owned(),
            );
        }
        About {
            kind: (if settings.dora { "DoRA" } else { "LoRA" }).to_owned(),
            base: settings.base,
            tied: settings.tied,
            announced: Some(Announced {
                targeted: settings.targeted,
                modules: adapted,
            }),
            notes,
        }
    }

    /// A parameter in place of the base's.
    fn saved(&self, module: &str, parameter: &str, name: &str, tensor: BaseTensor) -> Entry {
        Entry {
            target: Target::Stored(format!("{module}.{parameter}")),
            tensor: name.to_owned(),
            change: Change::Replace {
                tensor,
                rows: Rows::All,
                own: self.settings.saves(module),
            },
        }
    }

    /// New rows of an embedding.
    fn tokens(&self, module: &str, name: &str, tensor: BaseTensor) -> Result<Entry, MllmError> {
        let tokens = self.settings.tokens.as_ref();
        let Some(indices) = tokens.and_then(|tokens| tokens.of_module(module)) else {
            return Err(self.broken(name, "trainable_token_indices names no tokens for it"));
        };
        if tensor.shape().first() != Some(&indices.len()) {
            let problem = format!(
                "it has the shape {:?}, but trainable_token_indices names {} tokens",
                tensor.shape(),
                indices.len()
            );
            return Err(self.broken(name, &problem));
        }
        Ok(Entry {
            target: Target::Stored(format!("{module}.weight")),
            tensor: name.to_owned(),
            change: Change::Tokens {
                indices: indices.to_vec(),
                tensor,
            },
        })
    }

    /// The parameter of experts that a wrapped module stands for: the first of several is wrapped
    /// by the others.
    fn parameter(&self, module: &str) -> Option<String> {
        let (inner, wrappers) = Name::unwrapped(module);
        let of_module = |parameter: &String| {
            // A bare name is that of all experts.
            let (holder, name) = parameter.rsplit_once('.').unwrap_or(("experts", parameter));
            let before = inner.strip_suffix(holder)?;
            (before.is_empty() || before.ends_with('.')).then(|| name.to_owned())
        };
        let mut names: Vec<String> = self
            .settings
            .parameters
            .iter()
            .filter_map(of_module)
            .collect();
        // Modules hold them in this order, whatever that of the settings is.
        names.sort_by_key(|name| name.starts_with("down"));
        let name = names.get(names.len().checked_sub(1 + wrappers)?)?;
        Some(format!("{inner}.{name}"))
    }

    /// The product of a linear layer, a convolution or an embedding, and the bias of B.
    fn low_rank(&self, module: &str, mut tensors: Module<'_>) -> Result<Vec<Entry>, MllmError> {
        let mut take = |role| tensors.remove(&role);
        let (linear, embedding) = (
            (take(Role::A), take(Role::B)),
            (take(Role::EmbeddingA), take(Role::EmbeddingB)),
        );
        let (bias, magnitude) = (take(Role::BBias), take(Role::Magnitude));
        let ((a, b), of_embedding) = match (linear, embedding) {
            (pair, (None, None)) => (pair, false),
            ((None, None), pair) => (pair, true),
            _ => {
                return Err(
                    self.broken(module, "it has the tensors of a layer and of an embedding")
                );
            }
        };
        let (Some((name, a)), Some((_, b))) = (a, b) else {
            return Err(self.broken(module, "the adapter has only one of its matrices A and B"));
        };
        let (rank, scale) = self.settings.scale(module);
        self.check_rank(&name, rank, &a, &b)?;
        let magnitude = self.magnitude(module, magnitude)?;
        let initial = match self.settings.initial(scale) {
            // PEFT initializes only linear layers so.
            _ if of_embedding || a.shape().len() != 2 => Initial::Same,
            initial => initial,
        };
        let change = Change::LowRank(LowRank {
            left: Factor {
                tensor: b,
                transposed: false,
            },
            right: Factor {
                tensor: a,
                transposed: false,
            },
            rank,
            scale,
            initial,
            magnitude: magnitude.map(|(_, tensor)| tensor),
            transposed: false,
            flips: self.settings.fan_in_fan_out && !of_embedding,
            rows: Rows::All,
        });
        let change = if of_embedding {
            change.flipped()
        } else {
            change
        };
        let entry = |parameter: &str, tensor: String, change| Entry {
            target: Target::Stored(format!("{module}.{parameter}")),
            tensor,
            change,
        };
        let bias = bias.map(|(name, tensor)| {
            let added = Change::Add {
                tensor,
                scale,
                rows: Rows::All,
            };
            entry("bias", name, added)
        });
        Ok([Some(entry("weight", name, change)), bias]
            .into_iter()
            .flatten()
            .collect())
    }

    fn check_rank(
        &self,
        name: &str,
        rank: usize,
        a: &BaseTensor,
        b: &BaseTensor,
    ) -> Result<(), MllmError> {
        let found = [flat(a.shape()), flat(b.shape())];
        match found {
            [Some([rows, _]), Some([_, columns])] if rows == columns && rows == rank => Ok(()),
            [Some([rows, _]), Some([_, columns])] if rows == columns => {
                let problem = format!(
                    "it has rank {rows}, but {PEFT_CONFIG} gives its module rank {rank} (r, rank_pattern)"
                );
                Err(self.broken(name, &problem))
            }
            _ => {
                let problem = format!(
                    "its shape {:?} and that of its B, {:?}, have no common rank",
                    a.shape(),
                    b.shape()
                );
                Err(self.broken(name, &problem))
            }
        }
    }

    fn magnitude(
        &self,
        module: &str,
        magnitude: Option<(String, BaseTensor)>,
    ) -> Result<Option<(String, BaseTensor)>, MllmError> {
        match (self.settings.dora, &magnitude) {
            (true, None) => Err(self.broken(
                module,
                "use_dora is set, but its magnitude vector is missing",
            )),
            (false, Some((name, _))) => {
                Err(self.broken(name, "it is a magnitude of DoRA, but use_dora is not set"))
            }
            _ => Ok(magnitude),
        }
    }

    fn experts(&self, parameter: &str, mut tensors: Module<'_>) -> Result<Entry, MllmError> {
        let mut take = |role| tensors.remove(&role);
        let (Some((name, a)), Some((_, b))) = (take(Role::A), take(Role::B)) else {
            return Err(self.broken(
                parameter,
                "the adapter has only one of its matrices A and B",
            ));
        };
        if let Some((name, _)) = tensors.into_values().next() {
            return Err(self.broken(&name, "experts (target_parameters) have no such tensor"));
        }
        let (rank, scale) = self.settings.scale(parameter);
        if rank == 0 {
            return Err(self.broken(&name, "its rank is 0"));
        }
        Ok(Entry {
            target: Target::Stored(parameter.to_owned()),
            tensor: name,
            change: Change::Experts(Experts {
                a,
                b,
                rank,
                scale,
                older: self.settings.older,
            }),
        })
    }

    fn broken(&self, name: &str, problem: &str) -> MllmError {
        refused(&self.folder, format!("{}: {problem}", name.escape_debug()))
    }
}
