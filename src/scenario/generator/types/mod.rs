//! The scenario types that the generator makes, a file each.
//!
//! To add one, write its file with a `TYPE` of a seed constant of its own, and list it in [`ALL`].

pub mod behind_long_vehicle;
mod case_red_light;
mod case_roundabout;
pub mod changing_lane;
pub mod following_lane_with_lead;
pub mod high_lateral_acceleration;
pub mod high_magnitude_speed;
pub mod low_magnitude_speed;
pub mod near_multiple_vehicles;
pub mod starting_left_turn;
pub mod starting_right_turn;
pub mod starting_straight_traffic_light_intersection_traversal;
pub mod stationary_in_traffic;
pub mod stopping_with_lead;
pub mod traversing_intersection;
pub mod traversing_pickup_dropoff;
pub mod traversing_roundabout;
pub mod waiting_for_pedestrian_to_cross;

use super::scenario_type::{ScenarioType, TypeGroup};

/// All types. Suites list their scenes in this order, so a new type goes to the end of its group.
pub const ALL: &[ScenarioType] = &[
    starting_left_turn::TYPE,
    starting_right_turn::TYPE,
    starting_straight_traffic_light_intersection_traversal::TYPE,
    stopping_with_lead::TYPE,
    high_lateral_acceleration::TYPE,
    high_magnitude_speed::TYPE,
    low_magnitude_speed::TYPE,
    traversing_pickup_dropoff::TYPE,
    waiting_for_pedestrian_to_cross::TYPE,
    behind_long_vehicle::TYPE,
    stationary_in_traffic::TYPE,
    near_multiple_vehicles::TYPE,
    changing_lane::TYPE,
    following_lane_with_lead::TYPE,
    traversing_intersection::TYPE,
    traversing_roundabout::TYPE,
    case_roundabout::TYPE,
    case_red_light::TYPE,
];

/// The types of the suite `generated`: all but the cases of the paper.
pub fn in_suites() -> impl Iterator<Item = ScenarioType> {
    ALL.iter()
        .copied()
        .filter(|kind| kind.group() != TypeGroup::Case)
}

/// The fourteen types of nuPlan's benchmarks (Val14, Test14).
pub fn nuplan14() -> impl Iterator<Item = ScenarioType> {
    ALL.iter()
        .copied()
        .filter(|kind| kind.group() == TypeGroup::Nuplan14)
}

/// The type of this name.
pub fn named(name: &str) -> Option<ScenarioType> {
    ALL.iter().copied().find(|kind| kind.name() == name)
}
