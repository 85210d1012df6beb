//! The state of a drive and its step from iteration to iteration (devkit `simulation.py`).

use super::controller::EgoController;
use super::error::SimulationError;
use super::observation::{Challenge, Observation};
use crate::planner::{Planner, PlannerInitialization, PlannerInput};
use crate::scenario::{Frame, Scenario};
use crate::world::{EgoState, History, HistorySample, Scene, Trajectory};

/// A drive in progress; in `open_loop_boxes` the loop is not closed, and the ego does what was recorded. It can be cloned at any iteration, so that several planners can be tried from one state.
#[derive(Debug, Clone)]
pub struct ClosedLoop<'a> {
    scenario: &'a Scenario,
    iteration: usize,
    present: HistorySample,
    history: History,
    controller: EgoController,
    observation: Observation,
}

impl<'a> ClosedLoop<'a> {
    /// The drive at iteration 0: the recorded ego, the recorded past, and the traffic of the challenge.
    ///
    /// # Errors
    /// When the scenario has fewer than two iterations or its times do not grow.
    pub fn new(scenario: &'a Scenario, challenge: Challenge) -> Result<Self, SimulationError> {
        let iterations = scenario.iterations();
        let too_short = || SimulationError::TooShort { scenario: scenario.id.clone(), iterations };
        let first = scenario.frame(0).filter(|_| iterations >= 2).ok_or_else(too_short)?;
        let times: Vec<i64> = scenario.expert().map(|ego| ego.time_us).collect();
        if let Some(k) = times.windows(2).position(|w| w[1] <= w[0]) {
            return Err(SimulationError::TimeNotIncreasing { scenario: scenario.id.clone(), iteration: k + 1 });
        }
        let observation = Observation::new(challenge, scenario, first);
        let mut history = History::default();
        for frame in scenario.past() {
            history.push(HistorySample { ego: frame.ego, objects: frame.objects.clone() });
        }
        let present = HistorySample { ego: first.ego, objects: observation.objects(first) };
        history.push(present.clone());
        let controller = EgoController::of(challenge);
        Ok(Self { scenario, iteration: 0, present, history, controller, observation })
    }

    /// The scenario that is driven.
    pub fn scenario(&self) -> &'a Scenario {
        self.scenario
    }

    /// Which iteration is the present, from 0.
    pub fn iteration(&self) -> usize {
        self.iteration
    }

    /// Whether the last iteration is reached: no trajectory is asked for there.
    pub fn is_over(&self) -> bool {
        self.iteration + 1 >= self.scenario.iterations()
    }

    /// The ego and the objects now.
    pub fn present(&self) -> &HistorySample {
        &self.present
    }

    /// All that a planner may see now.
    pub fn scene(&self) -> Scene<'_> {
        Scene {
            map: &self.scenario.map,
            route: &self.scenario.route,
            ego: &self.present.ego,
            objects: &self.present.objects,
            lights: &self.frame(0).lights,
            history: &self.history,
        }
    }

    /// Prepares a planner for this drive.
    ///
    /// # Errors
    /// When the planner refuses.
    pub fn initialize(&self, planner: &mut dyn Planner) -> Result<(), SimulationError> {
        let initialization = PlannerInitialization { map: &self.scenario.map, route: &self.scenario.route };
        planner.initialize(&initialization).map_err(|source| SimulationError::Initialization {
            planner: planner.name().to_owned(),
            scenario: self.scenario.id.clone(),
            source,
        })
    }

    /// Asks a planner for its trajectory at the present iteration.
    ///
    /// # Errors
    /// When the planner gives none.
    pub fn plan(&self, planner: &mut dyn Planner) -> Result<Trajectory, SimulationError> {
        let input = PlannerInput { iteration: self.iteration, scene: self.scene() };
        planner.compute_trajectory(&input).map_err(|source| SimulationError::Planner {
            planner: planner.name().to_owned(),
            scenario: self.scenario.id.clone(),
            iteration: self.iteration,
            source,
        })
    }

    /// Moves on to the next iteration: the ego along `trajectory`, the traffic by its rule. Nothing happens when the drive
    /// is over. `planner` is named in errors.
    ///
    /// # Errors
    /// When the trajectory does not cover the present or leads to a state that is not finite.
    pub fn advance(&mut self, trajectory: &Trajectory, planner: &str) -> Result<(), SimulationError> {
        if self.is_over() {
            return Ok(());
        }
        let next = self.frame(1);
        let dt_us = next.ego.time_us - self.frame(0).ego.time_us;
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
        self.observation.update(&self.present.ego, next, dt_us);
        self.present = HistorySample { ego, objects: self.observation.objects(next) };
        self.history.push(self.present.clone());
        self.iteration += 1;
        Ok(())
    }

    /// The frame `ahead` iterations after the present; the loop never passes the last one.
    fn frame(&self, ahead: usize) -> &'a Frame {
        &self.scenario.frames[self.scenario.start + self.iteration + ahead]
    }
}

fn is_finite(ego: &EgoState) -> bool {
    let scalars = [ego.steering_angle, ego.steering_rate, ego.angular_velocity, ego.angular_acceleration];
    ego.rear_axle.is_finite()
        && ego.velocity.norm().is_finite()
        && ego.acceleration.norm().is_finite()
        && scalars.iter().all(|v| v.is_finite())
}
