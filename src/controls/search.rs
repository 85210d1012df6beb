//! Privileged search: simulates many planners from a state. The best one is the label. Plans drive
//! and are judged as the agent's, so a label is worth what the agent makes of its code.
//! Why: docs/decisions/152-the-teacher-drives-as-the-agent.md.

use super::trial::{score_of_whole, score_of_window};
use planagent_agent::environment::lane_graph::{Centerline, GoalLane};
use planagent_agent::environment::{CenterlineName, GraphedScene, LaneGraph};
use planagent_agent::planner::{
    DEFAULT_ACCELERATIONS, ReflectionSettings, feedback, grid_codes, planner_code,
};
use planagent_agent::reasoning::{Feedback, PlannerCode};
use planagent_agent::reflection::{IdmPlan, Judge, PlanMonitor, ReflectionReport, Verdict};
use planagent_agent::simulation::ClosedLoop;
use planagent_score::pdm::PdmMemory;
use planagent_world::{HistorySample, STEP_S, SceneView};

/// Horizon of the search, iterations: long enough for a lane change and its effect.
pub const HORIZON: usize = 60;
/// Iterations between roll-outs.
const REPLAN: usize = 5;
/// Desired speeds, as fractions of the limit. A monitored planner slows down by itself for
/// foreseeable events.
const SPEED_FRACTIONS: [f64; 4] = [1.0, 0.7, 0.4, 0.2];
/// Desired speeds with a lane change; a slow one makes no sense.
const LANE_CHANGE_FRACTIONS: [f64; 1] = [1.0];
/// From this share of the limit on, the limit determines the speed.
pub const NEAR_LIMIT: f64 = 0.85;
/// Other accelerations, tried with the best centerline and speed if these leave something to gain,
/// m/s²: gentle, firm, emergency.
const REFINEMENTS: [(f64, f64); 3] = [(1.0, 2.0), (2.0, 4.0), (1.5, 6.0)];
/// From this score on, slower planners and other accelerations are not tried.
const GOOD: f64 = 0.95;
/// Bonus of full progress at the limit. nuPlan's progress is capped by the expert's, which leaves
/// ties.
const PROGRESS_BONUS: f64 = 0.2;
/// Time for which the final speed counts as progress, seconds. It rewards passing a slow lead
/// vehicle.
const TERMINAL_S: f64 = 4.0;
/// Distance ahead for which a lane change must stay on the route, meters, beyond the horizon.
const ON_ROUTE_AHEAD: f64 = 120.0;
/// Minimum gain of a lane change.
const LANE_CHANGE_COST: f64 = 0.02;
/// Minimum gain of a slow planner. The search picks the best of several slow ones in hindsight,
/// which a model cannot.
/// Why: docs/decisions/152-the-teacher-drives-as-the-agent.md.
const SLOW_COST: f64 = 0.05;
/// Minimum gain of a lane change that Reflection rejects: more than possible.
const REJECTED_CHANGE_COST: f64 = 2.0;
/// Minimum gain of a rejected planner in the ego's lane. It is small, since the best rejected one
/// is executed in the end, monitored as in the search.
const REJECTED_COST: f64 = 0.05;
/// Minimum gain of other accelerations, which are also picked in hindsight. In simulations they
/// only scattered the scores. On 350 validation scenarios with reactive agents it was by -0.5 to
/// +0.2 of 100, depending on the weights, in few scenarios.
const REFINEMENT_COST: f64 = 0.5;

/// What each lane change costs that is left to the goal's lane after the horizon: what a modified
/// scene's score loses where one was needed and none was made.
/// Why: docs/decisions/116-goal-lane.md.
const GOAL_COST: f64 = 0.2;

/// A simulated planner.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Its code.
    pub code: PlannerCode,
    /// nuPlan's score over the horizon.
    pub score: f64,
    /// The score with the terms that break ties.
    pub value: f64,
    /// Speed after 3 s, m/s.
    pub speed_later: f64,
    /// What Reflection says of its plan.
    pub reflection: ReflectionReport,
}

