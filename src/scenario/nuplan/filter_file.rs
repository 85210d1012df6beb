//! Scenario filters as nuPlan users keep them: YAML files, with the keys that Hydra puts into them.
//!
//! Nothing is ignored in silence: a key that is not known, a value of another type and a field that cannot be honoured are errors with
//! their line. References to other Hydra files (`${...}`) cannot be followed and are told.

use super::filter::{Limit, ScenarioFilter, TokenSet};
use super::token::Token;
use saphyr::{LoadableYamlNode, MarkedYaml, Scalar, YamlData};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// End of the `_target_` of nuPlan's own filter.
const TARGET: &str = "scenario_filter.ScenarioFilter";
/// End of the `_target_` of interPlan's filter.
const INTERPLAN: &str = "BenchmarkScenarioFilter";

/// A filter file that was read.
#[derive(Debug, Clone, PartialEq)]
pub struct FilterFile {
    /// The filter.
    pub filter: ScenarioFilter,
    /// What of the file could not be followed, for the user.
    pub notes: Vec<String>,
}

/// What is wrong in a filter file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FilterFault {
    /// No YAML.
    #[error("not YAML: {0}")]
    Syntax(String),
    /// No mapping of keys to values.
    #[error("a scenario filter is a list of `key: value` lines")]
    NotAMapping,
    /// A key that nuPlan's filter does not have.
    #[error("`{0}` is not a field of nuPlan's ScenarioFilter")]
    UnknownKey(String),
    /// A value of another type.
    #[error("{key} must be {expected}")]
    Type {
        /// The field.
        key: String,
        /// What it should be.
        expected: &'static str,
    },
    /// A token that YAML takes for a number.
    #[error("the token `{0}` is read as a number by YAML: put it in quotes")]
    UnquotedToken(String),
    /// No token.
    #[error("`{0}` is no token: expected 16 hexadecimal digits in quotes")]
    NotAToken(String),
    /// A token again.
    #[error("the token {token} stands in line {first} already")]
    DuplicateToken {
        /// Which.
        token: Token,
        /// Where it stands first.
        first: usize,
    },
    /// An empty list, which nothing would pass.
    #[error("{0} is an empty list, which no scenario passes; write null to let all pass")]
    EmptyList(String),
    /// A reference that cannot be followed and without which the filter means something else.
    #[error(
        "{key} refers to {reference}, which lies in nuPlan's own configuration: write the names out or list scenario_tokens"
    )]
    Reference {
        /// The field.
        key: String,
        /// The reference.
        reference: String,
    },
    /// Single-frame scenarios.
    #[error("expand_scenarios makes scenarios of a single frame, in which nothing can be driven: set it to false")]
    ExpandScenarios,
    /// interPlan's filter.
    #[error(
        "this is interPlan's filter: its tokens (as d480a5d2b0fe5fe6-dlgloa) name scenarios whose traffic and goal interPlan's own \
         code rewrites; they are not in nuPlan's logs"
    )]
    InterPlan,
    /// A filter of something else.
    #[error("_target_ is `{0}`, not nuPlan's ScenarioFilter")]
    Target(String),
    /// One of the two fields of a token set.
    #[error("token_set_path and fraction_in_token_set_threshold belong together")]
    HalfTokenSet,
}

/// Why a filter file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FilterError {
    /// The file cannot be read.
    #[error("{}: cannot open: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Something is wrong in it.
    #[error("{}, line {line}: {fault}", path.display())]
    Content {
        /// Which file.
        path: PathBuf,
        /// Which line, from 1.
        line: usize,
        /// What.
        fault: FilterFault,
    },
}

impl FilterFile {
    /// Reads a file.
    ///
    /// # Errors
    /// When it cannot be opened, or says something that cannot be honoured.
    pub fn open(path: &Path) -> Result<Self, FilterError> {
        let text = std::fs::read_to_string(path).map_err(|source| FilterError::Io { path: path.to_owned(), source })?;
        Self::parse(&text).map_err(|(line, fault)| FilterError::Content { path: path.to_owned(), line, fault })
    }

