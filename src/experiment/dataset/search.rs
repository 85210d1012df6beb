//! Privileged search: from a state, many planners are driven in the true simulation, and the best becomes the label.

use crate::environment::lane_graph::Centerline;
use crate::environment::{CenterlineName, LaneGraph};
use crate::metrics::{self, EvaluatedSimulation, MetricList};
use crate::pdm::PdmMemory;
use crate::planner::{DEFAULT_ACCELERATIONS, build_idm_plan, feedback, monitored_step, planner_code};
use crate::reasoning::{Feedback, PlannerCode};
use crate::reflection::{IdmPlan, Judge, LeadPolicy, PlanMonitor, ReflectionReport, Verdict, steps_of};
use crate::simulation::ClosedLoop;
use crate::world::{EgoState, HistorySample, STEP_S};

/// Length of the search, iterations: long enough for a lane change and what comes of it.
pub const HORIZON: usize = 60;
/// Iterations that one roll-out is followed before the next.
const REPLAN: usize = 5;
/// Length of the roll-outs, seconds: Reflection's default.
const ROLLOUT_S: f64 = 4.0;
/// λ: Reflection's default.
pub const THRESHOLD: f64 = 0.75;
/// Desired speeds that are tried, as fractions of the limit. A planner is watched as it drives and slows down by itself for what
/// can be foreseen.
const SPEED_FRACTIONS: [f64; 4] = [1.0, 0.7, 0.4, 0.2];
/// Fractions that are tried with a lane change: to change lanes in order to crawl is never wanted.
const LANE_CHANGE_FRACTIONS: [f64; 1] = [1.0];
/// From this share of the limit on, a speed is not slow: the limit is what holds it.
pub(super) const NEAR_LIMIT: f64 = 0.85;
/// Limit where the map has none, m/s.
const FALLBACK_LIMIT: f64 = 15.0;
/// Other pairs that are tried with the best centreline and speed, where these leave something to gain, m/s²: gentle, firm,
/// emergency.
const REFINEMENTS: [(f64, f64); 3] = [(1.0, 2.0), (2.0, 4.0), (1.5, 6.0)];
/// A score from which on slower planners and other accelerations are not tried.
const GOOD: f64 = 0.95;
/// What full progress at the limit adds to a score. nuPlan's progress is capped by the expert's, so it leaves ties.
const PROGRESS_BONUS: f64 = 0.2;
/// The speed at the end counts as if it were driven for so long, seconds: what it is worth to be rid of a slow leader.
const TERMINAL_S: f64 = 4.0;
/// A lane change must stay on the route for this long ahead of the ego, metres: what lies behind the horizon counts too.
const ON_ROUTE_AHEAD: f64 = 120.0;
/// What a lane change must gain.
const LANE_CHANGE_COST: f64 = 0.02;
/// What slow driving must gain: the best of several slow planners is picked after the fact, and in a drive the model has to pick one
/// before. About what remains are collisions.
const SLOW_COST: f64 = 0.7;
/// What a change of lanes must gain that Reflection would refuse: more than there is to gain.
const REFUSED_CHANGE_COST: f64 = 2.0;
/// What a planner in the own lane must gain that Reflection would refuse: little, since it is the best of the refused that drives in the
/// end, watched; the search drives it so.
const REFUSED_COST: f64 = 0.05;
/// What an unusual acc and dec must gain: as with slow driving, the best of several is picked after the fact. In drives they only
/// scattered the scores: on 350 validation scenes among reactive traffic -0.5 to +0.2 of 100 by the weights, always in few drives.
const REFINEMENT_COST: f64 = 0.5;

/// A planner that was tried.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    /// Its code.
    pub code: PlannerCode,
    /// nuPlan's score over the horizon.
    pub score: f64,
    /// The score with the terms that break ties.
    pub value: f64,
    /// Speed after 3 s, m/s.
    pub speed_later: f64,
    /// What Reflection says of it now.
    pub reflection: ReflectionReport,
}

impl Tried {
    /// Whether Reflection would let it drive now.
    pub fn is_accepted(&self) -> bool {
        self.reflection.verdict == Verdict::Execute
    }

    /// What an attempt is told after this one.
    pub fn feedback(&self) -> Feedback {
        feedback(Some(self.code.to_string()), Some(&self.reflection), &[], THRESHOLD)
    }
}

/// Drives every candidate from the present state of `drive` and gives them in the order in which they were tried.
/// Candidates that the simulation or the metrics refuse are left out.
pub fn search(drive: &ClosedLoop<'_>, graph: &LaneGraph) -> Vec<Tried> {
    let limit = graph.ego_lane().speed_limit.unwrap_or(FALLBACK_LIMIT);
    let mut tried: Vec<Tried> = Vec::new();
    let scene = drive.scene();
    let mut memory = PdmMemory::default();
    let Ok(judge) = Judge::new(&scene, graph, ROLLOUT_S, &mut memory) else { return tried };
    let present = Present { drive, graph, judge: &judge, memory: &memory, limit };
    for centerline in &graph.centerlines {
        let fractions: &[f64] = match centerline.name {
            CenterlineName::EgoLane => &SPEED_FRACTIONS,
            _ if stays_on_route(drive, centerline) => &LANE_CHANGE_FRACTIONS,
            _ => continue,
        };
        for fraction in fractions {
            let code = planner_code(graph, centerline.name, *fraction, DEFAULT_ACCELERATIONS);
            // Slower is not tried where the limit does well: what remains to be gained is less than the ties that it would make.
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
            let code = PlannerCode { accel_max, decel_max, ..best.code.clone() };
            tried.extend(present.attempt(code));
        }
    }
    tried
}

