//! The known name that a mistyped one is closest to.

use clap::error::{ContextKind, ContextValue};
use planagent_agent::planner_registry::UnknownPlanner;
use planagent_lab::study::StudyError;
use planagent_mllm::MllmError;
use planagent_runs::report::render::RenderError;
use planagent_runs::report::{NoPair, ReportError, ReportFault};
use planagent_runs::runner::{NoSuchType, RunnerError};
use planagent_runs::worker::interactive::NAMES;
use planagent_runs::worker::split::SplitError;
use planagent_runs::worker::suite::Suite;
use planagent_scenario::generator::{GeneratorError, types};
use planagent_scenario::{DataRoots, ReaderError, Readers};
use std::error::Error;
use std::ffi::OsStr;
use std::path::Path;

/// Similarity from which a name is suggested; clap uses the same for options and commands.
const MIN_SIMILARITY: f64 = 0.7;

/// A name that is not known.
struct Mistyped {
    /// What has the name.
    what: &'static str,
    name: String,
    known: Vec<String>,
}

impl Mistyped {
    fn new(what: &'static str, name: &str, known: Vec<String>) -> Self {
        Self {
            what,
            name: name.to_owned(),
            known,
        }
    }
}

/// Letters from which on a part of a name suggests it.
const MIN_PART: usize = 3;

/// The known name closest to a mistyped one, if it is close.
pub(super) fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let folded = |text: &str| text.to_lowercase().replace(['_', ' '], "-");
    let name = folded(name);
    let is_part = |one: &str| {
        let (short, long) = if one.len() < name.len() {
            (one, name.as_str())
        } else {
            (name.as_str(), one)
        };
        short.chars().count() >= MIN_PART
            && long
                .split(['-', '/', '.'])
                .any(|part| part.starts_with(short))
            || short.contains('-') && long.contains(short)
    };
    // The first words of a name are closest. One wrong, missing or swapped letter is close in a short
    // name too.
    let begins = |one: &str| {
        let rest = one.strip_prefix(name.as_str());
        rest.is_some_and(|rest| rest.starts_with(['-', '/', '.']))
    };
    let similarity = |one: &str| {
        let one = folded(one);
        match strsim::damerau_levenshtein(&name, &one) {
            0 => 3.0,
            _ if name.chars().count() >= MIN_PART && begins(&one) => 2.5,
            1 => 2.0,
            _ if is_part(&one) => 1.5,
            _ => strsim::jaro(&name, &one),
        }
    };
    let similar = known.into_iter().map(|one| (similarity(one), one));
    let close = similar.filter(|(similarity, _)| *similarity > MIN_SIMILARITY);
    // Of equally close names the first.
    close
        .reduce(|best, other| if other.0 > best.0 { other } else { best })
        .map(|(_, one)| one)
}

/// Commands of before, each with the command that replaces it.
const REPLACED_COMMANDS: [(&str, &str); 1] = [("experiment", "study")];

/// Adds to an error about a command that it has another name now.
pub(super) fn add_new_command(error: &mut clap::Error) {
    let Some(ContextValue::String(word)) = error.get(ContextKind::InvalidSubcommand) else {
        return;
    };
    let Some((_, command)) = REPLACED_COMMANDS.iter().find(|(old, _)| old == word) else {
        return;
    };
    let tip = format!("the command is `planagent {command}` now");
    error.remove(ContextKind::SuggestedSubcommand);
    error.insert(
        ContextKind::Suggested,
        ContextValue::StyledStrs(vec![tip.into()]),
    );
}

/// A tip for an error of a mistyped name.
pub(super) fn tip(error: &anyhow::Error) -> Option<String> {
    if let Some(tip) = error.chain().find_map(other_option) {
        return Some(tip);
    }
    let Mistyped { what, name, known } = error.chain().find_map(mistyped)?;
    let similar = nearest(&name, known.iter().map(String::as_str))?;
    Some(similar_exists(what, similar))
}

