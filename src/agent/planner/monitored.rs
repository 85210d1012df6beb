//! Monitoring: Reflection scores the active plan at every step and chooses the version of it that
//! is executed, or another plan that becomes active at once.

use super::agent_state::ActivePlan;
use super::layer::{AgentLayer, forward};
use super::{PlannerError, PlannerInput};
use crate::environment::{CenterlineName, GraphedScene};
use crate::reflection::{IdmPlan, MonitoredStep, PlanMonitor};
use planagent_world::{SceneView, Trajectory};
use std::time::Instant;

/// An agent whose active plan is monitored. A lane change or an overtake that needs hard braking or
/// scores less than λ is aborted where the plan is better in the ego's present lane; a plan in that
/// lane which needs as much is left for a lane beside where people are near and the ego can swerve.
/// The ego stays there until the next planning call.
#[derive(Debug)]
pub struct Monitored<A> {
    inner: A,
    monitor: PlanMonitor,
}

impl<A> Monitored<A> {
    /// An agent whose active plan is monitored.
    pub fn new(inner: A, monitor: PlanMonitor) -> Self {
        Self { inner, monitor }
    }
}

impl<A: AgentLayer> Monitored<A> {
    /// The active plan in the ego's present lane, and its step; `None` when it is bound for that
    /// lane already.
    fn aborted_lane_change(
        &mut self,
        scene: &SceneView<'_>,
    ) -> Result<Option<(IdmPlan, MonitoredStep)>, PlannerError> {
        let state = self.inner.state_mut();
        let Some((plan, graph)) = state.plan_and_graph(scene) else {
            return Ok(None);
        };
        let seen = GraphedScene::new(scene, &graph);
        let Some(back) = state.builder.back_to_ego_lane(plan, seen)? else {
            return Ok(None);
        };
        let step = self.monitor.step(scene, &back, &mut state.memory)?;
        Ok(Some((back, step)))
    }

    /// The plan of the same code that swerves into a lane beside for a person or a bicycle, and its
    /// step: in each lane the gentlest that scores enough, of these the best. `None` where the plan
    /// leaves the ego's lane already.
    /// Why: docs/decisions/154-evade-at-once.md.
    fn evasion(
        &mut self,
        scene: &SceneView<'_>,
    ) -> Result<Option<(IdmPlan, MonitoredStep)>, PlannerError> {
        let state = self.inner.state_mut();
        let (Some(needed), Some((plan, graph))) =
            (self.monitor.evasion, state.plan_and_graph(scene))
        else {
            return Ok(None);
        };
        let own = &graph.ego_lane().path.lanes;
        let leaves_lane = plan.oncoming().is_some() || !own.contains(&plan.lane_now(scene));
        if leaves_lane || !graph.has_person_near(scene) {
            return Ok(None);
        }
        let (seen, code) = (GraphedScene::new(scene, &graph), plan.code);
        let mut best: Option<(IdmPlan, MonitoredStep)> = None;
        for into in [CenterlineName::LeftLane, CenterlineName::RightLane] {
            let Some(plan) = state.builder.build_in(into, seen, code)? else {
                continue;
            };
            for swerve in plan.swerves(scene, state.builder.horizon_s) {
                let swerve = swerve?;
                let (_, step) = self.monitor.own_step(scene, &swerve, &mut state.memory)?;
                if step.brakes || step.score < needed {
                    continue;
                }
                if best
                    .as_ref()
                    .is_none_or(|(_, best)| step.is_better_than(best))
                {
                    best = Some((swerve, step));
                }
                // The next ones turn harder, and no more is needed in this lane.
                break;
            }
        }
        Ok(best)
    }

    /// The step of the active plan, of what evades, of PDM-Closed's proposals or of the plan back in
    /// the ego's lane; and the plan that becomes active with it, if another. `None` without a
    /// generated plan.
    fn monitored_step(
        &mut self,
        scene: &SceneView<'_>,
    ) -> Result<Option<(MonitoredStep, Instead)>, PlannerError> {
        let state = self.inner.state_mut();
        let ActivePlan::Generated(plan) = &state.active else {
            return Ok(None);
        };
        let (choice, own) = self.monitor.own_step(scene, plan, &mut state.memory)?;
        if !self.monitor.is_poor(&own) {
            return Ok(Some((own, Instead::Nothing)));
        }
        // Before a handover, which lasts for one step alone.
        if let Some((aside, step)) = self.evasion(scene)?
            && step.is_better_than(&own)
        {
            return Ok(Some((step, Instead::Evasion(aside))));
        }
        let state = self.inner.state_mut();
        let mut step = own;
        if let ActivePlan::Generated(plan) = &state.active
            && let Some(handover) =
                self.monitor
                    .handed_over(scene, (plan, choice), &mut state.memory)?
        {
            step = handover;
        }
        if self.monitor.is_poor(&step)
            && let Some((back, instead)) = self.aborted_lane_change(scene)?
            && instead.is_better_than(&step)
        {
            return Ok(Some((instead, Instead::AbortedLaneChange(back))));
        }
        Ok(Some((step, Instead::Nothing)))
    }
}

