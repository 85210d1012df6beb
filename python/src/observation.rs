//! What a planner sees at one instant.

use crate::errors::{Failure, Outcome};
use crate::scenario::{ego_numbers, lanes};
use crate::trajectory::{Trajectory, array, packed, planned, poses};
use crate::work::{computed, long, quick};
use image::RgbImage;
use planagent::planning::{History, HistorySample, SceneView};
use planagent::road::{Lane, LaneMap, Pose, Route};
use planagent::traffic::{ObjectKind, TrackedObject, TrafficLights};
use planagent::{EgoState, Scene};
use planagent_agent::environment::bev::render as render_bev;
use planagent_agent::environment::text::write as write_lane_graph;
use planagent_agent::environment::{
    BevView, CenterlineName, Description, GraphedScene, LaneGraph, TextForm, UnknownChoice,
};
use planagent_agent::planner::{ReflectionSettings, planner_code};
use planagent_agent::reflection::Judge;
use planagent_runs::report::render::{Look, observed_picture};
use planagent_runs::worker::run::with_causes;
use planagent_score::pdm::PdmMemory;
use planagent_world::dynamics::{JerkPenalty, simulate_proposal};
use planagent_world::{HISTORY_SAMPLES, MapParts, STEP_S};
use pyo3::prelude::*;
use pyo3::types::{PyByteArray, PyBytes, PyDict};
use serde::{Deserialize, Serialize};
use serde_pickle::{DeOptions, SerOptions};
use std::borrow::Cow;
use std::str::FromStr;
use std::sync::Arc;

/// Length of the nodes of the lane graph, meters: that of the paper's settings.
const NODE_LENGTH_M: f64 = 20.0;
/// Time that the plan of a planner code reaches, seconds.
const PLAN_S: f64 = 8.0;
/// Bounds of the horizon of a score, steps: comfort needs four states, Reflection reaches eight
/// seconds.
const SCORED_STEPS: std::ops::RangeInclusive<usize> = 3..=80;

/// The scene at one instant with its recent past.
#[pyclass(frozen, module = "planagent._core")]
pub(crate) struct Observation {
    pub(crate) scene: Arc<Scene>,
    pub(crate) iteration: usize,
    start_us: i64,
}

/// An observation as bytes.
#[derive(Serialize, Deserialize)]
struct Stored<'a> {
    map: Cow<'a, MapParts>,
    route: Route,
    lights: TrafficLights,
    samples: Vec<(EgoState, Vec<TrackedObject>)>,
    ego: EgoState,
    objects: Vec<TrackedObject>,
    iteration: usize,
    start_us: i64,
}

/// Time (µs) and numbers of an ego state.
type Ego = (i64, [f64; 11]);

fn kind_number(kind: ObjectKind) -> u8 {
    match kind {
        ObjectKind::Vehicle => 0,
        ObjectKind::Pedestrian => 1,
        ObjectKind::Bicycle => 2,
        ObjectKind::TrafficCone => 3,
        ObjectKind::Barrier => 4,
        ObjectKind::CzoneSign => 5,
        ObjectKind::GenericObject => 6,
    }
}

/// Objects as records: token (u32), kind (u8), three unused bytes, then x, y, heading, length,
/// width, vx, vy (f64).
fn objects(objects: &[TrackedObject]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(objects.len() * 64);
    for object in objects {
        let (center, shape, velocity) = (object.shape.center, object.shape, object.velocity);
        bytes.extend(object.token.0.to_ne_bytes());
        bytes.extend([kind_number(object.kind), 0, 0, 0]);
        bytes.extend(packed([
            center.x,
            center.y,
            center.heading,
            shape.length,
            shape.width,
            velocity.x,
            velocity.y,
        ]));
    }
    bytes
}

/// Bytes of a picture with its height and width.
type Picture<'py> = (Bound<'py, PyByteArray>, u32, u32);