/// The words of a tip, as clap has them.
pub(super) fn similar_exists(what: &str, similar: &str) -> String {
    format!("a similar {what} exists: '{similar}'")
}

/// A tip for a scenario that is named as a split, or a split that is named as a scenario.
fn other_option(error: &(dyn Error + 'static)) -> Option<String> {
    // These wrap the error that knows the name, so they come first.
    if let Some(RunnerError::Scenario(error)) = error.downcast_ref() {
        return other_option(error);
    }
    if let Some(RunnerError::Split(error)) = error.downcast_ref() {
        return other_option(error);
    }
    if let Some(RunnerError::FindModel(error)) = error.downcast_ref() {
        return other_option(&**error);
    }
    if let Some(ReaderError::Missing(path)) = error.downcast_ref() {
        let name = path.file_name()?.to_str()?;
        let splits = Readers::new(&DataRoots::default()).splits();
        let is_split =
            Suite::named(name).is_some() || NAMES.contains(&name) || splits.contains(&name);
        if is_split {
            return Some(format!("{name} is a split: --split {name}"));
        }
        let similar = generated(path)?;
        return Some(similar_exists("scenario", &similar));
    }
    if let Some(MllmError::UnknownModel { name, .. }) = error.downcast_ref() {
        return is_of_ollama(name).then(|| {
            format!(
                "a model of Ollama is named with its server: --model http://127.0.0.1:11434#{name}"
            )
        });
    }
    if let Some(SplitError::Unknown { name, .. }) = error.downcast_ref() {
        let is_scenario = Path::new(name).exists() || name.starts_with("generated/");
        return is_scenario.then(|| format!("{name} names scenarios: --scenario {name}"));
    }
    None
}

/// The generated scenario that is meant by a path that ends as its name does: the name without
/// `generated/`, or a type alone.
fn generated(path: &Path) -> Option<String> {
    let is_type = |word: &str| types::in_suites().any(|kind| kind.to_string() == word);
    let mut words = path.iter().rev().filter_map(OsStr::to_str);
    let last = words.next()?;
    if is_type(last) {
        return Some(format!("generated/{last}/0"));
    }
    let kind = words.next().filter(|kind| is_type(kind))?;
    let seed = last.split(['.', '~']).next()?;
    seed.parse::<u64>()
        .is_ok()
        .then(|| format!("generated/{kind}/{last}"))
}

/// Whether a word has the form of Ollama's names, such as `llava:7b`.
fn is_of_ollama(name: &str) -> bool {
    let plain = |part: &str| {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        !part.is_empty() && part.chars().all(is_plain)
    };
    // A tag of digits alone is the port of a host.
    let is_tag = |tag: &str| plain(tag) && tag.contains(|c: char| c.is_ascii_alphabetic());
    name.split_once(':')
        .is_some_and(|(model, tag)| plain(model) && is_tag(tag))
}

fn mistyped(error: &(dyn Error + 'static)) -> Option<Mistyped> {
    let owned = |known: &[&str]| known.iter().map(ToString::to_string).collect();
    let listed = |known: &str| known.split(", ").map(str::to_owned).collect();
    // Errors that show another one as their own are no links of the chain; they are opened here.
    if let Some(error) = error.downcast_ref::<RunnerError>() {
        return match error {
            RunnerError::Planner(error) => mistyped(error),
            RunnerError::Split(error) => mistyped(error),
            RunnerError::Scenario(error) => mistyped(error),
            RunnerError::Lab(error) => mistyped(&**error),
            RunnerError::NoSuchType(error) => mistyped(error),
            RunnerError::FindModel(error) => mistyped(&**error),
            _ => None,
        };
    }
    if let Some(RenderError::NoSimulation { wanted, known, .. }) = error.downcast_ref() {
        return Some(Mistyped::new("simulation", wanted, known.clone()));
    }
    if let Some(ReportError {
        fault: ReportFault::NoScenario { part, known },
        ..
    }) = error.downcast_ref()
    {
        return Some(Mistyped::new("scenario", part, known.clone()));
    }
    if let Some(UnknownPlanner { name, known }) = error.downcast_ref() {
        return Some(Mistyped::new("planner", name, known.clone()));
    }
    if let Some(NoSuchType { name, known }) = error.downcast_ref() {
        return Some(Mistyped::new("type", name, known.clone()));
    }
    if let Some(NoPair::UnknownPlanner { name, known, .. }) = error.downcast_ref() {
        return Some(Mistyped::new("planner", name, known.clone()));
    }
    if let Some(error) = error.downcast_ref::<SplitError>() {
        return match error {
            SplitError::Unknown { name, known } => Some(Mistyped::new("split", name, owned(known))),
            SplitError::Reader(error) => mistyped(error),
            SplitError::Retired { .. } => None,
        };
    }
    if let Some(ReaderError::Source(source)) = error.downcast_ref() {
        return mistyped(&**source);
    }
    if let Some(GeneratorError::UnknownType(name)) = error.downcast_ref() {
        let known = types::in_suites().map(|kind| kind.to_string()).collect();
        return Some(Mistyped::new("type", name, known));
    }
    if let Some(MllmError::UnknownModel { name, known, .. }) = error.downcast_ref() {
        return Some(Mistyped::new("model", name, listed(known)));
    }
    if let Some(StudyError::Unknown { word, known }) = error.downcast_ref() {
        return Some(Mistyped::new("study", word, listed(known)));
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_of_ollama_is_known_by_its_form() {
        assert!(is_of_ollama("llava:7b") && is_of_ollama("qwen2.5vl:3b-q8_0"));
        for other in [
            "llava",
            "localhost:99999",
            "org/name:Q8_0",
            "a: b",
            ":7b",
            "a:b:c",
            "C:\\m",
        ] {
            assert!(!is_of_ollama(other), "{other}");
        }
    }

    #[test]
    fn a_generated_scenario_is_known_by_the_end_of_its_name() {
        let meant = |word: &str| generated(Path::new(word));
        for (word, name) in [
            ("changing_lane/2", "generated/changing_lane/2"),
            (
                "/work/generatd/changing_lane/2.low_traffic",
                "generated/changing_lane/2.low_traffic",
            ),
            ("changing_lane", "generated/changing_lane/0"),
        ] {
            assert_eq!(meant(word).as_deref(), Some(name));
        }
        for word in ["changing_lane/x", "changing_lane/2/3", "2", "", "file.db"] {
            assert_eq!(meant(word), None, "{word}");
        }
    }

    #[test]
    fn only_close_names_are_suggested() {
        assert_eq!(nearest("imd", ["plan-agent", "idm", "simple"]), Some("idm"));
        assert_eq!(nearest("telepathy", ["plan-agent", "idm", "simple"]), None);
    }

    #[test]
    fn a_part_of_a_name_suggests_the_name() {
        let planners = [
            "plan-agent",
            "log-replay",
            "idm",
            "pdm-closed",
            "pdm-closed-plus",
            "pdm-open",
            "raster-model",
        ];
        assert_eq!(nearest("pdm", planners), Some("pdm-closed"));
        assert_eq!(nearest("closed", planners), Some("pdm-closed"));
        assert_eq!(nearest("PDM_Closed", planners), Some("pdm-closed"));
        assert_eq!(nearest("planagent", planners), Some("plan-agent"));
        assert_eq!(nearest("raster", planners), Some("raster-model"));
        assert_eq!(
            nearest("pdm-closed-pluss", planners),
            Some("pdm-closed-plus")
        );
        assert_eq!(nearest("xy", planners), None);
        assert_eq!(nearest("the", planners), None);
        assert_eq!(
            nearest("hard", ["generated-test14", "generated-test14-hard"]),
            Some("generated-test14-hard")
        );
    }

    #[test]
    fn one_wrong_word_of_several_is_close() {
        assert_eq!(
            nearest(
                "generated-test14-hrad",
                ["generated-test14", "generated-test14-hard"]
            ),
            Some("generated-test14-hard")
        );
    }
}
