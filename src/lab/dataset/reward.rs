//! The reward of answers at states: what the search or Reflection makes of a model's planner code.

use super::refusal::refusal;
use super::state_name::{OpenState, StateError, StateName};
use planagent_agent::reasoning::{Names, ParseError, Parsed, PlannerCode, parse};
use planagent_agent::reflection::{ReflectionReport, SubScores, Verdict};
use planagent_controls::search::{self, Candidate};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// What a reward measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RewardKind {
    /// The value of the search that labels datasets: nuPlan's score over six seconds, with terms
    /// that break ties.
    Search,
    /// Reflection's score of the plan, from 0 to 1, without a simulation.
    Reflection,
}

impl RewardKind {
    /// Both, with their names.
    pub const NAMED: [(&'static str, Self); 2] =
        [("search", Self::Search), ("reflection", Self::Reflection)];

    /// The value of an answer without a plan: less than that of any plan.
    pub(crate) fn without_plan(self) -> f64 {
        match self {
            // A plan loses less than 5 by what the search subtracts.
            Self::Search => -5.0,
            Self::Reflection => -1.0,
        }
    }
}

/// What became of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RewardOutcome {
    /// Its code was judged, and Reflection accepts its plan.
    Scored,
    /// Its code was judged, and Reflection refuses its plan. It has a value all the same.
    Refused,
    /// It has no code that can be read, or its code stands for no plan here.
    Unreadable,
    /// Its plan cannot be simulated to the end of the horizon.
    Failed,
}

impl RewardOutcome {
    /// Name in files.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Scored => "scored",
            Self::Refused => "refused",
            Self::Unreadable => "unreadable",
            Self::Failed => "failed",
        }
    }

    pub(super) fn from_report(reflection: &ReflectionReport) -> Self {
        match reflection.verdict {
            Verdict::Execute => Self::Scored,
            Verdict::Rethink => Self::Refused,
        }
    }
}

/// The reward of one answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Reward {
    /// By the kind of the reward; that of [`RewardKind::without_plan`] without a plan.
    pub value: f64,
    pub outcome: RewardOutcome,
    /// nuPlan's score over the search's horizon, 0 to 1; none of Reflection's reward, and without
    /// a plan.
    pub score: Option<f64>,
    /// Reflection's score, 0 to 1, and its parts.
    pub reflection: Option<(f64, SubScores)>,
    /// The code as it was read.
    pub code: Option<PlannerCode>,
    /// Why it is not [`RewardOutcome::Scored`]; empty if it is.
    pub reason: String,
}

impl Reward {
    fn without_plan(kind: RewardKind, outcome: RewardOutcome, reason: String) -> Self {
        Self {
            value: kind.without_plan(),
            outcome,
            score: None,
            reflection: None,
            code: None,
            reason,
        }
    }

    fn of_report(
        value: f64,
        score: Option<f64>,
        code: PlannerCode,
        report: &ReflectionReport,
    ) -> Self {
        Self {
            value,
            outcome: RewardOutcome::from_report(report),
            score,
            reflection: Some((report.score, report.parts)),
            code: Some(code),
            reason: refusal(report),
        }
    }
}

/// A state of a batch that is not as a dataset names it.
#[derive(Debug, thiserror::Error)]
#[error("states[{index}]: {source}")]
pub struct RewardError {
    /// Index in the batch, from 0.
    pub index: usize,
    pub source: StateError,
}

/// The rewards of answers at states, in order. Answers at equal states share the simulation that
/// leads there; states are computed in parallel.
///
/// # Errors
/// When a state is not as a dataset names it.
pub fn rewards(
    questions: &[(StateName, String)],
    kind: RewardKind,
) -> Result<Vec<Reward>, RewardError> {
    let mut groups: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for (index, (state, _)) in questions.iter().enumerate() {
        groups.entry(format!("{state:?}")).or_default().push(index);
    }
    let groups: Vec<Vec<usize>> = groups.into_values().collect();
    let judged = groups.par_iter().map(|indices| {
        let first = *indices.first().expect("a group holds an index");
        let state = questions[first].0.open().map_err(|source| RewardError {
            index: first,
            source,
        })?;
        let answers: Vec<&str> = indices.iter().map(|&i| questions[i].1.as_str()).collect();
        Ok::<_, RewardError>((indices, at_state(&state, &answers, kind)))
    });
    let judged: Vec<_> = judged.collect();
    let mut rewards: Vec<Option<Reward>> = vec![None; questions.len()];
    for of_group in judged {
        let (indices, of_state) = of_group?;
        for (&index, reward) in indices.iter().zip(of_state) {
            rewards[index] = Some(reward);
        }
    }
    Ok(rewards.into_iter().flatten().collect())
}