    /// Reads the text of a file.
    ///
    /// # Errors
    /// The line from 1 and what is wrong there.
    pub fn parse(text: &str) -> Result<Self, (usize, FilterFault)> {
        let documents = MarkedYaml::load_from_str(text)
            .map_err(|error| (error.marker().line(), FilterFault::Syntax(error.info().to_owned())))?;
        let Some(document) = documents.first() else { return Err((1, FilterFault::NotAMapping)) };
        let YamlData::Mapping(mapping) = &document.data else {
            return Err((document.span.start.line(), FilterFault::NotAMapping));
        };
        let mut reader = Reader { text, ..Reader::default() };
        for (key, value) in mapping {
            let line = key.span.start.line();
            let Some(name) = string(key) else { return Err((line, FilterFault::UnknownKey(reader.source(key)))) };
            reader.field(name, line, value)?;
        }
        reader.finish()
    }
}

type Node<'a> = MarkedYaml<'a>;
type Fault = (usize, FilterFault);

#[derive(Default)]
struct Reader<'t> {
    text: &'t str,
    filter: ScenarioFilter,
    notes: Vec<String>,
    /// References that matter unless tokens are listed: field, reference, line.
    references: Vec<(String, String, usize)>,
    token_set_path: Option<(PathBuf, usize)>,
    token_set_fraction: Option<(f64, usize)>,
}

