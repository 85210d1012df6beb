//! Scenario filters as nuPlan users keep them: YAML files, with the keys that Hydra adds.
//!
//! An unknown key, a value of another type and a field that cannot be applied are errors with their
//! line. References to other Hydra files (`key: ${...}`) cannot be followed: they are errors, or
//! notes where listed tokens decide alone.

use super::filter::{Limit, ScenarioFilter, TokenSet};
use super::token::Token;
use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_saphyr::{Error as YamlError, Spanned};
use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

/// End of the `_target_` of nuPlan's own filter.
const TARGET: &str = "scenario_filter.ScenarioFilter";
/// End of the `_target_` of interPlan's filter.
const INTERPLAN: &str = "BenchmarkScenarioFilter";

/// A filter file that was read.
#[derive(Debug, Clone, PartialEq)]
pub struct FilterFile {
    pub filter: ScenarioFilter,
    /// What of the file could not be applied, for the user.
    pub notes: Vec<String>,
}

/// What is wrong in a filter file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum FilterFault {
    #[error("not a scenario filter in YAML (lines of `key: value`): {0}")]
    Yaml(String),
    #[error("'{0}' is read as a number by YAML: put it in quotes")]
    Unquoted(String),
    #[error("{key} must be {expected}")]
    Value {
        key: &'static str,
        expected: &'static str,
    },
    #[error("the token {token} stands in line {first} already")]
    DuplicateToken { token: Token, first: u64 },
    #[error("{0} is an empty list, which no scenario passes; write null to let all pass")]
    EmptyList(&'static str),
    #[error(
        "{key} refers to {target}, which lies in nuPlan's own configuration: write the names out or list scenario_tokens"
    )]
    Reference { key: String, target: String },
    #[error(
        "expand_scenarios makes scenarios of a single frame, which cannot be simulated: set it to false"
    )]
    ExpandScenarios,
    #[error(
        "this is interPlan's filter: its tokens (as d480a5d2b0fe5fe6-dlgloa) name scenarios whose agents and goal interPlan's own \
         code rewrites; they are not in nuPlan's logs"
    )]
    InterPlan,
    #[error("_target_ is '{0}', not nuPlan's ScenarioFilter")]
    Target(String),
    #[error(
        "token_set_path and fraction_in_token_set_threshold belong together: give both or neither"
    )]
    HalfTokenSet,
}

/// Why a filter file cannot be used.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum FilterError {
    #[error("{}: cannot open: {source}", path.display())]
    Io {
        path: PathBuf,
        source: std::io::Error,
    },
    #[error("{}, line {line}: {fault}", path.display())]
    Content {
        path: PathBuf,
        line: u64,
        fault: FilterFault,
    },
}

/// The line, from 1, and what is wrong there.
type Fault = (u64, FilterFault);

impl FilterFile {
    pub fn open(path: &Path) -> Result<Self, FilterError> {
        let text = planagent_files::read_text(path, planagent_files::MAX_LIST_BYTES).map_err(
            |source| FilterError::Io {
                path: path.to_owned(),
                source,
            },
        )?;
        Self::parse(&text).map_err(|(line, fault)| FilterError::Content {
            path: path.to_owned(),
            line,
            fault,
        })
    }

    /// Reads the text of a file.
    fn parse(text: &str) -> Result<Self, Fault> {
        let (text, references) = without_references(text);
        // Without a schema a plain scalar that reads as a number is no text: the devkit would read
        // it as a number.
        let options =
            serde_saphyr::options! { no_schema: true, strict_booleans: true, with_snippet: false };
        // Another program's filter is recognized before its fields are judged.
        if let Ok(Kind {
            _target_: Some(target),
        }) = serde_saphyr::from_str(&text)
        {
            check_target(&target.value).map_err(|fault| (line_of(&target), fault))?;
        }
        match serde_saphyr::from_str_with_options::<Option<Fields>>(&text, options) {
            Ok(Some(fields)) => fields.apply(references),
            Ok(None) => Err((1, FilterFault::Yaml("the file is empty".to_owned()))),
            Err(error) => Err(yaml_fault(&error)),
        }
    }
}

fn yaml_fault(error: &YamlError) -> Fault {
    let fault = match error {
        YamlError::QuotingRequired { value, .. } => FilterFault::Unquoted(value.clone()),
        other => FilterFault::Yaml(other.to_string()),
    };
    (
        error
            .location()
            .map_or(1, |location| location.line().max(1)),
        fault,
    )
}

