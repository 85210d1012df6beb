//! PlanTF.

use super::scene::scene;
use super::vectors::{FEATURES, NETWORK, Vectors, assert_close, assert_manifest, fixture, network};
use candle_core::{DType, Tensor};
use planagent::{Scene, SceneBuilder};
use planagent_learned::Probe;
use planagent_learned::plantf::{
    LineFeatures, PlanTf, PlanTfConfig, PlanTfFeatures, PlanTfInputs, PlanTfMap,
};
use planagent_score::pdm::corrected_route;
use planagent_world::ObjectKind;

const TINY: PlanTfConfig = PlanTfConfig {
    dim: 32,
    depth: 2,
    heads: 4,
    modes: 3,
};
/// Intermediates of the files of the tiny network alone.
const TINY_MIDS: [&str; 5] = [
    "agent_encoder.history_encoder.embed",
    "agent_encoder.history_encoder.levels.0.blocks.0.attn",
    "agent_encoder.history_encoder.levels.2.blocks.0.attn",
    "agent_encoder.history_encoder.norm0",
    "agent_encoder.history_encoder.norm2",
];
/// Intermediates of every file.
const MIDS: [&str; 8] = [
    "agent_encoder.history_encoder",
    "agent_encoder.ego_state_emb",
    "agent_encoder",
    "map_encoder.polygon_encoder",
    "map_encoder",
    "pos_emb",
    "encoder_blocks.0",
    "norm",
];

fn inputs(file: &Vectors) -> PlanTfInputs {
    let input = |name: &str| file.of_kind(DType::F32, &format!("in.{name}"));
    let mask = |name: &str| file.of_kind(DType::U8, &format!("in.{name}"));
    let index = |name: &str| file.of_kind(DType::U32, &format!("in.{name}"));
    let center_line = |name: &str| {
        input(name)
            .narrow(2, 0, 1)
            .unwrap()
            .squeeze(2)
            .unwrap()
            .contiguous()
            .unwrap()
    };
    PlanTfInputs {
        current_state: input("current_state"),
        position: input("agent.position"),
        heading: input("agent.heading"),
        velocity: input("agent.velocity"),
        shape: input("agent.shape"),
        category: index("agent.category"),
        valid: mask("agent.valid_mask"),
        map: PlanTfMap {
            point: center_line("map.point_position"),
            vector: center_line("map.point_vector"),
            orientation: center_line("map.point_orientation"),
            center: input("map.polygon_center"),
            kind: index("map.polygon_type"),
            on_route: index("map.polygon_on_route"),
            light: index("map.polygon_tl_status"),
            speed_limit: input("map.polygon_speed_limit"),
            has_speed_limit: mask("map.polygon_has_speed_limit"),
            valid: mask("map.valid_mask"),
        },
    }
}

/// `in.*` of one file and `mid.*` and `out.*` of another.
fn check(network: &PlanTf, given: &Vectors, expected: &Vectors, name: &str) {
    let probe = Probe::on();
    let outputs = network.forward(&inputs(given), &probe).unwrap();
    let tiny = if name.starts_with("plantf_tiny") {
        &TINY_MIDS[..]
    } else {
        &[]
    };
    for mid in tiny.iter().chain(&MIDS) {
        assert_close(
            &format!("{name} {mid}"),
            &probe.get(mid).unwrap(),
            expected.get(&format!("mid.{mid}")),
            NETWORK,
        );
    }
    for (out, found) in [
        ("trajectory", &outputs.trajectory),
        ("probability", &outputs.probability),
        ("prediction", &outputs.prediction),
        ("output_trajectory", &outputs.best().unwrap()),
    ] {
        assert_close(
            &format!("{name} {out}"),
            found,
            expected.get(&format!("out.{out}")),
            NETWORK,
        );
    }
}

#[test]
fn the_tiny_network_computes_what_pytorch_computes() {
    let network = network(|weights| PlanTf::take(weights, TINY));
    for source in ["random", "scene_a", "scene_b"] {
        let file = Vectors::open(&fixture(&format!(
            "plantf/plantf_tiny.{source}.io.safetensors"
        )));
        check(&network, &file, &file, &format!("plantf_tiny.{source}"));
    }
}

#[test]
fn the_full_network_computes_what_pytorch_computes() {
    let network = network(|weights| PlanTf::take(weights, PlanTfConfig::PUBLISHED));
    for source in ["random", "scene_a", "scene_b"] {
        let expected = Vectors::open(&fixture(&format!(
            "plantf/plantf_full.{source}.io.safetensors"
        )));
        let given = Vectors::open(&fixture(&format!(
            "plantf/plantf_tiny.{source}.io.safetensors"
        )));
        let given = if source == "random" {
            &expected
        } else {
            &given
        };
        check(&network, given, &expected, &format!("plantf_full.{source}"));
    }
}

