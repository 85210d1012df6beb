//! llama.cpp's LoRA in GGUF.

use super::BaseModel;
use super::about::{About, refused};
use super::change::{Change, Entry, Factor, LowRank, Rows, Target};
use super::initial::Initial;
use super::source::AdapterFiles;
use crate::MllmError;
use crate::checkpoint::{BaseTensor, RowOrder, TensorPlace};
use crate::gguf::{GgufLayout, Header, llama, open_header};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

const ARCHITECTURE: &str = "general.architecture";
const KIND: &str = "general.type";
const ALPHA: &str = "adapter.lora.alpha";
const INVOCATION: &str = "adapter.alora.invocation_tokens";
/// The embedding, whose A has a row for each token.
const EMBEDDING: &str = "token_embd.weight";
/// Keys of adapters that change nothing here.
const WITHOUT_EFFECT: [&str; 4] = [
    "adapter.type",
    "adapter.lora.task_name",
    "adapter.lora.prompt_prefix",
    ALPHA,
];

/// An adapter whose header is read.
#[derive(Debug)]
pub(super) struct GgufAdapter {
    header: Header,
    files: Arc<AdapterFiles>,
}

impl GgufAdapter {
    pub(super) fn open(path: &Path) -> Result<(Self, Arc<AdapterFiles>), MllmError> {
        let (header, weights) = open_header(path)?;
        match header.text(KIND)? {
            Some("adapter") => {}
            found => {
                let found = found.unwrap_or("model").escape_debug().to_string();
                return Err(header.error(KIND, format!("this is a {found}, not an adapter")));
            }
        }
        match header.text("adapter.type")? {
            Some("lora") => {}
            Some(found) => {
                let problem = format!(
                    "adapters of type '{}' are not supported; lora is",
                    found.escape_debug()
                );
                return Err(header.error("adapter.type", problem));
            }
            None => {
                let problem = "is missing; adapters of type lora are supported";
                return Err(header.error("adapter.type", problem));
            }
        }
        // Merged, it would act on every token: refused, because the model would answer otherwise.
        if header.metadata.contains_key(INVOCATION) {
            let problem = "an activated LoRA works from a token sequence on and cannot be merged";
            return Err(header.error(INVOCATION, problem));
        }
        let files = Arc::new(AdapterFiles {
            weights,
            settings: Vec::new(),
        });
        let adapter = Self {
            header,
            files: Arc::clone(&files),
        };
        Ok((adapter, files))
    }

    /// The changes that the tensors make to a model.
    pub(super) fn entries(self, base: &BaseModel<'_>) -> Result<(Vec<Entry>, About), MllmError> {
        let header = &self.header;
        let layout = base.gguf.map_err(|lacking| {
            let problem = format!(
                "llama.cpp's format has no place for {lacking} of a {} model",
                base.family
            );
            header.error(ARCHITECTURE, problem)
        })?;
        let own = header.architecture()?;
        if let Some(architecture) = base.architecture
            && architecture != own
        {
            let problem = format!(
                "the adapter is for a decoder of architecture '{}', the model has '{architecture}'",
                own.escape_debug()
            );
            return Err(header.error(ARCHITECTURE, problem));
        }
        // 0 stands for a scale of 1, as does a file without one.
        let alpha = header.number_or_none(ALPHA)?;
        let mut pairs: BTreeMap<&str, [Option<&TensorPlace>; 2]> = BTreeMap::new();
        for (name, place) in &header.tensors {
            let (target, half) = match (name.strip_suffix(".lora_a"), name.strip_suffix(".lora_b"))
            {
                (Some(target), _) => (target, 0),
                (_, Some(target)) => (target, 1),
                // llama.cpp leaves them out too.
                _ if name.ends_with("_norm.weight") => continue,
                _ => {
                    let problem = format!(
                        "tensor {} is neither lora_a nor lora_b",
                        name.escape_debug()
                    );
                    return Err(refused(&header.path, problem));
                }
            };
            if let Some(slot) = pairs.entry(target).or_default().get_mut(half) {
                *slot = Some(place);
            }
        }
        let mut entries = Vec::with_capacity(pairs.len());
        for (target, pair) in &pairs {
            let [Some(a), Some(b)] = pair else {
                let problem = format!(
                    "{}: one of lora_a and lora_b is missing",
                    target.escape_debug()
                );
                return Err(refused(&header.path, problem));
            };
            entries.push(self.entry(target, [a, b], alpha, layout, base)?);
        }
        let about = self.about(own)?;
        Ok((entries, about))
    }