/// A field that refers to another Hydra file.
struct Reference {
    line: u64,
    key: String,
    target: String,
}

/// A text with null in place of the references, and the references.
fn without_references(text: &str) -> (String, Vec<Reference>) {
    let mut references = Vec::new();
    let mut lines = Vec::new();
    for (line, number) in text.lines().zip(1..) {
        let target = |value: &str| value.trim().trim_matches(['\'', '"']).to_owned();
        match line
            .split_once(':')
            .map(|(key, value)| (key, target(value)))
        {
            Some((key, target)) if target.starts_with("${") => {
                references.push(Reference {
                    line: number,
                    key: key.trim().to_owned(),
                    target,
                });
                lines.push(format!("{key}: null"));
            }
            _ => lines.push(line.to_owned()),
        }
    }
    (lines.join("\n"), references)
}

type Field<T> = Option<Spanned<T>>;

/// What the file configures.
#[derive(Deserialize)]
struct Kind {
    _target_: Field<String>,
}

/// The fields of a file, by nuPlan's and Hydra's names.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Fields {
    #[serde(rename = "_target_")]
    _target: Option<IgnoredAny>,
    #[serde(rename = "_convert_")]
    _convert: Option<IgnoredAny>,
    defaults: Field<IgnoredAny>,
    scenario_types: Field<Vec<String>>,
    scenario_tokens: Field<Vec<Spanned<Token>>>,
    log_names: Field<Vec<String>>,
    map_names: Field<Vec<String>>,
    num_scenarios_per_type: Option<NonZeroUsize>,
    limit_total_scenarios: Field<TotalLimit>,
    timestamp_threshold_s: Field<f64>,
    ego_displacement_minimum_m: Field<f64>,
    expand_scenarios: Field<bool>,
    remove_invalid_goals: Option<bool>,
    shuffle: Option<bool>,
    ego_start_speed_threshold: Field<f64>,
    ego_stop_speed_threshold: Field<f64>,
    speed_noise_tolerance: Field<f64>,
    token_set_path: Field<PathBuf>,
    fraction_in_token_set_threshold: Field<f64>,
    ego_route_radius: Field<f64>,
}

/// nuPlan's limit: a whole number counts, a number with a point is a share.
#[derive(Clone, Copy, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a whole number above 0, a share between 0.0 and 1.0, or null"
)]
enum TotalLimit {
    Count(NonZeroUsize),
    Share(f64),
}

impl Fields {
    fn apply(self, references: Vec<Reference>) -> Result<FilterFile, Fault> {
        let mut notes = Vec::new();
        if let Some(defaults) = &self.defaults {
            notes.push(format!(
                "line {}: the files that `defaults` names are not read",
                line_of(defaults)
            ));
        }
        if let Some(expand) = self.expand_scenarios.filter(|expand| expand.value) {
            return Err((line_of(&expand), FilterFault::ExpandScenarios));
        }
        let scenario_tokens = list("scenario_tokens", self.scenario_tokens)?
            .map(distinct)
            .transpose()?;
        // Listed tokens are what published splits consist of; then a file that cannot be followed
        // changes nothing.
        for Reference { line, key, target } in references {
            if scenario_tokens.is_none() {
                return Err((line, FilterFault::Reference { key, target }));
            }
            notes.push(format!(
                "line {line}: {key} refers to {target}, which is not known here; the listed tokens decide alone"
            ));
        }
        let filter = ScenarioFilter {
            scenario_types: list("scenario_types", self.scenario_types)?,
            scenario_tokens,
            log_names: list("log_names", self.log_names)?,
            map_names: list("map_names", self.map_names)?,
            num_scenarios_per_type: self.num_scenarios_per_type.map(NonZeroUsize::get),
            limit_total_scenarios: self.limit_total_scenarios.as_ref().map(limit).transpose()?,
            timestamp_threshold_s: amount("timestamp_threshold_s", self.timestamp_threshold_s)?,
            ego_displacement_minimum_m: amount(
                "ego_displacement_minimum_m",
                self.ego_displacement_minimum_m,
            )?,
            remove_invalid_goals: self.remove_invalid_goals.unwrap_or_default(),
            shuffle: self.shuffle.unwrap_or_default(),
            ego_start_speed_threshold: amount(
                "ego_start_speed_threshold",
                self.ego_start_speed_threshold,
            )?,
            ego_stop_speed_threshold: amount(
                "ego_stop_speed_threshold",
                self.ego_stop_speed_threshold,
            )?,
            speed_noise_tolerance: amount("speed_noise_tolerance", self.speed_noise_tolerance)?,
            token_set: token_set(self.token_set_path, self.fraction_in_token_set_threshold)?,
            ego_route_radius: amount("ego_route_radius", self.ego_route_radius)?,
            ..ScenarioFilter::default()
        };
        if filter.shuffle {
            notes.push(format!(
                "shuffle: drawn with seed {}; the devkit's order differs from run to run",
                filter.seed
            ));
        }
        Ok(FilterFile { filter, notes })
    }
}

