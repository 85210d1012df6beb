//! Finds the tensors of the base that an adapter changes.

use super::about::{About, refused};
use super::change::{Change, Entry, Rows, Target};
use super::merge::MergedTensor;
use super::missing::{Announced, layer_of};
use super::source::AdapterFiles;
use crate::MllmError;
use crate::checkpoint::{
    BaseTensor, MergedAdapter, TensorPlace, TensorSource, Weights, may_add_one,
};
use crate::gguf::GgufLayout;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Names that a message lists.
const SHOWN: usize = 4;
const OUTPUT: &str = "lm_head.weight";
const EMBEDDING: &str = "embed_tokens.weight";
/// The layers of a tower.
const TOWER_LAYERS: &str = "vision_tower.encoder.layers.";

/// The model that an adapter is merged into.
pub(crate) struct BaseModel<'a> {
    /// Name of its family.
    pub family: &'a str,
    /// The canonical name of a tensor, by its name in Hugging Face's files.
    pub canonical_name: &'a dyn Fn(&str) -> Option<String>,
    /// How llama.cpp names its tensors, or the part that its format has no place for.
    pub gguf: Result<&'a dyn GgufLayout, &'a str>,
    /// llama.cpp's name of its decoder; none if llama.cpp knows no such decoder.
    pub architecture: Option<&'a str>,
    /// Heads of queries and of keys of its decoder.
    pub heads: [usize; 2],
}

/// The changes of each tensor, by canonical names.
type Changes = BTreeMap<String, Vec<(String, Change)>>;

/// Puts the changed tensors in the place of the base's.
pub(super) fn merge(
    path: &Path,
    files: Arc<AdapterFiles>,
    entries: Vec<Entry>,
    about: About,
    weights: &mut Weights,
    base: &BaseModel<'_>,
) -> Result<MergedAdapter, MllmError> {
    if entries.is_empty() {
        return Err(refused(path, "it has no tensors"));
    }
    let count = entries.len();
    let layers = weights.shapes().filter_map(|(name, _)| tower_layer(name));
    let last = layers.max().map(|last| last.saturating_add(1));
    let (mut changes, mut unmatched, mut beyond) = (Changes::new(), Vec::new(), 0_usize);
    for Entry {
        target,
        tensor,
        change,
    } in entries
    {
        let canonical = match target {
            Target::Canonical(name) => Some(name),
            Target::Stored(name) => (base.canonical_name)(&name),
        };
        let places = canonical
            .as_deref()
            .map_or_else(Vec::new, |name| places(name, &change, weights));
        if places.is_empty() {
            // Converters to GGUF leave out a last layer that no feature is taken from.
            if weights.is_gguf()
                && last.is_some()
                && canonical.as_deref().and_then(tower_layer) == last
            {
                beyond += 1;
            } else {
                unmatched.push(tensor);
            }
            continue;
        }
        for (name, change) in places {
            let known = changes.entry(name).or_default();
            known.push((tensor.clone(), change));
        }
    }
    if !unmatched.is_empty() {
        return Err(matches_nothing(path, &unmatched, count, &about, base));
    }
    untie(&changes, about.tied, weights);
    let tensors = changes.len();
    // All before the first is put: an output layer may be made of an embedding that changes too.
    let mut prepared = Vec::with_capacity(tensors);
    for (name, changes) in changes {
        let (base, merged) = prepare(path, &name, changes, &about, weights)?;
        prepared.push((name, base, merged));
    }
    for (name, base, merged) in prepared {
        weights.put_merged(&name, &base, merged);
    }
    weights.add_file(Shared(files));
    let merged = MergedAdapter {
        path: path.display().to_string(),
        kind: about.kind,
        base: about.base,
        tensors,
    };
    weights.note(format!("adapter {merged} is merged"));
    if beyond > 0 {
        weights.note(format!(
            "{beyond} tensors of the adapter are for the tower's last layer, which the files of the model leave out"
        ));
    }
    if let Some(announced) = &about.announced {
        note_missing(announced, weights, base);
    }
    about.notes.into_iter().for_each(|note| weights.note(note));
    weights.set_adapter(merged.clone());
    Ok(merged)
}

