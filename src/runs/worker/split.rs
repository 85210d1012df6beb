//! Named lists of scenarios: the suites of generated scenarios, and the splits of the scenario
//! readers.

use super::interactive;
use super::suite::Suite;
use planagent_files::{path_of, word_of};
use planagent_scenario::modified::ModifiedName;
use planagent_scenario::{OnProgress, ReaderError, Readers, Split};

#[derive(Debug, thiserror::Error)]
pub enum SplitError {
    #[error("unknown split '{name}'; there are {}; or name a scenario filter FILE.yaml", known.join(", "))]
    Unknown {
        name: String,
        known: Vec<&'static str>,
    },
    #[error(
        "the scenes of split '{name}' cannot be made any more, because lanes have more vertices; take '{}'",
        successor(name)
    )]
    Retired { name: String },
    #[error(transparent)]
    Reader(#[from] ReaderError),
}

/// The suite that replaces a retired one.
fn successor(retired: &str) -> String {
    retired.replace("generated-14", "generated-test14")
}

/// The scenarios of a split: a suite or a published split by its name, or those of a scenario
/// filter `FILE.yaml`. `on_progress` counts the searched logs.
pub fn split(
    name: &str,
    readers: &Readers,
    on_progress: OnProgress<'_>,
) -> Result<Split, SplitError> {
    if let Some((base, modified)) = ModifiedName::in_word(name) {
        let modification = modified.read().map_err(ReaderError::new)?;
        let of_base = split(base, readers, on_progress)?;
        // The list alone does not make the scenarios: the name of the file is not enough.
        let file = of_base
            .file
            .as_ref()
            .map(|file| path_of(&modified.mark(&word_of(file.as_os_str()))));
        let scenarios = of_base
            .scenarios
            .iter()
            .map(|scenario| modification.modify(scenario.clone()))
            .collect();
        return Ok(of_base.with(scenarios, file));
    }
    if let Some(suite) = Suite::named(name) {
        let scenarios = suite.specs().into_iter().map(Into::into).collect();
        return Ok(Split::from_scenarios(scenarios));
    }
    if let Some(split) = interactive::split(name, readers) {
        return split;
    }
    if Suite::RETIRED.contains(&name) {
        return Err(SplitError::Retired {
            name: name.to_owned(),
        });
    }
    let Some(split) = readers.split(name, on_progress) else {
        let known = Suite::ALL
            .map(|suite| suite.name)
            .into_iter()
            .chain(interactive::NAMES)
            .chain(readers.splits())
            .collect();
        return Err(SplitError::Unknown {
            name: name.to_owned(),
            known,
        });
    };
    Ok(split?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_scenario::DataRoots;

    fn readers() -> Readers {
        Readers::new(&DataRoots::default())
    }

    #[test]
    fn the_generated_split_has_ten_seeds_of_each_type() {
        let scenarios = split("generated", &readers(), &|_, _| {})
            .unwrap()
            .scenarios;
        assert_eq!(scenarios.len(), 160);
        assert_eq!(scenarios[0].to_string(), "generated/starting_left_turn/0");
        assert_eq!(
            scenarios[159].to_string(),
            "generated/traversing_roundabout/9"
        );
    }

    #[test]
    fn unknown_names_and_files_say_what_to_do() {
        let error = |name: &str| split(name, &readers(), &|_, _| {}).unwrap_err().to_string();
        assert!(
            error("val15").contains("generated-test14, generated-test14-hard"),
            "{}",
            error("val15")
        );
        assert!(
            error("val15").contains("val14, reduced-val14"),
            "{}",
            error("val15")
        );
        assert!(error("generated-14-hard").contains("take 'generated-test14-hard'"));
        assert!(error("nowhere.yaml").contains("nowhere.yaml: cannot open"));
    }
}
