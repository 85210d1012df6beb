//! Where the agent's planner codes come from: a vision-language model, or a baseline without one.

use crate::environment::{AgentName, CenterlineName, LaneGraph};
use crate::reasoning::{
    ACCELERATIONS, AnswerHistory, DECELERATIONS, Feedback, Names, Parsed, PlannerCode, PromptSet,
    Reasoning, ReasoningError, ReasoningSettings, ReasoningTrace, ScenarioPrompt, parse,
    target_speeds,
};
use planagent_mllm::{Deadline, Mllm};
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::sync::{Arc, Mutex, PoisonError};

/// acc and dec of the fixed code, m/s²; the label search of nano prefers them too.
pub const DEFAULT_ACCELERATIONS: (f64, f64) = (1.5, 3.0);
/// Desired speeds of the grid, as fractions of the limit.
const GRID_SPEEDS: [f64; 7] = [1.0, 0.85, 0.7, 0.55, 0.4, 0.2, 0.0];
/// Pairs of acc and dec of the grid, m/s²: default, gentle, firm, emergency.
const GRID_ACCELERATIONS: [(f64, f64); 4] =
    [DEFAULT_ACCELERATIONS, (1.0, 2.0), (2.0, 4.0), (1.5, 6.0)];
/// Maximum number of codes that a model proposes.
const FOUR: usize = 4;
/// Limit where the map has none, m/s.
const FALLBACK_LIMIT: f64 = 15.0;

/// The source of an agent's planner codes.
#[derive(Clone)]
#[non_exhaustive]
pub enum CodeSource {
    /// A vision-language model that reasons in rounds.
    #[allow(missing_docs)]
    Model {
        model: Arc<dyn Mllm>,
        prompts: Arc<PromptSet>,
        reasoning: ReasoningSettings,
    },
    /// A baseline: each attempt is drawn uniformly from the codes that the grammar allows.
    Random,
    /// A baseline: the best of four random codes, as many as a model proposes at most.
    RandomFour,
    /// A baseline: always the ego's lane at the speed limit, in one attempt.
    Fixed,
    /// A baseline: the code of a grid that Reflection scores best. Earlier codes win ties: the
    /// ego's lane before others, fast before slow.
    Grid,
    /// A baseline: the best of four codes that do not look: each lane at the limit, then the ego's
    /// lane more slowly.
    GridFour,
    /// One line that a person wrote, in one attempt.
    Written(String),
    /// A baseline: a code that was found outside of the agent, in one attempt; the fixed one where
    /// none was.
    Handed(HandedCode),
}

/// A code that is handed to an agent before its next planning call.
#[derive(Debug, Clone, Default)]
pub struct HandedCode(Arc<Mutex<Option<PlannerCode>>>);

impl HandedCode {
    /// Hands a code over, or none.
    pub fn hand(&self, code: Option<PlannerCode>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = code;
    }

    fn take(&self) -> Option<PlannerCode> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

impl CodeSource {
    /// Side of the image that the model takes, pixels; `None` if it takes none.
    pub(super) fn image_size(&self) -> Option<u32> {
        let Self::Model { model, .. } = self else {
            return None;
        };
        model.describe().image_size
    }

    /// The prompts of a model.
    pub(super) fn prompts(&self) -> Option<&PromptSet> {
        let Self::Model { prompts, .. } = self else {
            return None;
        };
        Some(prompts)
    }

    /// Whether all of its codes are tried out and the best one is taken.
    pub(super) fn compares(&self) -> bool {
        matches!(self, Self::Grid | Self::GridFour | Self::RandomFour)
    }

    /// Whether its codes may name the oncoming lane. A model's prompt set says so, unless the
    /// settings forbid it; without a model the settings decide.
    pub(super) fn names_oncoming_lane(&self, setting: Option<bool>) -> bool {
        match self.prompts() {
            Some(prompts) => {
                prompts.forms().scene_text.names_oncoming_lane() && setting != Some(false)
            }
            None => setting == Some(true),
        }
    }

