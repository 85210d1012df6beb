//! Scenarios by name.

use crate::errors::{Failure, Outcome};
use crate::observation::Observation;
use crate::trajectory::{array, packed};
use crate::work::{computed, long, quick};
use planagent::Scenario as Opened;
use planagent::planning::{History, HistorySample, SceneView};
use planagent::road::{Lane, LaneId, Neighbor, Point};
use planagent::sources::{DataRoots, Readers};
use planagent::traffic::Frame;
use planagent::{EgoState, Scene};
use planagent_runs::worker::run::with_causes;
use planagent_scenario::nuplan::export::{ExportSettings, write_scenario};
use pyo3::prelude::*;
use pyo3::types::{PyByteArray, PyDict};
use std::path::PathBuf;
use std::sync::Arc;

/// A recorded or generated scenario.
#[pyclass(frozen, module = "planagent._core")]
pub(crate) struct Scenario {
    pub(crate) opened: Arc<Opened>,
    /// The word that names it from any working directory; none for a scenario of tables.
    word: Option<String>,
}

fn readers() -> Readers {
    Readers::new(&DataRoots::from_environment())
}

/// Opens the scenario that a word names.
#[pyfunction]
pub(crate) fn open(py: Python<'_>, word: String) -> PyResult<Scenario> {
    let opened = move || {
        let readers = readers();
        let found = readers.find(&word)?;
        let opened = match found.as_slice() {
            [one] => Arc::new(one.open()?),
            several => {
                let count = several.len();
                let text = format!("'{word}' names {count} scenarios; planagent.find lists them");
                return Err(Failure::new("ScenarioError", text));
            }
        };
        Ok(Scenario {
            opened,
            word: Some(readers.absolute_word(&word)),
        })
    };
    long(py, || computed(opened), &|| ())
}

/// The words of all scenarios that a word names.
#[pyfunction]
pub(crate) fn find(py: Python<'_>, word: String) -> PyResult<Vec<String>> {
    let found = move || {
        Ok(readers()
            .find(&word)?
            .iter()
            .map(ToString::to_string)
            .collect())
    };
    long(py, || computed(found), &|| ())
}

/// The scenario types of the generator.
#[pyfunction]
pub(crate) fn scenario_types() -> Vec<String> {
    planagent_scenario::generator::types::ALL
        .iter()
        .map(|kind| kind.name().to_owned())
        .collect()
}

/// The numbers of an ego state: x, y, heading of the rear axle, vx, vy, ax, ay, steering angle and
/// rate, angular velocity and acceleration.
pub(crate) fn ego_numbers(ego: &EgoState) -> [f64; 11] {
    let (pose, velocity, acceleration) = (ego.rear_axle, ego.velocity, ego.acceleration);
    [
        pose.x,
        pose.y,
        pose.heading,
        velocity.x,
        velocity.y,
        acceleration.x,
        acceleration.y,
        ego.steering_angle,
        ego.steering_rate,
        ego.angular_velocity,
        ego.angular_acceleration,
    ]
}

/// Packed x, y of points.
fn points<'py>(py: Python<'py>, points: &[Point]) -> Bound<'py, PyByteArray> {
    array(
        py,
        &packed(points.iter().flat_map(|point| [point.x, point.y])),
    )
}

