//! The commented configuration file, which the program has in it, and what it says of each setting.

use std::collections::BTreeMap;

/// The file with every setting, its default value and its meaning.
pub(super) const COMMENTED: &str = include_str!("../../planagent.toml");

/// What the comments say of each setting, by key with section. Settings that follow each other
/// without a comment between them share one.
pub(super) fn explanations() -> BTreeMap<String, String> {
    let (mut all, mut section, mut text) = (BTreeMap::new(), String::new(), String::new());
    let mut is_new = true;
    for line in COMMENTED.lines() {
        if let Some(name) = line.strip_prefix('[') {
            section = name.replace(']', ".");
            text.clear();
        } else if line.is_empty() {
            text.clear();
        } else if let Some(key) = key_of(line) {
            all.insert(format!("{section}{key}"), text.clone());
            is_new = true;
        } else {
            if std::mem::take(&mut is_new) {
                text.clear();
            }
            if !text.is_empty() {
                text.push(' ');
            }
            text.push_str(line.trim_start_matches('#').trim());
        }
    }
    all
}

/// The key of a line with an assignment. One that is not set by default stands in a comment.
fn key_of(line: &str) -> Option<&str> {
    let (key, _) = line.trim_start_matches("# ").split_once(" = ")?;
    let is_key = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_' || c == '-';
    (!key.is_empty() && key.chars().all(is_key)).then_some(key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::keys;
    use planagent_mllm::Families;

    #[test]
    fn every_setting_is_explained() {
        let all = explanations();
        for key in keys().unwrap() {
            let text = all.get(&key).unwrap_or_else(|| panic!("no {key}"));
            assert!(text.ends_with('.'), "{key}: {text:?}");
        }
        assert_eq!(all["environment.bev"], all["environment.lane_graph"]);
        assert!(all["mllm.ignore_memory"].starts_with("Load a model"));
    }

    #[test]
    fn the_file_names_every_family() {
        let about = &explanations()["mllm.model"];
        for family in Families::default().iter() {
            let name = family.name();
            assert!(about.contains(name), "mllm.model does not name {name}");
        }
    }
}
