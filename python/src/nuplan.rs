//! Scenes of nuplan-devkit, for planners of the library inside it.

use crate::errors::{Failure, Outcome};
use crate::observation::Observation;
use crate::tables::object;
use crate::work::{computed, lock, long, quick};
use planagent::planning::{History, HistorySample, SceneView};
use planagent::road::{Pose, Route, Vector};
use planagent::traffic::{SignalStatus, TrafficLights};
use planagent::{EgoState, Scene};
use planagent_runs::worker::run::with_causes;
use planagent_scenario::nuplan::{MapStore, NuPlanMap};
use pyo3::prelude::*;
use std::collections::HashMap;
use std::path::PathBuf;
use std::process;
use std::sync::{Arc, Mutex, MutexGuard};

/// An object: its track token, its kind by number, then x, y, heading, length, width, vx, vy.
type ObjectRow = (String, u8, [f64; 7]);
/// The ego (time in µs, the numbers of an ego state) and the objects at one instant.
type SampleRow = (i64, [f64; 11], Vec<ObjectRow>);

/// A scenario of nuplan-devkit as its planner sees it: the map, the route, and the past so far.
#[pyclass(frozen, module = "planagent._core")]
pub(crate) struct NuPlanWorld {
    map: Arc<NuPlanMap>,
    route: Route,
    past: Mutex<Past>,
}

#[derive(Default)]
struct Past {
    history: History,
    /// Numbers of tracks in the order of their appearance.
    tracks: HashMap<String, u32>,
    start_us: Option<i64>,
}

/// The maps of folders, by process: a store that another thread of the parent reads into stays
/// locked in a fork.
type Stores = HashMap<(u32, PathBuf), Arc<MapStore>>;

static STORES: Mutex<Option<Stores>> = Mutex::new(None);

/// The lock of the maps, held through a fork.
pub(crate) type HeldMaps = MutexGuard<'static, Option<Stores>>;

pub(crate) fn held_maps() -> HeldMaps {
    lock(&STORES)
}

/// The map of a location; each is read once in a process.
fn map(root: PathBuf, location: &str) -> Outcome<Arc<NuPlanMap>> {
    let store = {
        let mut stores = lock(&STORES);
        let stores = stores.get_or_insert_default();
        Arc::clone(
            stores
                .entry((process::id(), root.clone()))
                .or_insert_with(|| Arc::new(MapStore::new(Some(root)))),
        )
    };
    store
        .map(location)
        .map_err(|error| Failure::new("ScenarioError", with_causes(&error)))
}

impl NuPlanWorld {
    fn sample(
        &self,
        (time_us, ego, objects): SampleRow,
        tracks: &mut HashMap<String, u32>,
    ) -> Outcome<HistorySample> {
        let [
            x,
            y,
            heading,
            vx,
            vy,
            ax,
            ay,
            angle,
            rate,
            yaw_rate,
            yaw_acceleration,
        ] = ego;
        let ego = EgoState {
            time_us,
            rear_axle: self.map.to_local(Pose { x, y, heading }),
            velocity: Vector::new(vx, vy),
            acceleration: Vector::new(ax, ay),
            steering_angle: angle,
            steering_rate: rate,
            angular_velocity: yaw_rate,
            angular_acceleration: yaw_acceleration,
        };
        let objects = objects.into_iter().map(|(token, kind, values)| {
            let next = tracks.len() as u32;
            let number = *tracks.entry(token).or_insert(next);
            let [x, y, heading, length, width, vx, vy] = values;
            let center = self.map.to_local(Pose { x, y, heading });
            object(&(
                number,
                kind,
                [center.x, center.y, heading, length, width, vx, vy],
            ))
        });
        Ok(HistorySample {
            ego,
            objects: objects.collect::<Outcome<Vec<_>>>()?.into(),
        })
    }

    fn lights(&self, lights: &[(i64, String)]) -> TrafficLights {
        let status = |text: &str| match text {
            "green" => SignalStatus::Green,
            "yellow" => SignalStatus::Yellow,
            "red" => SignalStatus::Red,
            _ => SignalStatus::Unknown,
        };
        lights
            .iter()
            .filter_map(|(fid, text)| Some((self.map.connector(*fid)?, status(text))))
            .collect()
    }
}

#[pymethods]
impl NuPlanWorld {
    /// The world of a map (maps folder and location), a route (ids of roadblocks) and a goal (x, y,
    /// heading).
    #[new]
    fn new(
        py: Python<'_>,
        root: PathBuf,
        location: String,
        route: Vec<i64>,
        goal: Option<(f64, f64, f64)>,
    ) -> PyResult<Self> {
        let read = move || {
            let map = map(root, &location)?;
            let block = |&id: &i64| {
                let unknown = || {
                    Failure::new(
                        "ScenarioError",
                        format!("the map of {location} has no roadblock {id}"),
                    )
                };
                map.roadblock(id).ok_or_else(unknown)
            };
            let roadblocks = route.iter().map(block).collect::<Outcome<_>>()?;
            let goal = goal.map(|(x, y, heading)| map.to_local(Pose { x, y, heading }));
            Ok(Self {
                route: Route {
                    roadblocks,
                    goal,
                    goal_lane: None,
                },
                map,
                past: Mutex::default(),
            })
        };
        long(py, || computed(read), &|| ())
    }

    /// Easting and northing of the map's (0, 0), meters.
    #[getter]
    fn origin(&self) -> (f64, f64) {
        (self.map.origin.x, self.map.origin.y)
    }

    /// The scene after these samples, oldest first, that were not given before; lights by the id of
    /// their connector.
    fn observe(
        &self,
        py: Python<'_>,
        iteration: usize,
        samples: Vec<SampleRow>,
        lights: Vec<(i64, String)>,
    ) -> PyResult<Observation> {
        quick(py, || {
            let mut past = lock(&self.past);
            let Past {
                history,
                tracks,
                start_us,
            } = &mut *past;
            // All are read before one is kept, so that a wrong one leaves no half of a scene.
            let samples: Outcome<Vec<HistorySample>> = samples
                .into_iter()
                .map(|row| self.sample(row, tracks))
                .collect();
            for sample in samples? {
                history.push(sample);
            }
            let present = history.latest().cloned();
            let present =
                present.ok_or_else(|| Failure::argument("a scene needs at least one sample"))?;
            let view = SceneView {
                map: &self.map.lanes,
                route: &self.route,
                ego: &present.ego,
                objects: &present.objects,
                lights: &self.lights(&lights),
                history,
            };
            let start_us = *start_us.get_or_insert(present.ego.time_us);
            Ok(Observation::new(
                Scene::of_view(Arc::clone(&self.map.lanes), &view),
                iteration,
                start_us,
            ))
        })
    }
}
