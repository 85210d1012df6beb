//! Scores plans by PDM's measure over a short horizon. Why nothing of it is learned:
//! docs/decisions/146-no-learned-judge.md.

use super::behavior::{BehaviorScores, Behaviors};
use super::idm_plan::IdmPlan;
use super::overtake::OvertakeRules;
use super::reach::{Compared, MIN_REACH, Reach, is_compared};
use super::report::{ProgressReference, ReflectionReport, SubScores, Verdict};
use super::ride::Ride;
use super::rollout::{Rollout, Version};
use crate::environment::LaneGraph;
use planagent_score::metrics::MetricError;
use planagent_score::pdm::{
    self, Collided, Contest, DrivableLayers, EMERGENCY_TIME_S, EgoAreas, Forecast, OvertakeVerdict,
    PdmInstant, PdmMemory, ProposalScore, ReferencePath, ScoringScene, no_at_fault_collisions,
    score_proposals, simulate_proposals,
};
use planagent_world::dynamics::{JerkPenalty, simulate_proposal};
use planagent_world::geometry::{GeometryError, Polyline, Pose};
use planagent_world::{EgoState, PACIFICA, STEP_S, SceneView, Trajectory, TrajectoryError};

/// Whether PDM-Closed's emergency brake would overrule this roll-out: the ego is slow and would be
/// at fault for a collision within two seconds. What the ego touches is added to `memory`; areas
/// are those of its reference path, which is chosen now if there is none.
pub fn needs_emergency_brake(
    scene: &SceneView<'_>,
    rollout: &Rollout,
    memory: &mut PdmMemory,
) -> bool {
    memory.keep_reference_path(scene);
    let instant = observe(scene, memory);
    let steps = steps_of(EMERGENCY_TIME_S);
    let reference = rollout.poses.get(..=steps).unwrap_or(&rollout.poses);
    let states = simulate_proposal(scene.ego, reference, JerkPenalty::PdmClosed);
    let areas: Vec<EgoAreas> = states
        .iter()
        .map(|state| instant.drivable.areas_of(state))
        .collect();
    let first = no_at_fault_collisions(&states, &areas, &instant.forecast).state;
    pdm::needs_emergency_brake(first.map(|state| state as f64 * STEP_S), scene.ego)
}

/// Steps of 0.1 s in a time in seconds.
pub fn steps_of(seconds: f64) -> usize {
    (seconds / STEP_S).round() as usize
}

/// PDM's view of the scene along the reference path in `memory`; without one, along the lanes of
/// the route. Drivable is what nuPlan's metric will find so
/// ([`DrivableMap::judged_as_by_the_metric`]).
///
/// [`DrivableMap::judged_as_by_the_metric`]:
/// planagent_score::pdm::DrivableMap::judged_as_by_the_metric
pub(super) fn observe<'a>(scene: &SceneView<'a>, memory: &mut PdmMemory) -> PdmInstant<'a> {
    let PdmMemory {
        reference_path,
        collided,
    } = memory;
    if let Some(reference_path) = reference_path {
        return observe_along(reference_path, scene, collided);
    }
    let lanes = scene.route.lanes(scene.map);
    let layers = DrivableLayers::from_map(scene.map, &lanes, scene.ego.center().position());
    judged(scene, PdmInstant::new(scene, &lanes, layers, collided))
}

pub(super) fn observe_along<'a>(
    reference_path: &ReferencePath,
    scene: &SceneView<'a>,
    collided: &mut Collided,
) -> PdmInstant<'a> {
    judged(scene, PdmInstant::along(reference_path, scene, collided))
}

fn judged<'a>(
    scene: &SceneView<'a>,
    PdmInstant { drivable, forecast }: PdmInstant<'a>,
) -> PdmInstant<'a> {
    PdmInstant {
        drivable: drivable.judged_as_by_the_metric(),
        forecast: forecast.along_lanes(scene.map),
    }
}

