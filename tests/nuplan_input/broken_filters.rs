//! Filter files: errors name file and line.

use crate::outside::data;
use planagent_scenario::nuplan::FilterFile;

fn error_of(content: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("split.yaml");
    std::fs::write(&path, content).unwrap();
    FilterFile::open(&path).unwrap_err().to_string()
}

#[test]
fn errors_name_file_and_line() {
    let unquoted = error_of("scenario_types: null\nscenario_tokens:\n  - '0488dbdf03b55f00'\n  - 1234567890123456\n");
    assert!(unquoted.contains("split.yaml, line 4: '1234567890123456' is read as a number"), "{unquoted}");
    assert!(unquoted.contains("put it in quotes"), "{unquoted}");
    let twice = error_of("scenario_tokens: ['0488dbdf03b55f00',\n  '0488dbdf03b55f00']\n");
    assert!(twice.contains("line 2: the token 0488dbdf03b55f00 stands in line 1 already"), "{twice}");
    let broken = error_of("scenario_tokens: [\n");
    assert!(broken.contains("split.yaml, line") && broken.contains("in YAML"), "{broken}");
}

#[test]
#[cfg_attr(not(outside_data), ignore = "needs PLANAGENT_DATA")]
fn interplan_is_rejected_with_the_reason() {
    let Some(path) = data("splits/interPlan__interplan10.yaml") else { return };
    let error = FilterFile::open(&path).unwrap_err().to_string();
    assert!(error.contains("line 1: this is interPlan's filter"), "{error}");
}