    fn about(&self, architecture: &str) -> Result<About, MllmError> {
        let header = &self.header;
        // An address names one repository; several models share a name.
        let base = match header.text("general.base_model.0.repo_url")? {
            Some(address) => Some(address),
            None => header.text("general.base_model.0.name")?,
        };
        let known = |key: &str| WITHOUT_EFFECT.contains(&key);
        let unknown = header
            .metadata
            .keys()
            .filter(|key| key.starts_with("adapter.") && !known(key));
        let mut notes: Vec<String> = unknown
            .map(|key| {
                format!(
                    "the adapter's key {} is not known and not read",
                    key.escape_debug()
                )
            })
            .collect();
        notes.push(
            "a GGUF adapter does not say whether it was trained with rsLoRA or alpha_pattern; if it was, its scale is wrong, \
             and its PEFT folder is right"
                .to_owned(),
        );
        Ok(About {
            kind: format!(
                "LoRA in GGUF of architecture {}",
                architecture.escape_debug()
            ),
            base: base.map(str::to_owned),
            tied: false,
            announced: None,
            notes,
        })
    }

    fn entry(
        &self,
        target: &str,
        [a, b]: [&TensorPlace; 2],
        alpha: Option<f64>,
        layout: &dyn GgufLayout,
        base: &BaseModel<'_>,
    ) -> Result<Entry, MllmError> {
        let tensor = |end: &str, place: &TensorPlace| {
            let file = Arc::clone(&self.files) as Arc<_>;
            BaseTensor::new(file, format!("{target}.{end}"), place.clone())
        };
        let rank = b.shape.last().copied().unwrap_or(0);
        let broken = |problem: String| {
            refused(
                &self.header.path,
                format!("{}: {problem}", target.escape_debug()),
            )
        };
        if a.shape.len() != 2 || b.shape.len() != 2 || rank == 0 {
            return Err(broken(format!(
                "lora_a has the shape {:?} and lora_b {:?}; experts are not supported",
                a.shape, b.shape
            )));
        }
        let rows = self.row_order(target, b, base).map_err(broken)?;
        let change = Change::LowRank(LowRank {
            left: Factor {
                tensor: tensor("lora_b", b).with_rows(rows),
                transposed: false,
            },
            right: Factor {
                tensor: tensor("lora_a", a),
                // The embedding's A has tokens as rows.
                transposed: target == EMBEDDING,
            },
            rank,
            scale: alpha.map_or(1.0, |alpha| (alpha / rank as f64) as f32),
            initial: Initial::Same,
            magnitude: None,
            transposed: false,
            flips: false,
            rows: Rows::All,
        });
        let change = if target == EMBEDDING {
            change.flipped()
        } else {
            change
        };
        let canonical = layout.canonical_name(&self.header, target)?;
        if layout.heads_are_tiled()
            && let Some(name) = canonical
                .as_deref()
                .filter(|name| name.contains(".linear_attn."))
        {
            let problem = format!(
                "changes {name}, whose heads llama.cpp has in another order; take the adapter's folder and the model's"
            );
            return Err(broken(problem));
        }
        Ok(Entry {
            // A name that no tensor has matches nothing, and the error says so.
            target: Target::Canonical(canonical.unwrap_or_else(|| target.to_owned())),
            tensor: format!("{target}.lora_a"),
            change,
        })
    }

    /// How B has the rows of queries and keys: those of a `llama` in pairs.
    fn row_order(
        &self,
        target: &str,
        b: &TensorPlace,
        base: &BaseModel<'_>,
    ) -> Result<RowOrder, String> {
        let architecture = self
            .header
            .architecture()
            .map_err(|error| error.to_string())?;
        let [queries, keys] = base.heads;
        let heads = match llama::projection(target) {
            Some("attn_q") if architecture == llama::ARCHITECTURE => queries,
            Some("attn_k") if architecture == llama::ARCHITECTURE => keys,
            _ => return Ok(RowOrder::Plain),
        };
        let rows = b.shape.first().copied().unwrap_or(0);
        if heads > 0 && rows.is_multiple_of(2 * heads) {
            return Ok(RowOrder::Paired { heads });
        }
        Err(format!(
            "its {rows} rows are no {heads} heads of whole pairs"
        ))
    }
}
