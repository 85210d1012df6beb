//! What a model is asked at a state: as it is, with another picture and without, and with changed
//! answers. Reflection is off, since a card asks about the first code.

use super::changes::{CHANGES, Change};
use super::error::CardError;
use super::given::GivenAnswers;
use super::state_record::{Answered, ChangedAnswer, StateRecord};
use crate::dataset::VisitedState;
use crate::twins::first_call;
use planagent_agent::planner::{CodeSource, Latency};
use planagent_agent::reasoning::{Names, PlannerAnswer, PlannerCode, Round};
use planagent_controls::search;
use planagent_runs::worker::run::AgentParts;
use std::sync::Arc;

/// The questions at each state.
pub(super) struct Questions {
    parts: AgentParts,
    /// Whether the model sees the picture.
    sees: bool,
    rounds: Vec<Round>,
}

/// The answers to one question, with the code as it was read.
struct Asked {
    answers: Vec<String>,
    code: Option<PlannerCode>,
    log_probability: Option<f64>,
}

impl Questions {
    /// The questions to the model of an agent; `takes` says whether it takes a picture at all.
    pub(super) fn new(parts: &AgentParts, takes: bool) -> Self {
        let mut parts = parts.clone();
        parts.settings.reflection.enabled = false;
        parts.settings.agent.gate = None;
        parts.settings.agent.latency = Latency::None;
        let rounds = match &parts.model {
            Some(CodeSource::Model { reasoning, .. }) => reasoning.rounds.clone(),
            _ => Vec::new(),
        };
        Self {
            sees: takes && parts.settings.environment.bev,
            rounds,
            parts,
        }
    }

    /// The questions in words: other ones have other answers.
    pub(super) fn in_words(&self) -> String {
        format!("{} {:?} {CHANGES:?}", self.sees, self.rounds)
    }

    /// Asks all of them at a state; none where the model was interrupted.
    pub(super) fn ask(
        &self,
        visited: &VisitedState<'_>,
        scene: &str,
    ) -> Result<Option<StateRecord>, CardError> {
        let at = |parts: &AgentParts| ask_once(parts, visited, scene);
        let Some(own) = at(&self.parts)? else {
            return Ok(None);
        };
        // The control of all changes: given answers alone must change nothing.
        let before_code = own.answers.len().saturating_sub(1);
        let given = own.answers.iter().take(before_code).cloned().collect();
        let Some(again) = at(&self.given(given))? else {
            return Ok(None);
        };
        let (mut other_picture, mut no_picture) = (None, None);
        if self.sees {
            let [shuffled, blind] = self.with_other_pictures();
            let (Some(other), Some(none)) = (at(&shuffled)?, at(&blind)?) else {
                return Ok(None);
            };
            other_picture = Some(other.answered(visited));
            no_picture = Some(none.answered(visited));
        }
        let mut changes = Vec::new();
        for (change, answers) in self.changes(&own, &Names::from_graph(visited.graph)) {
            let Some(changed) = at(&self.given(answers))? else {
                return Ok(None);
            };
            let agrees = |new: &PlannerCode| {
                own.code
                    .is_some_and(|own| change.expected.agrees(&own, new))
            };
            changes.push(ChangedAnswer {
                change: change.name.to_owned(),
                code: changed.code.map(|code| code.to_string()),
                agrees: changed.code.as_ref().is_some_and(agrees),
            });
        }
        Ok(Some(StateRecord {
            scene: scene.to_owned(),
            time_s: visited.time_s(),
            challenge: visited.challenge.to_string(),
            best: visited.best.code.to_string(),
            best_value: visited.best.value,
            own: own.answered(visited),
            again: again.code.map(|code| code.to_string()),
            other_picture,
            no_picture,
            changes,
        }))
    }

    /// The agent whose model gives these answers first.
    fn given(&self, answers: Vec<String>) -> AgentParts {
        let mut parts = self.parts.clone();
        if let Some(CodeSource::Model {
            model,
            prompts,
            reasoning,
        }) = &self.parts.model
        {
            // What is empty cannot be forced, and a repeatable model says it again.
            let given = |answer: String| Some(answer).filter(|answer| !answer.is_empty());
            let model = GivenAnswers {
                model: Arc::clone(model),
                answers: answers.into_iter().map(given).collect(),
            };
            parts.model = Some(CodeSource::Model {
                model: Arc::new(model),
                prompts: Arc::clone(prompts),
                reasoning: reasoning.clone(),
            });
        }
        parts
    }

    /// The agent with the picture of another scene, and without one.
    fn with_other_pictures(&self) -> [AgentParts; 2] {
        let (mut shuffled, mut blind) = (self.parts.clone(), self.parts.clone());
        shuffled.settings.environment.shuffled_bev = true;
        blind.settings.environment.bev = false;
        [shuffled, blind]
    }

    /// The changes that a state allows, each with the answers up to the changed one.
    fn changes(&self, own: &Asked, names: &Names) -> Vec<(&'static Change, Vec<String>)> {
        let Some(code) = own.code else {
            return Vec::new();
        };
        let answers = |change: &'static Change| {
            let turn = self
                .rounds
                .iter()
                .position(|round| *round == change.round)?;
            let changed = change.of_answer(own.answers.get(turn)?)?;
            let before = own.answers.iter().take(turn).cloned();
            Some((change, before.chain([changed]).collect()))
        };
        CHANGES
            .iter()
            .filter(|change| change.expected.can_be_met(&code, names))
            .filter_map(answers)
            .collect()
    }
}

impl Asked {
    fn answered(&self, visited: &VisitedState<'_>) -> Answered {
        let value = |code: PlannerCode| {
            let tried = visited.tried.iter().find(|tried| tried.code == code);
            tried.map(|tried| tried.value).or_else(|| {
                search::attempt(visited.simulation, visited.graph, code).map(|found| found.value)
            })
        };
        Answered {
            answers: self.answers.clone(),
            code: self.code.map(|code| code.to_string()),
            log_probability: self.log_probability,
            value: self.code.and_then(value),
        }
    }
}

/// Asks an agent's model once; none where it was interrupted.
fn ask_once(
    parts: &AgentParts,
    visited: &VisitedState<'_>,
    state: &str,
) -> Result<Option<Asked>, CardError> {
    let simulation = visited.simulation;
    let call = first_call(parts, &simulation.scenario().id, simulation.scene())?;
    let call = call.map_err(|fault| CardError::Call {
        state: state.to_owned(),
        fault,
    })?;
    if call.interruption().is_some() {
        return Ok(None);
    }
    let attempt = call.attempts.first();
    let rounds = attempt.map_or(&[][..], |attempt| attempt.rounds.as_slice());
    Ok(Some(Asked {
        answers: rounds.iter().map(|round| round.answer.clone()).collect(),
        code: attempt
            .and_then(|attempt| attempt.answer.as_ref())
            .and_then(PlannerAnswer::code),
        log_probability: rounds.last().and_then(|round| round.log_probability),
    }))
}
