//! Names keep their scenarios: results, suites and labels refer to scenarios by name.

use super::super::{Spec, generate, types};
use super::CORPUS;
use crate::geometry::Point;
use crate::scenario::Scenario;
use rayon::prelude::*;

/// BLAKE3 of the scenes of the tests, a line each: name, length of the expert's path in centimetres, objects at the start.
const CORPUS_DIGEST: &str = "680c75eaa0c18188d1b27b4be5541b1e16d2f4c073ff5baeed7e01fe0bb996eb";

/// Digests of seed 3 of each type, without and with a traffic seed.
const DIGESTS: [&str; 1] = [""];

fn line(scenario: &Scenario) -> String {
    let steps = scenario.expert().zip(scenario.expert().skip(1));
    let length: f64 = steps.map(|(a, b)| a.rear_axle.distance(&b.rear_axle)).sum();
    let objects = scenario.frame(0).map_or(0, |frame| frame.objects.len());
    format!("{} {:.0} {objects}\n", scenario.id, length * 100.0)
}

/// BLAKE3 of every number of a scene: map, route, ego, objects, lights.
fn digest(scenario: &Scenario) -> String {
    let mut numbers: Vec<f64> = Vec::new();
    let points = |points: &[Point]| -> Vec<f64> { points.iter().flat_map(|point| [point.x, point.y]).collect() };
    for lane in scenario.map.lanes() {
        numbers.extend(points(lane.centerline.vertices()));
        numbers.extend(points(lane.polygon.ring()));
        numbers.push(lane.speed_limit.unwrap_or(-1.0));
    }
    let map = &scenario.map;
    for area in [map.intersections(), map.crosswalks(), map.generic_drivable(), map.carparks()].into_iter().flatten() {
        numbers.extend(points(area.ring()));
    }
    numbers.extend(scenario.route.roadblocks.iter().map(|block| map[*block].source_id as f64));
    for frame in &scenario.frames {
        let ego = &frame.ego;
        numbers.extend([ego.time_us as f64, ego.rear_axle.x, ego.rear_axle.y, ego.rear_axle.heading]);
        numbers.extend([ego.velocity.x, ego.velocity.y, ego.acceleration.x, ego.acceleration.y]);
        for object in frame.objects.iter() {
            let (center, shape) = (object.shape.center, object.shape);
            numbers.extend([f64::from(object.token.0), center.x, center.y, center.heading, shape.length, shape.width]);
            numbers.extend([object.velocity.x, object.velocity.y, f64::from(object.kind as u8)]);
        }
        numbers.extend(frame.lights.iter().map(|(lane, status)| (lane.index() * 10 + status as usize) as f64));
    }
    let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_bits().to_le_bytes()).collect();
    format!("{} {}", scenario.id, &blake3::hash(&bytes).to_hex()[..16])
}

#[test]
fn the_scenes_of_the_tests_stay() {
    let lines: String = CORPUS.iter().map(|generated| line(&generated.scenario)).collect();
    assert_eq!(blake3::hash(lines.as_bytes()).to_hex().as_str(), CORPUS_DIGEST, "{lines}");
}

#[test]
fn every_number_of_a_scene_of_each_type_stays() {
    let own = types::ALL.iter().map(|&kind| Spec::new(kind, 3));
    let specs: Vec<Spec> = own.flat_map(|spec| [spec, spec.with_traffic_seed(1)]).collect();
    let digests: Vec<String> = specs.par_iter().map(|spec| digest(&generate(spec).unwrap())).collect();
    assert_eq!(digests, DIGESTS);
}
