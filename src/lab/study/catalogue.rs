//! The studies that are built in, and those in files of users.

use super::Study;
use std::path::Path;

/// Name and file of each built-in study.
macro_rules! built_in {
    ($($name:literal,)*) => { &[$(($name, include_str!(concat!("../../../studies/", $name, ".toml")))),*] };
}

/// The built-in studies in the order in which `all` runs them. Another one is a file and a line.
const BUILT_IN: &[(&str, &str)] = built_in![
    "main",
    "scenario-types",
    "environment",
    "reasoning",
    "interval",
    "mllm",
    "controls",
    "inputs",
    "execution",
    "gate",
    "latency-aware",
    "recorded",
    "interactive",
    "ceilings",
    "agents",
];

#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    #[error("unknown study '{word}'; there are {known}; or name the path of a study FILE.toml")]
    Unknown { word: String, known: String },
    #[error("cannot read the study {place}: {source}")]
    Read {
        place: String,
        source: std::io::Error,
    },
    #[error("in the study {place}: {source}")]
    Parse {
        place: String,
        source: Box<toml::de::Error>,
    },
    #[error("in the study {place}: {fault}")]
    Value { place: String, fault: String },
}

pub fn names() -> impl Iterator<Item = &'static str> {
    BUILT_IN.iter().map(|(name, _)| *name)
}

pub fn all() -> Result<Vec<Study>, StudyError> {
    BUILT_IN
        .iter()
        .map(|(name, text)| parse(name, text))
        .collect()
}

/// The study of a name, or of a file whose name ends in `.toml`.
pub fn find(word: &str) -> Result<Study, StudyError> {
    if let Some((name, text)) = BUILT_IN.iter().find(|(name, _)| *name == word) {
        return parse(name, text);
    }
    if Path::new(word)
        .extension()
        .is_none_or(|ending| ending != "toml")
    {
        return Err(StudyError::Unknown {
            word: word.to_owned(),
            known: names().collect::<Vec<_>>().join(", "),
        });
    }
    let text = planagent_files::read_text(Path::new(word), planagent_files::MAX_SETTINGS_BYTES);
    parse(
        word,
        &text.map_err(|source| StudyError::Read {
            place: word.to_owned(),
            source,
        })?,
    )
}

fn parse(place: &str, text: &str) -> Result<Study, StudyError> {
    let place = || place.to_owned();
    let mut study: Study = toml::from_str(text).map_err(|source| StudyError::Parse {
        place: place(),
        source: Box::new(source),
    })?;
    study.word = place();
    study.check().map_err(|fault| StudyError::Value {
        place: place(),
        fault,
    })?;
    Ok(study)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "
        name = 'mine'
        title = 'Two thresholds'
        labels = ['threshold']
        suites = ['generated']
        [[variants]]
        labels = ['0.5']
        settings.reflection.threshold = 0.5
        [[variants]]
        labels = ['0.9']
        settings.reflection.threshold = 0.9
    ";

    #[test]
    fn every_built_in_study_is_complete_and_bears_its_name() {
        let found: Vec<String> = all().unwrap().into_iter().map(|study| study.name).collect();
        assert_eq!(found, names().collect::<Vec<_>>());
    }

    #[test]
    fn a_study_without_a_fitting_part_is_refused_with_its_place() {
        let study = parse("mine.toml", TEXT).unwrap();
        assert_eq!(
            (study.variants.len(), study.variants[0].planner.as_str()),
            (2, "plan-agent")
        );
        for (from, to, fault) in [
            ("labels = ['0.9']", "labels = ['0.5']", "two variants"),
            (
                "labels = ['0.9']",
                "labels = ['0.9', 'more']",
                "has 2 labels",
            ),
            (
                "labels = ['threshold']",
                "labels = ['threshold']\nreference = 2",
                "there are 2 variants",
            ),
            (
                "labels = ['0.9']",
                "labels = ['0.9']\nx = 1.0",
                "figure.lines",
            ),
            ("name = 'mine'", "name = '../mine'", "folder name"),
            ("suites = ['generated']", "suites = []", "must not be empty"),
            ("labels = ['0.9']", "label = ['0.9']", "label"),
        ] {
            let error = parse("mine.toml", &TEXT.replace(from, to)).unwrap_err();
            let text = format!("{error}");
            assert!(text.contains("mine.toml") && text.contains(fault), "{text}");
        }
        assert!(
            find("mian")
                .unwrap_err()
                .to_string()
                .contains("scenario-types")
        );
        assert!(
            find("nowhere.toml")
                .unwrap_err()
                .to_string()
                .contains("nowhere.toml")
        );
    }

    #[test]
    fn every_variant_of_a_study_can_be_configured() {
        for study in super::super::all().unwrap() {
            for variant in &study.variants {
                planagent_runs::runner::Config::default()
                    .overlaid(&variant.settings)
                    .unwrap();
            }
        }
    }
}
