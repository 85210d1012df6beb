//! Which modules the settings of an adapter name. Its tensors decide what is merged; PEFT would
//! leave out those that its settings do not name.

use super::patterns::{compile, whole};
use super::settings::listed;
use crate::MllmError;
use crate::checkpoint::ConfigObject;
use fancy_regex::Regex;
use serde_json::Value;

/// The settings `target_modules`, `exclude_modules`, `layers_to_transform` and `layers_pattern`.
#[derive(Debug)]
pub(super) struct Targeted {
    targets: Modules,
    excluded: Modules,
    /// The layers that a list of targets is restricted to, and how a name tells its layer.
    layers: Option<(Vec<u64>, Vec<Regex>)>,
}

#[derive(Debug)]
enum Modules {
    Unset,
    /// All linear layers but the output layer.
    AllLinear,
    Named(Vec<String>),
    Matching(Regex),
}

/// Most modules that a list names, and most patterns of layers.
const MAX_NAMES: usize = 1 << 14;
const MAX_PATTERNS: usize = 1 << 6;

impl Targeted {
    /// Reads the settings; a list of layers may have `most` entries.
    pub(super) fn read(root: &ConfigObject<'_>, most: usize) -> Result<Self, MllmError> {
        const LAYERS: &str = "layers_to_transform";
        const PATTERN: &str = "layers_pattern";
        let layers: Vec<u64> = listed(root, LAYERS)?;
        if layers.len() > most {
            return Err(root.error(LAYERS, format!("more than {most} layers")));
        }
        let patterns: Vec<String> = listed(root, PATTERN)?;
        if patterns.len() > MAX_PATTERNS {
            return Err(root.error(PATTERN, format!("more than {MAX_PATTERNS} patterns")));
        }
        let named: Vec<&str> = patterns
            .iter()
            .map(String::as_str)
            .filter(|pattern| !pattern.is_empty())
            .collect();
        // PEFT then takes any name before the number of a layer.
        let named = if named.is_empty() {
            vec!["[^.]*"]
        } else {
            named
        };
        let expressions = named
            .iter()
            .map(|pattern| compile(root, PATTERN, &format!(r"^.*\.{pattern}\.(\d+)\.")));
        let expressions = expressions.collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            targets: Modules::read(root, "target_modules")?,
            excluded: Modules::read(root, "exclude_modules")?,
            layers: (!layers.is_empty()).then_some((layers, expressions)),
        })
    }

    /// The ends of names in a list of targets.
    pub(super) fn listed(&self) -> &[String] {
        match &self.targets {
            Modules::Named(names) => names,
            Modules::Unset | Modules::AllLinear | Modules::Matching(_) => &[],
        }
    }

    /// Whether the settings name a module.
    pub(super) fn names(&self, module: &str) -> bool {
        if self.excluded.contain(module) {
            return false;
        }
        match (&self.targets, &self.layers) {
            (Modules::Unset | Modules::AllLinear, _) => true,
            (Modules::Named(names), Some((layers, patterns)))
                if !names.iter().any(|name| name == module) =>
            {
                let layer = patterns.iter().find_map(|pattern| {
                    let found = pattern.captures(module).ok()??;
                    found.get(1)?.as_str().parse().ok()
                });
                self.targets.contain(module) && layer.is_some_and(|layer| layers.contains(&layer))
            }
            (targets, _) => targets.contain(module),
        }
    }
}

impl Modules {
    fn read(root: &ConfigObject<'_>, key: &str) -> Result<Self, MllmError> {
        Ok(match root.value::<Value>(key)? {
            None => Self::Unset,
            Some(Value::String(name)) if name.eq_ignore_ascii_case("all-linear") => Self::AllLinear,
            Some(Value::String(expression)) => Self::Matching(whole(root, key, &expression)?),
            Some(_) => {
                let names: Vec<String> = root.list(key)?;
                if names.len() > MAX_NAMES {
                    return Err(root.error(key, format!("more than {MAX_NAMES} modules")));
                }
                Self::Named(names)
            }
        })
    }

    fn contain(&self, module: &str) -> bool {
        match self {
            Self::Unset | Self::AllLinear => false,
            Self::Matching(expression) => expression.is_match(module).unwrap_or(false),
            Self::Named(names) => names.iter().any(|name| ends_in(module, name)),
        }
    }
}

/// Whether a module's last parts are those of a name.
pub(super) fn ends_in(module: &str, name: &str) -> bool {
    module
        .strip_suffix(name)
        .is_some_and(|before| before.is_empty() || before.ends_with('.'))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::path::Path;

    fn named(settings: &Value, modules: &[&str]) -> Vec<bool> {
        let root = ConfigObject::root(Path::new("c"), settings).unwrap();
        let targeted = Targeted::read(&root, 10).unwrap();
        modules
            .iter()
            .map(|module| targeted.names(module))
            .collect()
    }

    #[test]
    fn lists_expressions_layers_and_exclusions_are_those_of_peft() {
        let modules = [
            "model.layers.0.self_attn.q_proj",
            "model.layers.1.self_attn.q_proj",
            "model.layers.1.self_attn.my_q_proj",
            "model.visual.blocks.1.attn.qkv",
        ];
        for (settings, expected) in [
            (
                json!({"target_modules": ["q_proj"]}),
                [true, true, false, false],
            ),
            (
                json!({"target_modules": ["q_proj"], "layers_to_transform": 1}),
                [false, true, false, false],
            ),
            (
                json!({"target_modules": ["q_proj", "qkv"], "layers_to_transform": [1], "layers_pattern": "blocks"}),
                [false, false, false, true],
            ),
            (
                json!({"target_modules": "^(?!.*visual).*(?:q_proj|qkv)"}),
                [true, true, true, false],
            ),
            (
                json!({"target_modules": "all-linear", "exclude_modules": ["qkv"]}),
                [true, true, true, false],
            ),
            (
                json!({"target_modules": ["q_proj"], "exclude_modules": r".*\.0\..*"}),
                [false, true, false, false],
            ),
            (json!({}), [true; 4]),
        ] {
            assert_eq!(named(&settings, &modules), expected, "{settings}");
        }
    }
}