impl Reader<'_> {
    fn field(&mut self, key: &str, key_line: usize, value: &Node<'_>) -> Result<(), Fault> {
        let line = value.span.start.line().max(key_line);
        if let Some(reference) = string(value).filter(|text| text.starts_with("${")) {
            self.references.push((key.to_owned(), reference.to_owned(), line));
            return Ok(());
        }
        let wrong = |expected: &'static str| (line, FilterFault::Type { key: key.to_owned(), expected });
        let amount = || match number(value) {
            None if is_null(value) => Ok(None),
            Some(number) if number.is_finite() && number >= 0.0 => Ok(Some(number)),
            _ => Err(wrong("a number from 0 on, or null")),
        };
        let flag = || match &value.data {
            YamlData::Value(Scalar::Boolean(flag)) => Ok(*flag),
            YamlData::Value(Scalar::Null) => Ok(false),
            _ => Err(wrong("true or false")),
        };
        let filter = &mut self.filter;
        match key {
            "_target_" => return target(string(value).unwrap_or_default()).map_err(|fault| (line, fault)),
            "defaults" => self.notes.push(format!("line {key_line}: the files that `defaults` names are not read")),
            "scenario_types" => filter.scenario_types = names(key, value)?,
            "scenario_tokens" => self.filter.scenario_tokens = self.tokens(key, value)?,
            "log_names" => filter.log_names = names(key, value)?,
            "map_names" => filter.map_names = names(key, value)?,
            "num_scenarios_per_type" => {
                filter.num_scenarios_per_type = match &value.data {
                    YamlData::Value(Scalar::Null) => None,
                    YamlData::Value(Scalar::Integer(count)) if *count > 0 => Some(*count as usize),
                    _ => return Err(wrong("a whole number above 0, or null")),
                }
            }
            "limit_total_scenarios" => {
                filter.limit_total_scenarios = match &value.data {
                    YamlData::Value(Scalar::Null) => None,
                    YamlData::Value(Scalar::Integer(count)) if *count > 0 => Some(Limit::Count(*count as usize)),
                    YamlData::Value(Scalar::FloatingPoint(share)) if share.0 > 0.0 && share.0 < 1.0 => {
                        Some(Limit::Fraction(share.0))
                    }
                    _ => return Err(wrong("a whole number above 0, a share between 0.0 and 1.0, or null")),
                }
            }
            "timestamp_threshold_s" => filter.timestamp_threshold_s = amount()?,
            "ego_displacement_minimum_m" => filter.ego_displacement_minimum_m = amount()?,
            "ego_start_speed_threshold" => filter.ego_start_speed_threshold = amount()?,
            "ego_stop_speed_threshold" => filter.ego_stop_speed_threshold = amount()?,
            "speed_noise_tolerance" => filter.speed_noise_tolerance = amount()?,
            "ego_route_radius" => filter.ego_route_radius = amount()?,
            "expand_scenarios" if flag()? => return Err((line, FilterFault::ExpandScenarios)),
            "_convert_" | "expand_scenarios" => {}
            "remove_invalid_goals" => filter.remove_invalid_goals = flag()?,
            "shuffle" => filter.shuffle = flag()?,
            "token_set_path" if is_null(value) => {}
            "token_set_path" => {
                let path = string(value).ok_or_else(|| wrong("the path of a JSON file, or null"))?;
                self.token_set_path = Some((PathBuf::from(path), line));
            }
            "fraction_in_token_set_threshold" => match amount()? {
                Some(share) if share > 1.0 => return Err(wrong("a share from 0 to 1")),
                share => self.token_set_fraction = share.map(|share| (share, line)),
            },
            _ => return Err((key_line, FilterFault::UnknownKey(key.to_owned()))),
        }
        Ok(())
    }

    fn finish(mut self) -> Result<FilterFile, Fault> {
        for (key, reference, line) in &self.references {
            if self.filter.scenario_tokens.is_none() || key == "scenario_tokens" {
                let (key, reference) = (key.clone(), reference.clone());
                return Err((*line, FilterFault::Reference { key, reference }));
            }
            self.notes.push(format!(
                "line {line}: {key} refers to {reference}, which is not known here; the listed tokens decide alone"
            ));
        }
        self.filter.token_set = match (self.token_set_path, self.token_set_fraction) {
            (None, None) => None,
            (Some((path, _)), Some((fraction, _))) => Some(TokenSet { path, fraction }),
            (Some((_, line)), None) | (None, Some((_, line))) => return Err((line, FilterFault::HalfTokenSet)),
        };
        if self.filter.shuffle {
            self.notes.push(format!(
                "shuffle: drawn with seed {}; the devkit's order differs from run to run",
                self.filter.seed
            ));
        }
        Ok(FilterFile { filter: self.filter, notes: self.notes })
    }

    fn tokens(&self, key: &str, value: &Node<'_>) -> Result<Option<Vec<Token>>, Fault> {
        let Some(items) = list(key, value)? else { return Ok(None) };
        let mut lines: BTreeMap<Token, usize> = BTreeMap::new();
        let mut tokens = Vec::with_capacity(items.len());
        for item in items {
            let line = item.span.start.line();
            let Some(text) = string(item) else {
                let source = self.source(item);
                let numeric = matches!(item.data, YamlData::Value(Scalar::Integer(_) | Scalar::FloatingPoint(_)));
                let fault = if numeric { FilterFault::UnquotedToken(source) } else { FilterFault::NotAToken(source) };
                return Err((line, fault));
            };
            let token: Token = text.parse().map_err(|_| (line, FilterFault::NotAToken(text.to_owned())))?;
            if let Some(first) = lines.insert(token, line) {
                return Err((line, FilterFault::DuplicateToken { token, first }));
            }
            tokens.push(token);
        }
        Ok(Some(tokens))
    }

    /// What stands in the file where a node is, without the dash of its list entry.
    fn source(&self, node: &Node<'_>) -> String {
        let (start, end) = (node.span.start.index(), node.span.end.index());
        let source: String = self.text.chars().skip(start).take(end.saturating_sub(start).min(40)).collect();
        source.trim().to_owned()
    }
}

fn target(name: &str) -> Result<(), FilterFault> {
    if name.ends_with(INTERPLAN) {
        Err(FilterFault::InterPlan)
    } else if name.ends_with(TARGET) {
        Ok(())
    } else {
        Err(FilterFault::Target(name.to_owned()))
    }
}

fn string<'a>(node: &'a Node<'_>) -> Option<&'a str> {
    match &node.data {
        YamlData::Value(Scalar::String(text)) => Some(text),
        _ => None,
    }
}

fn number(node: &Node<'_>) -> Option<f64> {
    match &node.data {
        YamlData::Value(Scalar::Integer(number)) => Some(*number as f64),
        YamlData::Value(Scalar::FloatingPoint(number)) => Some(number.0),
        _ => None,
    }
}

