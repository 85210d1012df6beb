//! `adapter_config.json` of PEFT (0.21.2), as far as it decides the merged weights. Absent keys take
//! the defaults of `LoraConfig`.

use super::about::PEFT_CONFIG;
use super::initial::Initial;
use super::patterns::Patterns;
use super::targeted::Targeted;
use crate::MllmError;
use crate::checkpoint::{ConfigObject, OneOrMany};
use serde_json::{Map, Value};
use std::path::Path;

/// Keys of kinds of LoRA with other formulas, and what each is.
const REFUSED: [(&str, &str); 7] = [
    ("layer_replication", "an adapter that repeats layers"),
    (
        "alora_invocation_tokens",
        "an activated LoRA works from a token sequence on and cannot be merged",
    ),
    ("use_qalora", "QA-LoRA"),
    ("use_bdlora", "block-diagonal LoRA"),
    ("arrow_config", "a mixture of adapters (Arrow)"),
    ("kasa_config", "KaSA"),
    ("monteclora_config", "Monte Carlo LoRA"),
];

/// Keys that change training alone, and those that older versions wrote.
const WITHOUT_EFFECT: [&str; 22] = [
    "auto_mapping",
    "revision",
    "task_type",
    "inference_mode",
    "lora_dropout",
    "megatron_config",
    "megatron_core",
    "eva_config",
    "corda_config",
    "loftq_config",
    "lora_ga_config",
    "velora_config",
    "qalora_group_size",
    "runtime_config",
    "peft_type",
    "peft_version",
    "base_model_name_or_path",
    "bias",
    "merge_weights",
    "modules_to_save",
    "layers_pattern",
    "layers_to_transform",
];

/// Keys that [`Settings::read`] reads.
const READ: [&str; 14] = [
    "r",
    "lora_alpha",
    "use_rslora",
    "use_dora",
    "lora_bias",
    "fan_in_fan_out",
    "init_lora_weights",
    "rank_pattern",
    "alpha_pattern",
    "trainable_token_indices",
    "target_parameters",
    "ensure_weight_tying",
    "target_modules",
    "exclude_modules",
];

/// Most experts' parameters and token lists that a file names.
const MAX_NAMED: usize = 1 << 10;
/// Most layers that a file restricts its modules to.
const MAX_LAYERS: usize = 1 << 13;

/// The settings of an adapter.
#[derive(Debug)]
#[allow(
    clippy::struct_excessive_bools,
    reason = "keys of the file of PEFT, each for itself"
)]
pub(super) struct Settings {
    /// The model that it was trained for, as its trainer called it.
    pub(super) base: Option<String>,
    pub(super) dora: bool,
    pub(super) fan_in_fan_out: bool,
    /// Whether an adapted embedding serves the output layer too where the base ties them.
    pub(super) tied: bool,
    /// Parameters of experts, by the ends of their names.
    pub(super) parameters: Vec<String>,
    pub(super) tokens: Option<Tokens>,
    pub(super) targeted: Targeted,
    pub(super) start: Start,
    /// Whether A of experts belongs to the second axis where both fit.
    pub(super) older: bool,
    pub(super) notes: Vec<String>,
    /// Names of modules that are saved whole.
    saved: Vec<String>,
    rank: usize,
    alpha: f64,
    rslora: bool,
    ranks: Patterns<usize>,
    alphas: Patterns<f64>,
}

/// Which rows of embeddings are new.
#[derive(Debug, Clone)]
pub(super) enum Tokens {
    OfTheInput(Vec<usize>),
    OfModules(Vec<(String, Vec<usize>)>),
}

/// How the adapter was initialized.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Start {
    OfTheBase,
    Pissa,
    Olora,
}