impl Candidate {
    /// Whether Reflection accepts its plan.
    pub fn is_accepted(&self) -> bool {
        self.reflection.verdict == Verdict::Execute
    }

    /// Feedback to an attempt after this one.
    pub fn feedback(&self) -> Feedback {
        feedback(
            Some(self.code.to_string()),
            Some(&self.reflection),
            &[],
            self.reflection.threshold,
        )
    }
}

/// Simulates every candidate from the present state, in order. Plans drive, and are judged, as the
/// agent's do by its defaults. Candidates that fail in the simulation or the metrics are skipped.
pub fn search(simulation: &ClosedLoop<'_>, graph: &LaneGraph) -> Vec<Candidate> {
    search_ahead(simulation, graph, &ReflectionSettings::default(), HORIZON)
}

/// As [`search`], with plans that drive as these settings say, over a number of iterations.
pub fn search_ahead(
    simulation: &ClosedLoop<'_>,
    graph: &LaneGraph,
    reflection: &ReflectionSettings,
    horizon: usize,
) -> Vec<Candidate> {
    let mut tried: Vec<Candidate> = Vec::new();
    let scene = simulation.scene();
    let Some(present) = Present::observe(simulation, &scene, graph, reflection, horizon) else {
        return tried;
    };
    for centerline in graph.named() {
        let fractions: &[f64] = match centerline.name {
            CenterlineName::EgoLane => &SPEED_FRACTIONS,
            _ if stays_on_route(simulation, centerline) => &LANE_CHANGE_FRACTIONS,
            _ => continue,
        };
        for fraction in fractions {
            let code = planner_code(graph, centerline.name, *fraction, DEFAULT_ACCELERATIONS);
            // Slower planners are skipped if the limit scores well: their gain would be smaller
            // than the ties that they cause.
            if *fraction < 1.0 && tried.iter().any(|t| t.score >= GOOD && t.is_accepted()) {
                continue;
            }
            if !tried.iter().any(|t| t.code == code) {
                tried.extend(present.attempt(code));
            }
        }
    }
    if let Some(best) = best(&tried).filter(|best| best.score < GOOD).cloned() {
        for (accel_max, decel_max) in REFINEMENTS {
            let code = PlannerCode {
                accel_max,
                decel_max,
                ..best.code
            };
            tried.extend(present.attempt(code));
        }
    }
    tried
}

/// Simulates every code of the grid from the present state, over a number of iterations. With the
/// samples before the present, scores are those of the whole simulation.
pub(crate) fn search_grid(
    simulation: &ClosedLoop<'_>,
    graph: &LaneGraph,
    reflection: &ReflectionSettings,
    (past, horizon): (Option<&[HistorySample]>, usize),
) -> Vec<Candidate> {
    let scene = simulation.scene();
    let Some(present) = Present::observe(simulation, &scene, graph, reflection, horizon) else {
        return Vec::new();
    };
    let present = Present { past, ..present };
    grid_codes(graph)
        .into_iter()
        .filter_map(|code| present.attempt(code))
        .collect()
}

/// The candidate with the highest score, the first one of equals, whatever it costs.
pub(crate) fn highest(tried: &[Candidate]) -> Option<&Candidate> {
    tried
        .iter()
        .rev()
        .max_by(|a, b| a.score.total_cmp(&b.score))
}

/// Simulates one planner code from the present state over [`HORIZON`]. None if it gives no plan, or
/// fails as in [`search`].
pub fn attempt(
    simulation: &ClosedLoop<'_>,
    graph: &LaneGraph,
    code: PlannerCode,
) -> Option<Candidate> {
    attempts(simulation, graph, &[code]).pop().flatten()
}