fn is_null(node: &Node<'_>) -> bool {
    matches!(node.data, YamlData::Value(Scalar::Null))
}

/// The entries of a list that is not empty; `None` for null.
fn list<'a, 'i>(key: &str, value: &'a Node<'i>) -> Result<Option<&'a [Node<'i>]>, Fault> {
    let line = value.span.start.line();
    match &value.data {
        YamlData::Value(Scalar::Null) => Ok(None),
        YamlData::Sequence(items) if items.is_empty() => Err((line, FilterFault::EmptyList(key.to_owned()))),
        YamlData::Sequence(items) => Ok(Some(items)),
        _ => Err((line, FilterFault::Type { key: key.to_owned(), expected: "a list, or null" })),
    }
}

fn names(key: &str, value: &Node<'_>) -> Result<Option<Vec<String>>, Fault> {
    let Some(items) = list(key, value)? else { return Ok(None) };
    let name = |item: &Node<'_>| {
        let fault = FilterFault::Type { key: key.to_owned(), expected: "a list of names" };
        string(item).map(str::to_owned).ok_or((item.span.start.line(), fault))
    };
    items.iter().map(name).collect::<Result<_, _>>().map(Some)
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
        assert!(file.notes[0].contains("line 8") && file.notes[0].contains("${splitter.log_splits.val}"));
    }

    #[test]
    fn tokens_that_yaml_reads_as_numbers_are_told_with_their_line() {
        let (line, fault_) = fault("scenario_tokens:\n  - '0488dbdf03b55f00'\n  - 1234567890123456\n");
        assert_eq!((line, fault_), (3, FilterFault::UnquotedToken("1234567890123456".to_owned())));
        assert!(FilterFault::UnquotedToken("1".to_owned()).to_string().contains("in quotes"));
        let (line, fault_) = fault("scenario_tokens:\n  - 12345678901234e5\n");
        assert_eq!((line, fault_), (2, FilterFault::UnquotedToken("12345678901234e5".to_owned())));
        assert_eq!(
            fault("scenario_tokens: ['0488dbdf03b55f0']"),
            (1, FilterFault::NotAToken("0488dbdf03b55f0".to_owned()))
        );
        let twice = fault("scenario_tokens:\n- '0488dbdf03b55f00'\n- '0488DBDF03B55F00'\n");
        let token = "0488dbdf03b55f00".parse().unwrap();
        assert_eq!(twice, (3, FilterFault::DuplicateToken { token, first: 2 }));
    }

    #[test]
    fn nothing_is_ignored_in_silence() {
        assert_eq!(fault("shufle: true\n"), (1, FilterFault::UnknownKey("shufle".to_owned())));
        assert_eq!(fault("shuffle: true\nexpand_scenarios: true\n"), (2, FilterFault::ExpandScenarios));
        assert_eq!(fault("scenario_types: []\n"), (1, FilterFault::EmptyList("scenario_types".to_owned())));
        assert!(matches!(fault("timestamp_threshold_s: -1\n"), (1, FilterFault::Type { .. })));
        assert!(matches!(fault("num_scenarios_per_type: 1.5\n"), (1, FilterFault::Type { .. })));
        assert!(matches!(fault("limit_total_scenarios: 1.0\n"), (1, FilterFault::Type { .. })));
        assert!(matches!(fault("log_names: ${x}\n"), (1, FilterFault::Reference { .. })));
        assert!(matches!(fault("token_set_path: a.json\n"), (1, FilterFault::HalfTokenSet)));
        assert!(matches!(fault("_target_: a.BenchmarkScenarioFilter\n"), (1, FilterFault::InterPlan)));
        assert!(matches!(fault("_target_: a.SceneFilter\n"), (1, FilterFault::Target(_))));
        assert!(matches!(fault("shuffle: true\nshuffle: false\n"), (2, FilterFault::Syntax(_))));
        assert!(matches!(fault("- a\n"), (1, FilterFault::NotAMapping)));
        assert!(matches!(fault(""), (1, FilterFault::NotAMapping)));
        assert!(matches!(fault("a: [\n"), (_, FilterFault::Syntax(_))));
    }
}