fn picture(py: Python<'_>, image: RgbImage) -> Picture<'_> {
    let (width, height) = image.dimensions();
    (array(py, image.as_raw()), height, width)
}

/// The value of an argument that is one of a few words.
fn chosen<T: FromStr<Err = UnknownChoice>>(argument: &str, word: &str) -> Outcome<T> {
    word.parse().map_err(|unknown: UnknownChoice| {
        Failure::argument(format!(
            "{argument} is '{word}'; expected one of {}",
            unknown.expected
        ))
    })
}

impl Observation {
    pub(crate) fn new(scene: Scene, iteration: usize, start_us: i64) -> Self {
        Self {
            scene: Arc::new(scene),
            iteration,
            start_us,
        }
    }

    fn graph(&self) -> Outcome<LaneGraph> {
        let graph = LaneGraph::build(&self.scene.view(), NODE_LENGTH_M);
        graph.map_err(|error| Failure::new("SceneError", error.to_string()))
    }
}

#[pymethods]
impl Observation {
    #[getter]
    fn iteration(&self) -> usize {
        self.iteration
    }

    /// Seconds after iteration 0.
    #[getter]
    fn time_s(&self) -> f64 {
        (self.scene.ego.time_us - self.start_us) as f64 / 1e6
    }

    fn ego(&self) -> Ego {
        (self.scene.ego.time_us, ego_numbers(&self.scene.ego))
    }

    fn objects<'py>(&self, py: Python<'py>) -> Bound<'py, PyByteArray> {
        array(py, &objects(&self.scene.objects))
    }

    /// Ego and objects of the past, oldest first; the present is the last.
    fn history<'py>(&self, py: Python<'py>) -> Vec<(Ego, Bound<'py, PyByteArray>)> {
        let of = |ego: &EgoState| (ego.time_us, ego_numbers(ego));
        let samples = self.scene.history.samples();
        samples
            .map(|sample| (of(&sample.ego), array(py, &objects(&sample.objects))))
            .collect()
    }

    /// Lane connectors with the color of their light.
    fn lights(&self) -> Vec<(u32, String)> {
        self.scene
            .lights
            .iter()
            .map(|(lane, status)| (lane.0, status.to_string()))
            .collect()
    }

    /// The lanes near the ego; all without a distance (meters).
    #[pyo3(signature = (within_m=None))]
    fn lanes<'py>(
        slf: &Bound<'py, Self>,
        within_m: Option<f64>,
    ) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let scene = Arc::clone(&slf.get().scene);
        let is_on_route = |lane: &Lane| scene.route.contains(lane.roadblock);
        let map = &slf.get().scene.map;
        match within_m {
            None => lanes(slf.py(), map.lanes().iter(), &is_on_route),
            Some(distance) => {
                let near = map.lanes_near(scene.ego.center().position(), distance);
                lanes(
                    slf.py(),
                    near.into_iter().map(|lane| &map[lane]),
                    &is_on_route,
                )
            }
        }
    }

    /// Name of the map.
    fn map_name(&self) -> String {
        self.scene.map.name().to_owned()
    }

    /// The roadblocks of the route by the ids of their source.
    fn route(&self) -> Vec<i64> {
        self.scene
            .route
            .roadblocks
            .iter()
            .map(|&block| self.scene.map[block].source_id)
            .collect()
    }

    /// Lane connectors by the ids of their source, with the color of their light.
    fn source_lights(&self) -> Vec<(i64, String)> {
        self.scene
            .lights
            .iter()
            .map(|(lane, status)| (self.scene.map[lane].source_id, status.to_string()))
            .collect()
    }

    /// The goal of the route: x, y, heading.
    fn goal(&self) -> Option<(f64, f64, f64)> {
        self.scene
            .route
            .goal
            .map(|Pose { x, y, heading }| (x, y, heading))
    }

    /// The lane of the goal, where the score asks for it.
    fn goal_lane(&self) -> Option<u32> {
        self.scene.route.goal_lane.map(|lane| lane.0)
    }

    /// The picture that a model sees.
    fn image<'py>(&self, py: Python<'py>, pixels: u32, meters: f64) -> PyResult<Picture<'py>> {
        let image = quick(py, || {
            let view = BevView::new(pixels, meters)
                .map_err(|error| Failure::argument(error.to_string()))?;
            Ok(render_bev(&self.scene.view(), &view))
        })?;
        Ok(picture(py, image))
    }

    /// The picture for people.
    #[pyo3(signature = (pixels, meters, plan=None))]
    fn render<'py>(
        &self,
        py: Python<'py>,
        pixels: u32,
        meters: f64,
        plan: Option<&Bound<'py, Trajectory>>,
    ) -> PyResult<Picture<'py>> {
        let plan = plan.map(|plan| &plan.get().0);
        let image = quick(py, || {
            let drawn = observed_picture(&self.scene.view(), plan, Look { pixels, meters });
            drawn.map_err(|error| Failure::argument(error.to_string()))
        })?;
        Ok(picture(py, image))
    }

    /// The lane graph in words, in the form of a prompt set.
    fn lane_graph(&self, py: Python<'_>, form: String) -> PyResult<String> {
        quick(py, || {
            let form: TextForm = chosen("form", &form)?;
            Ok(write_lane_graph(
                &Description::from_graph(&self.graph()?),
                form,
            ))
        })
    }

    /// The centerlines that a planner code may follow.
    fn centerlines(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        quick(py, || {
            Ok(self
                .graph()?
                .centerlines
                .iter()
                .map(|centerline| centerline.name.to_string())
                .collect())
        })
    }

    /// The trajectory of a planner code: centerline, share of the speed limit, maximum acceleration
    /// and deceleration (m/s²).
    fn plan_of_code(
        &self,
        py: Python<'_>,
        centerline: String,
        speed: f64,
        accelerations: (f64, f64),
    ) -> PyResult<Trajectory> {
        quick(py, || {
            let graph = self.graph()?;
            let name: CenterlineName = chosen("centerline", &centerline)?;
            let builder = ReflectionSettings::default().plan_builder();
            let scene = self.scene.view();
            let failed =
                |error: &dyn std::error::Error| Failure::new("SceneError", with_causes(error));
            let plan = builder.build(
                GraphedScene::new(&scene, &graph),
                planner_code(&graph, name, speed, accelerations),
            );
            let plan = plan.map_err(|error| failed(&error))?;
            let absent = || {
                Failure::argument(format!(
                    "there is no {name} here; Observation.centerlines lists them"
                ))
            };
            let rollout = plan
                .ok_or_else(absent)?
                .roll_out(&scene, (PLAN_S / STEP_S) as usize);
            rollout
                .to_trajectory(&self.scene.ego)
                .map(Trajectory)
                .map_err(|error| failed(&error))
        })
    }

    /// A trajectory from the present through packed poses at equal steps.
    fn trajectory(&self, py: Python<'_>, poses: &[u8], dt_s: f64) -> PyResult<Trajectory> {
        quick(py, || {
            Ok(Trajectory(planned(
                &self.scene.ego,
                &crate::trajectory::poses(poses)?,
                dt_s,
            )?))
        })
    }

    /// The whole scene with its map as bytes.
    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = quick(py, || {
            let scene = &self.scene;
            let stored = Stored {
                map: Cow::Borrowed(scene.map.parts()),
                route: scene.route.clone(),
                lights: scene.lights.clone(),
                samples: scene
                    .history
                    .samples()
                    .map(|sample| (sample.ego, sample.objects.to_vec()))
                    .collect(),
                ego: scene.ego,
                objects: scene.objects.to_vec(),
                iteration: self.iteration,
                start_us: self.start_us,
            };
            serde_pickle::to_vec(&stored, SerOptions::new())
                .map_err(|error| Failure::panic(format!("the scene as bytes: {error}")))
        })?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// The observation of such bytes.
    #[staticmethod]
    fn of_bytes(py: Python<'_>, bytes: &[u8]) -> PyResult<Self> {
        quick(py, || {
            let wrong = |error: &dyn std::error::Error| {
                Failure::argument(format!(
                    "the bytes of an observation: {}",
                    with_causes(error)
                ))
            };
            let stored: Stored<'_> =
                serde_pickle::from_slice(bytes, DeOptions::new()).map_err(|error| wrong(&error))?;
            let map = LaneMap::new(stored.map.into_owned()).map_err(|error| wrong(&error))?;
            let mut history = History::default();
            for (ego, objects) in stored.samples {
                let objects = objects.into();
                history.push(HistorySample { ego, objects });
            }
            let map = Arc::new(map);
            let view = SceneView {
                map: &map,
                route: &stored.route,
                ego: &stored.ego,
                objects: &stored.objects,
                lights: &stored.lights,
                history: &history,
            };
            let scene = Scene::of_view(Arc::clone(&map), &view);
            Ok(Self::new(scene, stored.iteration, stored.start_us))
        })
    }

    /// How many samples a full history has.
    #[classattr]
    const MAX_HISTORY: usize = HISTORY_SAMPLES;
}

