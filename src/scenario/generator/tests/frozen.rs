//! Names keep their scenarios: results, suites and labels refer to scenarios by name.

use super::super::{Spec, generate, types};
use super::CORPUS;
use crate::Scenario;
use planagent_world::geometry::Point;
use rayon::prelude::*;

/// BLAKE3 of the scenarios of the tests, one line each: name, length of the expert's path in
/// centimeters, objects at the start.
const CORPUS_DIGEST: &str = "680c75eaa0c18188d1b27b4be5541b1e16d2f4c073ff5baeed7e01fe0bb996eb";

/// Digests of seed 3 of each type, without and with a traffic seed.
const DIGESTS: [&str; 36] = [
    "generated/starting_left_turn/3 b72039a173723489",
    "generated/starting_left_turn/3.1 661b48b4b91f2f26",
    "generated/starting_right_turn/3 0836a8c07466d436",
    "generated/starting_right_turn/3.1 1b1578a9e2d50840",
    "generated/starting_straight_traffic_light_intersection_traversal/3 bc2b9121fb34b06e",
    "generated/starting_straight_traffic_light_intersection_traversal/3.1 565c7c9fe5a913f9",
    "generated/stopping_with_lead/3 38f71a34c380203a",
    "generated/stopping_with_lead/3.1 e6e37c402f01ca1c",
    "generated/high_lateral_acceleration/3 4a0387ede73dfff3",
    "generated/high_lateral_acceleration/3.1 84191eed7b77241f",
    "generated/high_magnitude_speed/3 36c2f928c7607f44",
    "generated/high_magnitude_speed/3.1 0e3163b575578dab",
    "generated/low_magnitude_speed/3 72d368d31ecdc8f9",
    "generated/low_magnitude_speed/3.1 cc1020daf5843d70",
    "generated/traversing_pickup_dropoff/3 2e79416b16f5524c",
    "generated/traversing_pickup_dropoff/3.1 df86d6cba0abac9d",
    "generated/waiting_for_pedestrian_to_cross/3 a8abfd82b0c5c4ab",
    "generated/waiting_for_pedestrian_to_cross/3.1 1d37b4576748b34f",
    "generated/behind_long_vehicle/3 db59c7aeadd4d1c9",
    "generated/behind_long_vehicle/3.1 d4eae03fdadf82cc",
    "generated/stationary_in_traffic/3 1b8b97d3c18ff28c",
    "generated/stationary_in_traffic/3.1 a8679c2dcb293a10",
    "generated/near_multiple_vehicles/3 cf7921e3893aa2eb",
    "generated/near_multiple_vehicles/3.1 1b762a03bade2ef1",
    "generated/changing_lane/3 59a0721f8726fcd4",
    "generated/changing_lane/3.1 b7d5973fcf26a6f8",
    "generated/following_lane_with_lead/3 c29b1f4a40597b89",
    "generated/following_lane_with_lead/3.1 3bdf5ac426f31946",
    "generated/traversing_intersection/3 31cef728d8e0ae55",
    "generated/traversing_intersection/3.1 e9e41c96020c4b09",
    "generated/traversing_roundabout/3 e535fea2befcf9da",
    "generated/traversing_roundabout/3.1 ff66907677860f33",
    "generated/case_roundabout/3 ac57a0cd1b1cc2c3",
    "generated/case_roundabout/3.1 2d1278dc68bd1d41",
    "generated/case_red_light/3 7f27408350ffdae4",
    "generated/case_red_light/3.1 12228da39bd2bd58",
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
    let points = |points: &[Point]| -> Vec<f64> {
        points.iter().flat_map(|point| [point.x, point.y]).collect()
    };
    for lane in scenario.map.lanes() {
        numbers.extend(points(lane.centerline.vertices()));
        numbers.extend(points(lane.polygon.ring()));
        numbers.push(lane.speed_limit.unwrap_or(-1.0));
    }
    let map = &scenario.map;
    for area in [
        map.intersections(),
        map.crosswalks(),
        map.generic_drivable(),
        map.carparks(),
    ]
    .into_iter()
    .flatten()
    {
        numbers.extend(points(area.ring()));
    }
    numbers.extend(
        scenario
            .route
            .roadblocks
            .iter()
            .map(|block| map[*block].source_id as f64),
    );
    for frame in &scenario.frames {
        let ego = &frame.ego;
        numbers.extend([
            ego.time_us as f64,
            ego.rear_axle.x,
            ego.rear_axle.y,
            ego.rear_axle.heading,
        ]);
        numbers.extend([
            ego.velocity.x,
            ego.velocity.y,
            ego.acceleration.x,
            ego.acceleration.y,
        ]);
        for object in frame.objects.iter() {
            let (center, shape) = (object.shape.center, object.shape);
            numbers.extend([
                f64::from(object.token.0),
                center.x,
                center.y,
                center.heading,
                shape.length,
                shape.width,
            ]);
            numbers.extend([
                object.velocity.x,
                object.velocity.y,
                f64::from(object.kind as u8),
            ]);
        }
        numbers.extend(
            frame
                .lights
                .iter()
                .map(|(lane, status)| (lane.index() * 10 + status as usize) as f64),
        );
    }
    let bytes: Vec<u8> = numbers
        .iter()
        .flat_map(|number| number.to_bits().to_le_bytes())
        .collect();
    format!("{} {}", scenario.id, &blake3::hash(&bytes).to_hex()[..16])
}

#[test]
fn the_scenarios_of_the_tests_stay() {
    let lines: String = CORPUS
        .iter()
        .map(|generated| line(&generated.scenario))
        .collect();
    assert_eq!(
        blake3::hash(lines.as_bytes()).to_hex().as_str(),
        CORPUS_DIGEST,
        "{lines}"
    );
}

#[test]
fn every_number_of_a_scenario_of_each_type_stays() {
    let own = types::ALL.iter().map(|&kind| Spec::new(kind, 3));
    let specs: Vec<Spec> = own
        .flat_map(|spec| [spec, spec.with_traffic_seed(1)])
        .collect();
    let digests: Vec<String> = specs
        .par_iter()
        .map(|spec| digest(&generate(spec).unwrap()))
        .collect();
    assert_eq!(digests, DIGESTS);
}