fn line_of<T>(value: &Spanned<T>) -> u64 {
    value.referenced.line()
}

fn check_target(name: &str) -> Result<(), FilterFault> {
    if name.ends_with(INTERPLAN) {
        Err(FilterFault::InterPlan)
    } else if name.ends_with(TARGET) {
        Ok(())
    } else {
        Err(FilterFault::Target(name.to_owned()))
    }
}

/// The entries of a list that is not empty.
fn list<T>(key: &'static str, value: Field<Vec<T>>) -> Result<Option<Vec<T>>, Fault> {
    match value {
        Some(list) if list.value.is_empty() => Err((line_of(&list), FilterFault::EmptyList(key))),
        list => Ok(list.map(|list| list.value)),
    }
}

fn distinct(tokens: Vec<Spanned<Token>>) -> Result<Vec<Token>, Fault> {
    let mut lines: BTreeMap<Token, u64> = BTreeMap::new();
    let once = |token: Spanned<Token>| match lines.insert(token.value, line_of(&token)) {
        Some(first) => Err((
            line_of(&token),
            FilterFault::DuplicateToken {
                token: token.value,
                first,
            },
        )),
        None => Ok(token.value),
    };
    tokens.into_iter().map(once).collect()
}

fn amount(key: &'static str, value: Field<f64>) -> Result<Option<f64>, Fault> {
    match value {
        Some(amount) if !(amount.value.is_finite() && amount.value >= 0.0) => Err((
            line_of(&amount),
            FilterFault::Value {
                key,
                expected: "a number from 0 on, or null",
            },
        )),
        amount => Ok(amount.map(|amount| amount.value)),
    }
}

fn limit(value: &Spanned<TotalLimit>) -> Result<Limit, Fault> {
    match value.value {
        TotalLimit::Count(count) => Ok(Limit::Count(count.get())),
        TotalLimit::Share(share) if share > 0.0 && share < 1.0 => Ok(Limit::Fraction(share)),
        TotalLimit::Share(_) => {
            let expected = "a whole number above 0, a share between 0.0 and 1.0, or null";
            Err((
                line_of(value),
                FilterFault::Value {
                    key: "limit_total_scenarios",
                    expected,
                },
            ))
        }
    }
}

