//! GC-PGP: everything of its network but the random draws.

use super::vectors::{NETWORK, Vectors, assert_close, assert_manifest, fixture, network};
use candle_core::DType;
use planagent::internals::planner::learned::Probe;
use planagent::internals::planner::learned::gc_pgp::{GcPgp, GcPgpInputs};

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
        let file = Vectors::open(&fixture(&format!("gc_pgp/gc_pgp_full.{source}.io.safetensors")));
        let name = |what: &str| format!("gc_pgp_full.{source} {what}");
        let mut probe = Probe::on();
        let scene = network.encode(&inputs(&file), true, &mut probe).unwrap();
        for mid in ["node_gru", "agent_node_attention", "mix_linear", "gat0", "gat1"] {
            assert_close(&name(mid), probe.get(mid).unwrap(), file.get(&format!("mid.{mid}")), NETWORK);
        }
        assert_close(&name("ego"), &scene.encodings.ego, file.get("enc.target_agent"), NETWORK);
        assert_close(&name("nodes"), &scene.encodings.nodes, file.get("enc.nodes"), NETWORK);
        assert_close(&name("policy"), &scene.policy, file.get("policy.pi_route_masked"), NETWORK);
        let free = network.encode(&inputs(&file), false, &mut Probe::off()).unwrap();
        assert_close(&name("free policy"), &free.policy, file.get("policy.pi_without_route_mask"), NETWORK);
        let traversals = file.of_kind(DType::U32, "aggregator.in.traversals").to_vec3::<u32>().unwrap();
        let traversals: Vec<Vec<[u32; 16]>> = traversals
            .into_iter()
            .map(|sample| sample.into_iter().map(|traversal| traversal.try_into().unwrap()).collect())
            .collect();
        let contexts = network.aggregate(&scene.encodings, &traversals).unwrap();
        assert_close(&name("aggregator"), &contexts, file.get("aggregator.out"), NETWORK);
        let trajectories = network.decode(file.get("aggregator.out"), file.get("decoder.in.z")).unwrap();
        assert_close(&name("decoder"), &trajectories, file.get("decoder.out.traj_all"), NETWORK);
    }
}

#[test]
fn the_tensors_are_those_of_the_manifest() {
    assert_manifest("gc_pgp/gc_pgp_full.manifest.json", GcPgp::take);
}
