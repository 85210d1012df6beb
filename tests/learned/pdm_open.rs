//! PDM-Open and PDM-Offset.

use super::scene::scene;
use super::vectors::{
    FEATURES, NETWORK, Vectors, assert_close, assert_manifest, fixture, json, network,
};
use candle_core::{Device, Tensor};
use planagent_learned::pdm_open::{HIDDEN, PdmFeatures, PdmInputs, PdmNetwork, fused, sampled};
use planagent_learned::{Probe, trajectory};
use planagent_score::pdm::{PdmPath, centerline_poses, corrected_route, current_lane, lane_chain};
use planagent_world::geometry::Pose;
use planagent_world::{Scene, Trajectory, TrajectoryState};
use serde_json::Value;

/// Hidden width of the tiny variants.
const TINY: usize = 32;

fn check(network: &PdmNetwork, file: &Vectors, name: &str, mids: &[&str]) {
    for source in ["random", "scene_a", "scene_b"] {
        let input = |name: &str| file.get(&format!("{source}.in.{name}")).clone();
        let inputs = PdmInputs {
            position: input("ego_position"),
            velocity: input("ego_velocity"),
            acceleration: input("ego_acceleration"),
            centerline: input("planner_centerline"),
            trajectory: file
                .names()
                .any(|name| name.ends_with("in.planner_trajectory"))
                .then(|| input("planner_trajectory")),
        };
        let probe = Probe::on();
        let plan = network.forward(&inputs, &probe).unwrap();
        for mid in mids {
            let expected = file.get(&format!("{source}.mid.{mid}"));
            assert_close(
                &format!("{name} {source} {mid}"),
                &probe.get(mid).unwrap(),
                expected,
                NETWORK,
            );
        }
        assert_close(
            &format!("{name} {source}"),
            &plan,
            file.get(&format!("{source}.out.trajectory")),
            NETWORK,
        );
    }
}

const OPEN: [&str; 4] = [
    "state_encoding",
    "centerline_encoding",
    "planner_head.0",
    "planner_head.4",
];
const OFFSET: [&str; 5] = [
    "state_encoding",
    "centerline_encoding",
    "trajectory_encoding",
    "planner_head.0",
    "planner_head.4",
];

#[test]
fn the_tiny_networks_compute_what_pytorch_computes() {
    let open = network(|weights| PdmNetwork::open(weights, TINY));
    check(
        &open,
        &Vectors::open(&fixture("pdm/pdm_open_tiny.io.safetensors")),
        "pdm_open_tiny",
        &OPEN,
    );
    let offset = network(|weights| PdmNetwork::offset(weights, TINY));
    check(
        &offset,
        &Vectors::open(&fixture("pdm/pdm_offset_tiny.io.safetensors")),
        "pdm_offset_tiny",
        &OFFSET,
    );
}

#[test]
fn the_full_networks_compute_what_pytorch_computes() {
    let file = Vectors::open(&fixture("pdm/pdm_open_full.io.safetensors"));
    check(
        &network(|weights| PdmNetwork::open(weights, HIDDEN)),
        &file,
        "pdm_open_full",
        &OPEN,
    );
    let file = Vectors::open(&fixture("pdm/pdm_offset_full.io.safetensors"));
    check(
        &network(|weights| PdmNetwork::offset(weights, HIDDEN)),
        &file,
        "pdm_offset_full",
        &OFFSET,
    );
}

#[test]
fn the_tensors_are_those_of_the_manifests() {
    assert_manifest("pdm/pdm_open_full.manifest.json", |weights| {
        PdmNetwork::open(weights, HIDDEN)
    });
    assert_manifest("pdm/pdm_offset_full.manifest.json", |weights| {
        PdmNetwork::offset(weights, HIDDEN)
    });
}

fn path(scene: &Scene) -> PdmPath {
    let blocks = corrected_route(&scene.map, &scene.route.roadblocks, scene.ego.rear_axle);
    let lanes: Vec<_> = blocks
        .iter()
        .flat_map(|&block| scene.map[block].lanes.iter().copied())
        .collect();
    let start = current_lane(&scene.map, &lanes, &scene.ego).unwrap();
    PdmPath::new(&centerline_poses(
        &scene.map,
        &lane_chain(&scene.map, &blocks, &lanes, start),
    ))
    .unwrap()
}

fn matrix(value: &Value) -> Tensor {
    let rows = value.as_array().unwrap();
    let row = |row: &Value| {
        row.as_array()
            .unwrap()
            .iter()
            .map(|x| x.as_f64().unwrap() as f32)
            .collect::<Vec<f32>>()
    };
    let columns = row(&rows[0]).len();
    let values: Vec<f32> = rows.iter().flat_map(row).collect();
    Tensor::from_vec(values, (rows.len(), columns), &Device::Cpu).unwrap()
}

