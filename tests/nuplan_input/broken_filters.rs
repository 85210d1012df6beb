//! Filter files: errors name file and line.

use crate::outside::{Needy, data};
use planagent_scenario::nuplan::{FilterFile, PUBLISHED_SPLITS};

fn error_of(content: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("split.yaml");
    std::fs::write(&path, content).unwrap();
    FilterFile::open(&path).unwrap_err().to_string()
}

#[test]
fn errors_name_file_and_line() {
    let unquoted = error_of(
        "scenario_types: null\nscenario_tokens:\n  - '0488dbdf03b55f00'\n  - 1234567890123456\n",
    );
    assert!(
        unquoted.contains("split.yaml, line 4: '1234567890123456' is read as a number"),
        "{unquoted}"
    );
    assert!(unquoted.contains("put it in quotes"), "{unquoted}");
    let twice = error_of("scenario_tokens: ['0488dbdf03b55f00',\n  '0488dbdf03b55f00']\n");
    assert!(
        twice.contains("line 2: the token 0488dbdf03b55f00 stands in line 1 already"),
        "{twice}"
    );
    let broken = error_of("scenario_tokens: [\n");
    assert!(
        broken.contains("split.yaml, line") && broken.contains("in YAML"),
        "{broken}"
    );
}

#[test]
fn published_lists_are_known_by_their_tokens() -> Needy {
    let folder = data("splits")?;
    for split in &PUBLISHED_SPLITS {
        let file = split
            .files
            .iter()
            .map(|file| folder.join(file))
            .find(|path| path.is_file());
        let filter = FilterFile::open(&file.unwrap()).unwrap().filter;
        let tokens = filter.scenario_tokens.unwrap();
        assert!(split.is_published(&tokens), "{}", split.name);
        assert!(!split.is_published(&tokens[1..]), "{}", split.name);
        assert_eq!(filter.scenario_types.unwrap().len(), 14);
        assert!(filter.remove_invalid_goals && filter.timestamp_threshold_s == Some(15.0));
    }
    Ok(())
}

#[test]
fn interplan_is_rejected_with_the_reason() {
    let error = error_of(
        "_target_: interplan.planning.scenario_builder.benchmark_scenario_filter.BenchmarkScenarioFilter\n\
         _convert_: 'all'\n\
         defaults:\n  - modifications: interPlan_modifications\n\
         scenario_types: null\nscenario_tokens:\n  - d480a5d2b0fe5fe6-dlgloa\n",
    );
    assert!(
        error.contains("line 1: this is interPlan's filter"),
        "{error}"
    );
}