/// Whether a centreline keeps to the route as far as a lane change must, or to the route's end.
fn stays_on_route(drive: &ClosedLoop<'_>, centerline: &Centerline) -> bool {
    let scenario = drive.scenario();
    let last = scenario.route.roadblocks.last();
    let path = &centerline.path;
    let ahead = path.lanes.iter().zip(&path.starts).filter(|&(_, &start)| start < centerline.ego_s + ON_ROUTE_AHEAD);
    let mut blocks = ahead.map(|(&lane, _)| scenario.map[lane].roadblock);
    let mut arrived = false;
    blocks.all(|block| {
        arrived |= Some(&block) == last;
        arrived || scenario.route.contains(block)
    })
}

/// The one with the highest value; the first tried wins ties.
pub fn best(tried: &[Tried]) -> Option<&Tried> {
    tried.iter().rev().max_by(|a, b| a.value.total_cmp(&b.value))
}

/// The state that is searched from.
struct Present<'a> {
    drive: &'a ClosedLoop<'a>,
    graph: &'a LaneGraph,
    judge: &'a Judge<'a>,
    /// What PDM's rules know here.
    memory: &'a PdmMemory,
    /// Speed limit, m/s.
    limit: f64,
}

impl Present<'_> {
    /// Drives one candidate and judges it.
    fn attempt(&self, code: PlannerCode) -> Option<Tried> {
        let drive = self.drive;
        let planner = planner(drive, self.graph, code)?;
        let reflection = self.judge.reflect(&planner, THRESHOLD).ok()?;
        let mut future = drive.clone();
        let samples = follow(&mut future, &planner, &mut self.memory.clone(), HORIZON)?;
        let scenario = drive.scenario();
        let from = scenario.start + drive.iteration();
        let expert: Vec<EgoState> =
            scenario.frames.get(from..=from + samples.len())?.iter().map(|frame| frame.ego).collect();
        let judged = EvaluatedSimulation::new(&scenario.map, &samples, &expert);
        let score = metrics::evaluate(MetricList::ClosedLoop, &judged).ok()?.score.value;
        let driven: f64 = samples.windows(2).map(|w| w[0].ego.rear_axle.distance(&w[1].ego.rear_axle)).sum();
        let way = driven + samples.last()?.ego.speed() * TERMINAL_S;
        let possible = self.limit.max(1.0) * (HORIZON as f64 * STEP_S + TERMINAL_S);
        let unusual = (planner.code.accel_max, planner.code.decel_max) != DEFAULT_ACCELERATIONS;
        let changes = planner.code.centerline != CenterlineName::EgoLane.as_str();
        let slow = planner.code.target_speed < NEAR_LIMIT * self.limit;
        let cost = |when: bool, cost: f64| if when { cost } else { 0.0 };
        let value = score + PROGRESS_BONUS * (way / possible).min(1.0)
            - cost(changes, LANE_CHANGE_COST)
            - cost(slow, SLOW_COST)
            - cost(unusual, REFINEMENT_COST)
            - cost(reflection.verdict == Verdict::Rethink, if changes { REFUSED_CHANGE_COST } else { REFUSED_COST });
        let speed_later = samples.get(30).or(samples.last())?.ego.speed();
        Some(Tried { code: planner.code, score, value, speed_later, reflection })
    }
}

/// The planner of a code at the present state of a drive.
pub fn planner(drive: &ClosedLoop<'_>, graph: &LaneGraph, code: PlannerCode) -> Option<IdmPlan> {
    build_idm_plan(&drive.scene(), graph, code, LeadPolicy::Nearest, ROLLOUT_S).ok().flatten()
}

/// Drives a planner, watched, for so many iterations; the samples begin with the present. `None` when the drive ends or fails
/// before.
pub fn follow(
    drive: &mut ClosedLoop<'_>,
    planner: &IdmPlan,
    memory: &mut PdmMemory,
    iterations: usize,
) -> Option<Vec<HistorySample>> {
    let monitor = PlanMonitor { steps: steps_of(ROLLOUT_S), threshold: THRESHOLD, emergency_brake: true };
    let mut samples = Vec::with_capacity(iterations + 1);
    let mut trajectory = None;
    for i in 0..iterations {
        if drive.is_over() {
            return None;
        }
        if i % REPLAN == 0 {
            let scene = drive.scene();
            trajectory = Some(monitored_step(planner, &scene, &monitor, memory).ok()?.trajectory);
        }
        samples.push(drive.present().clone());
        drive.advance(trajectory.as_ref()?, "search").ok()?;
    }
    Some(samples)
}
