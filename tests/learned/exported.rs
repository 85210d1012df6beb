//! Networks of checkpoints that `python -m imitation` exported, with the inputs that it exported
//! beside them. The bench of learned planners includes this file too.

use candle_core::{DType, Device, Tensor};
use planagent_learned::dtpp::{Dtpp, DtppConfig};
use planagent_learned::gameformer::{GameFormer, GameFormerConfig, SceneInputs};
use planagent_learned::gc_pgp::{GcPgp, GcPgpInputs};
use planagent_learned::pdm_open::{HIDDEN, PdmInputs, PdmNetwork};
use planagent_learned::plantf::{PlanTf, PlanTfConfig, PlanTfInputs, PlanTfMap};
use planagent_learned::raster_model::{RasterModel, RasterModelConfig};
use planagent_learned::urban_driver::{Elements, UrbanDriver, UrbanDriverConfig};
use planagent_learned::{Checkpoint, Probe, Weights};
use std::collections::HashMap;
use std::path::Path;

/// The planners that are exported.
pub(crate) const PLANNERS: [&str; 7] = [
    "pdm-open",
    "plantf",
    "urban-driver",
    "raster-model",
    "gc-pgp",
    "gameformer",
    "dtpp",
];

/// Which shapes are exported.
#[derive(Clone, Copy, PartialEq, Eq)]
#[allow(
    dead_code,
    reason = "the tests have small ones, the bench published ones"
)]
pub(crate) enum Shape {
    /// Those of `selftest`.
    Small,
    /// Those of `speed`.
    Published,
}

/// A network with its inputs: its outputs by name.
pub(crate) type Run = Box<dyn Fn() -> Vec<(String, Tensor)> + Send + Sync>;

/// Inputs and outputs by name.
pub(crate) struct Exported(HashMap<String, Tensor>);

impl Exported {
    pub(crate) fn open(path: &Path) -> Self {
        Self(candle_core::safetensors::load(path, &Device::Cpu).unwrap())
    }

    /// The outputs that were exported.
    pub(crate) fn outputs(&self) -> impl Iterator<Item = (&str, &Tensor)> {
        self.0
            .iter()
            .filter_map(|(name, tensor)| Some((name.strip_prefix("out.")?, tensor)))
    }

    fn get(&self, name: &str) -> Tensor {
        self.0
            .get(&format!("in.{name}"))
            .unwrap_or_else(|| panic!("no in.{name}"))
            .clone()
    }

    fn typed(&self, dtype: DType, name: &str) -> Tensor {
        self.get(name).to_dtype(dtype).unwrap()
    }

    fn scene(&self) -> SceneInputs {
        SceneInputs {
            ego: self.get("ego_agent_past"),
            neighbors: self.get("neighbor_agents_past"),
            lanes: self.get("map_lanes"),
            crosswalks: self.get("map_crosswalks"),
        }
    }
}

fn load<M>(checkpoint: &Path, take: impl FnOnce(&mut Weights) -> candle_core::Result<M>) -> M {
    Checkpoint::open(checkpoint)
        .unwrap()
        .load("the exported network", take)
        .unwrap()
}

fn named(outputs: Vec<(&str, Tensor)>) -> Vec<(String, Tensor)> {
    outputs
        .into_iter()
        .map(|(name, tensor)| (name.to_owned(), tensor))
        .collect()
}

