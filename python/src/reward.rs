//! Rewards of answers at states of a dataset.

use crate::errors::Failure;
use crate::trajectory::{array, packed};
use crate::work::{computed, long};
use planagent_agent::reflection::SubScores;
use planagent_lab::dataset::{Reward, RewardKind, StateName, rewards as rewards_of};
use pyo3::prelude::*;
use pyo3::types::PyByteArray;

/// What became of each answer, why, and its code.
type Texts = (Vec<&'static str>, Vec<String>, Vec<Option<String>>);

/// The numbers of a reward: value, nuPlan's score, Reflection's score, and its six parts; NaN for
/// what there is not.
fn numbers(reward: &Reward) -> [f64; 9] {
    let (reflection, parts) = reward.reflection.unwrap_or((
        f64::NAN,
        SubScores {
            no_collision: f64::NAN,
            drivable_area: f64::NAN,
            driving_direction: f64::NAN,
            progress: f64::NAN,
            time_to_collision: f64::NAN,
            comfort: f64::NAN,
        },
    ));
    [
        reward.value,
        reward.score.unwrap_or(f64::NAN),
        reflection,
        parts.no_collision,
        parts.drivable_area,
        parts.driving_direction,
        parts.progress,
        parts.time_to_collision,
        parts.comfort,
    ]
}

/// The rewards of answers at states, which are JSON; nine numbers for each, and texts.
#[pyfunction]
pub(crate) fn rewards<'py>(
    py: Python<'py>,
    states: Vec<String>,
    answers: Vec<String>,
    kind: &str,
) -> PyResult<(Bound<'py, PyByteArray>, Texts)> {
    // The work runs on a thread of its own, without the GIL, so it borrows nothing of Python.
    let kind = kind.to_owned();
    let work = move || {
        let known = RewardKind::NAMED.iter().find(|(name, _)| *name == kind);
        let Some(&(_, kind)) = known else {
            let names: Vec<&str> = RewardKind::NAMED.iter().map(|(name, _)| *name).collect();
            return Err(Failure::argument(format!(
                "kind is '{kind}'; expected one of: {}",
                names.join(", ")
            )));
        };
        let mut questions = Vec::with_capacity(states.len());
        for (index, (state, answer)) in states.iter().zip(answers).enumerate() {
            let state: StateName = serde_json::from_str(state)
                .map_err(|error| Failure::argument(format!("states[{index}]: {error}")))?;
            questions.push((state, answer));
        }
        rewards_of(&questions, kind).map_err(|error| Failure::argument(error.to_string()))
    };
    let found = long(py, || computed(work), &|| ())?;
    let texts = (
        found.iter().map(|reward| reward.outcome.as_str()).collect(),
        found.iter().map(|reward| reward.reason.clone()).collect(),
        found
            .iter()
            .map(|reward| reward.code.map(|code| code.to_string()))
            .collect(),
    );
    Ok((array(py, &packed(found.iter().flat_map(numbers))), texts))
}