/// Says which modules of the base an adapter names and lacks.
fn note_missing(announced: &Announced, weights: &mut Weights, base: &BaseModel<'_>) {
    let layers = weights
        .shapes()
        .filter_map(|(name, _)| layer_of(name))
        .max();
    // No base has more layers than tensors, whatever its names say.
    let layers = layers
        .map_or(0, |last| last.saturating_add(1))
        .min(weights.shapes().count());
    let missing = announced.missing(layers, |module| {
        (base.canonical_name)(&format!("{module}.weight"))
            .is_some_and(|name| weights.contains(&name))
    });
    if !missing.is_empty() {
        weights.note(format!(
            "{} modules that target_modules names have no tensors in the adapter and stay as they are: {}",
            missing.len(),
            shown(&missing)
        ));
    }
}

/// The first of some names.
fn shown(names: &[String]) -> String {
    let first: Vec<String> = names
        .iter()
        .take(SHOWN)
        .map(|name| name.escape_debug().to_string())
        .collect();
    let more = if names.len() > SHOWN { ", …" } else { "" };
    format!("{}{more}", first.join(", "))
}

/// The files of an adapter as a file of the model, for its digest.
#[derive(Debug)]
struct Shared(Arc<AdapterFiles>);

impl TensorSource for Shared {
    fn path(&self) -> &Path {
        self.0.path()
    }

    fn bytes(&self, place: &TensorPlace) -> Result<Vec<u8>, MllmError> {
        self.0.bytes(place)
    }

    fn hash(&self, hasher: &mut blake3::Hasher) -> Result<(), MllmError> {
        self.0.hash(hasher)
    }
}

/// The tensors of the base that a change is for, each with its part of the change. Files have the
/// projections to queries, keys and values of a tower as three tensors, or as one.
fn places(canonical: &str, change: &Change, weights: &Weights) -> Vec<(String, Change)> {
    const PARTS: [&str; 3] = ["q_proj", "k_proj", "v_proj"];
    if weights.contains(canonical) || canonical == OUTPUT && embedding(weights).is_some() {
        return vec![(canonical.to_owned(), change.clone())];
    }
    let Some((module, parameter)) = canonical.rsplit_once('.') else {
        return Vec::new();
    };
    let Some((before, part)) = module.rsplit_once('.') else {
        return Vec::new();
    };
    let height = |name: &str| weights.base_tensor(name)?.shape().first().copied();
    let mut found = Vec::new();
    // All three parts or none: a change of some of them would be another model.
    if part == "qkv" {
        let mut source = 0;
        for part in PARTS {
            let name = format!("{before}.{part}.{parameter}");
            let Some(count) = height(&name) else {
                return Vec::new();
            };
            let rows = Rows::Part {
                source,
                target: 0,
                count,
            };
            source += count;
            found.extend(change.clone().of_rows(rows).map(|change| (name, change)));
        }
        return if found.len() == PARTS.len() && change.rows_of_source() == Some(source) {
            found
        } else {
            Vec::new()
        };
    }
    if let Some(index) = PARTS.iter().position(|known| *known == part) {
        let name = format!("{before}.qkv.{parameter}");
        let count = height(&name).unwrap_or(0) / PARTS.len();
        let rows = Rows::Part {
            source: 0,
            target: index * count,
            count,
        };
        if count > 0 && change.rows_of_source() == Some(count) {
            found.extend(change.clone().of_rows(rows).map(|change| (name, change)));
        }
    }
    found
}

/// The name of the embedding, where it is the output layer too.
fn embedding(weights: &Weights) -> Option<String> {
    if weights.contains(OUTPUT) {
        return None;
    }
    let mut names = weights.shapes().map(|(name, _)| name);
    names
        .find(|name| name.ends_with(EMBEDDING))
        .map(str::to_owned)
}

