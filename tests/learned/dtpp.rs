//! DTPP.

use super::gameformer::{check_features, random_scene};
use super::scene::scene;
use super::vectors::{
    NETWORK, Vectors, assert_close, assert_manifest, comparison, fixture, input, json, network,
    numbers,
};
use candle_core::{Device, Tensor};
use planagent_learned::Probe;
use planagent_learned::dtpp::{
    Dtpp, DtppConfig, Step, costed_paths, first_stage, paths, profile, scored_tree, second_stage,
};
use planagent_learned::gameformer::{ActorFeatures, SceneInputs};

/// The tiny variant divides the width of the inner layer by sixteen twice.
const TINY: DtppConfig = DtppConfig {
    dim: 16,
    inner: 4,
    encoder_layers: 2,
    neighbors: 4,
    branches: 6,
};

fn inputs(file: &Vectors) -> (SceneInputs, Tensor) {
    let scene = SceneInputs {
        ego: file.get("in.ego_agent_past").clone(),
        neighbors: file.get("in.neighbor_agents_past").clone(),
        lanes: file.get("in.map_lanes").clone(),
        crosswalks: file.get("in.map_crosswalks").clone(),
    };
    (scene, file.get("in.tree").clone())
}

/// The random scene and tree of the full size, which the recipe of the inputs makes.
fn random_inputs(steps: usize) -> (SceneInputs, Tensor) {
    let [ego, mut neighbors, mut lanes, mut crosswalks] = random_scene("dtpp_full", 1);
    let (neighbor, lane, crosswalk) = (21 * 11, 50 * 7, 30 * 3);
    neighbors[18 * neighbor..].fill(0.0);
    neighbors[2 * neighbor..3 * neighbor].fill(0.0);
    lanes[37 * lane..].fill(0.0);
    crosswalks[4 * crosswalk..].fill(0.0);
    let x = input("dtpp_full/tree/0", 28 * steps * 6, 1.0);
    let mut tree = vec![0f32; 30 * 80 * 6];
    for branch in 0..28 {
        let x = |step: usize, column: usize| f64::from(x[(branch * steps + step) * 6 + column]);
        let mut along = 0.0;
        for step in 0..steps {
            let speed = 5.0 + 2.0 * x(0, 3) + 0.5 * x(step, 3);
            along += 0.1 * speed;
            let row = [
                along,
                0.3 * x(step, 1),
                0.05 * x(step, 2),
                speed,
                x(step, 4),
                0.05 * x(step, 5),
            ];
            tree[(branch * 80 + step) * 6..][..6].copy_from_slice(&row.map(|value| value as f32));
        }
    }
    let tensor =
        |values: Vec<f32>, shape: &[usize]| Tensor::from_vec(values, shape, &Device::Cpu).unwrap();
    let scene = SceneInputs {
        ego: tensor(ego, &[1, 21, 7]),
        neighbors: tensor(neighbors, &[1, 20, 21, 11]),
        lanes: tensor(lanes, &[1, 40, 50, 7]),
        crosswalks: tensor(crosswalks, &[1, 5, 30, 3]),
    };
    (scene, tensor(tree, &[1, 30, 80, 6]))
}

fn check(
    network: &Dtpp,
    (scene, tree): &(SceneInputs, Tensor),
    steps: usize,
    file: &Vectors,
    name: &str,
) {
    let close = comparison(name);
    let probe = Probe::on();
    let outputs = network.forward(scene, tree, steps, &probe).unwrap();
    for mid in [
        "encoder.ego_encoder",
        "encoder.fusion_encoder",
        "decoder.ego_traj_encoder",
        "decoder.environment_decoder",
        "decoder.ego_condition_decoder",
        "hardcoded_features",
    ] {
        let expected = format!("mid.{mid}");
        if file.names().any(|name| name == expected) {
            close(
                &format!("{name} {mid}"),
                &probe.get(mid).unwrap(),
                file.get(&expected),
                NETWORK,
            );
        }
    }
    let batch = tree.dim(0).unwrap();
    for mid in [
        "decoder.interaction_feature_encoder",
        "decoder.interaction_feature_decoder",
    ] {
        let expected = format!("mid.{mid}");
        if batch == 1 && file.names().any(|name| name == expected) {
            close(
                &format!("{name} {mid}"),
                &probe.get(mid).unwrap(),
                file.get(&expected),
                NETWORK,
            );
        }
    }
    let near = probe
        .get("collision")
        .unwrap()
        .narrow(1, 0, 1)
        .unwrap()
        .squeeze(1)
        .unwrap();
    close(
        &format!("{name} collision"),
        &near,
        file.get("mid.collision_branch0"),
        NETWORK,
    );
    close(
        &format!("{name} futures"),
        &outputs.futures,
        file.get("out.agent_trajectories"),
        NETWORK,
    );
    close(
        &format!("{name} weights"),
        &outputs.weights,
        file.get("out.weights"),
        NETWORK,
    );
    close(
        &format!("{name} ego"),
        &outputs.regularization,
        file.get("out.ego_regularization"),
        NETWORK,
    );
    let finite = |scores: &Tensor| scores.maximum(-1e9f64).unwrap();
    close(
        &format!("{name} scores"),
        &finite(&outputs.scores),
        &finite(file.get("out.scores")),
        NETWORK,
    );
}

