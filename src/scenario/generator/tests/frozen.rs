//! Names keep their scenarios: results, suites and labels refer to scenarios by name.

use super::super::{Spec, generate, types};
use super::CORPUS;
use crate::geometry::Point;
use crate::scenario::Scenario;
use rayon::prelude::*;

/// BLAKE3 of the scenarios of the tests, one line each: name, length of the expert's path in centimeters, objects at the start.
const CORPUS_DIGEST: &str = "680c75eaa0c18188d1b27b4be5541b1e16d2f4c073ff5baeed7e01fe0bb996eb";

/// Digests of seed 3 of each type, without and with a traffic seed.
const DIGESTS: [&str; 36] = [
    "generated/starting_left_turn/3 d3f41040617e7cdf",
    "generated/starting_left_turn/3.1 c6b624943e833728",
    "generated/starting_right_turn/3 9ff345ffc6ff2f80",
    "generated/starting_right_turn/3.1 1cc62d53eb9261db",
    "generated/starting_straight_traffic_light_intersection_traversal/3 d629897a8a55c99e",
    "generated/starting_straight_traffic_light_intersection_traversal/3.1 d5e6f9e573f1fe9c",
    "generated/stopping_with_lead/3 a641e047265f0132",
    "generated/stopping_with_lead/3.1 d289478319b824fb",
    "generated/high_lateral_acceleration/3 0e8e4e538f04a53d",
    "generated/high_lateral_acceleration/3.1 6c7b05cc1ad0fe04",
    "generated/high_magnitude_speed/3 71a087b4b1208882",
    "generated/high_magnitude_speed/3.1 d26b4a07baf18c92",
    "generated/low_magnitude_speed/3 433b2693ab9c7335",
    "generated/low_magnitude_speed/3.1 d7b4c96e00796f2c",
    "generated/traversing_pickup_dropoff/3 68e2b86b896a8cd0",
    "generated/traversing_pickup_dropoff/3.1 a428587c2198b5ae",
    "generated/waiting_for_pedestrian_to_cross/3 0e09e478736a12bc",
    "generated/waiting_for_pedestrian_to_cross/3.1 0786b3b63c791b69",
    "generated/behind_long_vehicle/3 a4927f053daee2f5",
    "generated/behind_long_vehicle/3.1 4a679177ab3498c9",
    "generated/stationary_in_traffic/3 f48be24b7471ba60",
    "generated/stationary_in_traffic/3.1 1fc53abbcef65804",
    "generated/near_multiple_vehicles/3 6469329c0c99ccc9",
    "generated/near_multiple_vehicles/3.1 a88346d53c7b7486",
    "generated/changing_lane/3 542ce04e5062b544",
    "generated/changing_lane/3.1 e7ecb2c0a8f6ce84",
    "generated/following_lane_with_lead/3 66e4e0ec467bd27b",
    "generated/following_lane_with_lead/3.1 dcaab04cc484e5c3",
    "generated/traversing_intersection/3 08346b86af5de11b",
    "generated/traversing_intersection/3.1 c273188372a8b483",
    "generated/traversing_roundabout/3 151273f945b0b7bb",
    "generated/traversing_roundabout/3.1 bc744c54b294b145",
    "generated/case_roundabout/3 7175546dc8f3ca5a",
    "generated/case_roundabout/3.1 f987d78a563fecd6",
    "generated/case_red_light/3 3fb8cc940cd4725c",
    "generated/case_red_light/3.1 670959121368b994",
];

fn line(scenario: &Scenario) -> String {
    let steps = scenario.expert().zip(scenario.expert().skip(1));
    let length: f64 = steps.map(|(a, b)| a.rear_axle.distance(&b.rear_axle)).sum();
    let objects = scenario.frame(0).map_or(0, |frame| frame.objects.len());
    format!("{} {:.0} {objects}\n", scenario.id, length * 100.0)
}

/// BLAKE3 of every number of a scenario: map, route, ego, objects, lights.
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
fn the_scenarios_of_the_tests_stay() {
    let lines: String = CORPUS.iter().map(|generated| line(&generated.scenario)).collect();
    assert_eq!(blake3::hash(lines.as_bytes()).to_hex().as_str(), CORPUS_DIGEST, "{lines}");
}

#[test]
fn every_number_of_a_scenario_of_each_type_stays() {
    let own = types::ALL.iter().map(|&kind| Spec::new(kind, 3));
    let specs: Vec<Spec> = own.flat_map(|spec| [spec, spec.with_traffic_seed(1)]).collect();
    let digests: Vec<String> = specs.par_iter().map(|spec| digest(&generate(spec).unwrap())).collect();
    assert_eq!(digests, DIGESTS);
}
