//! RasterModel's network.

use super::scene::scene;
use super::vectors::{
    FEATURES, NETWORK, Vectors, assert_close, assert_manifest, fixture, json, manifest_of, network,
};
use candle_core::{DType, Tensor};
use planagent_learned::Probe;
use planagent_learned::raster_model::{Canvas, Raster, RasterModel, RasterModelConfig, Vertex};

const TINY: RasterModelConfig = RasterModelConfig {
    widths: [4, 8, 16, 32],
};

fn halved(raster: &Tensor) -> Tensor {
    (raster.to_dtype(DType::F32).unwrap() / 2.0).unwrap()
}

fn check(network: &RasterModel, tiny: &Vectors, file: &Vectors, name: &str) {
    let probe = Probe::on();
    let plan = network
        .forward(&halved(tiny.get("random64.in.raster_times_2")), &probe)
        .unwrap();
    // The file of the full network is without the first two.
    let mids = [
        "bn1",
        "layer1",
        "maxpool",
        "layer2",
        "layer3",
        "layer4",
        "global_pool",
    ];
    for mid in &mids[if name == "raster_model_full" { 2 } else { 0 }..] {
        let found = probe
            .get(&format!("_model.{mid}"))
            .unwrap()
            .narrow(0, 0, 1)
            .unwrap();
        assert_close(
            &format!("{name} {mid}"),
            &found,
            file.get(&format!("random64.mid._model.{mid}")),
            NETWORK,
        );
    }
    assert_close(
        &format!("{name} random64"),
        &plan,
        file.get("random64.out.trajectory"),
        NETWORK,
    );
}

fn check_scene(network: &RasterModel, scene: &str, file: &Vectors, name: &str) {
    let raster = Vectors::open(&fixture(&format!("raster/raster_{scene}.safetensors")));
    let raster = halved(&raster.get("raster_chw_times_2").unsqueeze(0).unwrap());
    let plan = network.forward(&raster, &Probe::off()).unwrap();
    assert_close(
        &format!("{name} {scene}"),
        &plan,
        file.get(&format!("{scene}.out.trajectory")),
        NETWORK,
    );
}

#[test]
fn the_tiny_network_computes_what_pytorch_computes() {
    let network = network(|weights| RasterModel::take(weights, TINY));
    let file = Vectors::open(&fixture("raster/raster_model_tiny.io.safetensors"));
    check(&network, &file, &file, "raster_model_tiny");
    for scene in ["scene_a", "scene_b"] {
        check_scene(&network, scene, &file, "raster_model_tiny");
    }
}

#[test]
fn the_full_network_computes_what_pytorch_computes() {
    let network = network(|weights| RasterModel::take(weights, RasterModelConfig::PUBLISHED));
    let tiny = Vectors::open(&fixture("raster/raster_model_tiny.io.safetensors"));
    let file = Vectors::open(&fixture("raster/raster_model_full.io.safetensors"));
    check(&network, &tiny, &file, "raster_model_full");
    for scene in ["scene_a", "scene_b"] {
        check_scene(&network, scene, &file, "raster_model_full");
    }
}

#[test]
fn the_tensors_are_those_of_the_manifest() {
    let take = |weights: &mut _| RasterModel::take(weights, RasterModelConfig::PUBLISHED);
    assert_manifest("raster/raster_model_full.manifest.json", take);
}

#[test]
fn a_block_that_keeps_its_shape_has_no_shortcut() {
    let shortcuts = |config: RasterModelConfig| {
        let tensors = manifest_of(|weights| RasterModel::take(weights, config));
        tensors
            .iter()
            .filter(|(name, _)| name.starts_with("_model.layer1.0.downsample."))
            .count()
    };
    assert_eq!(shortcuts(RasterModelConfig::PUBLISHED), 6);
    assert_eq!(shortcuts(RasterModelConfig::SMALL), 0);
}

#[test]
fn shapes_are_drawn_as_opencv_draws_them() {
    let cases = json("raster/fill_cases.json");
    for (i, case) in cases["cases"].as_array().unwrap().iter().enumerate() {
        let place = |value: &serde_json::Value| value.as_i64().unwrap();
        let vertices = case["fixed_point"]
            .as_array()
            .unwrap()
            .iter()
            .map(|vertex| [place(&vertex[0]), place(&vertex[1])]);
        let vertices: Vec<Vertex> = vertices.collect();
        let shift = case["shift"].as_u64().unwrap() as u32;
        let mut canvas = Canvas::new(24);
        match case["op"].as_str().unwrap() {
            "fillPoly" => canvas.polygon(&vertices, shift, 1.0),
            "polylines_open" => canvas.line(&vertices, shift, 1.0),
            other => panic!("{other}"),
        }
        let row = |row: &[f32]| {
            row.iter()
                .map(|value| if *value == 0.0 { '0' } else { '2' })
                .collect::<String>()
        };
        let drawn: Vec<String> = canvas.pixels.chunks_exact(24).map(row).collect();
        let expected: Vec<&str> = case["rows"]
            .as_array()
            .unwrap()
            .iter()
            .map(|row| row.as_str().unwrap())
            .collect();
        assert_eq!(drawn, expected, "case {i}: {}", case["op"]);
    }
}

#[test]
fn the_rasters_are_those_of_the_original() {
    for name in ["scene_a", "scene_b"] {
        let raster = Raster::from_scene(&scene(name).view())
            .inputs()
            .unwrap()
            .squeeze(0)
            .unwrap();
        let expected = Vectors::open(&fixture(&format!("raster/raster_{name}.safetensors")));
        let expected = halved(expected.get("raster_chw_times_2"));
        for (channel, what) in ["ego", "agents", "road", "baselines"].iter().enumerate() {
            let one = |raster: &Tensor| raster.narrow(0, channel, 1).unwrap();
            assert_close(
                &format!("{name} {what}"),
                &one(&raster),
                &one(&expected),
                FEATURES,
            );
        }
    }
}