/// As [`attempt`], for several codes that are judged against one view of the scene.
pub fn attempts(
    simulation: &ClosedLoop<'_>,
    graph: &LaneGraph,
    codes: &[PlannerCode],
) -> Vec<Option<Candidate>> {
    let (scene, reflection) = (simulation.scene(), ReflectionSettings::default());
    let Some(present) = Present::observe(simulation, &scene, graph, &reflection, HORIZON) else {
        return vec![None; codes.len()];
    };
    codes.iter().map(|&code| present.attempt(code)).collect()
}

/// What Reflection says of the plans of several codes at the present state, without a simulation.
/// None for a code that gives no plan.
pub fn reflections(
    simulation: &ClosedLoop<'_>,
    graph: &LaneGraph,
    codes: &[PlannerCode],
) -> Vec<Option<ReflectionReport>> {
    let (scene, reflection) = (simulation.scene(), ReflectionSettings::default());
    let Some(present) = Present::observe(simulation, &scene, graph, &reflection, HORIZON) else {
        return vec![None; codes.len()];
    };
    let reflect = |&code: &PlannerCode| {
        let plan = present.plan(code)?;
        present.judge.reflect(&plan, reflection.threshold).ok()
    };
    codes.iter().map(reflect).collect()
}

/// True if a centerline stays on the route for [`ON_ROUTE_AHEAD`], or to the route's end.
fn stays_on_route(simulation: &ClosedLoop<'_>, centerline: &Centerline) -> bool {
    let scenario = simulation.scenario();
    let last = scenario.route.roadblocks.last();
    let path = &centerline.path;
    let ahead = path
        .lanes
        .iter()
        .zip(&path.starts)
        .filter(|&(_, &start)| start < centerline.ego_s + ON_ROUTE_AHEAD);
    let mut blocks = ahead.map(|(&lane, _)| scenario.map[lane].roadblock);
    let mut arrived = false;
    blocks.all(|block| {
        arrived |= Some(&block) == last;
        arrived || scenario.route.contains(block)
    })
}

/// The candidate with the highest value, the first one of equals.
pub fn best(tried: &[Candidate]) -> Option<&Candidate> {
    tried
        .iter()
        .rev()
        .max_by(|a, b| a.value.total_cmp(&b.value))
}

/// The state from which the search starts.
struct Present<'a> {
    simulation: &'a ClosedLoop<'a>,
    graph: &'a LaneGraph,
    judge: Judge<'a>,
    /// How plans drive and are judged.
    reflection: &'a ReflectionSettings,
    /// PDM-Closed's memory at the state.
    memory: PdmMemory,
    /// Iterations to look ahead.
    horizon: usize,
    /// The samples before the present, where the whole simulation is scored.
    past: Option<&'a [HistorySample]>,
}

impl<'a> Present<'a> {
    /// `None` where the scene cannot be judged.
    fn observe(
        simulation: &'a ClosedLoop<'a>,
        scene: &'a SceneView<'a>,
        graph: &'a LaneGraph,
        reflection: &'a ReflectionSettings,
        horizon: usize,
    ) -> Option<Self> {
        let mut memory = PdmMemory::default();
        let judge = reflection.judge(scene, graph, &mut memory).ok()?;
        Some(Self {
            simulation,
            graph,
            judge,
            reflection,
            memory,
            horizon,
            past: None,
        })
    }

    /// The plan of a code.
    fn plan(&self, code: PlannerCode) -> Option<IdmPlan> {
        plan_of(self.simulation, self.graph, self.reflection, code)
    }

