//! Episodes of reinforcement learning, many at once.

use crate::episode::{Episode, OBSERVATION, Rules, Stepped};
use crate::errors::{Failure, Outcome};
use crate::observation::Observation;
use crate::scenario::Scenario;
use crate::simulation::challenge;
use crate::trajectory::{array, numbers, packed};
use crate::work::{computed, guarded, lock, quick};
use pyo3::prelude::*;
use pyo3::types::PyByteArray;
use rayon::prelude::*;
use std::sync::{Arc, Mutex};

/// Least number of episodes that a thread takes together.
const TOGETHER: usize = 4;
/// Numbers of an action that is a code.
const CODE: usize = 3;

/// Episodes that step together. One that ended begins again at the next step, as gymnasium's
/// `AutoresetMode.NEXT_STEP`.
#[pyclass(frozen, module = "planagent._core")]
pub(crate) struct Vector {
    rules: Rules,
    episodes: Mutex<Vec<Episode>>,
}

/// The observations of all episodes as packed f32.
fn observations(episodes: &[Episode]) -> Vec<u8> {
    let mut all = vec![0.0f32; episodes.len() * OBSERVATION];
    for (episode, out) in episodes.iter().zip(all.chunks_exact_mut(OBSERVATION)) {
        episode.write(out);
    }
    all.into_iter().flat_map(f32::to_ne_bytes).collect()
}

/// Packed observations (f32) and rewards (f64), then a byte an episode: terminated, truncated.
type Steps<'py> = (
    Bound<'py, PyByteArray>,
    Bound<'py, PyByteArray>,
    Bound<'py, PyByteArray>,
    Bound<'py, PyByteArray>,
);

/// What is beside the observations, a list each.
type Infos = (
    Vec<usize>,
    Vec<f64>,
    Vec<usize>,
    Vec<bool>,
    Vec<bool>,
    Vec<Option<f64>>,
);

#[pymethods]
impl Vector {
    /// Numbers of an observation.
    #[classattr]
    const OBSERVATION: usize = OBSERVATION;

    #[new]
    fn new(
        py: Python<'_>,
        scenarios: Vec<Py<Scenario>>,
        challenge_name: &str,
        count: usize,
        steps: usize,
        pose_dt_s: Option<f64>,
    ) -> PyResult<Self> {
        let scenarios: Vec<_> = scenarios
            .iter()
            .map(|scenario| Arc::clone(&scenario.get().opened))
            .collect();
        quick(py, || {
            if scenarios.is_empty() || count == 0 || steps == 0 {
                return Err(Failure::argument(
                    "an environment needs a scenario, an episode and a step for each action",
                ));
            }
            let rules = Rules {
                scenarios,
                challenge: challenge(challenge_name)?,
                steps,
                pose_dt_s,
            };
            let episodes = (0..count)
                .map(|i| Episode::new(&rules, i as u64, None))
                .collect::<Outcome<_>>()?;
            Ok(Self {
                rules,
                episodes: Mutex::new(episodes),
            })
        })
    }

    /// Begins all episodes, each with its seed and, where given, the number of its scenario; gives
    /// packed observations.
    #[pyo3(signature = (seeds, scenario=None))]
    fn reset<'py>(
        &self,
        py: Python<'py>,
        seeds: Vec<Option<u64>>,
        scenario: Option<usize>,
    ) -> PyResult<Bound<'py, PyByteArray>> {
        let bytes = quick(py, || {
            let mut episodes = lock(&self.episodes);
            for (episode, seed) in episodes.iter_mut().zip(&seeds) {
                *episode = Episode::new(&self.rules, seed.unwrap_or(episode.random), scenario)?;
            }
            Ok(observations(&episodes))
        })?;
        Ok(array(py, &bytes))
    }

    /// One action each: packed numbers, as many for each episode.
    fn step<'py>(&self, py: Python<'py>, actions: &[u8]) -> PyResult<Steps<'py>> {
        let (bytes, stepped) = quick(py, || {
            let mut episodes = lock(&self.episodes);
            let actions = numbers(actions)?;
            let each = actions.len() / episodes.len();
            if each * episodes.len() != actions.len() || each == 0 || !each.is_multiple_of(CODE) {
                let (numbers, count) = (actions.len(), episodes.len());
                return Err(Failure::argument(format!(
                    "{numbers} numbers are no actions of {count} episodes"
                )));
            }
            if !actions.iter().all(|number| number.is_finite()) {
                return Err(Failure::argument("an action has a NaN or infinite value"));
            }
            let step = |(episode, action): (&mut Episode, &[f64])| {
                guarded(|| episode.step(&self.rules, action))
            };
            let stepped: Vec<Stepped> = if episodes.len() < 2 * TOGETHER {
                let pairs = episodes.iter_mut().zip(actions.chunks_exact(each));
                pairs.map(step).collect::<Outcome<_>>()?
            } else {
                let all = &mut *episodes;
                computed(|| {
                    let pairs = all.par_iter_mut().zip(actions.par_chunks_exact(each));
                    pairs.with_min_len(TOGETHER).map(step).collect()
                })?
            };
            Ok((observations(&episodes), stepped))
        })?;
        let flags = |of: fn(&Stepped) -> bool| {
            stepped
                .iter()
                .map(|one| u8::from(of(one)))
                .collect::<Vec<u8>>()
        };
        let rewards = packed(stepped.iter().map(|one| one.reward));
        let (terminated, truncated) = (flags(|one| one.terminated), flags(|one| one.truncated));
        Ok((
            array(py, &bytes),
            array(py, &rewards),
            array(py, &terminated),
            array(py, &truncated),
        ))
    }

    /// Of each episode: the number of its scenario, speed (m/s), iteration, whether the ego
    /// collided, whether it left the road, nuPlan's score.
    fn infos(&self, py: Python<'_>) -> Infos {
        py.detach(|| {
            let episodes = lock(&self.episodes);
            let all = || episodes.iter();
            (
                all().map(|one| one.scenario).collect(),
                all()
                    .map(|one| one.closed_loop.present().ego.velocity.x)
                    .collect(),
                all().map(|one| one.closed_loop.iteration()).collect(),
                all().map(|one| one.collided).collect(),
                all().map(|one| one.is_off_road).collect(),
                all().map(|one| one.score).collect(),
            )
        })
    }

    /// The numbers of the scenarios that the episodes are in.
    fn scenarios(&self, py: Python<'_>) -> Vec<usize> {
        py.detach(|| {
            lock(&self.episodes)
                .iter()
                .map(|episode| episode.scenario)
                .collect()
        })
    }

    /// What a planner would see in an episode.
    fn observe(&self, py: Python<'_>, episode: usize) -> PyResult<Observation> {
        quick(py, || {
            let episodes = lock(&self.episodes);
            let episode = episodes
                .get(episode)
                .ok_or_else(|| Failure::argument("there is no such episode"))?;
            let (closed_loop, scenario) = (&episode.closed_loop, episode.closed_loop.scenario());
            let start_us = scenario.frame(0).map_or(0, |frame| frame.ego.time_us);
            let scene = planagent::Scene::of_view(Arc::clone(&scenario.map), &closed_loop.scene());
            Ok(Observation::new(scene, closed_loop.iteration(), start_us))
        })
    }
}
