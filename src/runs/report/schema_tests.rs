//! The schemas of the records in `docs/schema/` have the structure of the types.

use super::{CallRecord, Manifest, SimulationRow, Summary};
use planagent_agent::planner::{ExecReply, ExecRequest};
use schemars::{JsonSchema, schema_for};
use serde_json::Value;
use std::path::Path;
use std::{env, fs};

/// Compares a schema with its file, or writes the file if `PLANAGENT_UPDATE_GOLDEN` is set.
/// Descriptions may differ, because they are the comments of several stages.
fn check<T: JsonSchema>(name: &str) {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../docs/schema/{name}.schema.json"));
    let text = serde_json::to_string_pretty(&schema_for!(T)).unwrap() + "\n";
    if env::var_os("PLANAGENT_UPDATE_GOLDEN").is_some() {
        fs::write(&path, &text).unwrap();
    }
    let structure =
        |text: &str| without_descriptions(serde_json::from_str(text).unwrap_or_default());
    if structure(&fs::read_to_string(&path).unwrap_or_default()) != structure(&text) {
        let derived = env::temp_dir().join(format!("{name}.schema.json"));
        fs::write(&derived, &text).unwrap();
        panic!(
            "{} is out of date: {} is the derived schema",
            path.display(),
            derived.display()
        );
    }
}

fn without_descriptions(schema: Value) -> Value {
    match schema {
        Value::Object(fields) => {
            let kept = fields
                .into_iter()
                .filter(|(key, value)| key != "description" || !value.is_string());
            kept.map(|(key, value)| (key, without_descriptions(value)))
                .collect()
        }
        Value::Array(values) => values.into_iter().map(without_descriptions).collect(),
        other => other,
    }
}

#[test]
fn schemas_of_the_records_are_up_to_date() {
    check::<CallRecord>("calls");
    check::<Manifest>("manifest");
    check::<SimulationRow>("record");
    check::<Summary>("summary");
    check::<ExecRequest>("exec_request");
    check::<ExecReply>("exec_reply");
}