/// The plan that becomes active in place of the present one.
enum Instead {
    Nothing,
    /// In a lane beside.
    Evasion(IdmPlan),
    /// In the ego's lane.
    AbortedLaneChange(IdmPlan),
}

impl<A: AgentLayer> AgentLayer for Monitored<A> {
    forward!(inner: state, reset, advance, plan);

    fn execute(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let Some((step, instead)) = self.monitored_step(&input.scene)? else {
            return self.inner.execute(input);
        };
        let state = self.inner.state_mut();
        match instead {
            Instead::Nothing => {}
            Instead::Evasion(aside) => {
                state.active = aside.into();
                state.note(|call| call.evasion = Some(input.iteration));
            }
            Instead::AbortedLaneChange(back) => {
                state.active = back.into();
                state.note(|call| call.aborted_lane_change = Some(input.iteration));
            }
        }
        if step.is_handover {
            state.note(|call| call.handovers += 1);
        }
        if step.brakes {
            state.note(|call| call.emergency_brakes += 1);
        }
        Ok(step.trajectory)
    }
}

#[cfg(test)]
mod tests {
    use crate::planner::code_source::CodeSource;
    use crate::planner::{PlanAgent, PlanAgentSettings, Planner, PlannerInput, PlannerName};
    use planagent_world::{LaneId, ObjectKind, Scene, SceneBuilder};
    use std::f64::consts::FRAC_PI_2;

    /// Two lanes, and the ego on the right one at 12 m/s.
    fn free() -> SceneBuilder {
        Scene::builder()
            .lanes(2, [[-50.0, 0.0], [250.0, 0.0]])
            .ego([0.0, -3.5], 0.0, 12.0)
    }

    /// The step at which an agent that keeps its lane swerves, and whether its plan is bound for the
    /// left lane, where the second step has this scene.
    fn evades(scene: SceneBuilder, evasion: bool) -> (Option<usize>, bool) {
        let code = "Generate_IDM_Planner(c=ego_lane, la=None, v0=12, acc=1.5, dec=3)";
        let mut settings = PlanAgentSettings::default();
        settings.reflection.evasion = evasion;
        let source = CodeSource::Written(code.to_owned());
        let mut agent = PlanAgent::new(PlannerName::PLAN_AGENT, source, settings).layered();
        let scenes = [free(), scene].map(|scene| scene.build().unwrap());
        for (iteration, scene) in scenes.iter().enumerate() {
            let scene = scene.view();
            agent
                .compute_trajectory(&PlannerInput { iteration, scene })
                .unwrap();
        }
        let bound_for = agent.state().active_plan().unwrap();
        let is_left = bound_for.lane_now(&scenes[1].view()) == LaneId(0);
        (agent.calls()[0].evasion, is_left)
    }

    #[test]
    fn the_ego_swerves_for_who_steps_out_where_the_lane_beside_is_free() {
        let walks = |scene: SceneBuilder, x: f64| {
            scene.object(ObjectKind::Pedestrian, [x, -5.5], FRAC_PI_2, 1.0)
        };
        let swerves = |&x: &f64| evades(walks(free(), x), true) == (Some(1), true);
        let x = (14..45).map(f64::from).find(swerves).unwrap();
        assert_eq!(evades(walks(free(), x), false), (None, false));
        let full = (-4..4).fold(walks(free(), x), |scene, place| {
            scene.vehicle([8.0 * f64::from(place), 0.0], 0.0, 12.0)
        });
        assert_eq!(evades(full, true), (None, false));
        let car = free().vehicle([x, -3.5], 0.0, 0.0);
        assert_eq!(evades(car, true), (None, false), "no person is near");
        assert_eq!(evades(free(), true), (None, false));
    }
}