/// The rewards of answers at one state.
fn at_state(state: &OpenState, answers: &[&str], kind: RewardKind) -> Vec<Reward> {
    let OpenState { simulation, graph } = state;
    let names = Names::from_graph(graph);
    let parsed: Vec<Parsed<PlannerCode>> =
        answers.iter().map(|answer| parse(answer, &names)).collect();
    // Answers of a group often have the same code, which is simulated once.
    let mut codes: Vec<PlannerCode> = Vec::new();
    for code in parsed.iter().filter_map(|parsed| parsed.answer) {
        if !codes.contains(&code) {
            codes.push(code);
        }
    }
    let of_codes: Vec<Reward> = match kind {
        RewardKind::Search => codes
            .iter()
            .zip(search::attempts(simulation, graph, &codes))
            .map(|(&code, candidate)| of_search(state, code, candidate))
            .collect(),
        RewardKind::Reflection => codes
            .iter()
            .zip(search::reflections(simulation, graph, &codes))
            .map(|(&code, report)| match report {
                Some(report) => Reward::of_report(report.score, None, code, &report),
                None => no_plan(kind, code),
            })
            .collect(),
    };
    let reward = |parsed: &Parsed<PlannerCode>| {
        let place = codes.iter().position(|code| Some(*code) == parsed.answer);
        match place.and_then(|place| of_codes.get(place)) {
            Some(reward) => reward.clone(),
            None => Reward::without_plan(
                kind,
                RewardOutcome::Unreadable,
                errors_in_words(&parsed.errors),
            ),
        }
    };
    parsed.iter().map(reward).collect()
}

fn of_search(state: &OpenState, code: PlannerCode, candidate: Option<Candidate>) -> Reward {
    let kind = RewardKind::Search;
    match candidate {
        Some(found) => Reward::of_report(found.value, Some(found.score), code, &found.reflection),
        None if search::planner(&state.simulation, &state.graph, code).is_none() => {
            no_plan(kind, code)
        }
        None => Reward {
            code: Some(code),
            ..Reward::without_plan(
                kind,
                RewardOutcome::Failed,
                "the plan cannot be simulated to the end of the search's horizon".to_owned(),
            )
        },
    }
}

fn no_plan(kind: RewardKind, code: PlannerCode) -> Reward {
    Reward {
        code: Some(code),
        ..Reward::without_plan(
            kind,
            RewardOutcome::Unreadable,
            "the line stands for no plan in this scene".to_owned(),
        )
    }
}

/// The errors of an answer in one line.
fn errors_in_words(errors: &[ParseError]) -> String {
    if errors.is_empty() {
        return "the answer has no planner code".to_owned();
    }
    let errors: Vec<String> = errors.iter().map(ToString::to_string).collect();
    errors.join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_agent::environment::TextForm;

    fn state(scenario: &str) -> StateName {
        StateName {
            scenario: scenario.to_owned(),
            seed: 0,
            time_s: 0.0,
            challenge: "reactive".to_owned(),
            scene_text: TextForm::Paper,
            driven: String::new(),
        }
    }

    const LINE: &str = "Generate_IDM_Planner(c=ego_lane, la=None, v0=9, acc=1.5, dec=3)";

    #[test]
    fn answers_are_scored_refused_or_unreadable_in_the_order_of_the_batch() {
        let here = state("generated/changing_lane/3");
        let other = state("generated/stopping_with_lead/1");
        let hard = LINE.replace("v0=9", "v0=13");
        let batch = [
            (here.clone(), LINE.to_owned()),
            (other.clone(), hard.clone()),
            (here.clone(), "I would stop.".to_owned()),
            (here.clone(), LINE.replace("ego_lane", "up")),
            (here.clone(), format!("First the scene. {LINE}")),
        ];
        let found = rewards(&batch, RewardKind::Search).unwrap();
        assert_eq!(found.len(), batch.len());
        assert_eq!(found[0], found[4], "the last line of an answer counts");
        for unreadable in &found[2..4] {
            assert_eq!(unreadable.outcome, RewardOutcome::Unreadable);
            assert!(unreadable.value <= -5.0 && !unreadable.reason.is_empty());
        }
        let alone = rewards(&batch[1..2], RewardKind::Search).unwrap();
        assert_eq!(alone[0].value.to_bits(), found[1].value.to_bits());
        for judged in &found[..2] {
            let (reflection, parts) = judged.reflection.unwrap();
            assert!((0.0..=1.0).contains(&reflection) && parts.no_collision <= 1.0);
            assert_eq!(
                judged.reason.is_empty(),
                judged.outcome == RewardOutcome::Scored
            );
        }
        let reflected = rewards(&batch, RewardKind::Reflection).unwrap();
        for (reflected, searched) in reflected.iter().zip(&found) {
            assert_eq!(reflected.outcome, searched.outcome);
            if let Some((score, _)) = searched.reflection {
                assert_eq!(reflected.value.to_bits(), score.to_bits());
            }
        }
    }

    #[test]
    fn wrong_states_are_named() {
        let of_file = state("/etc/passwd");
        let late = StateName {
            time_s: 1.5,
            ..state("generated/changing_lane/3")
        };
        let broken = StateName {
            driven: "ten iterations".to_owned(),
            ..state("generated/changing_lane/3")
        };
        let long = StateName {
            driven: format!("99999999*{LINE}"),
            ..state("generated/changing_lane/3")
        };
        for (wrong, word) in [
            (of_file, "not generated"),
            (late, "time_s is 1.5"),
            (broken, "driven"),
            (long, "60 s"),
        ] {
            let batch = [
                (state("generated/changing_lane/3"), LINE.to_owned()),
                (wrong, LINE.to_owned()),
            ];
            let error = rewards(&batch, RewardKind::Reflection).unwrap_err();
            let text = error.to_string();
            assert!(error.index == 1 && text.contains(word), "{text}");
        }
    }
}
