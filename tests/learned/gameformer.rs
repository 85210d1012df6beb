//! GameFormer.

use super::scene::scene;
use super::vectors::{
    FEATURES, NETWORK, Vectors, assert_close, assert_manifest, comparison, fixture, input, json,
    network, numbers,
};
use candle_core::Tensor;
use planagent_learned::Probe;
use planagent_learned::gameformer::{
    ActorFeatures, GameFormer, GameFormerConfig, PredictedAgent, STEPS, SceneInputs, costed_paths,
    placed, reference_path, refinement,
};
use planagent_learned::lattice::starting_block;
use planagent_world::{Scene, TrafficLights};

const TINY: GameFormerConfig = GameFormerConfig {
    dim: 16,
    encoder_layers: 2,
    levels: 2,
    modes: 3,
    neighbors: 4,
};

fn inputs(file: &Vectors) -> (SceneInputs, Tensor) {
    let scene = SceneInputs {
        ego: file.get("in.ego_agent_past").clone(),
        neighbors: file.get("in.neighbor_agents_past").clone(),
        lanes: file.get("in.map_lanes").clone(),
        crosswalks: file.get("in.map_crosswalks").clone(),
    };
    (scene, file.get("in.route_lanes").clone())
}

/// The random scene of the full size, which the recipe of the inputs makes.
pub(super) fn random_scene(prefix: &str, batch: usize) -> [Vec<f32>; 4] {
    [
        input(&format!("{prefix}/ego"), batch * 21 * 7, 6.0),
        input(&format!("{prefix}/nb"), batch * 20 * 21 * 11, 20.0),
        input(&format!("{prefix}/lanes"), batch * 40 * 50 * 7, 40.0),
        input(&format!("{prefix}/cw"), batch * 5 * 30 * 3, 40.0),
    ]
}

fn random_inputs() -> (SceneInputs, Tensor) {
    let [ego, mut neighbors, mut lanes, mut crosswalks] = random_scene("gf_full", 2);
    let mut route = input("gf_full/route", 2 * 10 * 50 * 3, 40.0);
    let (neighbor, lane, crosswalk, piece) = (21 * 11, 50 * 7, 30 * 3, 50 * 3);
    neighbors[16 * neighbor..20 * neighbor].fill(0.0);
    neighbors[(20 + 7) * neighbor..].fill(0.0);
    lanes[35 * lane..40 * lane].fill(0.0);
    lanes[(40 + 20) * lane..].fill(0.0);
    lanes[3 * lane + 20 * 7..3 * lane + 30 * 7].fill(0.0);
    lanes[41 * lane + 7 * 7] = 0.0;
    crosswalks[3 * crosswalk..5 * crosswalk].fill(0.0);
    crosswalks[(5 + 1) * crosswalk..].fill(0.0);
    route[7 * piece..].fill(0.0);
    let tensor = |values: Vec<f32>, shape: &[usize]| {
        Tensor::from_vec(values, shape, &candle_core::Device::Cpu).unwrap()
    };
    let scene = SceneInputs {
        ego: tensor(ego, &[2, 21, 7]),
        neighbors: tensor(neighbors, &[2, 20, 21, 11]),
        lanes: tensor(lanes, &[2, 40, 50, 7]),
        crosswalks: tensor(crosswalks, &[2, 5, 30, 3]),
    };
    (scene, tensor(route, &[2, 10, 50, 3]))
}

/// In the second sample of the full random file, one future of level 0 turns straight back in one
/// step (3.6e-7 m to the side): rounding decides the direction of that step, and all of the
/// sample's later levels follow from it. Only the first counts there.
fn well_conditioned(name: &str, tensor: &Tensor) -> Tensor {
    if name == "gameformer_full.random" {
        tensor.narrow(0, 0, 1).unwrap()
    } else {
        tensor.clone()
    }
}