/// Why a plan cannot be scored or executed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ReflectionError {
    #[error("the roll-out cannot be scored")]
    Score(#[from] MetricError),
    #[error("the states of the plan make no trajectory")]
    Trajectory(#[from] TrajectoryError),
    #[error("the plan has no path")]
    Path(#[from] GeometryError),
}

/// Scores the plans of one planning call, all against the same view of the scene.
pub struct Judge<'a> {
    scene: &'a SceneView<'a>,
    instant: PdmInstant<'a>,
    /// The forecasts of other behaviors.
    behaviors: Behaviors,
    /// The line along which progress is measured.
    centerline: Polyline,
    steps: usize,
    /// The reach of each of PDM-Closed's proposals, or of what stands for them.
    proposals: Vec<Reach>,
    /// What a plan is compared with.
    rivals: Reach,
    reference: ProgressReference,
}

impl<'a> Judge<'a> {
    /// Observes the scene: forecast, areas, and the progress of PDM-Closed's proposals, all along
    /// the reference path that PDM-Closed chooses now. Where the ego's lane is blocked, or all
    /// proposals stand, also what a plan could reach beyond the horizon. It is kept in `memory`,
    /// with what the ego has touched. Where PDM-Closed finds none, there are no proposals, and
    /// progress is measured along the ego's own centerline.
    ///
    /// # Errors
    /// When the horizon is too short to be scored.
    pub fn new(
        scene: &'a SceneView<'a>,
        graph: &LaneGraph,
        horizon_s: f64,
        memory: &mut PdmMemory,
    ) -> Result<Self, ReflectionError> {
        Self::of_plans(scene, graph, (Ride::Idm, horizon_s), memory)
    }

    /// As [`Self::new`], of plans with this ride. They are compared with what rides as they do: at
    /// [`Ride::Comfortable`], versions of a plan at the limit in the ego's lane stand for
    /// PDM-Closed's proposals.
    ///
    /// # Errors
    /// When the horizon is too short to be scored, or the ego's pose is not finite.
    pub(crate) fn of_plans(
        scene: &'a SceneView<'a>,
        graph: &LaneGraph,
        (ride, horizon_s): (Ride, f64),
        memory: &mut PdmMemory,
    ) -> Result<Self, ReflectionError> {
        memory.choose_reference_path(scene);
        if let PdmMemory {
            reference_path: Some(reference_path),
            collided,
        } = memory
        {
            let compared = Compared {
                scene,
                graph,
                ride,
                horizon_s,
                steps: steps_of(horizon_s),
            };
            let mut judge = match ride {
                Ride::Idm => Self::along(scene, reference_path, horizon_s, collided)?,
                Ride::Comfortable => Self::beside(&compared, reference_path, collided)?,
            };
            // Elsewhere what lies beyond the horizon decides nothing, and these roll-outs take
            // time.
            if is_compared(graph, judge.rivals.progress_m) {
                judge.compare_with_lanes(&compared)?;
            }
            return Ok(judge);
        }
        let (instant, steps) = (observe(scene, memory), steps_of(horizon_s));
        let centerline = graph.ego_lane().path.centerline.clone();
        let reference = ProgressReference::OwnProgress;
        Ok(Self::observing(
            scene,
            instant,
            centerline,
            steps,
            (Vec::new(), reference),
        ))
    }

    /// As [`Self::new`], along a given reference path. What the ego touches now is added to
    /// `collided`.
    ///
    /// # Errors
    /// When the horizon is too short to be scored.
    pub fn along(
        scene: &'a SceneView<'a>,
        reference_path: &ReferencePath,
        horizon_s: f64,
        collided: &mut Collided,
    ) -> Result<Self, ReflectionError> {
        let (instant, steps) = (
            observe_along(reference_path, scene, collided),
            steps_of(horizon_s),
        );
        let centerline = reference_path.centerline().line().clone();
        let proposals = instant.proposals(reference_path, scene.ego, steps);
        let simulated = simulate_proposals(scene.ego, proposals.all());
        let scores = score_proposals(&instant.scoring(&centerline, 0.0), &simulated)?;
        // The proposals borrow the instant, which moves into the judge.
        drop(proposals);
        let reaches = scores
            .iter()
            .zip(&simulated)
            .map(|(score, states)| Reach::of_rival(score, states));
        let proposals = (reaches.collect(), ProgressReference::PdmProposals);
        Ok(Self::observing(
            scene, instant, centerline, steps, proposals,
        ))
    }

    /// Along a given reference path, compared with versions of a plan at the limit in the ego's
    /// lane.
    fn beside(
        compared: &Compared<'a, '_>,
        reference_path: &ReferencePath,
        collided: &mut Collided,
    ) -> Result<Self, ReflectionError> {
        let instant = observe_along(reference_path, compared.scene, collided);
        let centerline = reference_path.centerline().line().clone();
        let proposals = compared.versions_at_limit(&instant.scoring(&centerline, 0.0))?;
        let proposals = (proposals, ProgressReference::PdmProposals);
        Ok(Self::observing(
            compared.scene,
            instant,
            centerline,
            compared.steps,
            proposals,
        ))
    }

    /// Of an instant, with progress along a line, beside these proposals.
    fn observing(
        scene: &'a SceneView<'a>,
        instant: PdmInstant<'a>,
        centerline: Polyline,
        steps: usize,
        (proposals, reference): (Vec<Reach>, ProgressReference),
    ) -> Self {
        Self {
            scene,
            behaviors: Behaviors::from_forecast(&instant.forecast, &centerline),
            instant,
            centerline,
            steps,
            rivals: Reach::best(proposals.iter().copied()),
            proposals,
            reference,
        }
    }

    /// Compares progress with what plans at the limit could reach, too. Where a plan stops early
    /// because something leads past what blocks the lane, so do the rivals that do not pass it.
    fn compare_with_lanes(&mut self, compared: &Compared<'_, '_>) -> Result<(), ReflectionError> {
        let graph = compared.graph;
        let lanes = compared.reach_of_lanes(&self.scoring())?;
        if let (Some(blocked), Some(_)) = (graph.blocked, graph.stop_point()) {
            let front = self
                .centerline
                .project(PACIFICA.front_of(self.scene.ego.rear_axle))
                .s;
            let obstacle = self
                .centerline
                .project(graph.ego_lane().path.centerline.point_at(blocked.from_s))
                .s;
            self.proposals
                .retain(|one| one.progress_m > obstacle - front);
            self.rivals = Reach::best(self.proposals.iter().copied().chain([lanes.own]));
        }
        self.rivals.reach_m = self.rivals.reach_m.max(lanes.best_m);
        if self.rivals.reach_m >= MIN_REACH {
            self.reference = ProgressReference::Reach;
        }
        Ok(())
    }

    /// The ego's states where it follows a trajectory over the horizon, as [`Self::assess`] takes
    /// them.
    pub fn follow(&self, trajectory: &Trajectory) -> Vec<EgoState> {
        let states = trajectory.states().iter().take(self.steps + 1);
        let path: Vec<Pose> = states.map(|state| state.rear_axle).collect();
        simulate_proposal(self.scene.ego, &path, JerkPenalty::PdmClosed)
    }

    fn simulate(&self, plan: &IdmPlan) -> Vec<EgoState> {
        let rollout = plan.roll_out(self.scene, self.steps);
        simulate_proposal(self.scene.ego, &rollout.poses, JerkPenalty::PdmClosed)
    }

    fn scoring(&self) -> ScoringScene<'_> {
        self.instant
            .scoring(&self.centerline, self.rivals.progress_m)
    }

    /// Rolls a plan out, scores it, and compares the score with λ.
    ///
    /// # Errors
    /// When the horizon is too short to be scored.
    pub fn reflect(
        &self,
        plan: &IdmPlan,
        threshold: f64,
    ) -> Result<ReflectionReport, ReflectionError> {
        self.assess_along(self.simulate(plan), Some(plan), threshold)
    }

    /// Scores the ego's states, one every 0.1 s over the horizon, the present one first, and
    /// compares the score with λ.
    ///
    /// # Errors
    /// When the horizon is too short to be scored.
    pub fn assess(
        &self,
        states: Vec<EgoState>,
        threshold: f64,
    ) -> Result<ReflectionReport, ReflectionError> {
        self.assess_along(states, None, threshold)
    }

    /// The report on the states of a roll-out. Progress is relative to PDM-Closed's proposals, as a
    /// plan alone has no rivals.
    /// Why: docs/decisions/105-progress-reference.md.
    fn assess_along(
        &self,
        states: Vec<EgoState>,
        plan: Option<&IdmPlan>,
        threshold: f64,
    ) -> Result<ReflectionReport, ReflectionError> {
        let batch = [states];
        let score = self.score(&batch, plan, &self.instant.forecast)?;
        // The roll-out stays, since a plan expects all others to keep their course.
        let under = |forecast| -> Result<f64, MetricError> {
            Ok(self.score(&batch, plan, forecast)?.total)
        };
        let behaviors = BehaviorScores::new(
            score.total,
            under(&self.behaviors.yields)?,
            under(&self.behaviors.insists)?,
        );
        let [states] = batch;
        let verdict = if score.total >= threshold {
            Verdict::Execute
        } else {
            Verdict::Rethink
        };
        Ok(ReflectionReport {
            score: score.total,
            parts: parts(&score),
            behaviors,
            progress_reference: self.reference,
            drivable_layers: self.instant.drivable.layers(),
            threshold,
            verdict,
            progress_m: score.progress_m,
            first_at_fault_s: score.first_at_fault_s,
            first_ttc_s: score.first_ttc_s,
            states,
        })
    }

    /// The score of the states of one roll-out where the others drive as `forecast` says.
    fn score(
        &self,
        states: &[Vec<EgoState>; 1],
        plan: Option<&IdmPlan>,
        forecast: &Forecast,
    ) -> Result<ProposalScore, MetricError> {
        let scoring = ScoringScene {
            forecast,
            ..self.scoring()
        };
        let scores = match plan {
            Some(plan) => score_versions(self.scene, plan, &[Version::PLAN], &scoring, states)?,
            None => score_proposals(&scoring, states)?,
        };
        // One proposal in, one score out.
        let score = scores
            .first()
            .copied()
            .ok_or(MetricError::TooFewSamples { needed: 1, got: 0 })?;
        if self.reference != ProgressReference::Reach {
            return Ok(score);
        }
        let own = Reach::from_rollout(&score, &states[0]).reach_m;
        Ok(score.with_progress(score.progress.min(own / self.rivals.reach_m.max(own))))
    }
}

