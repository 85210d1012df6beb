//! The labeled states of one scenario.

use super::label::{self, LabeledState};
use super::label_weights::DecisionWeights;
use super::lessons::lessons;
use super::{Settings, scenes};
use image::RgbImage;
use planagent_agent::environment::{
    BevView, GraphedScene, LaneGraph, OccupancyGrid, SceneFacts, bev,
};
use planagent_agent::planner::{AgentLayer, Attempt, Planner, PlannerInput};
use planagent_agent::reasoning::{Feedback, PromptError, feedback_text};
use planagent_agent::reflection::Verdict;
use planagent_agent::simulation::{Challenge, ClosedLoop};
use planagent_controls::search::{self, Candidate};
use planagent_scenario::generator::Spec;
use planagent_score::pdm::PdmMemory;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Iterations between two states of a scenario, uniformly random.
const GAP: std::ops::RangeInclusive<usize> = 14..=24;
/// Share of states after which a random candidate controls the ego, so that the dataset has states
/// off the best path.
const EXPLORE: f64 = 0.35;
/// Share of the states with a rejected candidate whose prompt reports it.
const RETHINK: f64 = 0.4;
/// Iterations of the occupancy grids after the state: 1 s and 2 s.
const LATER: [usize; 2] = [10, 20];

/// Labeled states of one scenario; none if the generator discards all its draws.
pub(super) fn label_scenario(
    spec: &Spec,
    settings: &Settings<'_>,
) -> Result<Vec<(LabeledState, RgbImage)>, PromptError> {
    let mut random =
        Pcg64Mcg::seed_from_u64(settings.seed ^ spec.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15));
    let Some(scenario) = scenes::scenario(spec, settings) else {
        return Ok(Vec::new());
    };
    let challenge = Challenge::CLOSED_LOOP[usize::from(random.random_bool(0.5))];
    let Ok(mut simulation) = ClosedLoop::new(&scenario, challenge) else {
        return Ok(Vec::new());
    };
    let mut agent = settings.driver.and_then(|parts| parts.agent(&scenario.id));
    let mut states = Vec::new();
    loop {
        let scene = simulation.scene();
        let Ok(mut graph) =
            LaneGraph::build(&scene, planagent_agent::environment::DEFAULT_NODE_LENGTH)
        else {
            break;
        };
        let form = settings.prompts.forms().scene_text;
        if form.names_oncoming_lane() {
            graph = graph.with_oncoming_lane(&scene);
        }
        if !form.names_goal() {
            graph.goal = None;
        }
        let tried = search::search(&simulation, &graph);
        let Some(best) = search::best(&tried) else {
            break;
        };
        let facts = SceneFacts::from_scene(GraphedScene::new(&scene, &graph));
        let name = format!(
            "{}@{:.1}",
            scenario.id,
            simulation.iteration() as f64 * planagent_world::STEP_S
        );
        let image = bev::render(&scene, &settings.view);
        let Some(occupancy) = occupancy(&simulation, &graph, best, &settings.view) else {
            break;
        };
        let mut label = |feedback: Option<Feedback>| -> Result<(), PromptError> {
            let weights = DecisionWeights::from_candidates(best, &tried, feedback.is_some());
            let lessons = lessons(best, &tried, feedback.is_some());
            let feedback = feedback
                .map(|feedback| feedback_text(settings.prompts, &feedback))
                .transpose()?;
            let label = label::label(
                name.clone(),
                &graph,
                &facts,
                best,
                weights,
                settings.prompts,
                feedback.as_deref(),
            )?;
            let tried = label::tried_codes(&graph, &facts, &lessons, settings.prompts);
            states.push((
                LabeledState {
                    occupancy: occupancy.clone(),
                    tried,
                    ..label
                },
                image.clone(),
            ));
            Ok(())
        };
        // The label is also the right answer after a rejection: it is accepted, or it is the best
        // of the rejected.
        let planner = if let Some(agent) = &mut agent {
            agent.state_mut().request_call();
            if agent
                .compute_trajectory(&PlannerInput {
                    iteration: 0,
                    scene,
                })
                .is_err()
            {
                break;
            }
            label(None)?;
            let call = agent.calls().last();
            for rejected in call
                .iter()
                .flat_map(|call| &call.attempts)
                .filter(|attempt| is_rejected(attempt))
            {
                label(Some(rejected.feedback(search::THRESHOLD)))?;
            }
            agent.state().active_plan().cloned()
        } else {
            let rejected: Vec<&Candidate> = tried
                .iter()
                .filter(|t| !t.is_accepted() && *t != best)
                .collect();
            let reported = rejected
                .choose(&mut random)
                .filter(|_| random.random_bool(RETHINK));
            label(reported.map(|candidate| candidate.feedback()))?;
            let next = if random.random_bool(EXPLORE) {
                tried.choose(&mut random).unwrap_or(best)
            } else {
                best
            };
            search::planner(&simulation, &graph, next.code)
        };
        let Some(planner) = planner else { break };
        if search::follow(
            &mut simulation,
            &planner,
            &mut PdmMemory::default(),
            random.random_range(GAP),
        )
        .is_none()
        {
            break;
        }
    }
    Ok(states)
}

fn is_rejected(attempt: &Attempt) -> bool {
    attempt
        .reflection
        .as_ref()
        .is_some_and(|report| report.verdict == Verdict::Rethink)
}

/// The grids of a state, now and [`LATER`], while the ego follows the labeled planner, all in the
/// picture of now. None if the simulation ends before.
pub(super) fn occupancy(
    simulation: &ClosedLoop<'_>,
    graph: &LaneGraph,
    best: &Candidate,
    view: &BevView,
) -> Option<[String; 3]> {
    let center = simulation.present().ego.center();
    let planner = search::planner(simulation, graph, best.code)?;
    let mut future = simulation.clone();
    let [soon, late] = LATER;
    let samples = search::follow(&mut future, &planner, &mut PdmMemory::default(), late)?;
    if samples.len() < late {
        return None;
    }
    let grid = |objects: &_| OccupancyGrid::from_objects(objects, view, center).to_string();
    Some([
        grid(&samples.first()?.objects),
        grid(&samples.get(soon)?.objects),
        grid(&future.present().objects),
    ])
}
