//! DTPP's network.

use super::gameformer::{check_features, random_scene};
use super::vectors::{NETWORK, Vectors, assert_close, assert_manifest, fixture, input, network, vectors};
use candle_core::{Device, Tensor};
use planagent::internals::planner::learned::Probe;
use planagent::internals::planner::learned::dtpp::{Dtpp, DtppConfig};
use planagent::internals::planner::learned::gameformer::SceneInputs;

/// The tiny variant divides the width of the inner layer by sixteen twice.
const TINY: DtppConfig = DtppConfig { dim: 16, inner: 4, encoder_layers: 2, neighbors: 4, branches: 6 };

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
            let row = [along, 0.3 * x(step, 1), 0.05 * x(step, 2), speed, x(step, 4), 0.05 * x(step, 5)];
            tree[(branch * 80 + step) * 6..][..6].copy_from_slice(&row.map(|value| value as f32));
        }
    }
    let tensor = |values: Vec<f32>, shape: &[usize]| Tensor::from_vec(values, shape, &Device::Cpu).unwrap();
    let scene = SceneInputs {
        ego: tensor(ego, &[1, 21, 7]),
        neighbors: tensor(neighbors, &[1, 20, 21, 11]),
        lanes: tensor(lanes, &[1, 40, 50, 7]),
        crosswalks: tensor(crosswalks, &[1, 5, 30, 3]),
    };
    (scene, tensor(tree, &[1, 30, 80, 6]))
}

fn check(network: &Dtpp, (scene, tree): &(SceneInputs, Tensor), steps: usize, file: &Vectors, name: &str) {
    let mut probe = Probe::on();
    let outputs = network.forward(scene, tree, steps, &mut probe).unwrap();
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
            assert_close(&format!("{name} {mid}"), probe.get(mid).unwrap(), file.get(&expected), NETWORK);
        }
    }
    let batch = tree.dim(0).unwrap();
    for mid in ["decoder.interaction_feature_encoder", "decoder.interaction_feature_decoder"] {
        let expected = format!("mid.{mid}");
        if batch == 1 && file.names().any(|name| name == expected) {
            assert_close(&format!("{name} {mid}"), probe.get(mid).unwrap(), file.get(&expected), NETWORK);
        }
    }
    let near = probe.get("collision").unwrap().narrow(1, 0, 1).unwrap().squeeze(1).unwrap();
    assert_close(&format!("{name} collision"), &near, file.get("mid.collision_branch0"), NETWORK);
    assert_close(&format!("{name} futures"), &outputs.futures, file.get("out.agent_trajectories"), NETWORK);
    assert_close(&format!("{name} weights"), &outputs.weights, file.get("out.weights"), NETWORK);
    assert_close(&format!("{name} ego"), &outputs.regularization, file.get("out.ego_regularization"), NETWORK);
    let finite = |scores: &Tensor| scores.maximum(-1e9f64).unwrap();
    assert_close(&format!("{name} scores"), &finite(&outputs.scores), &finite(file.get("out.scores")), NETWORK);
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
#[cfg_attr(not(outside_data), ignore = "needs PLANAGENT_DATA")]
fn the_full_network_computes_what_pytorch_computes() {
    let network = network(|weights| Dtpp::take(weights, DtppConfig::PUBLISHED));
    for steps in [30, 80] {
        let name = format!("dtpp_full.random_b1_t{steps}");
        let Some(path) = vectors(&format!("dtpp/{name}.io.safetensors")) else { return };
        check(&network, &random_inputs(steps), steps, &Vectors::open(&path), &name);
    }
}

#[test]
fn the_tensors_are_those_of_the_manifest() {
    assert_manifest("dtpp/dtpp_full.manifest.json", |weights| Dtpp::take(weights, DtppConfig::PUBLISHED));
}

#[test]
#[cfg_attr(not(outside_data), ignore = "needs PLANAGENT_DATA")]
fn the_features_are_those_of_the_original() {
    for name in ["scene_a", "scene_b"] {
        let Some(path) = vectors(&format!("dtpp/features_{name}.safetensors")) else { return };
        check_features(name, 80.0, &Vectors::open(&path));
    }
}