#[test]
fn the_tiny_network_computes_what_pytorch_computes() {
    let network = network(|weights| Dtpp::take(weights, TINY));
    for (batch, steps) in [(1, 30), (1, 80), (2, 30), (2, 80)] {
        let name = format!("dtpp_tiny.random_b{batch}_t{steps}");
        let file = Vectors::open(&fixture(&format!("dtpp/{name}.io.safetensors")));
        check(&network, &inputs(&file), steps, &file, &name);
    }
}

#[test]
fn the_full_network_computes_what_pytorch_computes() {
    let network = network(|weights| Dtpp::take(weights, DtppConfig::PUBLISHED));
    for steps in [30, 80] {
        let name = format!("dtpp_full.random_b1_t{steps}");
        let path = fixture(&format!("dtpp/{name}.io.safetensors"));
        check(
            &network,
            &random_inputs(steps),
            steps,
            &Vectors::open(&path),
            &name,
        );
    }
}

#[test]
fn the_tensors_are_those_of_the_manifest() {
    assert_manifest("dtpp/dtpp_full.manifest.json", |weights| {
        Dtpp::take(weights, DtppConfig::PUBLISHED)
    });
}

#[test]
fn the_features_are_those_of_the_original() {
    for name in ["scene_a", "scene_b"] {
        check_features(
            name,
            80.0,
            &Vectors::open(&fixture(&format!("dtpp/features_{name}.safetensors"))),
        );
    }
}

/// A place that lies on the border of two rows of the path may fall on either side in f32: one row
/// is 0.1 m.
const ROW: f32 = 0.11;

/// The largest distance between the places of two lists of steps, and the largest difference of
/// speeds and accelerations.
fn apart(found: &[Step], expected: &[Vec<f32>]) -> (f32, f32) {
    assert_eq!(found.len(), expected.len());
    let pairs = || found.iter().zip(expected);
    let places = pairs()
        .map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]))
        .fold(0.0, f32::max);
    let rates = pairs()
        .map(|(a, b)| (a[3] - b[3]).abs().max((a[4] - b[4]).abs()))
        .fold(0.0, f32::max);
    (places, rates)
}

#[test]
fn speed_profiles_are_those_of_the_original() {
    let cases = &json("dtpp/planner_cases.json")["spline_planner"];
    let row = |i: u32| {
        let s = 0.1 * f64::from(i);
        [
            s,
            0.002 * s * s,
            (0.004 * s).atan(),
            0.004 / (1.0 + (0.004 * s).powi(2)).powf(1.5),
        ]
    };
    let path: Vec<[f64; 4]> = (0..1200).map(row).collect();
    let rows = |value: &serde_json::Value| -> Vec<Vec<f32>> {
        let row = |row| numbers(row).iter().map(|&value| value as f32).collect();
        value.as_array().unwrap().iter().map(row).collect()
    };
    for case in cases["cases"].as_array().unwrap() {
        let number = |key: &str| case[key].as_f64().unwrap() as f32;
        let found = profile(
            &path,
            [number("v0"), number("a0"), number("vf")],
            number("tf"),
            number("offset"),
        );
        let (places, rates) = apart(&found.unwrap().unwrap(), &rows(&case["rows"])[1..]);
        assert!(places < ROW && rates < 1e-4, "{places} {rates}");
    }
    let ends = |found: Vec<Vec<Step>>| {
        found
            .iter()
            .map(|steps| *steps.last().unwrap())
            .collect::<Vec<Step>>()
    };
    let state = |case: &serde_json::Value| {
        numbers(&case["x0"])
            .iter()
            .map(|&value| value as f32)
            .collect::<Vec<f32>>()
    };
    let one = &cases["stage1"];
    let x = state(one);
    let limit = one["speed_limit"].as_f64().unwrap() as f32;
    let paths = std::slice::from_ref(&path);
    let (places, rates) = apart(
        &ends(first_stage(paths, [x[3], x[4]], limit).unwrap()),
        &rows(&one["ends"]),
    );
    assert!(places < ROW && rates < 1e-4, "{places} {rates}");
    let two = &cases["stage2"];
    let x = state(two);
    let from = [x[0], x[1], x[2], x[3], x[4], 0.0];
    let (places, rates) = apart(
        &ends(second_stage(paths, &from, limit).unwrap()),
        &rows(&two["ends"]),
    );
    assert!(places < ROW && rates < 1e-4, "{places} {rates}");
}