/// The lanes of a map as dictionaries, in the order of their numbers.
pub(crate) fn lanes<'py, 'a>(
    py: Python<'py>,
    lanes: impl Iterator<Item = &'a Lane>,
    is_on_route: &dyn Fn(&Lane) -> bool,
) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let ids = |ids: &[LaneId]| ids.iter().map(|id| id.0).collect::<Vec<_>>();
    let beside = |neighbors: &[Neighbor]| {
        neighbors
            .iter()
            .map(|neighbor| neighbor.lane.0)
            .collect::<Vec<_>>()
    };
    lanes
        .map(|lane| {
            let dict = PyDict::new(py);
            dict.set_item("id", lane.id.0)?;
            dict.set_item("source_id", lane.source_id)?;
            dict.set_item("connector", lane.is_connector())?;
            dict.set_item("on_route", is_on_route(lane))?;
            dict.set_item("speed_limit", lane.speed_limit)?;
            dict.set_item("traffic_light", lane.has_traffic_lights)?;
            dict.set_item("roadblock", lane.roadblock.0)?;
            dict.set_item("incoming", ids(&lane.incoming))?;
            dict.set_item("outgoing", ids(&lane.outgoing))?;
            dict.set_item("left", beside(&lane.left))?;
            dict.set_item("right", beside(&lane.right))?;
            dict.set_item("centerline", points(py, lane.centerline.vertices()))?;
            dict.set_item("polygon", points(py, lane.polygon.ring()))?;
            Ok(dict)
        })
        .collect()
}

impl Scenario {
    pub(crate) fn new(opened: Opened, word: Option<String>) -> Self {
        Self {
            opened: Arc::new(opened),
            word,
        }
    }

    fn frame(&self, iteration: usize) -> Outcome<&Frame> {
        let last = self.opened.iterations().saturating_sub(1);
        let outside = || {
            Failure::new(
                "ArgumentError",
                format!("iteration {iteration} is none of 0 to {last}"),
            )
        };
        self.opened.frame(iteration).ok_or_else(outside)
    }
}

#[pymethods]
impl Scenario {
    #[getter]
    fn id(&self) -> &str {
        &self.opened.id
    }

    #[getter]
    fn scenario_type(&self) -> &str {
        &self.opened.scenario_type
    }

    #[getter]
    fn log_name(&self) -> &str {
        &self.opened.log_name
    }

    #[getter]
    fn word(&self) -> Option<&str> {
        self.word.as_deref()
    }

    #[getter]
    fn iterations(&self) -> usize {
        self.opened.iterations()
    }

    /// The recorded scene of an iteration, with the recorded past.
    fn observe(&self, py: Python<'_>, iteration: usize) -> PyResult<Observation> {
        quick(py, || {
            let (opened, frame) = (&self.opened, self.frame(iteration)?);
            let mut history = History::default();
            for frame in opened.frames.iter().take(opened.start + iteration + 1) {
                history.push(HistorySample {
                    ego: frame.ego,
                    objects: Arc::clone(&frame.objects),
                });
            }
            let view: SceneView<'_> = opened.scene(frame, &history);
            let start_us = self.frame(0)?.ego.time_us;
            Ok(Observation::new(
                Scene::of_view(Arc::clone(&opened.map), &view),
                iteration,
                start_us,
            ))
        })
    }

    /// Times (µs) and packed numbers of the recorded ego from iteration 0 on.
    fn expert<'py>(&self, py: Python<'py>) -> (Vec<i64>, Bound<'py, PyByteArray>) {
        let times = self.opened.expert().map(|ego| ego.time_us).collect();
        (
            times,
            array(py, &packed(self.opened.expert().flat_map(ego_numbers))),
        )
    }

    /// All lanes of the map.
    fn lanes<'py>(slf: &Bound<'py, Self>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let opened = Arc::clone(&slf.get().opened);
        let is_on_route = |lane: &Lane| opened.route.contains(lane.roadblock);
        lanes(slf.py(), slf.get().opened.map.lanes().iter(), &is_on_route)
    }

    /// Writes the scenario as a nuPlan log with its map; gives the folders of the two.
    fn export_nuplan(
        &self,
        py: Python<'_>,
        folder: PathBuf,
        stand_in_maps: bool,
    ) -> PyResult<(PathBuf, PathBuf)> {
        let opened = Arc::clone(&self.opened);
        let written = move || {
            let settings = ExportSettings {
                stand_in_maps,
                ..ExportSettings::default()
            };
            let exported = write_scenario(&opened, &folder, &settings);
            let exported =
                exported.map_err(|error| Failure::new("ScenarioError", with_causes(&error)))?;
            Ok((exported.data, exported.maps))
        };
        long(py, || computed(written), &|| ())
    }
}
