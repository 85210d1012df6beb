//! Makes a card: asks the model at states and in text twins, simulates, and writes the page.

use super::calibration::Calibration;
use super::content::{Card, CardModel, FORMAT, StateCounts};
use super::error::CardError;
use super::estimate::Estimate;
use super::measured::CallCost;
use super::outcome::Part;
use super::page;
use super::pictures;
use super::reasoning::Reasoning;
use super::sections::{Section, sections};
use super::simulations::{Loop, RUNS};
use super::states::{self, AskedStates};
use crate::report::StudyFolder;
use crate::study_runs::judge_twins;
use crate::twins;
use planagent_agent::planner::Latency;
use planagent_agent::reasoning::{PromptForms, Round};
use planagent_files::quoted;
use planagent_mllm::ModelDescription;
use planagent_runs::report::SimulationRow;
use planagent_runs::runner::model::OpenModel;
use planagent_runs::runner::{Config, Listener, RESULT_VERSION, RunnerError};
use planagent_runs::worker::statistics::Bootstrap;
use std::path::{MAIN_SEPARATOR, Path, PathBuf};

/// Scenes of a suite, and pairs of text twins, of a card that names no number. With nano, two idle
/// cores make it in less than half an hour.
pub const DEFAULT_LIMIT: usize = 140;
/// States for each scene of a suite.
const STATES_PER_SCENE: usize = 4;

/// What a card is asked for.
#[derive(Debug, Clone)]
pub struct CardRequest {
    /// Folder for the card and its runs.
    pub out: PathBuf,
    /// Scenes of a suite.
    pub limit: usize,
    /// An earlier card, whose measured times are taken.
    pub latency_of: Option<PathBuf>,
    /// Whether to repeat failed simulations.
    pub retry_failed: bool,
}

/// A card that was made.
#[derive(Debug, Clone, PartialEq)]
pub struct CardMade {
    /// `card.json`.
    pub json: serde_json::Value,
    /// The page.
    pub sections: Vec<Section>,
    /// The simulations that failed.
    pub failed: Vec<SimulationRow>,
    /// Planning calls, and questions at states, without an answer.
    pub unanswered: usize,
}

/// The model of a card, without its weights.
struct Subject {
    about: ModelDescription,
    card: CardModel,
    rounds: Vec<Round>,
    forms: PromptForms,
    /// Whether codes may name the oncoming lane.
    oncoming: bool,
}

/// Makes the card of the configured model. What was asked and simulated before in its folder stays.
///
/// # Errors
/// When the request, the model or a folder cannot be used.
pub fn make(
    request: &CardRequest,
    config: &Config,
    listener: &Listener,
) -> Result<CardMade, RunnerError> {
    // What is wrong is said before the model loads.
    let earlier = check(request, config)?;
    let runs = request.out.join(RUNS);
    let (subject, asked) = ask(request, config, &runs, listener)?;
    let sees = subject.card.sees;
    let twins = if sees {
        let list = (
            twins::TEST.to_owned(),
            twins::evenly(&twins::test(), request.limit),
        );
        Part::Known(judge_twins(&list, config, &runs, listener)?)
    } else {
        Part::missing("the model sees no picture, so both scenes of a pair are one to it")
    };
    let loop_of = Loop {
        out: &request.out,
        limit: request.limit,
        retry_failed: request.retry_failed,
        sees,
        oncoming: subject.oncoming,
    };
    let simulated = loop_of.simulate(earlier, config, listener)?;
    let records = &asked.records;
    let card = Card {
        format: FORMAT,
        planagent: env!("CARGO_PKG_VERSION"),
        result_version: RESULT_VERSION,
        command: command(request, config)?,
        seed: config.seed,
        limit: request.limit,
        bootstrap: Bootstrap::default(),
        scores: simulated.scores,
        calls: simulated.calls,
        states: StateCounts {
            asked: records.len(),
            unanswered: asked.unanswered,
        },
        calibration: Calibration::new(records, no_probabilities(&subject, config)),
        pictures: if sees {
            Part::Known(pictures::compare(records))
        } else {
            Part::missing("the model sees no picture")
        },
        twins,
        reasoning: Reasoning::new(records, &subject.rounds, &subject.forms),
        measured: simulated.measured,
        model: subject.card,
    };
    let sections = sections(&card);
    Ok(CardMade {
        json: page::write(&request.out, &card, &sections)?,
        sections,
        failed: simulated.failed,
        unanswered: simulated.unanswered + asked.unanswered,
    })
}