fn check(network: &GameFormer, (scene, route): &(SceneInputs, Tensor), file: &Vectors, name: &str) {
    let close = comparison(name);
    let probe = Probe::on();
    let outputs = network.forward(scene, route, &probe).unwrap();
    let later = |what: &str, found: &Tensor, expected: &Tensor| {
        close(
            &format!("{name} {what}"),
            &well_conditioned(name, found),
            &well_conditioned(name, expected),
            NETWORK,
        );
    };
    for mid in [
        "encoder.ego_encoder",
        "encoder.fusion_encoder.layers.0",
        "encoder.fusion_encoder",
    ] {
        if let Some(expected) = file.find(&format!("mid.{mid}")) {
            close(
                &format!("{name} {mid}"),
                &probe.get(mid).unwrap(),
                expected,
                NETWORK,
            );
        }
    }
    for mid in [
        "decoder.interaction_stage.0.future_encoder",
        "decoder.interaction_stage.0.interaction_encoder",
        "planner.route_fusion",
        "planner.plan_decoder",
    ] {
        if let Some(expected) = file.find(&format!("mid.{mid}")) {
            later(mid, &probe.get(mid).unwrap(), expected);
        }
    }
    let points = probe.get("encoder.lane_encoder.point_net").unwrap();
    let points = points.narrow(0, 0, 1).unwrap().narrow(1, 0, 2).unwrap();
    close(
        &format!("{name} points"),
        &points,
        file.get("mid.encoder.lane_encoder.point_net"),
        NETWORK,
    );
    for part in [
        "decoder.initial_predictor.query_encoder",
        "decoder.interaction_stage.0.query_encoder",
    ] {
        let contents = probe.get(part).unwrap();
        for actor in 0..contents.dim(1).unwrap() {
            let call = if actor == 0 {
                String::new()
            } else {
                format!("#{actor}")
            };
            let content = contents.narrow(1, actor, 1).unwrap().squeeze(1).unwrap();
            if let Some(expected) = file.find(&format!("mid.{part}{call}")) {
                later(&format!("{part}{call}"), &content, expected);
            }
        }
    }
    for (level, (futures, scores)) in outputs.levels.iter().enumerate() {
        let expected = |what: &str| file.get(&format!("out.level_{level}_{what}"));
        if level == 0 {
            close(
                &format!("{name} futures 0"),
                futures,
                expected("interactions"),
                NETWORK,
            );
            close(
                &format!("{name} scores 0"),
                scores,
                expected("scores"),
                NETWORK,
            );
        } else {
            later(
                &format!("futures {level}"),
                futures,
                expected("interactions"),
            );
            later(&format!("scores {level}"), scores, expected("scores"));
        }
    }
    later("plan", &outputs.plan, file.get("out.ego_plan"));
}

#[test]
fn the_tiny_network_computes_what_pytorch_computes() {
    let network = network(|weights| GameFormer::take(weights, TINY));
    for source in ["random", "scene_a", "scene_b"] {
        let file = Vectors::open(&fixture(&format!(
            "gameformer/gameformer_tiny.{source}.io.safetensors"
        )));
        let given = if source == "random" {
            inputs(&file)
        } else {
            scene_inputs(source, &file)
        };
        check(
            &network,
            &given,
            &file,
            &format!("gameformer_tiny.{source}"),
        );
    }
}

/// The features of a scene: those in the file, else those of the feature builder, cut to the tiny
/// sizes.
fn scene_inputs(source: &str, file: &Vectors) -> (SceneInputs, Tensor) {
    if file.names().any(|name| name.starts_with("in.")) {
        return inputs(file);
    }
    inputs(&Vectors::open(&fixture(&format!(
        "gameformer/features_{source}.safetensors"
    ))))
}

#[test]
fn the_full_network_computes_what_pytorch_computes() {
    let network = network(|weights| GameFormer::take(weights, GameFormerConfig::PUBLISHED));
    for source in ["random", "scene_a", "scene_b"] {
        let path = fixture(&format!(
            "gameformer/gameformer_full.{source}.io.safetensors"
        ));
        let given = match source {
            "random" => random_inputs(),
            _ => inputs(&Vectors::open(&fixture(&format!(
                "gameformer/features_{source}.safetensors"
            )))),
        };
        check(
            &network,
            &given,
            &Vectors::open(&path),
            &format!("gameformer_full.{source}"),
        );
    }
}

