//! What thinks in an agent: a language model, or a control without one, against which a model's worth is measured.

use crate::environment::{CenterlineName, LaneGraph};
use crate::mllm::{Deadline, Mllm};
use crate::reasoning::{
    ACCELERATIONS, DECELERATIONS, Feedback, Names, Parsed, PlannerCode, PromptSet, Reasoning, ReasoningError,
    ReasoningSettings, ReasoningTrace, ScenarioPrompt, target_speeds,
};
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::sync::Arc;

/// acc and dec of the code that is always the same, m/s²: what the label search of nano calls usual.
pub const DEFAULT_ACCELERATIONS: (f64, f64) = (1.5, 3.0);
/// Desired speeds of the grid, as fractions of the limit.
const GRID_SPEEDS: [f64; 7] = [1.0, 0.85, 0.7, 0.55, 0.4, 0.2, 0.0];
/// Pairs of acc and dec of the grid, m/s²: usual, gentle, firm, emergency.
const GRID_ACCELERATIONS: [(f64, f64); 4] = [DEFAULT_ACCELERATIONS, (1.0, 2.0), (2.0, 4.0), (1.5, 6.0)];
/// Limit where the map has none, m/s.
const FALLBACK_LIMIT: f64 = 15.0;

/// Who writes the planner codes of an agent.
#[derive(Clone)]
pub enum CodeSource {
    /// A language model that reasons in rounds.
    Model {
        /// The model.
        model: Arc<dyn Mllm>,
        /// Its prompts.
        prompts: Arc<PromptSet>,
        /// How it is asked.
        reasoning: ReasoningSettings,
    },
    /// A control: each attempt is drawn evenly from the codes that the grammar allows.
    Random,
    /// A control: always the ego's lane at the speed limit. There is one attempt.
    Fixed,
    /// A control: all codes of a grid, of which Reflection's score chooses. Earlier ones win ties: the ego's lane before others,
    /// fast before slow.
    Grid,
}

impl CodeSource {
    /// Pixels of the picture that it looks at, if it looks.
    pub(super) fn image_size(&self) -> Option<u32> {
        match self {
            Self::Model { model, .. } => model.describe().image_size,
            Self::Random | Self::Fixed | Self::Grid => None,
        }
    }

    /// Whether it reads the lane-graph text, and if so with which prompts.
    pub(super) fn prompts(&self) -> Option<&PromptSet> {
        match self {
            Self::Model { prompts, .. } => Some(prompts),
            Self::Random | Self::Fixed | Self::Grid => None,
        }
    }

    /// Whether all its codes are tried and the best of them drives, so that none is accepted for being good enough.
    pub(super) fn compares(&self) -> bool {
        matches!(self, Self::Grid)
    }

    /// Begins a planning call of at most `attempts` attempts, except for a grid, which is as large as it is.
    pub(super) fn open<'a>(
        &'a self,
        scenario: &'a ScenarioPrompt,
        graph: &LaneGraph,
        (seed, deadline): (u64, Deadline),
        attempts: usize,
    ) -> Result<Thoughts<'a>, ReasoningError> {
        let codes = match self {
            Self::Model { model, prompts, reasoning } => {
                let reasoning = Reasoning::open(model.as_ref(), prompts, reasoning, scenario, seed, deadline)?;
                return Ok(Thoughts::Reasoned(reasoning));
            }
            Self::Random => random_codes(&scenario.names, seed, attempts),
            Self::Fixed => fixed_code(graph),
            Self::Grid => grid(graph),
        };
        Ok(Thoughts::Written(codes.into_iter()))
    }
}

/// The thoughts of one planning call, an attempt each.
pub(super) enum Thoughts<'a> {
    /// Those of a model.
    Reasoned(Reasoning<'a>),
    /// Codes without reasons.
    Written(std::vec::IntoIter<PlannerCode>),
}

impl Thoughts<'_> {
    /// The next one; `None` when there are no more.
    pub(super) fn next(&mut self, feedback: Option<&Feedback>) -> Result<Option<ReasoningTrace>, ReasoningError> {
        match self {
            Self::Reasoned(reasoning) => reasoning.think(feedback).map(Some),
            Self::Written(codes) => Ok(codes.next().map(|code| ReasoningTrace {
                rounds: Vec::new(),
                interruption: None,
                instruction: None,
                parsed: Parsed { code: Some(code), ..Parsed::default() },
            })),
        }
    }
}

fn random_codes(names: &Names, seed: u64, attempts: usize) -> Vec<PlannerCode> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let lead_agents: Vec<Option<String>> = names.lead_agents.iter().cloned().map(Some).chain([None]).collect();
    let draw = |_| {
        Some(PlannerCode {
            centerline: names.centerlines.choose(&mut random)?.clone(),
            lead_agent: lead_agents.choose(&mut random)?.clone(),
            target_speed: f64::from(random.random_range(target_speeds(names))),
            accel_max: *ACCELERATIONS.choose(&mut random)?,
            decel_max: *DECELERATIONS.choose(&mut random)?,
        })
    };
    (0..attempts).map_while(draw).collect()
}

fn fixed_code(graph: &LaneGraph) -> Vec<PlannerCode> {
    vec![planner_code(graph, CenterlineName::EgoLane, 1.0, DEFAULT_ACCELERATIONS)]
}

fn grid(graph: &LaneGraph) -> Vec<PlannerCode> {
    let mut centerlines: Vec<CenterlineName> = graph.centerlines.iter().map(|centerline| centerline.name).collect();
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

/// A code for a centreline of the scene, behind its leader, with a fraction of the limit as desired speed (whole m/s).
pub fn planner_code(
    graph: &LaneGraph,
    centerline: CenterlineName,
    fraction: f64,
    (accel_max, decel_max): (f64, f64),
) -> PlannerCode {
    let limit = graph.ego_lane().speed_limit.unwrap_or(FALLBACK_LIMIT);
    PlannerCode {
        centerline: centerline.to_string(),
        lead_agent: graph.lead_agent(centerline).map(|agent| agent.name.to_string()),
        target_speed: (fraction * limit).round(),
        accel_max,
        decel_max,
    }
}