    /// Simulates and scores one candidate.
    fn attempt(&self, code: PlannerCode) -> Option<Candidate> {
        let simulation = self.simulation;
        let planner = self.plan(code)?;
        let threshold = self.reflection.threshold;
        let reflection = self.judge.reflect(&planner, threshold).ok()?;
        let mut future = simulation.clone();
        let samples = follow_monitored(
            &mut future,
            &planner,
            self.reflection.plan_monitor(),
            &mut self.memory.clone(),
            self.horizon,
        )?;
        let score = match self.past {
            None => score_of_window(simulation, &samples),
            Some(past) => score_of_whole(simulation, past, &samples),
        }?;
        let driven: f64 = samples
            .windows(2)
            .map(|w| w[0].ego.rear_axle.distance(&w[1].ego.rear_axle))
            .sum();
        // The speed at the end counts as progress: else a late braking maneuver would equal a plan
        // that drives on.
        let distance = driven + samples.last()?.ego.speed() * TERMINAL_S;
        let limit = self.graph.limit();
        let possible = limit.max(1.0) * (samples.len() as f64 * STEP_S + TERMINAL_S);
        let unusual = (planner.code.accel_max, planner.code.decel_max) != DEFAULT_ACCELERATIONS;
        let changes = planner.code.centerline != CenterlineName::EgoLane;
        let slow = planner.code.target_speed < NEAR_LIMIT * limit;
        let cost = |when: bool, cost: f64| if when { cost } else { 0.0 };
        let value = score + PROGRESS_BONUS * (distance / possible).min(1.0)
            - cost(changes, LANE_CHANGE_COST)
            - cost(slow, SLOW_COST)
            - cost(unusual, REFINEMENT_COST)
            - GOAL_COST * f64::from(self.changes_left(&future, planner.code.centerline))
            - cost(
                reflection.verdict == Verdict::Rethink,
                if changes {
                    REJECTED_CHANGE_COST
                } else {
                    REJECTED_COST
                },
            );
        let speed_later = samples.get(30).or(samples.last())?.ego.speed();
        Some(Candidate {
            code: planner.code,
            score,
            value,
            speed_later,
            reflection,
        })
    }

    /// Lane changes to the goal's lane that a code leaves in its last state; where no lane there
    /// leads to the goal, those that it does not make.
    fn changes_left(&self, future: &ClosedLoop<'_>, centerline: CenterlineName) -> u32 {
        let Some(goal) = self.graph.goal else {
            return 0;
        };
        let last = GoalLane::from_scene(&future.scene());
        last.map_or_else(
            || goal.left_after(centerline.lane_changes()),
            |last| last.changes.unsigned_abs(),
        )
    }
}

/// The plan of a code at the present state, as the agent builds it by its defaults.
pub fn planner(
    simulation: &ClosedLoop<'_>,
    graph: &LaneGraph,
    code: PlannerCode,
) -> Option<IdmPlan> {
    plan_of(simulation, graph, &ReflectionSettings::default(), code)
}

fn plan_of(
    simulation: &ClosedLoop<'_>,
    graph: &LaneGraph,
    reflection: &ReflectionSettings,
    code: PlannerCode,
) -> Option<IdmPlan> {
    reflection
        .plan_builder()
        .build(GraphedScene::new(&simulation.scene(), graph), code)
        .ok()
        .flatten()
}

/// Simulates a plan for some iterations, or to the goal at which the scene ends, monitored as the
/// agent does by its defaults. The samples begin with the present. `None` if the recording ends or
/// the simulation fails before.
pub fn follow(
    simulation: &mut ClosedLoop<'_>,
    planner: &IdmPlan,
    memory: &mut PdmMemory,
    iterations: usize,
) -> Option<Vec<HistorySample>> {
    let monitor = ReflectionSettings::default().plan_monitor();
    follow_monitored(simulation, planner, monitor, memory, iterations)
}

fn follow_monitored(
    simulation: &mut ClosedLoop<'_>,
    planner: &IdmPlan,
    monitor: PlanMonitor,
    memory: &mut PdmMemory,
    iterations: usize,
) -> Option<Vec<HistorySample>> {
    let mut samples = Vec::with_capacity(iterations + 1);
    let mut trajectory = None;
    for i in 0..iterations {
        if simulation.is_over() {
            return simulation.is_at_goal().then_some(samples);
        }
        if i % REPLAN == 0 {
            let scene = simulation.scene();
            trajectory = Some(monitor.step(&scene, planner, memory).ok()?.trajectory);
        }
        samples.push(simulation.present().clone());
        simulation.advance(trajectory.as_ref()?, "search").ok()?;
    }
    Some(samples)
}
