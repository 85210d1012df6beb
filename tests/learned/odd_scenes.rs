//! What planners make of generated scenes without agents, with many, without lights and off the
//! route: features of the same shapes, and plans of finite poses.

use super::vectors::network;
use candle_core::Tensor;
use planagent_learned::Probe;
use planagent_learned::dtpp::{Dtpp, DtppConfig, paths, scored_tree};
use planagent_learned::gameformer::{
    ActorFeatures, GameFormer, GameFormerConfig, reference_path, refinement,
};
use planagent_learned::gc_pgp::{GcPgp, GcPgpFeatures, poses};
use planagent_learned::plantf::PlanTfFeatures;
use planagent_learned::raster_model::Raster;
use planagent_learned::urban_driver::UrbanDriverFeatures;
use planagent_scenario::Scenario;
use planagent_scenario::generator::{self, Spec, types};
use planagent_world::geometry::{OrientedBox, Pose, Vector};
use planagent_world::{
    History, HistorySample, ObjectKind, SceneView, TrackToken, TrackedObject, TrafficLights,
};
use std::sync::Arc;

const TINY_DTPP: DtppConfig = DtppConfig {
    dim: 16,
    inner: 4,
    encoder_layers: 1,
    neighbors: 10,
    branches: 30,
};
const TINY_GAMEFORMER: GameFormerConfig = GameFormerConfig {
    dim: 16,
    encoder_layers: 1,
    levels: 1,
    modes: 2,
    neighbors: 10,
};

/// Agents of all kinds around a pose, some of them far away.
fn crowd(around: Pose, count: u32) -> Arc<[TrackedObject]> {
    let kinds = [
        ObjectKind::Vehicle,
        ObjectKind::Pedestrian,
        ObjectKind::Bicycle,
        ObjectKind::TrafficCone,
    ];
    let agent = |i: u32| {
        let angle = f64::from(i) * 2.399;
        let place = around.translated(
            1.2 * f64::from(i) * angle.cos() * 0.3,
            f64::from(i) * angle.sin() * 0.4,
        );
        TrackedObject {
            token: TrackToken(1000 + i),
            kind: kinds[i as usize % kinds.len()],
            shape: OrientedBox::new(
                Pose {
                    heading: angle,
                    ..place
                },
                4.5,
                1.9,
            ),
            velocity: Vector::new(f64::from(i % 7), 0.5),
        }
    };
    (0..count).map(agent).collect()
}