    /// Begins a planning call; a grid gives all of its codes. `history` has the answers of the
    /// simulation so far.
    pub(super) fn open<'a>(
        &'a self,
        scenario: &'a ScenarioPrompt,
        graph: &LaneGraph,
        CodesAsked {
            seed,
            deadline,
            attempts,
        }: CodesAsked,
        history: &'a mut AnswerHistory,
    ) -> Result<Codes<'a>, ReasoningError> {
        let codes = match self {
            Self::Model {
                model,
                prompts,
                reasoning,
            } => {
                let reasoning = Reasoning::open(
                    model.as_ref(),
                    prompts,
                    reasoning,
                    scenario,
                    seed,
                    deadline,
                    history,
                )?;
                return Ok(Codes::Reasoned(Box::new(reasoning)));
            }
            Self::Random => random_codes(&scenario.names, seed, attempts),
            Self::Fixed => fixed_code(graph),
            Self::RandomFour => random_codes(&scenario.names, seed, FOUR),
            Self::Grid => grid(graph),
            Self::GridFour => grid_of_four(graph),
            Self::Handed(code) => code
                .take()
                .map_or_else(|| fixed_code(graph), |code| vec![code]),
            Self::Written(line) => return Ok(Codes::Written(Some(parse(line, &scenario.names)))),
        };
        Ok(Codes::Listed(codes.into_iter()))
    }
}

/// What a planning call asks for.
#[derive(Debug, Clone, Copy)]
pub(super) struct CodesAsked {
    pub(super) seed: u64,
    pub(super) deadline: Deadline,
    /// Maximum number of attempts.
    pub(super) attempts: usize,
}

/// The codes of one planning call, one for each attempt.
pub(super) enum Codes<'a> {
    Reasoned(Box<Reasoning<'a>>),
    Listed(std::vec::IntoIter<PlannerCode>),
    Written(Option<Parsed<PlannerCode>>),
}

impl Codes<'_> {
    /// The next one; `None` when there are no more.
    pub(super) fn next(
        &mut self,
        feedback: Option<&Feedback>,
    ) -> Result<Option<ReasoningTrace<PlannerCode>>, ReasoningError> {
        match self {
            Self::Reasoned(reasoning) => reasoning.think(feedback).map(Some),
            Self::Listed(codes) => Ok(codes.next().map(ReasoningTrace::without_rounds)),
            Self::Written(parsed) => Ok(parsed.take().map(ReasoningTrace::of_parsed)),
        }
    }
}

fn random_codes(names: &Names, seed: u64, attempts: usize) -> Vec<PlannerCode> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let lead_agents: Vec<Option<AgentName>> = names
        .lead_agents
        .iter()
        .copied()
        .map(Some)
        .chain([None])
        .collect();
    let draw = |_| {
        Some(PlannerCode {
            centerline: *names.centerlines.choose(&mut random)?,
            lead_agent: *lead_agents.choose(&mut random)?,
            target_speed: f64::from(random.random_range(target_speeds(names))),
            accel_max: *ACCELERATIONS.choose(&mut random)?,
            decel_max: *DECELERATIONS.choose(&mut random)?,
        })
    };
    (0..attempts).map_while(draw).collect()
}

fn fixed_code(graph: &LaneGraph) -> Vec<PlannerCode> {
    vec![planner_code(
        graph,
        CenterlineName::EgoLane,
        1.0,
        DEFAULT_ACCELERATIONS,
    )]
}

fn grid(graph: &LaneGraph) -> Vec<PlannerCode> {
    let mut centerlines: Vec<CenterlineName> =
        graph.named().map(|centerline| centerline.name).collect();
    centerlines.sort_by_key(|&name| name != CenterlineName::EgoLane);
    let mut codes = Vec::new();
    for centerline in centerlines {
        for fraction in GRID_SPEEDS {
            for accelerations in GRID_ACCELERATIONS {
                codes.push(planner_code(graph, centerline, fraction, accelerations));
            }
        }
    }
    codes.dedup();
    codes
}

/// Each lane at the limit, then the ego's lane more slowly: the first four.
fn grid_of_four(graph: &LaneGraph) -> Vec<PlannerCode> {
    let lanes = graph.named().map(|centerline| (centerline.name, 1.0));
    let slower = GRID_SPEEDS[1..]
        .iter()
        .step_by(2)
        .map(|&fraction| (CenterlineName::EgoLane, fraction));
    let code = |(name, fraction)| planner_code(graph, name, fraction, DEFAULT_ACCELERATIONS);
    lanes.chain(slower).map(code).take(FOUR).collect()
}

/// The code for a centerline of the scene behind its lead agent, at a fraction of the speed limit
/// (whole m/s).
pub fn planner_code(
    graph: &LaneGraph,
    centerline: CenterlineName,
    fraction: f64,
    (accel_max, decel_max): (f64, f64),
) -> PlannerCode {
    let limit = graph.ego_lane().speed_limit.unwrap_or(FALLBACK_LIMIT);
    PlannerCode {
        centerline,
        lead_agent: graph.lead_agent(centerline).map(|agent| agent.name),
        target_speed: (fraction * limit).round(),
        accel_max,
        decel_max,
    }
}