/// Scores of packed trajectories of as many steps of 0.1 s: for each, score, collision, area,
/// direction, progress, time to collision, comfort, progress in meters.
#[pyfunction]
pub(crate) fn score_trajectories<'py>(
    py: Python<'py>,
    observation: &Bound<'py, Observation>,
    packed_poses: Vec<u8>,
    steps: usize,
) -> PyResult<Bound<'py, PyByteArray>> {
    let (scene, iteration) = (
        Arc::clone(&observation.get().scene),
        observation.get().iteration,
    );
    let work = move || {
        if !SCORED_STEPS.contains(&steps) {
            let (least, most) = (SCORED_STEPS.start(), SCORED_STEPS.end());
            let text = format!(
                "a trajectory to be scored has {least} to {most} poses 0.1 s apart, got {steps}"
            );
            return Err(Failure::argument(text));
        }
        let observation = Observation {
            scene: Arc::clone(&scene),
            iteration,
            start_us: 0,
        };
        let (view, graph) = (scene.view(), observation.graph()?);
        let failed = |error: &dyn std::error::Error| Failure::new("SceneError", with_causes(error));
        let judge = Judge::new(
            &view,
            &graph,
            steps as f64 * STEP_S,
            &mut PdmMemory::default(),
        );
        let judge = judge.map_err(|error| failed(&error))?;
        let mut rows = Vec::new();
        for poses in poses(&packed_poses)?.chunks_exact(steps) {
            if !poses.iter().all(Pose::is_finite) {
                return Err(Failure::argument(
                    "a trajectory has a NaN or infinite value",
                ));
            }
            let reference: Vec<Pose> = std::iter::once(scene.ego.rear_axle)
                .chain(poses.iter().copied())
                .collect();
            let states = simulate_proposal(&scene.ego, &reference, JerkPenalty::PdmClosed);
            let report = judge.assess(states, 0.0).map_err(|error| failed(&error))?;
            let parts = report.parts;
            rows.extend([
                report.score,
                parts.no_collision,
                parts.drivable_area,
                parts.driving_direction,
                parts.progress,
                parts.time_to_collision,
                parts.comfort,
                report.progress_m,
            ]);
        }
        Ok(rows)
    };
    let rows = long(py, || computed(work), &|| ())?;
    Ok(array(py, &packed(rows)))
}
