//! Regular expressions as Python's `re` matches them.

use crate::MllmError;
use crate::checkpoint::ConfigObject;
use fancy_regex::{Regex, RegexBuilder};

/// Steps of one match before it is given up.
const MAX_STEPS: usize = 100_000;
/// Largest compiled form of an expression, bytes.
const MAX_SIZE: usize = 1 << 20;

/// Compiles an expression that must match from the first character to the last.
pub(super) fn whole(
    root: &ConfigObject<'_>,
    key: &str,
    expression: &str,
) -> Result<Regex, MllmError> {
    compile(root, key, &format!("^(?:{expression})$"))
}

pub(super) fn compile(
    root: &ConfigObject<'_>,
    key: &str,
    expression: &str,
) -> Result<Regex, MllmError> {
    RegexBuilder::new(expression)
        .backtrack_limit(MAX_STEPS)
        .delegate_size_limit(MAX_SIZE)
        .build()
        .map_err(|error| root.error(key, format!("'{}': {error}", expression.escape_debug())))
}

/// Values by the ends of module names (`rank_pattern`, `alpha_pattern`).
#[derive(Debug, Default)]
pub(super) struct Patterns<T>(Vec<(Regex, T)>);

/// Most patterns of a map. `EVA` writes one for each module.
const MAX_PATTERNS: usize = 1 << 13;

impl<T: Copy> Patterns<T> {
    /// Compiles the keys of a map in its order.
    pub(super) fn read(
        root: &ConfigObject<'_>,
        key: &str,
        entries: impl IntoIterator<Item = (String, T)>,
    ) -> Result<Self, MllmError> {
        let mut patterns = Vec::new();
        for (pattern, value) in entries {
            if patterns.len() >= MAX_PATTERNS {
                return Err(root.error(key, format!("more than {MAX_PATTERNS} patterns")));
            }
            let compiled = whole(root, key, &format!(r"(.*\.)?({pattern})"))?;
            patterns.push((compiled, value));
        }
        Ok(Self(patterns))
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// The value of the first pattern that matches; one that takes too long does not.
    pub(super) fn find(&self, module: &str) -> Option<T> {
        let matching = |(pattern, _): &&(Regex, T)| pattern.is_match(module).unwrap_or(false);
        self.0.iter().find(matching).map(|(_, value)| *value)
    }
}