fn token_set(path: Field<PathBuf>, fraction: Field<f64>) -> Result<Option<TokenSet>, Fault> {
    match (path, fraction) {
        (None, None) => Ok(None),
        (Some(path), Some(fraction)) if (0.0..=1.0).contains(&fraction.value) => {
            Ok(Some(TokenSet {
                path: path.value,
                fraction: fraction.value,
            }))
        }
        (Some(_), Some(fraction)) => {
            let (key, expected) = (
                "fraction_in_token_set_threshold",
                "a share from 0 to 1, or null",
            );
            Err((line_of(&fraction), FilterFault::Value { key, expected }))
        }
        (Some(path), None) => Err((line_of(&path), FilterFault::HalfTokenSet)),
        (None, Some(fraction)) => Err((line_of(&fraction), FilterFault::HalfTokenSet)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(text: &str) -> Fault {
        FilterFile::parse(text).unwrap_err()
    }

    #[test]
    fn reads_what_hydra_files_hold() {
        let file = FilterFile::parse(
            "_target_: nuplan.planning.scenario_builder.scenario_filter.ScenarioFilter\n_convert_: 'all'\n\
             scenario_types:\n  - changing_lane\nscenario_tokens:\n  - '1e502e7fc8745e0a'\n  - ac286967ed895963\n\
             log_names: ${splitter.log_splits.val}\nmap_names: null\nnum_scenarios_per_type: 100\nlimit_total_scenarios: 0.5\n\
             timestamp_threshold_s: 15\nexpand_scenarios: null\nremove_invalid_goals: true\nshuffle: false\n",
        )
        .unwrap();
        let filter = file.filter;
        assert_eq!(filter.scenario_tokens.unwrap().len(), 2);
        assert_eq!(filter.num_scenarios_per_type, Some(100));
        assert_eq!(filter.limit_total_scenarios, Some(Limit::Fraction(0.5)));
        assert_eq!(filter.timestamp_threshold_s, Some(15.0));
        assert!(filter.remove_invalid_goals && !filter.shuffle && filter.log_names.is_none());
        assert_eq!(file.notes.len(), 1, "{:?}", file.notes);
        assert!(
            file.notes[0].contains("line 8")
                && file.notes[0].contains("${splitter.log_splits.val}")
        );
        let limit = |text: &str| {
            FilterFile::parse(text)
                .unwrap()
                .filter
                .limit_total_scenarios
        };
        assert_eq!(limit("limit_total_scenarios: 3\n"), Some(Limit::Count(3)));
        assert_eq!(limit("limit_total_scenarios: null\n"), None);
    }

    #[test]
    fn tokens_that_yaml_reads_as_numbers_are_reported_with_their_line() {
        let unquoted = |text: &str| FilterFault::Unquoted(text.to_owned());
        let text = "scenario_tokens:\n  - '0488dbdf03b55f00'\n  - 1234567890123456\n";
        assert_eq!(fault(text), (3, unquoted("1234567890123456")));
        assert_eq!(
            fault("scenario_tokens:\n  - 12345678901234e5\n"),
            (2, unquoted("12345678901234e5"))
        );
        let (line, fault_) = fault("scenario_tokens:\n  - '0488dbdf03b55f0'");
        assert!(
            line == 2 && fault_.to_string().contains("'0488dbdf03b55f0' is no token"),
            "{fault_}"
        );
        let twice = fault("scenario_tokens:\n- '0488dbdf03b55f00'\n- '0488DBDF03B55F00'\n");
        let token = "0488dbdf03b55f00".parse().unwrap();
        assert_eq!(twice, (3, FilterFault::DuplicateToken { token, first: 2 }));
    }

    #[test]
    fn nothing_is_ignored_in_silence() {
        for (text, line, part) in [
            ("shufle: true\n", 1, "shufle"),
            (
                "shuffle: true\nexpand_scenarios: true\n",
                2,
                "set it to false",
            ),
            ("scenario_types: []\n", 1, "scenario_types is an empty list"),
            (
                "shuffle: true\ntimestamp_threshold_s: -1\n",
                2,
                "timestamp_threshold_s must be a number from 0 on",
            ),
            ("timestamp_threshold_s: soon\n", 1, "floating point"),
            ("num_scenarios_per_type: 1.5\n", 1, "column 25"),
            ("num_scenarios_per_type: 0\n", 1, "nonzero"),
            (
                "limit_total_scenarios: 1.0\n",
                1,
                "a share between 0.0 and 1.0",
            ),
            (
                "limit_total_scenarios: half\n",
                1,
                "a share between 0.0 and 1.0",
            ),
            ("log_names: ${x}\n", 1, "log_names refers to ${x}"),
            (
                "scenario_tokens: ${x}\n",
                1,
                "scenario_tokens refers to ${x}",
            ),
            ("token_set_path: a.json\n", 1, "belong together"),
            ("_target_: a.BenchmarkScenarioFilter\n", 1, "interPlan"),
            ("_target_: a.SceneFilter\n", 1, "'a.SceneFilter'"),
            ("shuffle: true\nshuffle: false\n", 2, "shuffle"),
            ("shuffle: maybe\n", 1, "YAML"),
            ("- a\n", 1, "lines of `key: value`"),
            ("scenario_types: 5\n", 1, "YAML"),
            ("a: [\n", 1, "YAML"),
            ("", 1, "the file is empty"),
        ] {
            let (at, fault) = fault(text);
            assert!(fault.to_string().contains(part), "{text}: {fault}");
            assert!(at == line || text == "a: [\n", "{text}: line {at}");
        }
    }
}