/// The layer of a tower that a tensor belongs to.
fn tower_layer(canonical: &str) -> Option<usize> {
    let layer = canonical.strip_prefix(TOWER_LAYERS)?.split('.').next()?;
    layer.parse().ok()
}

/// Gives the output layer numbers of its own where an adapter changes an embedding that serves as
/// both: in training, only the embedding was adapted.
fn untie(changes: &Changes, tied: bool, weights: &mut Weights) {
    let Some(embedding) = embedding(weights).filter(|_| !tied) else {
        return;
    };
    let of_embedding = changes.get(&embedding).into_iter().flatten();
    let parts = of_embedding.into_iter().any(|(_, change)| match change {
        Change::LowRank(_) => true,
        Change::Replace { own, .. } => *own,
        Change::Add { .. } | Change::Tokens { .. } | Change::Experts(_) => false,
    });
    if parts && !changes.contains_key(OUTPUT) {
        weights.copy(&embedding, OUTPUT);
    }
}

/// The merged tensor of some changes, with the tensor of the base that it is made of.
fn prepare(
    path: &Path,
    name: &str,
    mut changes: Vec<(String, Change)>,
    about: &About,
    weights: &Weights,
) -> Result<(BaseTensor, MergedTensor), MllmError> {
    let tied = embedding(weights).filter(|_| name == OUTPUT);
    let Some(base) = weights.base_tensor(tied.as_deref().unwrap_or(name)) else {
        return Err(refused(path, format!("the model has no tensor {name}")));
    };
    if weights.heads_are_tiled() && name.contains(".linear_attn.") {
        let problem = format!(
            "it changes {name}, whose heads the GGUF file has in another order; take the model's folder"
        );
        return Err(refused(path, problem));
    }
    let has_one = weights.norms_have_one() && may_add_one(name);
    if has_one && changes.iter().any(|(_, change)| change.order() == 0) {
        let problem = format!(
            "it has {name} of its own, which the GGUF file stores with 1 added; take the model's folder"
        );
        return Err(refused(path, problem));
    }
    // A replaced tensor comes before what is added to it, whatever their order in the file.
    changes.sort_by_key(|(_, change)| change.order());
    let mut fitting: Vec<Change> = Vec::with_capacity(changes.len());
    for (tensor, change) in changes {
        let Some(change) = change.fitting(base.shape()) else {
            return Err(unfit(path, &tensor, &base, about));
        };
        let before = fitting.last();
        if change.is_whole() && before.is_some_and(|before| before.order() == change.order()) {
            let problem = format!(
                "tensor {} changes {name} a second time, perhaps under the names of two layouts",
                tensor.escape_debug()
            );
            return Err(refused(path, problem));
        }
        fitting.push(change);
    }
    let merged = MergedTensor {
        adapter: path.to_path_buf(),
        base: base.clone(),
        changes: fitting,
    };
    Ok((base, merged))
}

fn matches_nothing(
    path: &Path,
    unmatched: &[String],
    count: usize,
    about: &About,
    base: &BaseModel<'_>,
) -> MllmError {
    refused(
        path,
        format!(
            "{} of its {count} changes match no tensor of this {} model: {}; {}",
            unmatched.len(),
            base.family,
            shown(unmatched),
            wanted(about)
        ),
    )
}

fn unfit(path: &Path, tensor: &str, base: &BaseTensor, about: &About) -> MllmError {
    refused(
        path,
        format!(
            "tensor {} does not fit the model's {} of shape {:?} ({}); {}",
            tensor.escape_debug(),
            base.name(),
            base.shape(),
            base.path().display(),
            wanted(about)
        ),
    )
}

/// Which model to take instead.
fn wanted(about: &About) -> String {
    match &about.base {
        Some(base) => format!("the adapter is for {}", base.escape_debug()),
        None => "the adapter is for another model".to_owned(),
    }
}