/// Refuses what no card can be made of, before the model loads; gives the times of an earlier card.
fn check(request: &CardRequest, config: &Config) -> Result<Option<CallCost>, RunnerError> {
    if request.limit == 0 {
        return Err(CardError::LimitZero.into());
    }
    if config.agent.latency != Latency::None {
        return Err(CardError::Setting {
            key: "agent.latency",
            why: "measures the latency by itself",
        }
        .into());
    }
    if config.agent.deadline_ms.is_some() {
        return Err(CardError::Setting {
            key: "agent.deadline_ms",
            why: "must not depend on the speed of the machine",
        }
        .into());
    }
    let earlier = request.latency_of.as_deref().map(CallCost::read);
    let earlier = earlier.transpose()?;
    StudyFolder::new(request.out.clone()).check(page::OWN, page::OWN_MARK)?;
    Ok(earlier)
}

/// Asks the model at states. Its weights are dropped before others load them.
fn ask(
    request: &CardRequest,
    config: &Config,
    runs: &Path,
    listener: &Listener,
) -> Result<(Subject, AskedStates), RunnerError> {
    let loaded = OpenModel::open(config, listener)?.with_prompts(config)?;
    loaded.probe(config, listener)?;
    let (_, prompts, reasoning) = loaded
        .parts()
        .ok_or(CardError::Twin(twins::TwinError::NoModel))?;
    let about = loaded.about.clone();
    let sees = about.image_size.is_some() && config.environment.bev;
    let mut card = CardModel::new(&about, sees, prompts.name(), prompts.blake3());
    if let Some(adapter) = &mut card.adapter {
        adapter.path = from_here(&adapter.path);
    }
    let subject = Subject {
        card,
        about,
        rounds: reasoning.rounds.clone(),
        forms: *prompts.forms(),
        oncoming: prompts.forms().scene_text.names_oncoming_lane()
            && config.environment.oncoming_lane != Some(false),
    };
    let wanted = request.limit.saturating_mul(STATES_PER_SCENE);
    let estimate = Estimate {
        states: wanted,
        pairs: if sees {
            twins::evenly(&twins::test(), request.limit).len()
        } else {
            0
        },
        scenes: request.limit,
        sees,
    };
    // The first answers are the first measurement of the model's speed.
    let tell = |time| estimate.tell(time, listener);
    let asked = states::ask(wanted, &loaded, config, runs, (listener, &tell))?;
    Ok((subject, asked))
}

/// Why answers have no probabilities, if they have none.
fn no_probabilities(subject: &Subject, config: &Config) -> &'static str {
    if subject.about.server.is_some() {
        "the server gives no probabilities"
    } else if config.reasoning.grammar {
        "no code was read"
    } else {
        "without a grammar there are no choices that have a probability"
    }
}

/// The command that makes the same card. Where it is written, and whose times it takes, is no part
/// of it.
fn command(request: &CardRequest, config: &Config) -> Result<String, RunnerError> {
    let mut words = vec![
        "planagent card".to_owned(),
        format!("--model {}", quoted(&from_here(&config.mllm.model))),
        format!("--limit {}", request.limit),
    ];
    for (key, value) in config.changes()? {
        if key == "mllm.model" {
            continue;
        }
        let value = value
            .as_str()
            .map_or_else(|| value.to_string(), str::to_owned);
        words.push(format!(
            "--set {}",
            quoted(&format!("{key}={}", from_here(&value)))
        ));
    }
    Ok(words.join(" "))
}

/// A setting as a user in the working directory writes it. Settings have absolute paths, and a card
/// is to be shown.
fn from_here(setting: &str) -> String {
    match std::env::current_dir() {
        Ok(here) => setting.replace(&format!("{}{MAIN_SEPARATOR}", here.display()), ""),
        Err(_) => setting.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_has_paths_from_the_working_directory() {
        let mut config = Config::default();
        let model = std::env::current_dir().unwrap().join("models");
        config.mllm.model = model.join("own").display().to_string();
        let request = CardRequest {
            out: PathBuf::from("card"),
            limit: 3,
            latency_of: None,
            retry_failed: false,
        };
        let expected = Path::new("models").join("own");
        assert_eq!(
            command(&request, &config).unwrap(),
            format!("planagent card --model {} --limit 3", expected.display())
        );
        config.mllm.model = "nano".to_owned();
        let of_name = command(&request, &config).unwrap();
        assert_eq!(of_name, "planagent card --model nano --limit 3");
    }
}