impl Settings {
    /// Reads the settings of `folder`; with `changed_base`, the model has lost what the adapter had
    /// at its start.
    pub(super) fn read(folder: &Path, json: &Value, changed_base: bool) -> Result<Self, MllmError> {
        let path = folder.join(PEFT_CONFIG);
        let root = ConfigObject::root(&path, json)?;
        check_kind(&root)?;
        let mut notes = Vec::new();
        // Before anything is read: a key without a meaning here would change the weights in
        // silence.
        check_unread(&root, json, &mut notes)?;
        let rank = root.value("r")?.unwrap_or(8);
        let map = |key: &str| -> Result<Map<String, Value>, MllmError> {
            Ok(root.value(key)?.unwrap_or_default())
        };
        let ranks = typed(&root, "rank_pattern", map("rank_pattern")?)?;
        let alphas = typed(&root, "alpha_pattern", map("alpha_pattern")?)?;
        let parameters: Vec<String> = root.list("target_parameters")?;
        if parameters.len() > MAX_NAMED {
            return Err(root.error("target_parameters", format!("more than {MAX_NAMED} names")));
        }
        let dora = flag(&root, "use_dora")?;
        if dora && !parameters.is_empty() {
            return Err(root.error("use_dora", "experts (target_parameters) have no DoRA"));
        }
        let version: Option<String> = root.value("peft_version")?;
        Ok(Self {
            base: root.value("base_model_name_or_path")?,
            dora,
            fan_in_fan_out: flag(&root, "fan_in_fan_out")?,
            tied: flag(&root, "ensure_weight_tying")?,
            parameters,
            tokens: tokens(&root)?,
            targeted: Targeted::read(&root, MAX_LAYERS)?,
            start: start(&root, changed_base, &mut notes)?,
            older: version.is_some_and(|version| is_older(&version)),
            saved: root.list("modules_to_save")?,
            rank,
            alpha: root.value("lora_alpha")?.unwrap_or(8.0),
            rslora: flag(&root, "use_rslora")?,
            ranks: Patterns::read(&root, "rank_pattern", ranks)?,
            alphas: Patterns::read(&root, "alpha_pattern", alphas)?,
            notes,
        })
    }

    /// Number of patterns that each module is matched with.
    pub(super) fn patterns(&self) -> usize {
        self.ranks.len() + self.alphas.len()
    }

    /// The rank of a module, and the factor of its product.
    pub(super) fn scale(&self, module: &str) -> (usize, f32) {
        let rank = self.ranks.find(module).unwrap_or(self.rank);
        let alpha = self.alphas.find(module).unwrap_or(self.alpha);
        let divisor = if self.rslora {
            (rank as f64).sqrt()
        } else {
            rank as f64
        };
        (rank, (alpha / divisor) as f32)
    }

    /// What the base loses where a linear layer with this scale is merged.
    pub(super) fn initial(&self, scale: f32) -> Initial {
        match self.start {
            Start::OfTheBase => Initial::Same,
            Start::Pissa => Initial::Leading,
            Start::Olora => Initial::FirstColumns {
                scale: f64::from(scale),
            },
        }
    }

    /// Whether a module is saved whole because its name is asked for.
    pub(super) fn saves(&self, module: &str) -> bool {
        self.saved
            .iter()
            .any(|name| module.ends_with(name.as_str()))
    }
}

fn flag(root: &ConfigObject<'_>, key: &str) -> Result<bool, MllmError> {
    Ok(root.value(key)?.unwrap_or(false))
}

fn check_kind(root: &ConfigObject<'_>) -> Result<(), MllmError> {
    const KEY: &str = "peft_type";
    if root.contains("fine_tune_type") && !root.contains(KEY) {
        let problem =
            "this is an adapter of mlx-lm, whose format is not read; PEFT's and llama.cpp's are";
        return Err(root.error("fine_tune_type", problem));
    }
    match root.value::<String>(KEY)?.as_deref() {
        Some("LORA") => Ok(()),
        Some(other) => Err(root.error(
            KEY,
            format!(
                "adapters of kind '{}' are not supported; LORA is (DoRA, rsLoRA, PiSSA and OLoRA among it)",
                other.escape_debug()
            ),
        )),
        None => Err(root.error(KEY, "is missing; LORA is supported")),
    }
}

/// Refuses keys with another formula, and notes those that nobody knows.
fn check_unread(
    root: &ConfigObject<'_>,
    json: &Value,
    notes: &mut Vec<String>,
) -> Result<(), MllmError> {
    for (key, value) in json.as_object().into_iter().flatten() {
        if is_neutral(value) {
            continue;
        }
        if let Some((_, kind)) = REFUSED.iter().find(|(refused, _)| refused == key) {
            return Err(root.error(key, format!("{kind}: not supported")));
        }
        if WITHOUT_EFFECT.contains(&key.as_str()) || READ.contains(&key.as_str()) {
            continue;
        }
        let key = key.escape_debug().to_string();
        if *value == Value::Bool(true) || key.starts_with("use_") {
            let problem = "is not known, and it may change the result; merge the adapter with PEFT \
                           (merge_and_unload) and name the merged folder";
            return Err(root.error(&key, problem));
        }
        notes.push(format!(
            "{PEFT_CONFIG}: the key {key} is not known and not read"
        ));
    }
    Ok(())
}

