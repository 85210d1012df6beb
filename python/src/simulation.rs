//! A simulation that Python steps.

use crate::errors::{Failure, Outcome};
use crate::observation::Observation;
use crate::planner::Planner;
use crate::scenario::{Scenario, ego_numbers};
use crate::trajectory::{Trajectory, array, packed, poses, through};
use crate::work::{computed, lock, long, quick};
use planagent::evaluation::{EvaluatedSimulation, Evaluation, MetricRegistry, Role};
use planagent::planning::HistorySample;
use planagent::{Challenge, EgoState, Scenario as Opened, Scene, Trajectory as Planned};
use planagent_agent::planner::check_plan;
use planagent_agent::simulation::ClosedLoop;
use planagent_runs::worker::run::with_causes;
use planagent_scenario::HeldScenario;
use pyo3::prelude::*;
use pyo3::types::PyByteArray;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

/// A simulation in progress.
#[pyclass(frozen, module = "planagent._core")]
pub(crate) struct Simulation {
    scenario: Arc<Opened>,
    challenge: Challenge,
    state: Arc<Mutex<State>>,
}

/// The closed loop with what the metrics need.
#[derive(Clone)]
struct State {
    closed_loop: ClosedLoop<'static>,
    samples: Vec<HistorySample>,
    plans: Vec<Planned>,
}

impl State {
    fn new(scenario: &Arc<Opened>, challenge: Challenge) -> Outcome<Self> {
        let closed_loop = ClosedLoop::new(HeldScenario::Shared(Arc::clone(scenario)), challenge)?;
        Ok(Self {
            closed_loop,
            samples: Vec::new(),
            plans: Vec::new(),
        })
    }

    /// One step along a trajectory.
    fn step(&mut self, plan: Planned, planner: &str) -> Outcome<()> {
        if self.closed_loop.is_over() {
            return Err(Failure::new(
                "SimulationError",
                "the simulation is over; call reset to start it again",
            ));
        }
        let sample = self.closed_loop.present().clone();
        self.closed_loop.advance(&plan, planner)?;
        self.samples.push(sample);
        self.plans.push(plan);
        Ok(())
    }

    /// One step along a trajectory of Python, which starts at the ego and moves as a vehicle can.
    fn step_checked(&mut self, plan: Planned) -> Outcome<()> {
        if !self.closed_loop.is_over() {
            check_plan(&plan, &self.closed_loop.present().ego)
                .map_err(|jump| Failure::argument(jump.to_string()))?;
        }
        self.step(plan, "of Python")
    }

    fn observe(&self, scenario: &Opened) -> Observation {
        let start_us = scenario.frame(0).map_or(0, |frame| frame.ego.time_us);
        let scene = Scene::of_view(Arc::clone(&scenario.map), &self.closed_loop.scene());
        Observation::new(scene, self.closed_loop.iteration(), start_us)
    }
}

