//! Modules that an adapter's settings name and its file does not have: a file that was cut, or one
//! for a smaller model.

use super::targeted::{Targeted, ends_in};
use std::collections::BTreeSet;

/// What an adapter of PEFT says that it changes, and the modules that it has.
#[derive(Debug)]
pub(super) struct Announced {
    pub(super) targeted: Targeted,
    /// By their names in the trainer's model.
    pub(super) modules: BTreeSet<String>,
}

impl Announced {
    /// The named modules of a base with so many layers that the adapter lacks.
    pub(super) fn missing(&self, layers: usize, in_base: impl Fn(&str) -> bool) -> Vec<String> {
        let mut kinds: BTreeSet<(&str, String)> = BTreeSet::new();
        for module in &self.modules {
            let Some((before, after)) = layered(module) else {
                continue;
            };
            let parent = after.rsplit_once('.').map_or("", |(parent, _)| parent);
            let unseen = self.targeted.listed().iter();
            let unseen = unseen.filter(|name| !self.has(name));
            kinds.extend(unseen.map(|name| (before, format!("{parent}.{name}"))));
            kinds.insert((before, after.to_owned()));
        }
        let all = kinds.iter().flat_map(|(before, after)| {
            (0..layers).map(move |layer| format!("{before}{layer}{after}"))
        });
        all.filter(|module| {
            !self.modules.contains(module) && self.targeted.names(module) && in_base(module)
        })
        .collect()
    }

    /// Whether the adapter has a module of this name in any layer.
    fn has(&self, name: &str) -> bool {
        self.modules.iter().any(|module| ends_in(module, name))
    }
}

/// What stands before and after the number of a module's layer.
fn layered(module: &str) -> Option<(&str, &str)> {
    let (at, number) = first_number(module)?;
    Some((&module[..at], &module[at + number.len()..]))
}

/// The layer that a name tells.
pub(super) fn layer_of(name: &str) -> Option<usize> {
    first_number(name)?.1.parse().ok()
}

/// The first part of a name that is a number, with its place.
fn first_number(name: &str) -> Option<(usize, &str)> {
    let mut at = 0;
    for part in name.split('.') {
        if !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit()) {
            return Some((at, part));
        }
        at += part.len() + 1;
    }
    None
}