/// Each scene in its versions.
fn each(check: impl Fn(&str, &SceneView<'_>)) {
    for (scenario_type, seed) in [
        (types::starting_left_turn::TYPE, 3),
        (types::traversing_roundabout::TYPE, 4),
        (types::changing_lane::TYPE, 5),
        (types::low_magnitude_speed::TYPE, 6),
    ] {
        let spec = Spec::new(scenario_type, seed);
        let log: Scenario = generator::generate(&spec).unwrap();
        let word = &log.id;
        for now in [log.start, log.frames.len() - 1] {
            let frame = log.frames[now].clone();
            let history = |objects: Option<&Arc<[TrackedObject]>>, kept: usize| {
                let mut history = History::default();
                for frame in &log.frames[(now + 1).saturating_sub(kept)..=now] {
                    let objects = objects.unwrap_or(&frame.objects).clone();
                    history.push(HistorySample {
                        ego: frame.ego,
                        objects,
                    });
                }
                history
            };
            check(word, &log.scene(&frame, &history(None, 22)));
            check(
                &format!("{word} without history"),
                &log.scene(&frame, &history(None, 1)),
            );
            for count in [0, 200] {
                let objects = crowd(frame.ego.rear_axle, count);
                let frame = planagent_scenario::Frame {
                    objects: objects.clone(),
                    ..frame.clone()
                };
                check(
                    &format!("{word} with {count} agents"),
                    &log.scene(&frame, &history(Some(&objects), 22)),
                );
            }
            let mut dark = frame.clone();
            dark.lights = Arc::new(TrafficLights::default());
            check(
                &format!("{word} without lights"),
                &log.scene(&dark, &history(None, 22)),
            );
            for beside in [30.0, 3000.0] {
                let mut off = frame.clone();
                off.ego.rear_axle = off.ego.rear_axle.translated(0.0, beside);
                let mut history = History::default();
                history.push(HistorySample {
                    ego: off.ego,
                    objects: off.objects.clone(),
                });
                check(
                    &format!("{word} off the route by {beside} m"),
                    &log.scene(&off, &history),
                );
            }
        }
    }
}

fn assert_finite(what: &str, tensor: &Tensor) {
    let values: Vec<f32> = tensor.flatten_all().unwrap().to_vec1().unwrap();
    assert!(values.iter().all(|value| value.is_finite()), "{what}");
}

#[test]
fn features_are_finite() {
    each(|name, scene| {
        assert_finite(name, &Raster::from_scene(scene).inputs().unwrap());
        let plantf = PlanTfFeatures::from_scene(scene, &scene.route.roadblocks)
            .inputs()
            .unwrap();
        assert_finite(name, &plantf.position);
        let urban = UrbanDriverFeatures::from_scene(scene);
        assert!(
            urban
                .vehicles
                .iter()
                .flatten()
                .flatten()
                .all(|value| value.is_finite()),
            "{name}"
        );
        for radius in [60.0, 80.0] {
            let inputs = ActorFeatures::from_scene(scene, radius).inputs().unwrap();
            assert_eq!(inputs.neighbors.dims(), [1, 20, 21, 11], "{name}");
            for part in [
                &inputs.ego,
                &inputs.neighbors,
                &inputs.lanes,
                &inputs.crosswalks,
            ] {
                assert_finite(name, part);
            }
        }
        let features = GcPgpFeatures::from_scene(scene).unwrap();
        let inputs = features.inputs().unwrap();
        for part in [
            &inputs.ego,
            &inputs.agents,
            &inputs.poses,
            &inputs.successors,
        ] {
            assert_finite(name, part);
        }
        let nodes = features.graph.nodes.len();
        assert!(
            features.graph.initial.iter().all(|&node| node < nodes)
                && !features.graph.initial.is_empty(),
            "{name}"
        );
        let edges = features
            .graph
            .nodes
            .iter()
            .flat_map(|node| node.successors.iter().chain(&node.proximal));
        assert!(edges.into_iter().all(|&to| to < nodes), "{name}");
        assert!(
            features
                .graph
                .nodes
                .iter()
                .all(|node| node.poses.len() <= 20),
            "{name}"
        );
        assert_eq!(features.agents.len() as u64, count(scene), "{name}");
    });
}

fn count(scene: &SceneView<'_>) -> u64 {
    scene
        .objects
        .iter()
        .filter(|object| object.kind == ObjectKind::Vehicle)
        .count() as u64
}

#[test]
fn plans_are_finite() {
    let pgp = network(GcPgp::take);
    let gameformer = network(|weights| GameFormer::take(weights, TINY_GAMEFORMER));
    let dtpp = network(|weights| Dtpp::take(weights, TINY_DTPP));
    each(|name, scene| {
        let features = GcPgpFeatures::from_scene(scene).unwrap();
        let plans = pgp.plans(&features, &features.inputs().unwrap()).unwrap();
        let sum: f64 = plans.iter().map(|plan| plan.0).sum();
        assert!(
            (sum - 1.0).abs() < 1e-9 && plans.is_sorted_by(|a, b| a.0 >= b.0),
            "{name}"
        );
        let plan = poses(&plans[0].1, features.start_speed());
        assert!(
            plan.len() == 16 && plan.as_flattened().iter().all(|value| value.is_finite()),
            "{name}"
        );
        let actors = ActorFeatures::from_scene(scene, 60.0);
        let inputs = actors.inputs().unwrap();
        let outputs = gameformer
            .forward(&inputs, &actors.route_input().unwrap(), &Probe::off())
            .unwrap();
        assert_finite(name, &outputs.plan);
        if let Some(path) = reference_path(scene) {
            assert_eq!(path.len(), 1200, "{name}");
            assert!(
                path.as_flattened().iter().all(|value| value.is_finite()),
                "{name}"
            );
            let plan: Vec<[f32; 3]> = path
                .iter()
                .step_by(9)
                .take(80)
                .map(|row| [row[0], row[1], row[2]])
                .collect();
            let speeds = refinement(&path, &plan, &[], actors.present_ego()).solve();
            assert!(
                speeds.len() == 80
                    && speeds
                        .iter()
                        .all(|speed| speed.is_finite() && *speed >= 0.0),
                "{name}"
            );
        } else {
            assert!(
                name.contains("off the route"),
                "{name} has no reference path"
            );
        }
        let (courses, limit) = paths(scene);
        assert!(courses.len() <= 3, "{name}");
        let start = [scene.ego.velocity.x as f32, scene.ego.acceleration.x as f32];
        if let Ok(tree) = scored_tree(&dtpp, &inputs, &courses, limit, start, 1) {
            assert!(
                tree.best.len() == 80
                    && tree
                        .best
                        .as_flattened()
                        .iter()
                        .all(|value| value.is_finite()),
                "{name}"
            );
        }
    });
}