/// Whether a value stands for a setting that is not used.
fn is_neutral(value: &Value) -> bool {
    match value {
        Value::Null | Value::Bool(false) => true,
        Value::Array(list) => list.is_empty(),
        Value::Object(map) => map.is_empty(),
        _ => false,
    }
}

/// The values of a map of patterns.
fn typed<T: serde::de::DeserializeOwned>(
    root: &ConfigObject<'_>,
    key: &str,
    map: Map<String, Value>,
) -> Result<Vec<(String, T)>, MllmError> {
    let value = |(pattern, value): (String, Value)| match serde_json::from_value(value) {
        Ok(value) => Ok((pattern, value)),
        Err(error) => Err(root.error(&format!("{key}.{}", pattern.escape_debug()), error)),
    };
    map.into_iter().map(value).collect()
}

fn tokens(root: &ConfigObject<'_>) -> Result<Option<Tokens>, MllmError> {
    const KEY: &str = "trainable_token_indices";
    let value: Option<Value> = root.value(KEY)?;
    let list = |name: &str, value: Value| {
        serde_json::from_value::<Vec<usize>>(value).map_err(|error| root.error(name, error))
    };
    Ok(match value {
        None => None,
        Some(Value::Object(modules)) => {
            let module = |(name, value): (String, Value)| {
                let key = format!("{KEY}.{}", name.escape_debug());
                Ok((name, list(&key, value)?))
            };
            let modules = modules.into_iter().map(module);
            Some(Tokens::OfModules(
                modules.collect::<Result<_, MllmError>>()?,
            ))
        }
        Some(value) => Some(Tokens::OfTheInput(list(KEY, value)?)),
    })
}

/// How the adapter was initialized, where that changed its base.
fn start(
    root: &ConfigObject<'_>,
    changed_base: bool,
    notes: &mut Vec<String>,
) -> Result<Start, MllmError> {
    const KEY: &str = "init_lora_weights";
    let Some(Value::String(name)) = root.value::<Value>(KEY)? else {
        return Ok(Start::OfTheBase);
    };
    let kind = name.to_lowercase();
    if changed_base {
        return Ok(Start::OfTheBase);
    }
    // Some initializations move a part of the base into the adapter, which must be taken out again.
    match kind.as_str() {
        "gaussian" | "orthogonal" | "mica" | "eva" | "true" | "false" => Ok(Start::OfTheBase),
        "pissa" => Ok(Start::Pissa),
        "olora" => Ok(Start::Olora),
        other if other.starts_with("pissa_niter_") => {
            notes.push(format!(
                "{KEY} = \"{}\": the trainer took a random approximation from the base; the exact one is taken here",
                other.escape_debug()
            ));
            Ok(Start::Pissa)
        }
        other => Err(root.error(
            KEY,
            format!(
                "'{}' changed the base in a way that the adapter does not tell; convert the adapter with PEFT \
                 (path_initial_model_for_weight_conversion), or name the changed base as the model and write \
                 adapter = {{ path = \"…\", changed_base = true }} in its description",
                other.escape_debug()
            ),
        )),
    }
}

/// Whether a version of PEFT is before 0.19, which took another axis of experts for A.
fn is_older(version: &str) -> bool {
    let mut parts = version
        .split('.')
        .map_while(|part| part.parse::<u32>().ok());
    matches!((parts.next(), parts.next()), (Some(0), Some(minor)) if minor < 19)
}

impl Tokens {
    /// The rows of a module.
    pub(super) fn of_module(&self, module: &str) -> Option<&[usize]> {
        match self {
            Self::OfTheInput(indices) => Some(indices),
            Self::OfModules(modules) => {
                let is_of = |name: &str| {
                    module
                        .strip_suffix(name)
                        .is_some_and(|before| before.is_empty() || before.ends_with('.'))
                };
                let found = modules.iter().find(|(name, _)| is_of(name));
                found.map(|(_, indices)| indices.as_slice())
            }
        }
    }
}

/// A list, or one entry; empty if absent.
pub(super) fn listed<T: serde::de::DeserializeOwned + Clone>(
    root: &ConfigObject<'_>,
    key: &str,
) -> Result<Vec<T>, MllmError> {
    let value: Option<OneOrMany<T>> = root.value(key)?;
    Ok(value.map_or_else(Vec::new, |value| value.as_slice().to_vec()))
}
