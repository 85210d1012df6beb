//! The state of a simulation and its step from iteration to iteration (devkit `simulation.py`).

use super::agents::AgentPolicy;
use super::challenge::Challenge;
use super::controller::EgoController;
use super::error::SimulationError;
use crate::planner::{Planner, PlannerInitialization, PlannerInput};
use planagent_scenario::{Frame, HeldScenario, Scenario};
use planagent_world::{EgoState, History, HistorySample, MICROS_PER_SECOND, SceneView, Trajectory};

/// Minimum number of iterations of a simulation: the metrics' filters need them.
const MIN_ITERATIONS: usize = 10;

/// A simulation in progress. In open loop the ego replays the log. Clone it at any iteration to try
/// several planners from one state.
#[derive(Debug, Clone)]
pub struct ClosedLoop<'a> {
    scenario: HeldScenario<'a>,
    iteration: usize,
    present: HistorySample,
    history: History,
    controller: EgoController,
    agents: Box<dyn AgentPolicy>,
}

impl<'a> ClosedLoop<'a> {
    /// The simulation at iteration 0: the recorded ego, the recorded past, and the agents of the
    /// challenge.
    ///
    /// # Errors
    /// When the scenario has fewer than two iterations or its times do not grow.
    pub fn new(
        scenario: impl Into<HeldScenario<'a>>,
        challenge: Challenge,
    ) -> Result<Self, SimulationError> {
        let scenario = scenario.into();
        let policy = challenge.spec().agents.new;
        Self::with_agents(scenario.clone(), challenge, |first| {
            policy(&scenario, first)
        })
    }

