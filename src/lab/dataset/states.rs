//! The labeled states of one scenario.

use super::label::{self, LabeledState, RefusedCode};
use super::label_weights::DecisionWeights;
use super::lessons::lessons;
use super::{Settings, scenes};
use image::RgbImage;
use planagent_agent::environment::{
    BevView, DEFAULT_NODE_LENGTH, GraphedScene, LaneGraph, LaneGraphError, OccupancyGrid,
    SceneFacts, TextForm, bev,
};
use planagent_agent::planner::{AgentLayer, Attempt, Planner, PlannerInput, ReflectionSettings};
use planagent_agent::reasoning::{Feedback, PlannerCode, PromptError, feedback_text};
use planagent_agent::reflection::Verdict;
use planagent_agent::simulation::{Challenge, ClosedLoop};
use planagent_controls::search::{self, Candidate};
use planagent_scenario::generator::Spec;
use planagent_score::pdm::PdmMemory;
use planagent_world::SceneView;
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

/// A state that a walk through a scenario comes to, with what the search found there.
pub(crate) struct VisitedState<'a> {
    pub(crate) simulation: &'a ClosedLoop<'a>,
    pub(crate) challenge: Challenge,
    pub(crate) graph: &'a LaneGraph,
    pub(crate) facts: &'a SceneFacts,
    /// What the search tried.
    pub(crate) tried: &'a [Candidate],
    pub(crate) best: &'a Candidate,
    /// The BEV map in the view of the settings.
    pub(crate) image: &'a RgbImage,
    /// Grids of the state, now and [`LATER`].
    pub(crate) occupancy: &'a [String; 3],
    /// The codes that controlled the ego before, each with its iterations; none where a model did.
    pub(crate) driven: &'a [(PlannerCode, usize)],
}

impl VisitedState<'_> {
    /// Time after the start of the scenario, seconds.
    pub(crate) fn time_s(&self) -> f64 {
        self.simulation.iteration() as f64 * planagent_world::STEP_S
    }
}

/// The lane graph of a scene as a prompt set with this form of text sees it.
pub(super) fn lane_graph(
    scene: &SceneView<'_>,
    form: TextForm,
) -> Result<LaneGraph, LaneGraphError> {
    let mut graph = LaneGraph::build(scene, DEFAULT_NODE_LENGTH)?;
    if form.names_oncoming_lane() {
        graph = graph.with_oncoming_lane(scene);
    }
    if !form.names_goal() {
        graph.goal = None;
    }
    Ok(graph)
}

/// Labeled states of one scenario; none if the generator discards all its draws.
pub(super) fn label_scenario(
    spec: &Spec,
    settings: &Settings<'_>,
) -> Result<Vec<(LabeledState, RgbImage)>, PromptError> {
    walk(spec, settings, &|visited, feedback| {
        let VisitedState {
            graph,
            facts,
            tried,
            best,
            ..
        } = *visited;
        // After a rejection another attempt costs nothing more, so the decisions weigh differently.
        let weights = DecisionWeights::from_candidates(best, tried, feedback.is_some());
        let lessons = lessons(best, tried, feedback.is_some());
        let feedback = feedback
            .map(|feedback| feedback_text(settings.prompts, &feedback))
            .transpose()?;
        let name = format!(
            "{}@{:.1}",
            visited.simulation.scenario().id,
            visited.time_s()
        );
        let label = label::label(
            name,
            graph,
            facts,
            best,
            weights,
            settings.prompts,
            feedback.as_deref(),
        )?;
        let refused = RefusedCode::among(tried);
        let tried = label::tried_codes(graph, facts, &lessons, settings.prompts);
        let label = LabeledState {
            occupancy: visited.occupancy.clone(),
            tried,
            refused,
            ..label
        };
        Ok((label, visited.image.clone()))
    })
}

/// What is made of a visited state, perhaps with feedback on a rejected code.
pub(crate) type Make<'m, T> =
    dyn Fn(&VisitedState<'_>, Option<Feedback>) -> Result<T, PromptError> + 'm;

/// Makes something of each state of one scenario, perhaps with feedback on a rejected code. The same
/// settings lead to the same states, whatever is made of them.
pub(crate) fn walk<T>(
    spec: &Spec,
    settings: &Settings<'_>,
    make: &Make<'_, T>,
) -> Result<Vec<T>, PromptError> {
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
    let (mut states, mut driven) = (Vec::new(), Vec::new());
    loop {
        let scene = simulation.scene();
        let Ok(graph) = lane_graph(&scene, settings.prompts.forms().scene_text) else {
            break;
        };
        let tried = search::search(&simulation, &graph);
        let Some(best) = search::best(&tried) else {
            break;
        };
        let facts = SceneFacts::from_scene(GraphedScene::new(&scene, &graph));
        let image = bev::render(&scene, &settings.view);
        let Some(occupancy) = occupancy(&simulation, &graph, best, &settings.view) else {
            break;
        };
        let visited = VisitedState {
            simulation: &simulation,
            challenge,
            graph: &graph,
            facts: &facts,
            tried: &tried,
            best,
            image: &image,
            occupancy: &occupancy,
            driven: &driven,
        };
        let mut note = |feedback: Option<Feedback>| -> Result<(), PromptError> {
            states.push(make(&visited, feedback)?);
            Ok(())
        };
        let mut code = None;
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
            note(None)?;
            let call = agent.calls().last();
            for rejected in call
                .iter()
                .flat_map(|call| &call.attempts)
                .filter(|attempt| is_rejected(attempt))
            {
                note(Some(
                    rejected.feedback(ReflectionSettings::default().threshold),
                ))?;
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
            note(reported.map(|candidate| candidate.feedback()))?;
            let next = if random.random_bool(EXPLORE) {
                tried.choose(&mut random).unwrap_or(best)
            } else {
                best
            };
            code = Some(next.code);
            search::planner(&simulation, &graph, next.code)
        };
        let Some(planner) = planner else { break };
        let gap = random.random_range(GAP);
        driven.extend(code.map(|code| (code, gap)));
        if search::follow(&mut simulation, &planner, &mut PdmMemory::default(), gap).is_none() {
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