/// Scores versions of a plan as [`contest_of_versions`] does.
pub(super) fn score_versions(
    scene: &SceneView<'_>,
    plan: &IdmPlan,
    versions: &[Version],
    scoring: &ScoringScene<'_>,
    simulated: &[Vec<EgoState>],
) -> Result<Vec<ProposalScore>, MetricError> {
    let verdicts = verdicts(scene, plan, versions);
    contest_of_versions(plan, &verdicts, scoring, simulated)?.scores()
}

/// Scores versions of a plan by their simulated states. One that passes something over the oncoming
/// lane is on its route there while it keeps the rules. Otherwise it has 0 for the driving
/// direction.
pub(super) fn contest_of_versions<'a>(
    plan: &IdmPlan,
    verdicts: &'a [OvertakeVerdict],
    scoring: &ScoringScene<'a>,
    simulated: &'a [Vec<EgoState>],
) -> Result<Contest<'a>, MetricError> {
    match plan.oncoming() {
        None => Contest::new(scoring, simulated),
        Some(oncoming) => Contest::overtaking(scoring, &oncoming.lanes, verdicts, simulated),
    }
}

/// What the rules of an overtake say of each version; nothing of a plan that makes none.
pub(super) fn verdicts(
    scene: &SceneView<'_>,
    plan: &IdmPlan,
    versions: &[Version],
) -> Vec<OvertakeVerdict> {
    let Some(oncoming) = plan.oncoming() else {
        return Vec::new();
    };
    let rules = OvertakeRules::new(oncoming, scene);
    let verdict = |&version: &Version| {
        rules.verdict(
            &plan
                .roll_out_version(version, scene, OvertakeRules::STEPS)
                .poses,
        )
    };
    versions.iter().map(verdict).collect()
}

fn parts(score: &ProposalScore) -> SubScores {
    SubScores {
        no_collision: score.no_at_fault_collisions,
        drivable_area: score.drivable_area,
        driving_direction: score.driving_direction,
        progress: score.progress,
        time_to_collision: score.time_to_collision,
        comfort: score.comfort,
    }
}
