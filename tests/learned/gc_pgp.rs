//! GC-PGP.

use super::scene::scene;
use super::vectors::{
    FEATURES, NETWORK, Vectors, assert_close, assert_manifest, fixture, json, network, numbers,
};
use candle_core::{DType, Device, Tensor};
use planagent_learned::Probe;
use planagent_learned::gc_pgp::{
    Clusters, GcPgp, GcPgpFeatures, GcPgpInputs, poses, ranks, scores,
};
use serde_json::Value;

fn inputs(file: &Vectors) -> GcPgpInputs {
    let input = |name: &str| file.of_kind(DType::F32, &format!("in.{name}"));
    GcPgpInputs {
        ego: input("ego_feats"),
        agents: input("vehicle_agent_feats"),
        agents_missing: input("vehicle_agent_masks"),
        far: input("vehicle_node_masks"),
        poses: input("lane_node_feats"),
        poses_missing: input("lane_node_masks"),
        red: input("red_light_flag"),
        successors: input("s_next"),
        edges: input("edge_type"),
        on_route: input("edge_on_route_mask"),
    }
}

#[test]
fn the_network_computes_what_pytorch_computes() {
    let network = network(GcPgp::take);
    for source in ["scene_a_b1", "batch2"] {
        let file = Vectors::open(&fixture(&format!(
            "gc_pgp/gc_pgp_full.{source}.io.safetensors"
        )));
        let name = |what: &str| format!("gc_pgp_full.{source} {what}");
        let probe = Probe::on();
        let scene = network.encode(&inputs(&file), true, &probe).unwrap();
        for mid in [
            "node_gru",
            "agent_node_attention",
            "mix_linear",
            "gat0",
            "gat1",
        ] {
            assert_close(
                &name(mid),
                &probe.get(mid).unwrap(),
                file.get(&format!("mid.{mid}")),
                NETWORK,
            );
        }
        assert_close(
            &name("ego"),
            &scene.encodings.ego,
            file.get("enc.target_agent"),
            NETWORK,
        );
        assert_close(
            &name("nodes"),
            &scene.encodings.nodes,
            file.get("enc.nodes"),
            NETWORK,
        );
        assert_close(
            &name("policy"),
            &scene.policy,
            file.get("policy.pi_route_masked"),
            NETWORK,
        );
        let free = network
            .encode(&inputs(&file), false, &Probe::off())
            .unwrap();
        assert_close(
            &name("free policy"),
            &free.policy,
            file.get("policy.pi_without_route_mask"),
            NETWORK,
        );
        let traversals = file
            .of_kind(DType::U32, "aggregator.in.traversals")
            .to_vec3::<u32>()
            .unwrap();
        let traversals: Vec<Vec<[u32; 16]>> = traversals
            .into_iter()
            .map(|sample| {
                sample
                    .into_iter()
                    .map(|traversal| traversal.try_into().unwrap())
                    .collect()
            })
            .collect();
        let contexts = network.aggregate(&scene.encodings, &traversals).unwrap();
        assert_close(
            &name("aggregator"),
            &contexts,
            file.get("aggregator.out"),
            NETWORK,
        );
        let trajectories = network
            .decode(file.get("aggregator.out"), file.get("decoder.in.z"))
            .unwrap();
        assert_close(
            &name("decoder"),
            &trajectories,
            file.get("decoder.out.traj_all"),
            NETWORK,
        );
    }
}

#[test]
fn the_tensors_are_those_of_the_manifest() {
    assert_manifest("gc_pgp/gc_pgp_full.manifest.json", GcPgp::take);
}

/// The tensors that the original builder made, with a batch dimension; `ours` are names of our
/// inputs.
#[test]
fn the_features_are_those_of_the_original() {
    for name in ["scene_a", "scene_b"] {
        let file = Vectors::open(&fixture(&format!("gc_pgp/features_{name}.safetensors")));
        let features = GcPgpFeatures::from_scene(&scene(name).view()).unwrap();
        let inputs = features.inputs().unwrap();
        for (theirs, found) in [
            ("ego_feats", &inputs.ego),
            ("vehicle_agent_feats", &inputs.agents),
            ("vehicle_agent_masks", &inputs.agents_missing),
            ("vehicle_node_masks", &inputs.far),
            ("lane_node_feats", &inputs.poses),
            ("lane_node_masks", &inputs.poses_missing),
            ("red_light_flag", &inputs.red),
            ("s_next", &inputs.successors),
            ("edge_type", &inputs.edges),
            ("edge_on_route_mask", &inputs.on_route),
        ] {
            let expected = file.get(&format!("feature.{theirs}"));
            let expected = if theirs == "ego_feats" {
                expected.clone()
            } else {
                expected.unsqueeze(0).unwrap()
            };
            let found = if theirs == "ego_feats" {
                found.squeeze(0).unwrap()
            } else {
                found.clone()
            };
            assert_close(
                &format!("gc_pgp {name} {theirs}"),
                &found,
                &expected,
                FEATURES,
            );
        }
        let mut initial = vec![0f32; features.graph.nodes.len()];
        let share = 1.0 / features.graph.initial.len() as f32;
        features
            .graph
            .initial
            .iter()
            .for_each(|&node| initial[node] = share);
        let initial = Tensor::new(initial, &Device::Cpu).unwrap();
        assert_close(
            &format!("gc_pgp {name} init_node"),
            &initial,
            file.get("feature.init_node"),
            FEATURES,
        );
    }
}