/// A score: value, multiplier, weighted average, its parts (name, role, score), and the scores of
/// all metrics that have one.
type Scored = (
    f64,
    f64,
    f64,
    Vec<(&'static str, String, f64)>,
    Vec<(String, Option<f64>)>,
);

fn scored(evaluation: &Evaluation) -> Scored {
    let score = &evaluation.score;
    let role = |role: Role| match role {
        Role::Weight(weight) => format!("weight {weight}"),
        _ => "multiplier".to_owned(),
    };
    let parts = score
        .parts
        .iter()
        .map(|part| (part.name, role(part.role), part.score))
        .collect();
    let metrics = evaluation
        .metrics
        .iter()
        .map(|metric| (metric.name.clone(), metric.score))
        .collect();
    (
        score.value,
        score.multiplier,
        score.weighted_average,
        parts,
        metrics,
    )
}

pub(crate) fn challenge(name: &str) -> Outcome<Challenge> {
    name.parse()
        .map_err(|error| Failure::argument(format!("{error}")))
}

#[pymethods]
impl Simulation {
    #[new]
    fn new(py: Python<'_>, scenario: &Bound<'_, Scenario>, challenge: String) -> PyResult<Self> {
        let scenario = Arc::clone(&scenario.get().opened);
        quick(py, || {
            let challenge = crate::simulation::challenge(&challenge)?;
            let state = Arc::new(Mutex::new(State::new(&scenario, challenge)?));
            Ok(Self {
                scenario,
                challenge,
                state,
            })
        })
    }

    #[getter]
    fn challenge(&self) -> &'static str {
        self.challenge.short_name()
    }

    #[getter]
    fn iterations(&self) -> usize {
        self.scenario.iterations()
    }

    #[getter]
    fn iteration(&self, py: Python<'_>) -> usize {
        py.detach(|| lock(&self.state).closed_loop.iteration())
    }

    #[getter]
    fn is_over(&self, py: Python<'_>) -> bool {
        py.detach(|| lock(&self.state).closed_loop.is_over())
    }

    /// Back to iteration 0.
    fn reset(&self, py: Python<'_>) -> PyResult<()> {
        quick(py, || {
            *lock(&self.state) = State::new(&self.scenario, self.challenge)?;
            Ok(())
        })
    }

    /// A copy in the same state.
    fn duplicate(&self, py: Python<'_>) -> PyResult<Self> {
        quick(py, || {
            let state = Arc::new(Mutex::new(lock(&self.state).clone()));
            Ok(Self {
                scenario: Arc::clone(&self.scenario),
                challenge: self.challenge,
                state,
            })
        })
    }

    fn observe(&self, py: Python<'_>) -> PyResult<Observation> {
        quick(py, || Ok(lock(&self.state).observe(&self.scenario)))
    }

    /// One step along a trajectory.
    fn step(&self, py: Python<'_>, plan: &Bound<'_, Trajectory>) -> PyResult<()> {
        let plan = plan.get().0.clone();
        quick(py, || lock(&self.state).step_checked(plan))
    }

    /// One step through packed poses at equal steps after the present.
    fn step_poses(&self, py: Python<'_>, packed_poses: &[u8], dt_s: f64) -> PyResult<()> {
        quick(py, || {
            let poses = poses(packed_poses)?;
            let mut state = lock(&self.state);
            let plan = through(&state.closed_loop.present().ego, &poses, dt_s)?;
            state.step_checked(plan)
        })
    }

    /// Steps to the end, or by a number of steps, with a planner of the library.
    #[pyo3(signature = (planner, steps=None))]
    fn run(
        &self,
        py: Python<'_>,
        planner: &Bound<'_, Planner>,
        steps: Option<usize>,
    ) -> PyResult<()> {
        let (planner, state) = (planner.get().shared(), Arc::clone(&self.state));
        let stopped = Arc::new(AtomicBool::new(false));
        let stop = Arc::clone(&stopped);
        let work = move || {
            // Who waits for these does so outside the pool.
            let (mut planner, mut state) = (lock(&planner), lock(&state));
            let (planner, state) = (&mut *planner, &mut *state);
            computed(move || {
                let name = planner.planner.name().to_owned();
                if state.closed_loop.iteration() == 0 || !planner.is_initialized {
                    state.closed_loop.initialize(planner.planner.as_mut())?;
                    planner.is_initialized = true;
                }
                let was_over = state.closed_loop.is_over();
                let mut left = steps.unwrap_or(usize::MAX);
                while left > 0 && !state.closed_loop.is_over() && !stopped.load(Ordering::Relaxed) {
                    let plan = state.closed_loop.plan(planner.planner.as_mut())?;
                    state.step(plan, &name)?;
                    left -= 1;
                }
                if !was_over && state.closed_loop.is_over() {
                    state.closed_loop.finish(planner.planner.as_mut())?;
                }
                Ok(())
            })
        };
        long(py, work, &move || stop.store(true, Ordering::Relaxed))
    }

    /// nuPlan's score of the finished simulation.
    fn score(&self, py: Python<'_>) -> PyResult<Scored> {
        quick(py, || {
            let state = lock(&self.state);
            if !state.closed_loop.is_over() {
                let (now, last) = (
                    state.closed_loop.iteration(),
                    self.scenario.iterations() - 1,
                );
                let text = format!(
                    "the simulation is at iteration {now} of {last}; a score needs all of them"
                );
                return Err(Failure::new("SimulationError", text));
            }
            let expert: Vec<EgoState> = self.scenario.expert().copied().collect();
            let simulation = EvaluatedSimulation::new(&self.scenario.map, &state.samples, &expert)
                .with_plans(&state.plans, &self.scenario.future);
            let evaluated =
                MetricRegistry::default().evaluate(self.challenge.metric_list(), &simulation);
            let evaluated =
                evaluated.map_err(|error| Failure::new("SimulationError", with_causes(&error)))?;
            Ok(scored(&evaluated))
        })
    }

    /// Times (µs) and packed numbers of the ego so far.
    fn ego_states<'py>(&self, py: Python<'py>) -> PyResult<(Vec<i64>, Bound<'py, PyByteArray>)> {
        let (times, numbers) = quick(py, || {
            let state = lock(&self.state);
            let egos = || {
                state
                    .samples
                    .iter()
                    .map(|sample| &sample.ego)
                    .chain([&state.closed_loop.present().ego])
            };
            Ok((
                egos().map(|ego| ego.time_us).collect(),
                packed(egos().flat_map(ego_numbers)),
            ))
        })?;
        Ok((times, array(py, &numbers)))
    }

    /// The trajectory that was followed at an iteration.
    fn plan_at(&self, py: Python<'_>, iteration: usize) -> PyResult<Trajectory> {
        quick(py, || {
            let state = lock(&self.state);
            let absent =
                || Failure::argument(format!("iteration {iteration} has no trajectory yet"));
            state
                .plans
                .get(iteration)
                .cloned()
                .map(Trajectory)
                .ok_or_else(absent)
        })
    }
}
