//! Tables of TOML: their keys, how one is laid over another, and how two differ.

use toml::de::DeTable;

/// The line of a key of a section in a text of TOML, from 1.
pub(super) fn line_of(text: &str, section: &str, name: &str) -> Option<usize> {
    let document = DeTable::parse(text).ok()?.into_inner();
    let section = document
        .iter()
        .find(|(key, _)| key.get_ref().as_ref() == section)?
        .1;
    let mut keys = section.get_ref().as_table()?.keys();
    let key = keys.find(|key| key.get_ref().as_ref() == name)?;
    Some(text.get(..key.span().start)?.matches('\n').count() + 1)
}

/// Replaces values of a table by those of another; tables within are merged.
pub(super) fn overlay(below: &mut toml::Table, above: toml::Table) {
    for (key, value) in above {
        match (below.get_mut(&key), value) {
            (Some(toml::Value::Table(below)), toml::Value::Table(above)) => overlay(below, above),
            (_, value) => {
                below.insert(key, value);
            }
        }
    }
}

/// The dotted keys of a table's values.
pub(super) fn leaves(prefix: &str, table: &toml::Table, on_key: &mut dyn FnMut(&str)) {
    for (name, value) in table {
        match value {
            toml::Value::Table(inner) => leaves(&format!("{prefix}{name}."), inner, on_key),
            _ => on_key(&format!("{prefix}{name}")),
        }
    }
}

/// Adds the values of `own` that are not those of `default`.
pub(super) fn collect_changes(
    prefix: &str,
    own: &toml::Table,
    default: &toml::Table,
    changes: &mut Vec<(String, toml::Value)>,
) {
    for (name, value) in own {
        let key = format!("{prefix}{name}");
        match (value, default.get(name)) {
            (toml::Value::Table(inner), Some(toml::Value::Table(default))) => {
                collect_changes(&format!("{key}."), inner, default, changes);
            }
            (value, default) if default == Some(value) => {}
            (toml::Value::Table(inner), None) => {
                collect_changes(&format!("{key}."), inner, &toml::Table::new(), changes);
            }
            (value, _) => changes.push((key, value.clone())),
        }
    }
}