#[test]
fn the_features_are_those_of_the_original() {
    for name in ["scene_a", "scene_b"] {
        let (scene, expected) = (scene(name), json(&format!("pdm/features_{name}.json")));
        let path = path(&scene);
        assert!((path.length() - expected["path_length"].as_f64().unwrap()).abs() < 1e-6);
        let features = PdmFeatures::from_scene(&scene.view(), &path).unwrap();
        let inputs = features.inputs().unwrap();
        for (key, found) in [
            ("ego_position", &inputs.position),
            ("ego_velocity", &inputs.velocity),
            ("ego_acceleration", &inputs.acceleration),
            ("planner_centerline", &inputs.centerline),
        ] {
            assert_close(
                &format!("{name} {key}"),
                &found.squeeze(0).unwrap(),
                &matrix(&expected[key]),
                FEATURES,
            );
        }
    }
}

#[test]
fn a_plan_becomes_the_trajectory_of_the_original() {
    for name in ["scene_a", "scene_b"] {
        let (scene, file) = (scene(name), json(&format!("pdm/features_{name}.json")));
        let case = &file["transform_predictions"];
        let plan = matrix(&case["prediction"]).to_vec2::<f32>().unwrap();
        let poses: Vec<[f32; 3]> = plan.iter().map(|row| [row[0], row[1], row[2]]).collect();
        let states = trajectory(&poses, 500_000, &scene.view()).unwrap();
        let expected = case["states"].as_array().unwrap();
        assert_eq!(states.states().len(), expected.len());
        for (state, expected) in states.states().iter().zip(expected) {
            let of = |column: usize| expected[column].as_f64().unwrap();
            // Upstream truncates times to microseconds.
            assert!((state.time_us as f64 - of(0)).abs() <= 1.0);
            let pose = Pose::new(of(1), of(2), of(3));
            assert!(
                state.rear_axle.distance(&pose) < 1e-6
                    && (state.rear_axle.heading - pose.heading).abs() < 1e-6
            );
            // The accelerations feel the microsecond by which recorded times are late.
            let motion = [
                state.velocity.x,
                state.velocity.y,
                state.acceleration.x,
                state.acceleration.y,
            ];
            for (found, column) in motion.into_iter().zip(4..) {
                assert!(
                    (found - of(column)).abs() < 2e-4,
                    "{found} instead of {}",
                    of(column)
                );
            }
        }
    }
}

/// PDM-Closed's trajectory in a case.
fn closed(file: &Value) -> Trajectory {
    let state = |state: &Value| {
        let of = |column: usize| state[column].as_f64().unwrap();
        TrajectoryState::moving(
            state[0].as_i64().unwrap(),
            Pose::new(of(1), of(2), of(3)),
            0.0,
            0.0,
        )
    };
    let states = file["offset_case"]["closed_trajectory_states"]
        .as_array()
        .unwrap();
    Trajectory::new(states.iter().map(state).collect()).unwrap()
}

#[test]
fn the_correction_reads_and_follows_the_trajectory_of_pdm_closed() {
    for name in ["scene_a", "scene_b"] {
        let (scene, file) = (scene(name), json(&format!("pdm/features_{name}.json")));
        let (closed, now_us) = (closed(&file), scene.ego.time_us);
        let poses = sampled(&closed, scene.ego.rear_axle, now_us).unwrap();
        let found =
            Tensor::from_slice(poses.as_flattened(), (poses.len(), 3), &Device::Cpu).unwrap();
        assert_close(
            name,
            &found,
            &matrix(&file["offset_case"]["planner_trajectory"]),
            FEATURES,
        );
        let corrected = trajectory(&poses, 500_000, &scene.view()).unwrap();
        let whole = fused(&closed, &corrected, now_us).unwrap();
        let times = |key: &str| {
            file["hybrid_fusion"][key]
                .as_array()
                .unwrap()
                .iter()
                .map(|time| time.as_i64().unwrap())
        };
        let expected: Vec<i64> = times("times_closed_kept")
            .chain(times("times_offset_kept"))
            .collect();
        assert_eq!(whole.states().len(), expected.len());
        for (state, expected) in whole.states().iter().zip(expected) {
            // Upstream truncates times to microseconds.
            assert!(
                (state.time_us - expected).abs() <= 1,
                "{} instead of {expected}",
                state.time_us
            );
        }
    }
}