#[test]
fn paths_trees_and_plans_are_those_of_the_original() {
    let cases = json("dtpp/planner_cases.json");
    let file = Vectors::open(&fixture("dtpp/planner_cases.safetensors"));
    let network = network(|weights| Dtpp::take(weights, DtppConfig::PUBLISHED));
    for name in ["scene_a", "scene_b"] {
        let scene = scene(name);
        let view = scene.view();
        let costed = costed_paths(&view);
        let expected = cases[name]["candidate_path_costs"].as_array().unwrap();
        assert_eq!(costed.len(), expected.len());
        for (path, expected) in costed.iter().zip(expected) {
            let number = |key: &str| expected[key].as_f64().unwrap();
            assert_eq!(path.points.len(), number("n_points") as usize);
            assert!((path.obstacle - number("obstacle")).abs() < 1e-12);
            assert!((path.curvature - number("curvature_max")).abs() < 1e-6);
            assert!((path.cost() - number("cost")).abs() < 1e-6);
        }
        let (courses, limit) = paths(&view);
        assert!((limit - cases[name]["speed_limit"].as_f64().unwrap()).abs() < 1e-12);
        for (i, course) in courses.iter().enumerate() {
            let values: Vec<f32> = course
                .as_flattened()
                .iter()
                .map(|&value| value as f32)
                .collect();
            let found = Tensor::from_vec(values, (course.len(), 4), &Device::Cpu).unwrap();
            assert_close(
                &format!("{name} path {i}"),
                &found,
                file.get(&format!("{name}.path.{i}")),
                NETWORK,
            );
        }
        let inputs = ActorFeatures::from_scene(&view, 80.0).inputs().unwrap();
        let start = [view.ego.velocity.x as f32, view.ego.acceleration.x as f32];
        let tree = scored_tree(&network, &inputs, &courses, limit, start, 0).unwrap();
        for (stage, (branches, scores)) in [("stage1", &tree.first), ("stage2", &tree.second)] {
            let expected = file
                .get(&format!("{name}.{stage}.leaf_trajectories"))
                .to_vec3::<f32>()
                .unwrap();
            assert_eq!(branches.len(), expected.len(), "{name} {stage}");
            let theirs: Vec<f32> = file
                .get(&format!("{name}.{stage}.scores"))
                .to_vec1()
                .unwrap();
            for (((found, expected), score), theirs) in
                branches.iter().zip(&expected).zip(scores).zip(theirs)
            {
                let (places, rates) = apart(found, expected);
                assert!(
                    places < ROW && rates < 1e-3,
                    "{name} {stage}: {places} m, {rates}"
                );
                // Where a place falls on the next row, the score of its trajectory changes with it.
                let tolerance = if places < 1e-3 { 1e-3 } else { 0.05 };
                assert!(
                    (score - theirs).abs() < tolerance * (1.0 + theirs.abs()),
                    "{name} {stage}: {score} instead of {theirs}, {places} m"
                );
            }
        }
        let best = file
            .get(&format!("{name}.best_trajectory"))
            .to_vec2::<f32>()
            .unwrap();
        assert_eq!(tree.best.len(), best.len());
        for (found, expected) in tree.best.iter().zip(&best) {
            assert!(
                (found[0] - expected[0]).hypot(found[1] - expected[1]) < ROW,
                "{name}: {found:?} {expected:?}"
            );
        }
    }
}