#[test]
fn the_tensors_are_those_of_the_manifest() {
    let take = |weights: &mut _| GameFormer::take(weights, GameFormerConfig::PUBLISHED);
    assert_manifest("gameformer/gameformer_full.manifest.json", take);
}

/// Features of a scene against those in a file.
pub(super) fn check_features(name: &str, radius: f64, file: &Vectors) {
    let features = ActorFeatures::from_scene(&scene(name).view(), radius);
    let found = features.inputs().unwrap();
    for (what, found) in [
        ("ego_agent_past", &found.ego),
        ("neighbor_agents_past", &found.neighbors),
        ("map_lanes", &found.lanes),
        ("map_crosswalks", &found.crosswalks),
        ("route_lanes", &features.route_input().unwrap()),
    ] {
        let what = format!("in.{what}");
        if file.names().any(|name| name == what) {
            assert_close(&format!("{name} {what}"), found, file.get(&what), FEATURES);
        }
    }
}

#[test]
fn the_features_are_those_of_the_original() {
    for name in ["scene_a", "scene_b"] {
        check_features(
            name,
            60.0,
            &Vectors::open(&fixture(&format!("gameformer/features_{name}.safetensors"))),
        );
    }
}

/// A scene with its lights or without any.
fn lit(name: &str, lights: &str) -> Scene {
    let mut scene = scene(name);
    if lights == "no_tl" {
        scene.lights = TrafficLights::default();
    }
    scene
}

#[test]
fn reference_paths_are_those_of_the_original() {
    let cases = json("gameformer/planner_cases.json");
    let file = Vectors::open(&fixture("gameformer/planner_cases.safetensors"));
    for (name, lights) in [
        ("scene_a", "red"),
        ("scene_a", "no_tl"),
        ("scene_b", "red"),
        ("scene_b", "no_tl"),
    ] {
        let scene = lit(name, lights);
        let view = scene.view();
        let (block, _) = starting_block(&view).unwrap();
        let costed = costed_paths(&view, block);
        let expected = cases[format!("reference_path_{name}_{lights}")]["candidates"]
            .as_array()
            .unwrap();
        assert_eq!(costed.len(), expected.len(), "{name} {lights}");
        for ((points, cost), expected) in costed.iter().zip(expected) {
            let number = |key: &str| expected[key].as_f64().unwrap();
            assert_eq!(points.len(), number("n_points") as usize, "{name} {lights}");
            let terms = &expected["terms"];
            let term = |key: &str| terms[key].as_f64().unwrap();
            assert!(
                (cost.obstacle - term("obstacle")).abs() < 1e-12,
                "{name} {lights}"
            );
            assert!(
                (cost.out_of_boundary - term("out_of_boundary")).abs() < 1e-12,
                "{name} {lights}"
            );
            assert!(
                (cost.target - term("target")).abs() < 1e-12,
                "{name} {lights}"
            );
            assert!(
                (cost.curvature.unwrap() - term("max_curvature")).abs() < 1e-6,
                "{name} {lights}"
            );
            assert!(
                (cost.sum().unwrap() - number("cost")).abs() < 1e-6,
                "{name} {lights}: {cost:?}"
            );
            for (place, key) in [(20, "p20"), (60, "p60")] {
                let place = points[place];
                let expected = numbers(&expected[key]);
                assert!(
                    (place.x - expected[0]).hypot(place.y - expected[1]) < 1e-5,
                    "{name} {lights} {key}"
                );
            }
        }
        let rows = reference_path(&view).unwrap();
        let found = Tensor::from_vec(rows.concat(), (1200, 6), &candle_core::Device::Cpu).unwrap();
        assert_close(
            &format!("{name} {lights}"),
            &found,
            file.get(&format!("ref.{name}.{lights}")),
            NETWORK,
        );
    }
}

