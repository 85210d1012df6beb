//! UrbanDriver.

use super::scene::scene;
use super::vectors::{FEATURES, NETWORK, Vectors, assert_close, assert_manifest, fixture, network};
use candle_core::DType;
use planagent_learned::Probe;
use planagent_learned::urban_driver::{
    ElementLimits, Elements, UrbanDriver, UrbanDriverConfig, UrbanDriverFeatures,
};

const TINY: UrbanDriverConfig = UrbanDriverConfig {
    embedding: 32,
    layers: 2,
};
const TINY_LIMITS: ElementLimits = ElementLimits {
    vehicles: 6,
    layers: [8, 8, 8, 3, 4, 6],
};

fn check(network: &UrbanDriver, limits: ElementLimits, file: &Vectors, name: &str) {
    let [a, b, c, d, e, f] = limits.layers;
    let elements = Elements {
        points: file.get("mid.elements").clone(),
        available: file.of_kind(DType::U8, "mid.availability"),
        counts: [1, limits.vehicles, a, b, c, d, e, f],
    };
    let probe = Probe::on();
    let plan = network.forward(&elements, &probe).unwrap();
    // The files of the full network are without these.
    if !name.starts_with("urban_full") {
        let embedded = probe
            .get("feature_embedding")
            .unwrap()
            .narrow(1, 0, 4)
            .unwrap();
        assert_close(
            &format!("{name} embedding"),
            &embedded,
            file.get("mid.feature_embedding_first4"),
            NETWORK,
        );
        let subgraph = probe.get("local_subgraph").unwrap();
        assert_close(
            &format!("{name} subgraph"),
            &subgraph,
            file.get("mid.local_subgraph"),
            NETWORK,
        );
        let kinds = probe.get("type_embedding").unwrap().unsqueeze(0).unwrap();
        assert_close(
            &format!("{name} kinds"),
            &kinds,
            file.get("mid.type_embedding"),
            NETWORK,
        );
    }
    let mixed = probe.get("attention").unwrap().transpose(0, 1).unwrap();
    assert_close(
        &format!("{name} attention"),
        &mixed,
        file.get("mid.attention"),
        NETWORK,
    );
    assert_close(name, &plan, file.get("out.trajectory"), NETWORK);
}

#[test]
fn the_tiny_network_computes_what_pytorch_computes() {
    let network = network(|weights| UrbanDriver::take(weights, TINY));
    for source in ["random", "scene_a", "scene_b"] {
        let file = Vectors::open(&fixture(&format!(
            "urban_driver/urban_tiny.{source}.io.safetensors"
        )));
        check(
            &network,
            TINY_LIMITS,
            &file,
            &format!("urban_tiny.{source}"),
        );
    }
}

#[test]
fn the_full_network_computes_what_pytorch_computes() {
    let network = network(|weights| UrbanDriver::take(weights, UrbanDriverConfig::PUBLISHED));
    for source in ["random", "scene_a", "scene_b"] {
        let file = Vectors::open(&fixture(&format!(
            "urban_driver/urban_full.{source}.io.safetensors"
        )));
        check(
            &network,
            ElementLimits::PUBLISHED,
            &file,
            &format!("urban_full.{source}"),
        );
    }
}

#[test]
fn the_tensors_are_those_of_the_manifest() {
    let take = |weights: &mut _| UrbanDriver::take(weights, UrbanDriverConfig::PUBLISHED);
    assert_manifest("urban_driver/urban_full.manifest.json", take);
}

#[test]
fn the_features_are_those_of_the_original() {
    for name in ["scene_a", "scene_b"] {
        let features = UrbanDriverFeatures::from_scene(&scene(name).view());
        let file = Vectors::open(&fixture(&format!(
            "urban_driver/urban_tiny.{name}.io.safetensors"
        )));
        let elements = Elements::from_scenes(&[features], TINY_LIMITS).unwrap();
        assert_close(
            &format!("{name} available"),
            &elements.available,
            file.get("mid.availability"),
            FEATURES,
        );
        assert_close(
            &format!("{name} elements"),
            &elements.points,
            file.get("mid.elements"),
            FEATURES,
        );
    }
}

#[test]
fn the_features_are_those_of_the_original_within_the_published_limits() {
    for name in ["scene_a", "scene_b"] {
        let file = Vectors::open(&fixture(&format!(
            "urban_driver/urban_full.{name}.io.safetensors"
        )));
        let elements = Elements::from_scenes(
            &[UrbanDriverFeatures::from_scene(&scene(name).view())],
            ElementLimits::PUBLISHED,
        )
        .unwrap();
        assert_close(
            &format!("{name} elements"),
            &elements.points,
            file.get("mid.elements"),
            FEATURES,
        );
    }
}