#[test]
fn ranks_poses_and_clusters_are_those_of_the_original() {
    let cases = json("gc_pgp/postprocess_cases.json");
    let rows = |value: &Value| {
        value
            .as_array()
            .unwrap()
            .iter()
            .map(numbers)
            .collect::<Vec<Vec<f64>>>()
    };
    for case in cases["ranking"].as_array().unwrap() {
        let counts: Vec<usize> = numbers(&case["counts"])
            .iter()
            .map(|&count| count as usize)
            .collect();
        let found = ranks(&counts, &rows(&case["centers"]));
        assert_eq!(
            found.iter().map(|&rank| rank as f64).collect::<Vec<_>>(),
            numbers(&case["ranks"])
        );
        for (score, expected) in scores(&found).iter().zip(numbers(&case["scores"])) {
            assert!((score - expected).abs() < 1e-12);
        }
    }
    for case in cases["waypoints_to_trajectory"].as_array().unwrap() {
        let places: Vec<[f32; 2]> = rows(&case["waypoints"])
            .iter()
            .map(|place| [place[0] as f32, place[1] as f32])
            .collect();
        let found = poses(&places, case["current_velocity"].as_f64().unwrap() as f32);
        let expected: Vec<f32> = numbers(&case["trajectory"])
            .iter()
            .map(|&value| value as f32)
            .collect();
        let tensor =
            |values: Vec<f32>| Tensor::from_vec(values, (places.len(), 3), &Device::Cpu).unwrap();
        assert_close(
            "gc_pgp poses",
            &tensor(found.concat()),
            &tensor(expected),
            NETWORK,
        );
    }
    // From the original's centers on nothing moves: they are the means of the rows nearest to them.
    let case = &cases["kmeans"];
    let clusters = Clusters::from(&rows(&case["X"]), rows(&case["centers"]));
    assert_eq!(
        clusters
            .labels
            .iter()
            .map(|&label| label as f64)
            .collect::<Vec<_>>(),
        numbers(&case["labels"])
    );
    for (found, expected) in clusters
        .centers
        .concat()
        .iter()
        .zip(numbers(&case["centers"]))
    {
        assert!((found - expected).abs() < 1e-9);
    }
}

/// The original draws with PyTorch's numbers, ours with others, so clusters agree only in
/// distribution. The trajectories end about a meter ahead, with ends 0.4 m apart: the means of all
/// ends must agree to 0.05 m and their spread to half, and each of our five best must be within
/// 0.15 m of one of theirs in the mean of its poses.
#[test]
fn drawn_plans_are_like_those_of_the_original() {
    let file = Vectors::open(&fixture(
        "gc_pgp/gc_pgp_full.scene_a_b1.sampled.safetensors",
    ));
    let network = network(GcPgp::take);
    let features = GcPgpFeatures::from_scene(&scene("scene_a").view()).unwrap();
    let plans = network
        .plans(&features, &features.inputs().unwrap())
        .unwrap();
    let theirs: Vec<Vec<Vec<f32>>> = file
        .get("out.trajectories")
        .squeeze(0)
        .unwrap()
        .to_vec3()
        .unwrap();
    assert_eq!(plans.len(), theirs.len());
    let ends: Vec<[f32; 2]> = plans.iter().map(|(_, places)| places[15]).collect();
    let their_ends: Vec<[f32; 2]> = theirs
        .iter()
        .map(|places| [places[15][0], places[15][1]])
        .collect();
    for axis in 0..2 {
        let mean =
            |ends: &[[f32; 2]]| ends.iter().map(|end| end[axis]).sum::<f32>() / ends.len() as f32;
        let spread = |ends: &[[f32; 2]]| {
            let mean = mean(ends);
            (ends
                .iter()
                .map(|end| (end[axis] - mean).powi(2))
                .sum::<f32>()
                / ends.len() as f32)
                .sqrt()
        };
        let (ours, expected) = (mean(&ends), mean(&their_ends));
        assert!(
            (ours - expected).abs() < 0.05,
            "mean {ours} instead of {expected}"
        );
        let (ours, expected) = (spread(&ends), spread(&their_ends));
        assert!(
            (0.5..2.0).contains(&(ours / expected)),
            "spread {ours} instead of {expected}"
        );
    }
    let apart = |ours: &[[f32; 2]], theirs: &[Vec<f32>]| {
        let distances = ours
            .iter()
            .zip(theirs)
            .map(|([x, y], other)| (x - other[0]).hypot(y - other[1]));
        distances.sum::<f32>() / ours.len() as f32
    };
    for (score, places) in plans.iter().take(5) {
        let nearest = theirs
            .iter()
            .map(|other| apart(places, other))
            .fold(f32::INFINITY, f32::min);
        assert!(
            nearest < 0.15,
            "the cluster with score {score} is {nearest} m from all of theirs"
        );
    }
    // The scores are those of ten ranks.
    let mut shares: Vec<f32> = file.get("out.probs").to_vec2::<f32>().unwrap().concat();
    shares.sort_by(|a, b| b.total_cmp(a));
    for ((score, _), share) in plans.iter().zip(shares) {
        assert!((*score as f32 - share).abs() < 1e-6);
    }
}
