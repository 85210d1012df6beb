//! Rows as CSV. A text that a spreadsheet would compute begins with an apostrophe, which
//! spreadsheets take for the mark of a text.

use planagent_runs::report::json_value;
use serde::Serialize;
use serde_json::Value;

/// Rows with a header of all their fields. Fields of fields have dotted names; lists are joined by
/// spaces; null is empty.
pub(super) fn csv_text(rows: &[impl Serialize]) -> anyhow::Result<String> {
    let rows = rows
        .iter()
        .map(|row| Ok(json_value(row)?))
        .collect::<anyhow::Result<Vec<Value>>>()?;
    let mut all = Value::Null;
    for row in &rows {
        join(&mut all, row);
    }
    let names: Vec<String> = if rows.is_empty() {
        Vec::new()
    } else {
        flat(&all).into_iter().map(|(name, _)| name).collect()
    };
    let header: Vec<&str> = names.iter().map(String::as_str).collect();
    let flat: Vec<_> = rows.iter().map(flat).collect();
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

/// Adds the fields of a row to those of the rows before it. A field that is null in one row has the
/// fields of the others.
fn join(all: &mut Value, row: &Value) {
    match (all, row) {
        (Value::Object(all), Value::Object(row)) => {
            for (name, value) in row {
                join(all.entry(name.clone()).or_insert(Value::Null), value);
            }
        }
        (all, row) if all.is_null() => *all = row.clone(),
        _ => {}
    }
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
                    guarded(name.clone())
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
        Value::String(text) => guarded(text.clone()),
        // A list of numbers stays one: only texts begin with the mark of a formula.
        Value::Array(values) if values.iter().any(Value::is_string) => guarded(listed(values)),
        Value::Array(values) => listed(values),
        other => other.to_string(),
    }
}

fn listed(values: &[Value]) -> String {
    let unguarded = |value: &Value| match value {
        Value::String(text) => text.clone(),
        other => cell(other),
    };
    values.iter().map(unguarded).collect::<Vec<_>>().join(" ")
}

/// A text with an apostrophe before it, if a spreadsheet would take it for a formula.
fn guarded(text: String) -> String {
    let is_mark = |c: char| {
        matches!(
            c,
            '=' | '+' | '-' | '@' | '\u{ff1d}' | '\u{ff0b}' | '\u{ff0d}' | '\u{ff20}'
        )
    };
    // Spreadsheets skip white space, or end a cell at a tab or at the end of a line.
    let is_formula = |part: &str| part.trim_start().starts_with(is_mark);
    let at_break = |c: char| matches!(c, '\t' | '\r' | '\n');
    if text.starts_with(at_break) || text.split(at_break).any(is_formula) {
        format!("'{text}")
    } else {
        text
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
        // The order of rows does not change the columns.
        let (none, some) = (
            json!({"a": 1, "d": null, "z": 2}),
            json!({"a": 3, "d": {"low": 4}, "z": 5}),
        );
        assert_eq!(
            csv_text(&[none.clone(), some.clone()]).unwrap(),
            "a,d.low,z\n1,,2\n3,4,5\n"
        );
        assert_eq!(csv_text(&[some, none]).unwrap(), "a,d.low,z\n3,4,5\n1,,2\n");
    }

    #[test]
    fn a_spreadsheet_computes_no_text_and_takes_numbers_for_numbers() {
        let cell = |value: Value| {
            let text = csv_text(&[json!({ "a": value })]).unwrap();
            let mut reader = csv::Reader::from_reader(text.as_bytes());
            let row = reader.records().next().unwrap().unwrap();
            row.get(0).unwrap().to_owned()
        };
        for formula in [
            "=1+1",
            "+1",
            "-1+1",
            "@SUM(A1)",
            " =1",
            "\t=1",
            "\rx",
            "\u{ff1d}1",
            "x\t=1",
            "x\n=1",
        ] {
            assert_eq!(cell(json!(formula)), format!("'{formula}"));
            assert!(cell(json!([formula, "x"])).starts_with('\''), "{formula}");
        }
        for (value, text) in [
            (json!(-0.5), "-0.5"),
            (json!([-1, 2]), "-1 2"),
            (json!("a-b=c"), "a-b=c"),
            (json!(["a", "-b"]), "a -b"),
        ] {
            assert_eq!(cell(value), text);
        }
        assert_eq!(csv_text(&[json!({"=1": 2})]).unwrap(), "'=1\n2\n");
    }
}