    /// Like [`Self::new`], with other agents. `agents` makes their policy from the recorded frame
    /// of iteration 0.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_agents(
        scenario: impl Into<HeldScenario<'a>>,
        challenge: Challenge,
        agents: impl FnOnce(&Frame) -> Box<dyn AgentPolicy>,
    ) -> Result<Self, SimulationError> {
        let scenario = scenario.into();
        let iterations = scenario.iterations();
        let too_short = || SimulationError::TooShort {
            scenario: scenario.id.clone(),
            iterations,
        };
        let first = scenario
            .frame(0)
            .filter(|_| iterations >= 2)
            .ok_or_else(too_short)?;
        let times: Vec<i64> = scenario.expert().map(|ego| ego.time_us).collect();
        if let Some(k) = times.windows(2).position(|w| w[1] <= w[0]) {
            return Err(SimulationError::TimeNotIncreasing {
                scenario: scenario.id.clone(),
                iteration: k + 1,
            });
        }
        let agents = agents(first);
        let mut history = History::default();
        for frame in scenario.past() {
            history.push(HistorySample {
                ego: frame.ego,
                objects: frame.objects.clone(),
            });
        }
        let present = HistorySample {
            ego: first.ego,
            objects: agents.objects(first),
        };
        // The planner's history ends with the present, as nuPlan's buffer does.
        history.push(present.clone());
        Ok(Self {
            scenario,
            iteration: 0,
            present,
            history,
            controller: challenge.spec().ego,
            agents,
        })
    }

    /// The scenario.
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// The present iteration, from 0.
    pub fn iteration(&self) -> usize {
        self.iteration
    }

    /// Whether the last iteration is reached, which needs no trajectory, or the goal at which a
    /// modified scenario ends.
    pub fn is_over(&self) -> bool {
        self.iteration + 1 >= self.scenario.iterations()
            || (self.iteration >= MIN_ITERATIONS && self.is_at_goal())
    }

    /// Whether the ego has reached the goal of a modified scenario.
    pub fn is_at_goal(&self) -> bool {
        let goal = self
            .scenario
            .interaction
            .as_ref()
            .and_then(|added| added.goal.as_ref());
        goal.is_some_and(|goal| goal.is_reached(self.present.ego.center().position()))
    }

    /// The ego and the objects now.
    pub fn present(&self) -> &HistorySample {
        &self.present
    }

    /// The input of a planner now.
    pub fn scene(&self) -> SceneView<'_> {
        SceneView {
            map: &self.scenario.map,
            route: &self.scenario.route,
            ego: &self.present.ego,
            objects: &self.present.objects,
            lights: &frame(&self.scenario, self.iteration).lights,
            history: &self.history,
        }
    }

    /// Prepares a planner for this scenario.
    pub fn initialize(&self, planner: &mut dyn Planner) -> Result<(), SimulationError> {
        let initialization = PlannerInitialization {
            map: &self.scenario.map,
            route: &self.scenario.route,
        };
        planner
            .initialize(&initialization)
            .map_err(|source| SimulationError::Initialization {
                planner: planner.name().to_owned(),
                scenario: self.scenario.id.clone(),
                source: Box::new(source),
            })
    }

    /// The planner's trajectory at the present iteration.
    pub fn plan(&self, planner: &mut dyn Planner) -> Result<Trajectory, SimulationError> {
        let input = PlannerInput {
            iteration: self.iteration,
            scene: self.scene(),
        };
        planner
            .compute_trajectory(&input)
            .map_err(|source| SimulationError::Planner {
                planner: planner.name().to_owned(),
                scenario: self.scenario.id.clone(),
                iteration: self.iteration,
                source: Box::new(source),
            })
    }

    /// Ends a simulation that is over: planner and agents may say that something was wrong.
    ///
    /// # Errors
    /// When they do.
    pub fn finish(&mut self, planner: &mut dyn Planner) -> Result<(), SimulationError> {
        planner
            .finish()
            .map_err(|source| SimulationError::Planner {
                planner: planner.name().to_owned(),
                scenario: self.scenario.id.clone(),
                iteration: self.iteration,
                source: Box::new(source),
            })?;
        self.agents
            .finish()
            .map_err(|source| SimulationError::Agents {
                scenario: self.scenario.id.clone(),
                iteration: self.iteration,
                source,
            })
    }

    /// Moves to the next iteration: the ego along `trajectory`, the agents by their policy. Does
    /// nothing after the last iteration. `planner` is the name for errors.
    ///
    /// # Errors
    /// When the trajectory does not cover the present or leads to a state that is not finite, or
    /// the agents' policy fails.
    pub fn advance(
        &mut self,
        trajectory: &Trajectory,
        planner: &str,
    ) -> Result<(), SimulationError> {
        if self.is_over() {
            return Ok(());
        }
        let next = frame(&self.scenario, self.iteration + 1);
        let dt_us = next.ego.time_us - frame(&self.scenario, self.iteration).ego.time_us;
        let moved = self.controller.update(&self.present.ego, trajectory, next);
        let ego = moved.map_err(|source| SimulationError::Tracking {
            planner: planner.to_owned(),
            scenario: self.scenario.id.clone(),
            iteration: self.iteration,
            source,
        })?;
        if !is_finite(&ego) {
            return Err(SimulationError::NotFinite {
                planner: planner.to_owned(),
                scenario: self.scenario.id.clone(),
                iteration: self.iteration,
            });
        }
        // The agents see the ego where it was, and not where it has just moved, as in nuPlan.
        let stepped = self
            .agents
            .step(&self.present.ego, next, dt_us as f64 / MICROS_PER_SECOND);
        stepped.map_err(|source| SimulationError::Agents {
            scenario: self.scenario.id.clone(),
            iteration: self.iteration + 1,
            source,
        })?;
        self.present = HistorySample {
            ego,
            objects: self.agents.objects(next),
        };
        self.history.push(self.present.clone());
        self.iteration += 1;
        Ok(())
    }
}

/// The frame of an iteration; the loop never passes the last one.
fn frame(scenario: &Scenario, iteration: usize) -> &Frame {
    &scenario.frames[scenario.start + iteration]
}

fn is_finite(ego: &EgoState) -> bool {
    let scalars = [
        ego.steering_angle,
        ego.steering_rate,
        ego.angular_velocity,
        ego.angular_acceleration,
    ];
    ego.rear_axle.is_finite()
        && ego.velocity.norm().is_finite()
        && ego.acceleration.norm().is_finite()
        && scalars.iter().all(|v| v.is_finite())
}