/// The network of a planner in an exported shape.
pub(crate) fn network(planner: &str, checkpoint: &Path, io: &Exported, shape: Shape) -> Run {
    let small = shape == Shape::Small;
    match planner {
        "pdm-open" => {
            let network = load(checkpoint, |weights| {
                PdmNetwork::open(weights, if small { 32 } else { HIDDEN })
            });
            let inputs = PdmInputs {
                position: io.get("position"),
                velocity: io.get("velocity"),
                acceleration: io.get("acceleration"),
                centerline: io.get("centerline"),
                trajectory: None,
            };
            Box::new(move || {
                named(vec![(
                    "trajectory",
                    network.forward(&inputs, &Probe::off()).unwrap(),
                )])
            })
        }
        "plantf" => plantf(checkpoint, io, small),
        "urban-driver" => {
            let config = UrbanDriverConfig {
                embedding: 32,
                layers: 2,
            };
            let config = if small {
                config
            } else {
                UrbanDriverConfig::PUBLISHED
            };
            let network = load(checkpoint, |weights| UrbanDriver::take(weights, config));
            let counts = if small {
                [1, 6, 8, 8, 8, 3, 4, 6]
            } else {
                [1, 30, 30, 30, 30, 20, 20, 30]
            };
            let elements = Elements {
                points: io.get("points"),
                available: io.typed(DType::U8, "available"),
                counts,
            };
            Box::new(move || {
                named(vec![(
                    "trajectory",
                    network.forward(&elements, &Probe::off()).unwrap(),
                )])
            })
        }
        "raster-model" => {
            let config = RasterModelConfig {
                widths: [16, 8, 16, 32],
            };
            let config = if small {
                config
            } else {
                RasterModelConfig::PUBLISHED
            };
            let network = load(checkpoint, |weights| RasterModel::take(weights, config));
            let raster = io.get("raster");
            Box::new(move || {
                named(vec![(
                    "trajectory",
                    network.forward(&raster, &Probe::off()).unwrap(),
                )])
            })
        }
        "gc-pgp" => gc_pgp(checkpoint, io),
        "gameformer" => {
            let config = GameFormerConfig {
                dim: 16,
                encoder_layers: 2,
                levels: 2,
                modes: 3,
                neighbors: 4,
            };
            let config = if small {
                config
            } else {
                GameFormerConfig::PUBLISHED
            };
            let network = load(checkpoint, |weights| GameFormer::take(weights, config));
            let (scene, route) = (io.scene(), io.get("route_lanes"));
            Box::new(move || {
                let outputs = network.forward(&scene, &route, &Probe::off()).unwrap();
                let mut found = vec![("ego_plan".to_owned(), outputs.plan)];
                for (i, (futures, scores)) in outputs.levels.into_iter().enumerate() {
                    found.push((format!("level_{i}_interactions"), futures));
                    found.push((format!("level_{i}_scores"), scores));
                }
                found
            })
        }
        "dtpp" => {
            let config = DtppConfig {
                dim: 16,
                inner: 4,
                encoder_layers: 2,
                neighbors: 4,
                branches: 30,
            };
            let config = if small { config } else { DtppConfig::PUBLISHED };
            let network = load(checkpoint, |weights| Dtpp::take(weights, config));
            let (scene, tree) = (io.scene(), io.get("tree"));
            Box::new(move || {
                let outputs = network.forward(&scene, &tree, 80, &Probe::off()).unwrap();
                named(vec![
                    ("agent_trajectories", outputs.futures),
                    ("scores", outputs.scores),
                    ("ego_regularization", outputs.regularization),
                    ("weights", outputs.weights),
                ])
            })
        }
        other => panic!("{other}"),
    }
}

fn plantf(checkpoint: &Path, io: &Exported, small: bool) -> Run {
    let config = PlanTfConfig {
        dim: 32,
        depth: 2,
        heads: 4,
        modes: 3,
    };
    let config = if small {
        config
    } else {
        PlanTfConfig::PUBLISHED
    };
    let network = load(checkpoint, |weights| PlanTf::take(weights, config));
    let line = |name: &str| {
        io.get(name)
            .narrow(2, 0, 1)
            .unwrap()
            .squeeze(2)
            .unwrap()
            .contiguous()
            .unwrap()
    };
    let inputs = PlanTfInputs {
        current_state: io.get("current_state"),
        position: io.get("agent.position"),
        heading: io.get("agent.heading"),
        velocity: io.get("agent.velocity"),
        shape: io.get("agent.shape"),
        category: io.typed(DType::U32, "agent.category"),
        valid: io.typed(DType::U8, "agent.valid_mask"),
        map: PlanTfMap {
            point: line("map.point_position"),
            vector: line("map.point_vector"),
            orientation: line("map.point_orientation"),
            center: io.get("map.polygon_center"),
            kind: io.typed(DType::U32, "map.polygon_type"),
            on_route: io.typed(DType::U32, "map.polygon_on_route"),
            light: io.typed(DType::U32, "map.polygon_tl_status"),
            speed_limit: io.get("map.polygon_speed_limit"),
            has_speed_limit: io.typed(DType::U8, "map.polygon_has_speed_limit"),
            valid: io.typed(DType::U8, "map.valid_mask"),
        },
    };
    Box::new(move || {
        let outputs = network.forward(&inputs, &Probe::off()).unwrap();
        named(vec![
            ("trajectory", outputs.trajectory),
            ("probability", outputs.probability),
            ("prediction", outputs.prediction),
        ])
    })
}

fn gc_pgp(checkpoint: &Path, io: &Exported) -> Run {
    let network = load(checkpoint, GcPgp::take);
    let inputs = GcPgpInputs {
        ego: io.get("ego"),
        agents: io.get("agents"),
        agents_missing: io.get("agents_missing"),
        far: io.get("far"),
        poses: io.get("poses"),
        poses_missing: io.get("poses_missing"),
        red: io.get("red"),
        successors: io.get("successors"),
        edges: io.get("edges"),
        on_route: io.get("on_route"),
    };
    let walks = io.typed(DType::U32, "walks").to_vec3::<u32>().unwrap();
    let walks: Vec<Vec<[u32; 16]>> = walks
        .into_iter()
        .map(|sample| {
            sample
                .into_iter()
                .map(|walk| walk.try_into().unwrap())
                .collect()
        })
        .collect();
    let latent = io.get("latent");
    Box::new(move || {
        let scene = network.encode(&inputs, false, &Probe::off()).unwrap();
        let contexts = network.aggregate(&scene.encodings, &walks).unwrap();
        let trajectories = network.decode(&contexts, &latent).unwrap();
        named(vec![
            ("policy", scene.policy),
            ("contexts", contexts),
            ("trajectories", trajectories),
        ])
    })
}