/// The original refines in f32 and its objective has steps, so that iterates part: in f64 they are
/// up to 0.04 m/s off.
#[test]
fn refinements_are_those_of_the_original() {
    let file = Vectors::open(&fixture("gameformer/planner_cases.safetensors"));
    let worst = |found: &[f64], expected: &[f32]| {
        found
            .iter()
            .zip(expected)
            .map(|(found, expected)| (found - f64::from(*expected)).abs())
            .fold(0.0, f64::max)
    };
    for source in [
        "scene_a.red",
        "scene_a.no_tl",
        "scene_b.red",
        "scene_b.no_tl",
    ] {
        let path: Vec<[f32; 6]> = rows(file.get(&format!("ref.{source}")));
        for case in 0..4 {
            let name = format!("refine.{source}.{case}");
            let get = |part: &str| file.get(&format!("{name}.{part}"));
            // The cases 0, 1 and 3 of a scene have the same traffic, with lights and without.
            let (scene, traffic) = (
                source.split_once('.').unwrap().0,
                if case == 2 { 2 } else { 0 },
            );
            let shared = |part: &str| file.get(&format!("refine.{scene}.red.{traffic}.{part}"));
            let states: Vec<[f32; 11]> = rows(shared("in.neighbors"));
            let scores = get("in.scores").to_vec2::<f32>().unwrap();
            let predictions = shared("in.predictions_xy");
            let agent = |(i, state): (usize, &[f32; 11])| {
                let scores = &scores[i + 1];
                let best = (0..scores.len())
                    .max_by(|&a, &b| scores[a].total_cmp(&scores[b]))
                    .unwrap();
                let future = predictions.get(i).unwrap().get(best).unwrap();
                PredictedAgent {
                    state: *state,
                    future: rows(&future),
                }
            };
            let agents: Vec<PredictedAgent> =
                states.iter().take(10).enumerate().map(agent).collect();
            let ego: [f32; 7] = get("in.ego_state")
                .to_vec1::<f32>()
                .unwrap()
                .try_into()
                .unwrap();
            let refinement = refinement(&path, &rows(get("in.plan")), &agents, ego);
            let places: Vec<f32> = get("mid.initial_s").to_vec1().unwrap();
            assert!(
                worst(&refinement.places, &places[1..]) < 1e-5,
                "{name} places"
            );
            let speeds: Vec<f32> = get("mid.initial_speed").to_vec1().unwrap();
            assert!(worst(&refinement.speeds, &speeds) < 1e-4, "{name} speeds");
            let occupied = refinement
                .occupancy
                .iter()
                .flatten()
                .map(|&occupied| u8::from(occupied));
            let expected: Vec<u8> = get("mid.occupancy_30x120")
                .flatten_all()
                .unwrap()
                .to_vec1()
                .unwrap();
            assert_eq!(occupied.collect::<Vec<u8>>(), expected, "{name} occupancy");
            assert_eq!(refinement.occupancy.len(), STEPS);
            let iterates = get("mid.iterates").to_vec2::<f32>().unwrap();
            for (i, (found, expected)) in refinement
                .iterates()
                .iter()
                .zip(&iterates)
                .take(4)
                .enumerate()
            {
                let off = worst(&found.0, expected);
                assert!(off < 0.05, "{name} iterate {i}: {off} m/s off");
            }
            let solved = refinement.solve();
            let off = worst(&solved, &get("out.speed").to_vec1::<f32>().unwrap());
            assert!(off < 0.05, "{name} solution: {off} m/s off");
            let plan: Vec<[f32; 3]> = rows(get("out.plan"));
            for ([x, y, _], [u, v, _]) in placed(&path, &solved).iter().zip(&plan) {
                assert!((x - u).hypot(y - v) < 0.35, "{name} plan");
            }
        }
    }
}

/// The rows of a matrix.
fn rows<const N: usize>(matrix: &Tensor) -> Vec<[f32; N]> {
    matrix
        .to_vec2::<f32>()
        .unwrap()
        .into_iter()
        .map(|row| row.try_into().unwrap())
        .collect()
}