#[test]
fn the_tensors_are_those_of_the_manifest() {
    assert_manifest("plantf/plantf_full.manifest.json", |weights| {
        PlanTf::take(weights, PlanTfConfig::PUBLISHED)
    });
}

fn features(scene: &Scene) -> PlanTfFeatures {
    let route = corrected_route(&scene.map, &scene.route.roadblocks, scene.ego.rear_axle);
    PlanTfFeatures::from_scene(&scene.view(), &route)
}

#[test]
fn the_features_are_those_of_the_original() {
    for name in ["scene_a", "scene_b"] {
        let file = Vectors::open(&fixture(&format!(
            "plantf/plantf_tiny.{name}.io.safetensors"
        )));
        let (features, expected) = (features(&scene(name)), inputs(&file));
        let found = features.inputs().unwrap();
        for (what, found, expected) in [
            (
                "current_state",
                &found.current_state,
                &expected.current_state,
            ),
            ("valid", &found.valid, &expected.valid),
            ("heading", &found.heading, &expected.heading),
            ("velocity", &found.velocity, &expected.velocity),
            ("shape", &found.shape, &expected.shape),
            ("category", &found.category, &expected.category),
            ("position", &found.position, &expected.position),
            ("map valid", &found.map.valid, &expected.map.valid),
            ("kind", &found.map.kind, &expected.map.kind),
            ("on route", &found.map.on_route, &expected.map.on_route),
            ("light", &found.map.light, &expected.map.light),
            (
                "speed limit",
                &found.map.speed_limit,
                &expected.map.speed_limit,
            ),
            (
                "has speed limit",
                &found.map.has_speed_limit,
                &expected.map.has_speed_limit,
            ),
            ("center", &found.map.center, &expected.map.center),
            ("point", &found.map.point, &expected.map.point),
            ("vector", &found.map.vector, &expected.map.vector),
            (
                "orientation",
                &found.map.orientation,
                &expected.map.orientation,
            ),
        ] {
            assert_close(&format!("{name} {what}"), found, expected, FEATURES);
        }
        for side in 0..3 {
            let of_side = |read: fn(&LineFeatures) -> &[[f32; 2]; 20]| -> Tensor {
                let lines = features
                    .map
                    .polygons
                    .iter()
                    .map(|polygon| &polygon.lines[side]);
                let values: Vec<f32> = lines
                    .flat_map(|line| read(line).as_flattened())
                    .copied()
                    .collect();
                Tensor::from_vec(
                    values,
                    (1, features.map.polygons.len(), 20, 2),
                    &candle_core::Device::Cpu,
                )
                .unwrap()
            };
            let expected = |key: &str| {
                file.get(key)
                    .narrow(2, side, 1)
                    .unwrap()
                    .squeeze(2)
                    .unwrap()
            };
            let points = of_side(|line| &line.point);
            assert_close(
                &format!("{name} points of {side}"),
                &points,
                &expected("in.map.point_position"),
                FEATURES,
            );
            let vectors = of_side(|line| &line.vector);
            assert_close(
                &format!("{name} vectors of {side}"),
                &vectors,
                &expected("in.map.point_vector"),
                FEATURES,
            );
        }
    }
}

fn road() -> SceneBuilder {
    Scene::builder()
        .lanes(2, [[0.0, 0.0], [300.0, 0.0]])
        .ego([50.0, 0.0], 0.0, 8.0)
}

/// No agents, two hundred of them, an ego beside its route, an ego far from every road: each gives
/// a finite plan.
#[test]
fn unusual_scenes_give_finite_plans() {
    let crowd = (0..200).fold(road(), |road, i| {
        road.object(
            ObjectKind::Pedestrian,
            [f64::from(i), 8.0 + f64::from(i % 7)],
            0.3,
            1.0,
        )
    });
    let lost = Scene::builder()
        .lane([[0.0, 0.0], [300.0, 0.0]])
        .ego([50.0, 900.0], 2.0, 0.0);
    let network = network(|weights| PlanTf::take(weights, TINY));
    for (what, builder, agents) in [
        ("empty", road(), 1),
        ("crowd", crowd, 33),
        ("lost", lost, 1),
    ] {
        let features = features(&builder.build().unwrap());
        assert_eq!(features.agents.len(), agents, "{what}");
        let outputs = network
            .forward(&features.inputs().unwrap(), &Probe::off())
            .unwrap();
        let plan: Vec<f32> = outputs
            .best()
            .unwrap()
            .flatten_all()
            .unwrap()
            .to_vec1()
            .unwrap();
        assert!(plan.iter().all(|value| value.is_finite()), "{what}");
    }
}
