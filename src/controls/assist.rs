//! `oracle-llm-assist-unc` and `oracle-llm-assist-par`: LLM-ASSIST with a search in the model's place.
//! Answers are executed in a copy of the simulation for as long as the agent executes them, and
//! PDM-Closed drives on. The best ones, an attempt each, go to the agent, which scores them as a
//! model's.

use crate::assist_answers::{VARIATIONS, limit, own_parameters, waypoints};
use crate::foresight::{self, Foresight};
use crate::trial::value_of_drive;
use planagent_agent::planner::{AssistDrive, HandedAnswers, LlmAssist, Planner};
use planagent_agent::planner_registry::PlannerEntry;
use planagent_agent::reasoning::{AssistVariant, Assistance};
use planagent_agent::simulation::ClosedLoop;
use planagent_world::{HistorySample, STEP_S, SceneView};

/// The planners of these names.
pub(crate) fn entries() -> [PlannerEntry; 2] {
    [
        entry(
            "oracle-llm-assist-unc",
            "LLM-ASSIST with waypoints tried out ahead (a control)",
            AssistVariant::Unconstrained,
        ),
        entry(
            "oracle-llm-assist-par",
            "LLM-ASSIST with parameters tried out ahead (a control)",
            AssistVariant::Parameters,
        ),
    ]
}

fn entry(name: &'static str, summary: &'static str, variant: AssistVariant) -> PlannerEntry {
    foresight::entry(name, summary, move |parts| {
        let answers = HandedAnswers::default();
        let settings = parts.settings.clone();
        Ok(AssistOracle {
            variant,
            attempts: settings.reflection.max_exec,
            planner: LlmAssist::handed(parts.name, answers.clone(), settings),
            answers,
        })
    })
}

/// LLM-ASSIST whose answers are tried out ahead.
struct AssistOracle {
    planner: LlmAssist,
    answers: HandedAnswers,
    variant: AssistVariant,
    /// Attempts of a planning call.
    attempts: usize,
}

impl Foresight for AssistOracle {
    fn planner(&self) -> &dyn Planner {
        &self.planner
    }

    fn planner_mut(&mut self) -> &mut dyn Planner {
        &mut self.planner
    }

    fn begins_with_call(&self, scene: &SceneView<'_>) -> bool {
        self.planner.begins_with_call(scene)
    }

    /// Hands the best answers over. Near the end of the recording the search looks no further than
    /// that; where it finds nothing, PDM-Closed drives.
    fn look_ahead(&mut self, simulation: &ClosedLoop<'static>, _: &[HistorySample]) {
        let search = Search {
            simulation,
            drive: self.planner.drive(),
            steps: (self.planner.answer_s() / STEP_S).round() as usize,
        };
        let mut tried = match self.variant {
            AssistVariant::Unconstrained => search.waypoints(),
            AssistVariant::Parameters => search.parameters(),
        };
        // PDM-Closed's own answer was tried first, and a stable order keeps it before its equals.
        tried.sort_by(|a, b| b.value.total_cmp(&a.value));
        let best = tried.into_iter().take(self.attempts);
        self.answers.hand(best.map(|tried| tried.answer));
    }
}

/// An answer with the value of its drive.
struct Tried {
    answer: Assistance,
    value: f64,
}

/// The state from which answers are tried out.
struct Search<'a> {
    simulation: &'a ClosedLoop<'static>,
    drive: &'a AssistDrive,
    /// Steps for which an answer is executed.
    steps: usize,
}

impl Search<'_> {
    /// All waypoints around PDM-Closed's path.
    fn waypoints(&self) -> Vec<Tried> {
        let scene = self.simulation.scene();
        let mut drive = self.drive.clone();
        let Ok(rules) = drive.rules(&scene) else {
            return Vec::new();
        };
        let lists = drive.reference_path().into_iter();
        lists
            .flat_map(|path| waypoints(&scene, path, &rules))
            .filter_map(|list| self.tried(Assistance::Waypoints(list)))
            .collect()
    }

    /// PDM-Closed's own parameters, then the values of one parameter after the other beside the best
    /// so far: all combinations would be 2,048.
    fn parameters(&self) -> Vec<Tried> {
        let scene = self.simulation.scene();
        let mut drive = self.drive.clone();
        if drive.rules(&scene).is_err() {
            return Vec::new();
        }
        let Some(limit) = drive.reference_path().map(|path| limit(&scene, path)) else {
            return Vec::new();
        };
        let mut best = own_parameters();
        let mut tried: Vec<Tried> = self
            .tried(Assistance::Parameters(best))
            .into_iter()
            .collect();
        let mut most = tried.first().map_or(f64::NEG_INFINITY, |own| own.value);
        // From the best so far on, since the parameters act together.
        for vary in VARIATIONS {
            let from = best;
            for parameters in vary(from, limit) {
                let answer = Assistance::Parameters(parameters);
                if tried.iter().any(|earlier| earlier.answer == answer) {
                    continue;
                }
                let Some(new) = self.tried(answer) else {
                    continue;
                };
                if new.value > most {
                    (best, most) = (parameters, new.value);
                }
                tried.push(new);
            }
        }
        tried
    }

    /// Executes an answer; `None` where its drive cannot be scored.
    fn tried(&self, answer: Assistance) -> Option<Tried> {
        let mut drive = self.drive.clone();
        let value = value_of_drive(self.simulation, |scene, step| {
            let rules = drive.rules(scene).ok()?;
            if step == 0 {
                drive.begin(&answer, scene.ego).ok()?;
            } else if step == self.steps {
                drive.end();
            }
            drive.trajectory(scene, rules).ok()
        })?;
        Some(Tried { answer, value })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::simulation;

    fn search<'a>(simulation: &'a ClosedLoop<'static>, drive: &'a AssistDrive) -> Search<'a> {
        Search {
            simulation,
            drive,
            steps: 20,
        }
    }

    #[test]
    fn pdm_closeds_own_parameters_drive_as_it_does() {
        let (simulation, mut drive) = (simulation(), AssistDrive::default());
        let own = search(&simulation, &drive.clone())
            .tried(Assistance::Parameters(own_parameters()))
            .unwrap();
        let rules = value_of_drive(&simulation, |scene, _| {
            Some(drive.rules(scene).ok()?.trajectory)
        });
        assert_eq!(Some(own.value), rules);
    }

    #[test]
    fn a_search_begins_with_pdm_closed_and_tries_no_answer_twice() {
        let (simulation, drive) = (simulation(), AssistDrive::default());
        let tried = search(&simulation, &drive).parameters();
        assert_eq!(tried[0].answer, Assistance::Parameters(own_parameters()));
        let highest = tried.iter().map(|tried| tried.value).fold(0.0, f64::max);
        assert!(highest >= tried[0].value);
        for (i, one) in tried.iter().enumerate() {
            assert!(tried[..i].iter().all(|other| other.answer != one.answer));
        }
    }

    #[test]
    fn waypoints_of_pdm_closeds_plan_drive_about_as_it_does() {
        let (simulation, drive) = (simulation(), AssistDrive::default());
        let tried = search(&simulation, &drive).waypoints();
        assert_eq!(tried.len(), 26);
        let own = search(&simulation, &drive).tried(Assistance::Parameters(own_parameters()));
        let own = own.unwrap().value;
        assert!(
            (tried[0].value - own).abs() < 0.1,
            "{} {own}",
            tried[0].value
        );
        let values = || tried.iter().map(|tried| tried.value);
        let lowest = values().fold(f64::INFINITY, f64::min);
        assert!(lowest < own - 0.05, "a hard brake or another lane costs");
    }
}
