//! Rows as CSV.

use planagent_runs::report::json_value;
use serde::Serialize;
use serde_json::Value;

/// Rows with a header of all their fields. Fields of fields have dotted names; lists are joined by
/// spaces; null is empty.
pub(super) fn csv_text(rows: &[impl Serialize]) -> anyhow::Result<String> {
    let flat = rows
        .iter()
        .map(|row| Ok(flat(&json_value(row)?)))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let mut header: Vec<&str> = Vec::new();
    for (name, _) in flat.iter().flatten() {
        if !header.contains(&name.as_str()) {
            header.push(name);
        }
    }
    let mut writer = csv::Writer::from_writer(Vec::new());
    if !header.is_empty() {
        writer.write_record(&header)?;
    }
    for row in &flat {
        let cell = |name: &&str| {
            row.iter()
                .find(|(own, _)| own == name)
                .map_or("", |(_, value)| value.as_str())
        };
        writer.write_record(header.iter().map(cell))?;
    }
    Ok(String::from_utf8(writer.into_inner()?)?)
}

/// The fields of a row in order.
fn flat(row: &Value) -> Vec<(String, String)> {
    let mut fields = Vec::new();
    flatten("", row, &mut fields);
    fields
}

fn flatten(prefix: &str, value: &Value, fields: &mut Vec<(String, String)>) {
    match value {
        Value::Object(inner) => {
            for (name, value) in inner {
                let name = if prefix.is_empty() {
                    name.clone()
                } else {
                    format!("{prefix}.{name}")
                };
                flatten(&name, value, fields);
            }
        }
        leaf => fields.push((prefix.to_owned(), cell(leaf))),
    }
}

fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        Value::Array(values) => values.iter().map(cell).collect::<Vec<_>>().join(" "),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn rows_of_different_fields_share_a_header() {
        let rows = [
            json!({"id": "a,b", "score": 0.5, "by": ["x", "y"]}),
            json!({"id": "c", "error": null, "d": {"n": 1}}),
        ];
        assert_eq!(
            csv_text(&rows).unwrap(),
            "id,score,by,error,d.n\n\"a,b\",0.5,x y,,\nc,,,,1\n"
        );
        assert_eq!(csv_text(&[Value::Null; 0]).unwrap(), "");
    }
}
